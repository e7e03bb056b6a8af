use super::*;
use crate::tests::{Tree, ms};

fn read(tree: &Tree) -> BoardState {
    Machine::new(&tree.config()).read()
}

fn nvpmodel(tree: &Tree, says: &str) {
    let fake = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/fake_nvpmodel");
    std::os::unix::fs::symlink(fake, tree.path("nvpmodel")).unwrap();
    tree.write("nvpmodel.says", says);
}

#[test]
fn the_hottest_usable_sensor_and_the_mean_clocks_are_reported_if_there_are_any() {
    let tree = Tree::default();
    assert_eq!(read(&tree), BoardState::default());
    for (file, text) in [
        ("class/thermal/thermal_zone0/type", "cpu-thermal"),
        ("class/thermal/thermal_zone0/temp", "51250"),
        ("class/thermal/thermal_zone1/type", "gpu-thermal"),
        ("class/thermal/thermal_zone1/temp", "-256000"),
        ("class/thermal/thermal_zone2/type", "PMIC-Die"),
        ("class/thermal/thermal_zone2/temp", "100000"),
        ("devices/system/cpu/cpufreq/boost", "1"),
        ("class/devfreq/17000000.gpu/cur_freq", "612000000"),
    ] {
        tree.write(format!("sys/{file}"), text);
    }
    for cpu in 0..2 {
        let file = format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq");
        tree.write(file, 1_000_000 * (cpu + 1));
    }
    let expected = BoardState {
        hottest_celsius: Some(51.25),
        hottest_sensor: Some("cpu-thermal".to_owned()),
        cpu_mhz: Some(1500.0),
        gpu_mhz: Some(612.0),
        ..BoardState::default()
    };
    assert_eq!(read(&tree), expected);
}

#[test]
fn a_jetsons_gpu_load_is_read_where_each_release_has_it_and_nonsense_is_not_a_figure() {
    for (file, text, share) in [
        ("class/devfreq/17000000.gpu/device/load", "437", Some(0.437)),
        ("class/devfreq/57000000.gpu/device/load", "0", Some(0.0)),
        ("devices/gpu.0/load", "1000", Some(1.0)),
        ("devices/platform/gpu.0/load", "5\n", Some(0.005)),
        ("devices/gpu.0/load", "4294967295", None),
        ("devices/gpu.0/load", "busy", None),
        ("class/devfreq/17000000.ethernet/device/load", "437", None),
    ] {
        let tree = Tree::default();
        tree.write(format!("sys/{file}"), text);
        assert_eq!(read(&tree).gpu_utilisation, share, "{file}: {text}");
    }
}

#[test]
fn throttling_is_an_active_cooling_device_but_no_fan_and_an_event_counter_that_rises() {
    let tree = Tree::default();
    let cool = |device: &str, kind: &str, state: u8| {
        tree.write(format!("sys/class/thermal/{device}/type"), kind);
        tree.write(format!("sys/class/thermal/{device}/cur_state"), state);
    };
    let counter = "sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_count";
    let event = "sys/class/hwmon/hwmon1/oc1_event_cnt";
    cool("cooling_device0", "pwm-fan", 3);
    cool("cooling_device1", "cpufreq-cpu0", 0);
    tree.write(counter, "41");
    tree.write(event, "0");
    let mut machine = Machine::new(&tree.config());
    let mut throttled = || machine.read().throttled;
    assert_eq!([throttled(), throttled()], [Some(false), Some(false)]);
    tree.write(event, "1");
    assert_eq!([throttled(), throttled()], [Some(true), Some(false)]);
    tree.write(counter, "42");
    assert_eq!([throttled(), throttled()], [Some(true), Some(false)]);
    cool("cooling_device1", "cpufreq-cpu0", 2);
    assert_eq!([throttled(), throttled()], [Some(true), Some(true)]);
}

#[test]
fn a_counter_that_was_away_for_a_while_is_no_throttling() {
    let tree = Tree::default();
    let counter =
        |cpu: u8| format!("sys/devices/system/cpu/cpu{cpu}/thermal_throttle/core_throttle_count");
    tree.write(counter(0), "5");
    tree.write(counter(1), "3");
    let mut machine = Machine::new(&tree.config());
    assert_eq!(machine.read().throttled, Some(false));
    // As that of a core that is switched off.
    std::fs::remove_file(tree.path(counter(1))).unwrap();
    assert_eq!(machine.read().throttled, Some(false));
    tree.write(counter(1), "3");
    assert_eq!(machine.read().throttled, Some(false));
    tree.write(counter(1), "4");
    assert_eq!(machine.read().throttled, Some(true));
}

#[test]
fn the_platform_profile_is_the_mode_without_a_working_nvpmodel() {
    let tree = Tree::default();
    tree.write("sys/firmware/acpi/platform_profile", "low-power");
    assert_eq!(read(&tree).power_mode.as_deref(), Some("low-power"));
    nvpmodel(&tree, "nvpmodel: permission denied");
    assert_eq!(read(&tree).power_mode.as_deref(), Some("low-power"));
}

#[test]
fn nvpmodel_is_polled_and_a_slow_answer_blocks_no_reading() {
    let tree = Tree::default();
    nvpmodel(&tree, "NV Fan Mode:quiet\nNV Power Mode: MODE_30W\n2");
    let mut machine = Machine::new(&tree.config());
    assert_eq!(machine.read().power_mode.as_deref(), Some("MODE_30W"));
    let calls = || std::fs::read_to_string(tree.path("nvpmodel.calls")).unwrap();
    assert_eq!(calls(), "-q\n", "the next time in a minute");
    (machine.mode, machine.modes) = follow_mode(tree.path("nvpmodel"), ms(100));
    // From now on it answers only after a write to the pipe.
    let says = tree.path("nvpmodel.says");
    std::fs::remove_file(&says).unwrap();
    let made = Command::new("mkfifo").arg(&says).status();
    assert!(made.unwrap().success());
    while calls().lines().count() < 3 {
        assert_eq!(machine.read().power_mode.as_deref(), Some("MODE_30W"));
        std::thread::sleep(ms(5));
    }
    std::fs::write(says, "NV Power Mode: MODE_15W\n").unwrap();
    while machine.read().power_mode.as_deref() != Some("MODE_15W") {
        std::thread::sleep(ms(5));
    }
}
