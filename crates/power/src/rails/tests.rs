use super::*;

fn rails(list: &[(&str, f64)]) -> Vec<RailWatts> {
    list.iter()
        .map(|(name, watts)| RailWatts {
            name: (*name).into(),
            watts: *watts,
        })
        .collect()
}

fn read(list: &[(&str, f64)]) -> Reading {
    RailMap::new(None).unwrap().reading(&rails(list))
}

#[test]
fn every_built_in_table_is_valid() {
    let tables = built_in().unwrap();
    assert!(tables.len() >= 6);
    for table in tables {
        assert_eq!(table.fault(), None);
        assert!(!table.name.is_empty());
    }
}

#[test]
fn a_missing_input_rail_is_a_gap_and_keeps_the_rule() {
    let mut map = RailMap::new(None).unwrap();
    let parts = [
        ("VDD_GPU", 2.0),
        ("VDD_CPU_SOC_MSS", 6.0),
        ("VIN_SYS_5V0", 5.0),
    ];
    let mut with_input = parts.to_vec();
    with_input.push(("VIN", 20.0));
    map.reading(&rails(&with_input));
    let found = map.reading(&rails(&parts));
    assert_eq!(found.value(Domain::Total), None);
    assert!(found.rails.iter().all(|rail| !rail.in_total));
    assert_eq!(found.value(Domain::Cpu), Some(Value::Power(6.0)));
    assert_eq!(&*found.total_from, "input_rail");
}

#[test]
fn a_user_table_takes_precedence_over_the_built_in_ones() {
    let user: RailTable = toml::from_str(
        "sum = [\"VDD_GPU_SOC\", \"VDDQ_VDD2_1V8AO\"]\nio_mem = [\"VDDQ_VDD2_1V8AO\"]",
    )
    .unwrap();
    let mut map = RailMap::new(Some(&user)).unwrap();
    let found = map.reading(&rails(&[
        ("VDD_GPU_SOC", 2.0),
        ("VDD_CPU_CV", 1.0),
        ("VDDQ_VDD2_1V8AO", 0.4),
    ]));
    let expected = Values {
        total: Some(Value::Power(2.4)),
        io_mem: Some(Value::Power(0.4)),
        ..Values::default()
    };
    assert_eq!(found.values, expected);
}

#[test]
fn the_rails_of_an_unknown_board_are_summed_and_the_rule_says_so() {
    let found = read(&[("5V", 2.0), ("3V3", 1.0)]);
    assert_eq!(found.value(Domain::Total), Some(Value::Power(3.0)));
    assert!(found.total_from.contains("unknown board"));
    assert_eq!(read(&[]).value(Domain::Total), None);
}
