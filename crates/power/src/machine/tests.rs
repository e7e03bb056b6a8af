//! Promises of the machine's condition, on fixture trees.

use super::*;

struct Tree(tempfile::TempDir);

impl Tree {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn write(&self, file: &str, text: &str) {
        let path = self.0.path().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, format!("{text}\n")).unwrap();
    }

    fn config(&self) -> PowerConfig {
        PowerConfig {
            sysfs: self.0.path().to_owned(),
            nvpmodel: self.0.path().join("nvpmodel"),
            ..PowerConfig::default()
        }
    }

    /// Puts the stand-in for nvpmodel there, which says `says`.
    fn nvpmodel(&self, says: &str) {
        let fake = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/fake_nvpmodel");
        std::os::unix::fs::symlink(fake, self.0.path().join("nvpmodel")).unwrap();
        self.write("nvpmodel.says", says);
    }
}

/// Waits until a question that was asked has its answer.
fn answered(machine: &mut Machine) {
    while machine.mode.question.is_some() {
        std::thread::sleep(Duration::from_millis(1));
        machine.mode.take_answer();
    }
}

#[test]
fn a_machine_that_tells_nothing_has_an_empty_condition() {
    let tree = Tree::new();
    let mut machine = Machine::new(&tree.config());
    assert_eq!(machine.read(Instant::now()), Condition::default());
}

#[test]
fn the_hottest_sensor_that_is_on_is_told_with_mean_clocks() {
    let tree = Tree::new();
    tree.write("class/thermal/thermal_zone0/type", "cpu-thermal");
    tree.write("class/thermal/thermal_zone0/temp", "51250");
    tree.write("class/thermal/thermal_zone1/type", "gpu-thermal");
    tree.write("class/thermal/thermal_zone1/temp", "-256000");
    tree.write(
        "devices/system/cpu/cpu0/cpufreq/scaling_cur_freq",
        "1000000",
    );
    tree.write(
        "devices/system/cpu/cpu1/cpufreq/scaling_cur_freq",
        "2000000",
    );
    tree.write("devices/system/cpu/cpufreq/boost", "1");
    tree.write("class/devfreq/17000000.gpu/cur_freq", "612000000");
    let mut machine = Machine::new(&tree.config());
    let found = machine.read(Instant::now());
    assert_eq!(found.hottest, Some(("cpu-thermal".into(), 51.25)));
    assert_eq!(found.cpu_mhz, Some(1500.0));
    assert_eq!(found.gpu_mhz, Some(612.0));
    assert_eq!(found.throttled, None, "nothing here reports throttling");
}

#[test]
fn throttling_shows_in_cooling_devices_but_not_in_fans() {
    let tree = Tree::new();
    tree.write("class/thermal/cooling_device0/type", "pwm-fan");
    tree.write("class/thermal/cooling_device0/cur_state", "3");
    tree.write("class/thermal/cooling_device1/type", "cpufreq-cpu0");
    tree.write("class/thermal/cooling_device1/cur_state", "0");
    let mut machine = Machine::new(&tree.config());
    assert_eq!(machine.read(Instant::now()).throttled, Some(false));
    tree.write("class/thermal/cooling_device1/cur_state", "2");
    assert_eq!(machine.read(Instant::now()).throttled, Some(true));
}

#[test]
fn throttling_shows_in_event_counters_that_rise_and_only_then() {
    let tree = Tree::new();
    let counter = "devices/system/cpu/cpu0/thermal_throttle/core_throttle_count";
    tree.write(counter, "41");
    tree.write("class/hwmon/hwmon1/oc1_event_cnt", "0");
    let mut machine = Machine::new(&tree.config());
    assert_eq!(machine.read(Instant::now()).throttled, Some(false));
    assert_eq!(machine.read(Instant::now()).throttled, Some(false));
    tree.write("class/hwmon/hwmon1/oc1_event_cnt", "1");
    assert_eq!(machine.read(Instant::now()).throttled, Some(true));
    assert_eq!(machine.read(Instant::now()).throttled, Some(false));
    tree.write(counter, "42");
    assert_eq!(machine.read(Instant::now()).throttled, Some(true));
}

#[test]
fn the_power_mode_is_asked_of_nvpmodel_once_a_minute() {
    let tree = Tree::new();
    tree.nvpmodel("NV Fan Mode:quiet\nNV Power Mode: MODE_30W\n2");
    let mut machine = Machine::new(&tree.config());
    let start = Instant::now();
    for second in 0..130 {
        let found = machine.read(start + Duration::from_secs(second));
        assert_eq!(found.mode.as_deref(), Some("MODE_30W"));
        answered(&mut machine);
    }
    let calls = std::fs::read_to_string(tree.0.path().join("nvpmodel.calls")).unwrap();
    assert_eq!(calls, "-q\n-q\n-q\n");
}

#[test]
fn without_nvpmodel_the_platform_profile_is_the_mode() {
    let tree = Tree::new();
    tree.write("firmware/acpi/platform_profile", "low-power");
    let mut machine = Machine::new(&tree.config());
    assert_eq!(
        machine.read(Instant::now()).mode.as_deref(),
        Some("low-power")
    );
    tree.nvpmodel("nvpmodel: permission denied");
    let mut machine = Machine::new(&tree.config());
    assert_eq!(
        machine.read(Instant::now()).mode.as_deref(),
        Some("low-power")
    );
}

#[test]
fn a_slow_nvpmodel_does_not_hold_up_the_reading() {
    let tree = Tree::new();
    tree.nvpmodel("NV Power Mode: MODE_30W");
    let mut machine = Machine::new(&tree.config());
    // From now on it answers when somebody writes into a pipe, and that is after the reading.
    let says = tree.0.path().join("nvpmodel.says");
    std::fs::remove_file(&says).unwrap();
    let made = std::process::Command::new("mkfifo").arg(&says).status();
    assert!(made.unwrap().success());
    let minute = Instant::now() + Duration::from_secs(61);
    assert_eq!(machine.read(minute).mode.as_deref(), Some("MODE_30W"));
    // Another reading meanwhile starts no second one.
    let found = machine.read(minute + Duration::from_secs(90));
    assert_eq!(found.mode.as_deref(), Some("MODE_30W"));
    // On a thread of its own, for a pipe that nobody reads any more is waited for without an end.
    std::thread::spawn(move || std::fs::write(says, "NV Power Mode: MODE_15W\n"));
    answered(&mut machine);
    let found = machine.read(minute + Duration::from_secs(1));
    assert_eq!(found.mode.as_deref(), Some("MODE_15W"));
    let calls = std::fs::read_to_string(tree.0.path().join("nvpmodel.calls")).unwrap();
    assert_eq!(calls, "-q\n-q\n");
}
