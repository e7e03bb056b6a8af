//! Promises of the hwmon meters, on trees in the documented layout.

use super::*;
use crate::reading::Domain;

struct Tree(tempfile::TempDir);

impl Tree {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// An INA3221 with up to three rails of (label, mV, mA), and the files that are no rails.
    fn ina3221(&self, directory: &str, rails: &[(&str, i64, i64)]) {
        self.write(directory, "name", "ina3221");
        for (i, (label, voltage, current)) in (1..).zip(rails) {
            self.write(directory, &format!("in{i}_label"), label);
            self.write(directory, &format!("in{i}_input"), &voltage.to_string());
            self.write(directory, &format!("curr{i}_input"), &current.to_string());
            self.write(directory, &format!("in{i}_enable"), "1");
            self.write(directory, &format!("in{}_input", i + 3), "999");
        }
        self.write(directory, "in7_label", "sum of shunt voltages");
        self.write(directory, "in7_input", "99999");
        self.write(directory, "curr4_input", "99999");
    }

    fn write(&self, directory: &str, file: &str, text: &str) {
        let directory = self.0.path().join(directory);
        std::fs::create_dir_all(&directory).unwrap();
        std::fs::write(directory.join(file), format!("{text}\n")).unwrap();
    }

    fn open(&self) -> Result<Ina, MeterError> {
        Ina::open(&PowerConfig {
            sysfs: self.0.path().to_owned(),
            ..PowerConfig::default()
        })
    }

    fn watts(&self, domain: Domain) -> Option<f64> {
        let reading = self.open().unwrap().poll(Instant::now()).unwrap().remove(0);
        reading.value(domain)?.watts()
    }
}

/// One idle AGX Thor, as quoted in public code.
const THOR: [(&str, i64, i64); 3] = [
    ("VDD_GPU", 12040, 640),
    ("VDD_CPU_SOC_MSS", 12040, 960),
    ("VIN_SYS_5V0", 5088, 1740),
];

fn close(found: Option<f64>, expected: f64) -> bool {
    found.is_some_and(|f| (f - expected).abs() < 1e-9)
}

#[test]
fn power_is_voltage_times_current_and_shunt_inputs_are_no_rails() {
    let tree = Tree::new();
    tree.ina3221("class/hwmon/hwmon3", &THOR);
    assert!(close(tree.watts(Domain::Gpu), 7.7056));
    assert!(close(tree.watts(Domain::Total), 7.7056 + 11.5584 + 8.85312));
    assert_eq!(tree.open().unwrap().channels.len(), 3);
}

#[test]
fn thors_input_monitor_is_the_total() {
    let tree = Tree::new();
    tree.ina3221("class/hwmon/hwmon2", &THOR);
    tree.write("class/hwmon/hwmon5", "name", "ina238");
    tree.write("class/hwmon/hwmon5", "power1_input", "31250000");
    assert!(close(tree.watts(Domain::Total), 31.25));
    let reading = tree.open().unwrap().poll(Instant::now()).unwrap().remove(0);
    assert_eq!(&*reading.total_from, "input_rail");
}

#[test]
fn two_monitors_of_one_board_are_one_reading() {
    let tree = Tree::new();
    let rails = [
        ("VDD_GPU_SOC", 20000, 100),
        ("VDD_CPU_CV", 20000, -20),
        ("VIN_SYS_5V0", 5000, 800),
    ];
    tree.ina3221("class/hwmon/hwmon3", &rails);
    let second = "class/hwmon/hwmon4";
    tree.ina3221(second, &[("NC", 0, 0), ("VDDQ_VDD2_1V8AO", 5000, 80)]);
    assert!(close(tree.watts(Domain::Total), 6.0));
    assert!(close(tree.watts(Domain::Cpu), 0.0));
    assert_eq!(tree.open().unwrap().channels.len(), 4);
}

#[test]
fn a_channel_that_is_off_or_fails_is_missing_and_not_zero() {
    let tree = Tree::new();
    tree.ina3221("class/hwmon/hwmon3", &THOR);
    tree.write("class/hwmon/hwmon3", "in1_enable", "0");
    assert_eq!(tree.watts(Domain::Gpu), None);
    assert_eq!(tree.watts(Domain::Total), None);
    assert!(close(tree.watts(Domain::Cpu), 11.5584));
    tree.write("class/hwmon/hwmon3", "curr2_input", "");
    assert_eq!(tree.watts(Domain::Cpu), None);
}

#[test]
fn a_machine_without_monitors_says_where_it_looked() {
    let tree = Tree::new();
    tree.write("class/hwmon/hwmon0", "name", "coretemp");
    let text = tree.open().unwrap_err().to_string();
    assert!(
        text.contains("class/hwmon") && text.contains("ina3221"),
        "{text}"
    );
}

#[test]
fn monitors_of_which_no_rail_can_be_read_name_the_file() {
    let tree = Tree::new();
    tree.ina3221("class/hwmon/hwmon3", &[("VDD_IN", 5000, 1000)]);
    tree.write("class/hwmon/hwmon3", "in1_input", "off");
    let text = tree.open().unwrap_err().to_string();
    assert!(text.contains("hwmon3/in1_input"), "{text}");
}
