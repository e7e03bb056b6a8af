use super::*;
use crate::reading::Domain;
use crate::tests::{Tree, assert_contains};

/// A tree with an INA3221 that has these rails, and with files that are not rails.
fn tree(rails: &[(&str, i64, i64)]) -> Tree {
    let tree = Tree::default();
    tree.ina3221("hwmon3", rails);
    for (file, text) in [
        ("in1_enable", "1"),
        ("in4_input", "999"),
        ("in7_label", "sum of shunt voltages"),
        ("in7_input", "99999"),
        ("curr4_input", "99999"),
    ] {
        tree.write(format!("{CHIP}/{file}"), text);
    }
    tree
}

const CHIP: &str = "sys/class/hwmon/hwmon3";

fn read(tree: &Tree) -> Reading {
    let mut meter = Ina::open(&tree.config()).unwrap();
    meter.poll(Instant::now()).unwrap().remove(0)
}

fn watts(tree: &Tree, domain: Domain) -> Option<f64> {
    read(tree).value(domain)?.mean_watts(None, 0.0)
}

/// An idle AGX Thor, as quoted in public code.
const THOR: [(&str, i64, i64); 3] = [
    ("VDD_GPU", 12040, 640),
    ("VDD_CPU_SOC_MSS", 12040, 960),
    ("VIN_SYS_5V0", 5088, 1740),
];

fn close(found: Option<f64>, expected: f64) -> bool {
    found.is_some_and(|f| (f - expected).abs() < 1e-9)
}

#[test]
fn power_is_voltage_times_current_without_shunt_inputs_and_an_input_monitor_gives_the_total() {
    let tree = tree(&THOR);
    assert!(close(watts(&tree, Domain::Gpu), 7.7056));
    let sum = 7.7056 + 11.5584 + 8.85312;
    assert!(close(watts(&tree, Domain::Total), sum));
    assert_eq!(read(&tree).rails.len(), 3);
    tree.write("sys/class/hwmon/hwmon5/name", "ina238");
    tree.write("sys/class/hwmon/hwmon5/power1_input", "31250000");
    assert!(close(watts(&tree, Domain::Total), 31.25));
    let found = read(&tree);
    assert_eq!(&*found.total_from, "input_rail");
    let in_total = found.rails.iter().filter(|rail| rail.in_total).count();
    assert_eq!(in_total, 1, "the parts are not added to the whole");
}

#[test]
fn two_monitors_of_a_board_make_one_reading() {
    let tree = tree(&[
        ("VDD_GPU_SOC", 20000, 100),
        ("VDD_CPU_CV", 20000, -20),
        ("VIN_SYS_5V0", 5000, 800),
    ]);
    tree.ina3221("hwmon4", &[("NC", 0, 0), ("VDDQ_VDD2_1V8AO", 5000, 80)]);
    assert!(close(watts(&tree, Domain::Total), 6.0));
    // A rail below zero counts as zero, but is reported as read.
    assert!(close(watts(&tree, Domain::Cpu), 0.0));
    let rails = read(&tree).rails;
    assert_eq!(rails.len(), 4);
    let cpu = rails.iter().find(|rail| &*rail.name == "VDD_CPU_CV");
    assert!(close(cpu.unwrap().value.mean_watts(None, 0.0), -0.4));
}

#[test]
fn a_disabled_or_failing_channel_is_missing_rather_than_zero() {
    let tree = tree(&THOR);
    tree.write("sys/class/hwmon/hwmon5/name", "ina238");
    tree.write("sys/class/hwmon/hwmon5/power1_input", "31250000");
    tree.write(format!("{CHIP}/in1_enable"), "0");
    assert_eq!(watts(&tree, Domain::Gpu), None);
    assert!(close(watts(&tree, Domain::Cpu), 11.5584));
    tree.write(format!("{CHIP}/curr2_input"), "");
    assert_eq!(watts(&tree, Domain::Cpu), None);
    assert!(close(watts(&tree, Domain::Total), 31.25));
}

#[rstest::rstest]
#[case::input_rail_switched_off(&[("VDD_IN", 5000, 1000), ("VDD_SOC", 5000, 100)], "in1_enable", "0")]
#[case::input_rail_that_shows_nothing(&[("VDD_IN", 5000, -1), ("VDD_SOC", 5000, 100)], "in1_enable", "1")]
#[case::one_rail_of_the_sum_is_off(&THOR, "in2_enable", "0")]
fn a_board_without_a_total_is_refused_so_that_auto_goes_on(
    #[case] rails: &[(&str, i64, i64)],
    #[case] file: &str,
    #[case] text: &str,
) {
    let tree = tree(rails);
    tree.write(format!("{CHIP}/{file}"), text);
    let error = Ina::open(&tree.config()).unwrap_err();
    assert_contains(error, &["the board's whole power", "power.rails"]);
    tree.write("proc/stat", "cpu 1 2 3 4 5 6 7 8");
    assert_eq!(
        crate::choose::open(&tree.config()).unwrap().0.as_str(),
        "estimate"
    );
}

#[test]
fn a_second_input_monitor_has_a_name_of_its_own_and_is_not_in_the_total() {
    let tree = Tree::default();
    for (chip, microwatts) in [("hwmon4", "20000000"), ("hwmon5", "3000000")] {
        tree.write(format!("sys/class/hwmon/{chip}/name"), "ina238");
        tree.write(format!("sys/class/hwmon/{chip}/power1_input"), microwatts);
    }
    let found = read(&tree);
    let rails: Vec<_> = found.rails.iter().map(|rail| (&*rail.name, rail.in_total)).collect();
    assert_eq!(rails, [("VIN", true), ("VIN 2", false)]);
    assert!(close(watts(&tree, Domain::Total), 20.0));
}

#[test]
fn missing_monitors_and_unreadable_files_are_errors_that_name_the_path() {
    let other = Tree::default();
    other.write("sys/class/hwmon/hwmon0/name", "coretemp");
    let error = Ina::open(&other.config()).unwrap_err();
    assert_contains(error, &["class/hwmon", "ina3221"]);
    let broken = tree(&[("VDD_IN", 5000, 1000)]);
    broken.write(format!("{CHIP}/in1_input"), "off");
    let error = Ina::open(&broken.config()).unwrap_err();
    assert_contains(error, &["hwmon3/in1_input"]);
}
