//! Every recorded line of `tegrastats` is read as an independent reader does.

use crate::support::{shared, text};
use albireo_power::{Domain, RailMap, tegrastats_rails};
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Deserialize)]
struct Expected {
    rails_mw: BTreeMap<String, i64>,
    total_mw: Option<f64>,
    total_from: Option<String>,
}

fn fixture(name: &str) -> String {
    text(&format!("tests/fixtures/telemetry/{name}"))
}

fn check(name: &str, text: &str, expected: &BTreeMap<String, Expected>) {
    let expected = &expected[name];
    let read = tegrastats_rails(text).unwrap_or_else(|| panic!("{name}: {text}"));
    let rails: BTreeMap<String, i64> = read
        .iter()
        .map(|rail| (rail.name.to_string(), (rail.watts * 1e3).round() as i64))
        .collect();
    assert_eq!(rails, expected.rails_mw, "{name}");
    assert_eq!(rails.len(), read.len(), "{name}: a rail is there twice");
    let reading = RailMap::new(None).unwrap().reading(&read);
    let total = reading
        .value(Domain::Total)
        .and_then(|total| total.mean_watts(None, 0.0))
        .map(|watts| (watts * 1e3).round());
    assert_eq!(total, expected.total_mw, "{name}");
    if let Some(rule) = &expected.total_from {
        assert_eq!(&*reading.total_from, rule, "{name}");
    }
}

fn expected() -> BTreeMap<String, Expected> {
    serde_json::from_str(&fixture("tegrastats_expected.json")).unwrap()
}

#[test]
fn every_stored_line_is_read_as_expected() {
    let expected = expected();
    let lines = fixture("tegrastats_lines.tsv");
    assert_eq!(lines.lines().count(), 26);
    for line in lines.lines() {
        let (name, text) = line.split_once('\t').unwrap();
        check(name, text, &expected);
    }
}

#[test]
#[ignore = "needs ../shared"]
fn shared_every_recorded_line_is_read_as_expected() {
    let expected = expected();
    let boards = "agx_orin_jp5 agx_orin_jp6 agx_orin_jp7 agx_thor edited_by_test_authors orin_nano orin_nx xavier_and_older";
    for board in boards.split(' ') {
        let file = shared(&format!("telemetry/tegrastats_{board}.txt"));
        for (number, line) in (1..).zip(std::fs::read_to_string(file).unwrap().lines()) {
            check(&format!("{board}:{number}"), line, &expected);
        }
    }
}
