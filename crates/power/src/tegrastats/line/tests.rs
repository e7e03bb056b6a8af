//! Promises of the reader of `tegrastats` lines, one a trap.

use super::*;

const PLAIN: &str = "RAM 1/2MB (lfb 1x512kB) SWAP 0/1MB (cached 0MB) CPU [10%@1000,off,30%@2000] EMC_FREQ 0%@2133 \
                     GR3D_FREQ 50%@600 APE 174 cpu@40C VDD_IN 4915mW/4000mW";

fn line(text: &str) -> TegrastatsLine {
    TegrastatsLine::parse(text).unwrap_or_else(|| panic!("{text}"))
}

fn rail(text: &str) -> Option<f64> {
    line(&format!("RAM 1/2MB {text}"))
        .rails
        .first()
        .map(|r| r.watts)
}

#[test]
fn power_is_read_with_and_without_unit_with_one_two_or_three_values_and_always_the_first() {
    assert_eq!(rail("GPU 18401/18525"), Some(18.401));
    assert_eq!(rail("VDD_IN 4915mW/4000mW"), Some(4.915));
    assert_eq!(rail("VIN 87426mW/43713mW/87426mW"), Some(87.426));
    assert_eq!(rail("VDD_GPU_SOC 2171mW"), Some(2.171));
    assert_eq!(rail("VDD_CPU_CV -398mW/-398mW"), Some(-0.398));
}

#[test]
fn what_looks_like_power_and_is_none_is_no_rail() {
    for text in [
        "SWAP 479/3427MB (cached 3MB)",
        "APE 150",
        "VIC_FREQ 729",
        "MTS fg 0% bg 10%",
        "NC 0mW/0mW",
        "NVENC 79%@166",
        "FUTURE_TOKEN value",
        "VDD_IN 1mW/2mW/3mW/4mW",
        "VDD_IN mW/mW",
    ] {
        assert_eq!(rail(text), None, "{text}");
    }
}

#[test]
fn cores_that_are_off_do_not_count() {
    for (text, mhz) in [
        (PLAIN, Some(1500.0)),
        ("RAM 1/2MB cpu [25%,50%]@408", Some(408.0)),
        ("RAM 1/2MB CPU [off,off]", None),
    ] {
        assert_eq!(line(text).cpu_mhz, mhz, "{text}");
    }
}

#[test]
fn the_gpus_clock_is_read_in_every_form() {
    for (text, mhz) in [
        ("GR3D_FREQ 0%", None),
        ("GR3D_FREQ 63%@[621]", Some(621.0)),
        ("GR3D_FREQ 0%@305 GR3D2_FREQ 0%@0", Some(305.0)),
        ("GR3D_FREQ 12%@[1300,1300]", Some(1300.0)),
        ("GR3D_FREQ @[314,314,314] NVENC0_FREQ @314", Some(314.0)),
        ("GR3D 39%@76", Some(76.0)),
        ("APE 25", None),
    ] {
        assert_eq!(line(&format!("RAM 1/2MB {text}")).gpu_mhz, mhz, "{text}");
    }
}

#[test]
fn a_sensor_that_is_gated_is_left_out_and_both_forms_are_read() {
    let found = line("RAM 1/2MB CV0@-256C CPU@42.5C gpu@38C/44.1C Tboard@bad");
    let expected = [("cpu".to_owned(), 42.5), ("gpu".to_owned(), 38.0)];
    assert_eq!(found.temperatures, expected);
}

#[test]
fn a_last_word_without_a_value_and_a_trailing_space_do_no_harm() {
    assert_eq!(line("RAM 775/7620MB VDD_IN 1mW/1mW ").rails.len(), 1);
    assert_eq!(line("RAM 775/7620MB VDD_IN").rails.len(), 0);
}

#[test]
fn a_line_of_another_program_is_refused() {
    for text in [
        "",
        "sudo: a password is required",
        "VDD_IN 4915mW/4915mW",
        "\u{fffd}\u{0}",
    ] {
        assert_eq!(TegrastatsLine::parse(text), None, "{text:?}");
    }
}

proptest::proptest! {
    #[test]
    fn no_text_makes_it_fail(text in "RAM (\\PC{0,40} ){0,8}[A-Z@/%,\\[\\]mWC0-9.-]{0,60}") {
        let found = line(&text);
        proptest::prop_assert!(found.rails.iter().all(|r| r.watts.is_finite()));
    }
}
