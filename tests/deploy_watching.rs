//! Prometheus rules and Grafana dashboards: every alert has a test, and every metric that they name is exported.

use crate::http_api::served::Served;
use crate::support::fleet::{HubProcess, router_config};
use crate::support::{albireo, free_port, project, run_command, text_at, until_ready};
use albireo_node::state::board::PowerSnapshot;
use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;

fn text(path: &str) -> String {
    crate::support::text(&format!("deploy/{path}"))
}

/// The metrics that a text names. Labels and their values have other beginnings.
fn metrics_in(text: &str) -> BTreeSet<&str> {
    let is_of_a_name = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == ':';
    let mut names = BTreeSet::new();
    for word in text.split(|c: char| !is_of_a_name(c)) {
        let name = word.trim_end_matches(':');
        let is_ours = name.starts_with("albireo") && name != "albireo";
        if is_ours || name.starts_with("process_") {
            names.insert(name);
        }
    }
    names
}

fn dashboards() -> Vec<(String, String)> {
    let files = std::fs::read_dir(project("deploy/grafana/dashboards")).unwrap();
    let names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    let read = |name: String| {
        let text = text(&format!("grafana/dashboards/{name}"));
        (name, text)
    };
    names.map(read).collect()
}

fn names(exposition: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for line in exposition.lines().filter_map(|line| line.strip_prefix("# TYPE ")) {
        let (name, kind) = line.split_once(' ').unwrap();
        if kind == "histogram" {
            names.extend(["bucket", "sum", "count"].map(|part| format!("{name}_{part}")));
        } else {
            names.insert(name.to_owned());
        }
    }
    assert!(!names.is_empty(), "{exposition}");
    names
}

#[tokio::test]
async fn every_query_names_metrics_of_ours_and_every_metric_in_a_rule_or_dashboard_is_exported() {
    let node = Served::start().await;
    node.board.set_power(PowerSnapshot {
        hottest: Some(("cpu".to_owned(), 50.0)),
        ..node.board.power()
    });
    let folder = tempfile::tempdir().unwrap();
    let (_, hub) = HubProcess::fresh(vec![]).await;
    let http = format!("127.0.0.1:{}", free_port());
    let _router = albireo()
        .args(["router", "--http", &http, "--config"])
        .arg(router_config(folder.path()))
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    until_ready(&format!("http://{http}")).await;
    let router = text_at(&format!("http://{http}/metrics")).await;
    let pages = [node.metrics().await, hub.metrics().await, router];
    let mut there: BTreeSet<_> = pages.iter().flat_map(|page| names(page)).collect();
    let rules = text("prometheus/rules.yml");
    let recorded = rules
        .lines()
        .filter_map(|line| line.split_once("record: "))
        .map(|(_, name)| name.to_owned());
    there.extend(recorded);
    let mut files = dashboards();
    let mut queries = 0;
    for (name, text) in &files {
        let dashboard: Value = serde_json::from_str(text).unwrap();
        let panels = dashboard["panels"].as_array().unwrap().iter();
        for target in panels.flat_map(|panel| panel["targets"].as_array().unwrap()) {
            let expression = target["expr"].as_str().unwrap();
            assert!(!metrics_in(expression).is_empty(), "{name}: {expression}");
            queries += 1;
        }
    }
    assert!(queries > 20, "{queries}");
    files.push(("rules.yml".to_owned(), rules));
    for (name, text) in &files {
        let named = metrics_in(text);
        assert!(named.len() > 20, "{name}: {named:?}");
        let missing: Vec<_> = named.iter().filter(|one| !there.contains(**one)).collect();
        assert!(missing.is_empty(), "{name}: no program exports {missing:?}");
    }
}

#[test]
#[ignore = "needs promtool"]
fn every_alert_fires_when_it_should_and_not_before() {
    for arguments in [
        &["check", "rules", "rules.yml"][..],
        &["test", "rules", "rules_test.yml"],
        &["check", "config", "--syntax-only", "prometheus.yml"],
    ] {
        let mut promtool = Command::new("promtool");
        let promtool = promtool.args(arguments);
        run_command(promtool.current_dir(project("deploy/prometheus"))).succeeds();
    }
}

#[test]
fn every_alert_has_a_test() {
    let alerts = |file: &str, start: &str| -> BTreeSet<String> {
        text(file)
            .lines()
            .filter_map(|line| line.trim_start().strip_prefix(start).map(str::to_owned))
            .collect()
    };
    let there = alerts("prometheus/rules.yml", "- alert: ");
    assert_eq!(there, alerts("prometheus/rules_test.yml", "alertname: "));
}

#[test]
fn the_map_of_the_dashboard_asks_the_hub_through_a_provisioned_data_source() {
    let (_, fleet) = dashboards().into_iter().find(|(name, _)| name == "fleet.json").unwrap();
    let fleet: Value = serde_json::from_str(&fleet).unwrap();
    let map = fleet["panels"]
        .as_array()
        .unwrap()
        .iter()
        .find(|panel| panel["type"] == "geomap")
        .unwrap();
    let asked = map["options"]["layers"][0]["config"]["src"]
        .as_str()
        .unwrap()
        .strip_prefix("api/datasources/proxy/uid/")
        .unwrap();
    let (source, path) = asked.split_once('/').unwrap();
    let sources = text("grafana/provisioning/datasources/prometheus.yml");
    assert!(sources.contains(&format!("uid: {source}\n")), "{sources}");
    let described = serde_json::to_value(albireo_hub::http::openapi()).unwrap();
    let route = &described["paths"][format!("/{path}")]["get"];
    let kinds = &route["responses"]["200"]["content"];
    assert!(kinds["application/geo+json"].is_object(), "{route}");
}
