use super::*;
use crate::tests::assert_contains;
use rstest::rstest;

fn open(script: &str) -> Result<Command, MeterError> {
    Command::open(&PowerConfig {
        command: Some(script.to_owned()),
        ..PowerConfig::default()
    })
}

/// The first reading that comes after the one that opened the meter.
fn next(meter: &mut Command) -> Reading {
    let given_up = std::time::Instant::now() + Duration::from_secs(20);
    loop {
        assert!(std::time::Instant::now() < given_up, "no reading");
        if let Some(reading) = meter.poll(Instant::now()).unwrap().pop() {
            return reading;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn watts(reading: &Reading) -> [Option<f64>; 4] {
    Domain::ALL.map(|domain| reading.value(domain)?.mean_watts(None, 0.0))
}

#[rstest]
#[case::the_whole_machine_and_a_part("total 9.5; gpu 4", [Some(9.5), Some(4.0), None, None], "input_rail")]
#[case::parts_are_added_and_named("cpu 3.25; Wi-Fi 0.5", [Some(3.75), None, Some(3.25), None], "cpu + Wi-Fi")]
#[case::an_offset_below_zero_adds_nothing("cpu 3; usb -0.01", [Some(3.0), None, Some(3.0), None], "cpu + usb")]
fn a_program_that_prints_once_is_run_for_each_reading(
    #[case] lines: &str,
    #[case] expected: [Option<f64>; 4],
    #[case] total_from: &str,
) {
    let mut meter = open(&format!("echo '{lines}' | tr ';' '\\n'")).unwrap();
    for _ in 0..2 {
        let reading = next(&mut meter);
        assert_eq!(watts(&reading), expected);
        assert_eq!(reading.total_from, total_from);
    }
}

#[test]
fn a_program_that_goes_on_ends_each_set_with_an_empty_line() {
    let script =
        "for w in 1 2 3 4 5 6 7 8 9; do printf 'total %s\\n\\n' $w; sleep 0.05; done; sleep 60";
    let mut meter = open(script).unwrap();
    let first = watts(&next(&mut meter))[0].unwrap();
    let second = watts(&next(&mut meter))[0].unwrap();
    assert!(second > first && second <= 9.0, "{first} {second}");
}

#[rstest]
#[case::a_sentence("echo usage: watts", "`usage: watts` is not a name and watts")]
#[case::no_number("echo total NaN", "`total NaN`")]
#[case::failed("exit 7", "it ended with exit status: 7")]
#[case::failed_with_a_word("echo broken >&2; exit 1", "it ended with exit status: 1: broken")]
#[case::missing("no-such-program-here", "it ended with exit status: 127: ")]
#[case::a_negative_total("echo total -5", "`total` (-5 W) is negative: change its sign")]
#[case::a_negative_sum("echo plug -5", "its lines (-5 W) is negative: change its sign")]
fn a_program_that_prints_something_else_is_refused_with_its_line(
    #[case] script: &str,
    #[case] expected: &str,
) {
    let error = open(script).unwrap_err();
    assert_contains(&error, &["power.command: ", expected]);
    assert!(matches!(error, MeterError::Failed(_)));
}

#[test]
fn a_program_that_goes_on_without_empty_lines_is_told_to_print_them() {
    let mut meter = open("printf 'total 1\\n\\n'; echo total 5; exec sleep 60").unwrap();
    let given_up = std::time::Instant::now() + Duration::from_secs(20);
    while meter.rails.is_empty() {
        assert!(std::time::Instant::now() < given_up, "no line");
        meter.poll(Instant::now()).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    let later = Instant::now() + 2 * LATE;
    let error = meter.poll(later).unwrap_err();
    let expected = "it must print an empty line after each reading, or end";
    assert_contains(error, &["no reading for", expected]);
}

#[test]
fn without_a_program_the_meter_is_missing() {
    let error = Command::open(&PowerConfig::default()).unwrap_err();
    assert!(matches!(error, MeterError::Missing(_)), "{error}");
}

/// What the devices print: a Raspberry Pi 5's PMIC (three of its rails), an INA219, a Shelly Plus Plug S, a battery.
const RECORDED: [(&str, &str, f64); 4] = [
    (
        "vcgencmd",
        "     3V7_WL_SW_A current(0)=0.09759750A\n   3V3_SYS_A current(1)=0.07904150A\n     VDD_CORE_A current(7)=0.76456000A\n\
              3V7_WL_SW_V volt(8)=3.72298500V\n     3V3_SYS_V volt(9)=3.31362900V\n    VDD_CORE_V volt(15)=0.72117220V\n\
                EXT5V_V volt(24)=5.16328000V\n       BATT_V volt(25)=0.00000000V",
        0.097_597_5 * 3.722_985 + 0.079_041_5 * 3.313_629 + 0.764_56 * 0.721_172_2,
    ),
    (
        "sys/bus/i2c/devices/1-0040/hwmon/hwmon2/power1_input",
        "5340000",
        5.34,
    ),
    (
        "curl",
        r#"{"id":0, "source":"init", "output":true, "apower":17.3, "voltage":231.9, "current":0.121, "aenergy":{"total":84.2},"temperature":{"tC":38.1, "tF":100.6}}"#,
        17.3,
    ),
    ("sys/class/power_supply/BAT0/power_now", "11475000", 11.475),
];

#[test]
fn the_documented_commands_read_what_their_devices_print() {
    let docs = include_str!("../../../../../docs/energy.md");
    let commands: Vec<&str> = docs
        .split("command = '''")
        .skip(1)
        .map(|rest| rest.split("'''").next().unwrap())
        .collect();
    assert_eq!(commands.len(), RECORDED.len());
    for (command, (device, printed, expected)) in commands.into_iter().zip(RECORDED) {
        let tree = crate::tests::Tree::default();
        tree.write(device, printed);
        if !device.starts_with("sys/") {
            // A program that prints what was recorded.
            tree.write(device, format!("#!/bin/sh\ncat <<'END'\n{printed}\nEND"));
            let executable = std::os::unix::fs::PermissionsExt::from_mode(0o755);
            std::fs::set_permissions(tree.path(device), executable).unwrap();
        }
        let here = tree.path("");
        let command = command.replace("/sys/", &format!("{}sys/", here.display()));
        let mut meter = open(&format!("PATH={}:$PATH; {command}", here.display())).unwrap();
        let found = watts(&next(&mut meter))[0].unwrap();
        assert!((found - expected).abs() < 1e-4, "{device}: {found} W");
    }
}
