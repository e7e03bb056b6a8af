//! Prometheus rules and Grafana dashboards: every alert has a test, and node, hub or router exports every metric that a rule
//! or a dashboard names.

use crate::http_api::served::Served;
use crate::support::fleet::{HubProcess, router_config, settings, sqlite};
use crate::support::{albireo, free_port, project, run_command, text_at, until};
use albireo_node::state::board::PowerSnapshot;
use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;

fn text(path: &str) -> String {
    crate::support::text(&format!("deploy/{path}"))
}

/// The metrics in an expression: words other than functions, labels and keywords.
fn metrics_of(expression: &str) -> BTreeSet<String> {
    // Text in quotes or braces is labels.
    let mut plain = String::new();
    let (mut quoted, mut depth) = (false, 0_u32);
    for c in expression.chars() {
        match c {
            '"' => quoted = !quoted,
            '{' if !quoted => depth += 1,
            '}' if !quoted => depth -= 1,
            c if !quoted && depth == 0 => plain.push(c),
            _ => {}
        }
    }
    plain
        .split(|c: char| !(c.is_ascii_alphanumeric() || c == '_' || c == ':'))
        .filter(|word| word.starts_with("albireo") || word.starts_with("process_"))
        .map(str::to_owned)
        .collect()
}

/// The expressions of the rules, and the names that they record.
fn rules() -> (Vec<String>, BTreeSet<String>) {
    let (mut expressions, mut recorded) = (Vec::new(), BTreeSet::new());
    let rules = text("prometheus/rules.yml");
    let mut lines = rules.lines().peekable();
    while let Some(line) = lines.next() {
        let line = line.trim_start().trim_start_matches("- ");
        if let Some(name) = line.strip_prefix("record: ") {
            recorded.insert(name.to_owned());
        }
        if let Some(expression) = line.strip_prefix("expr: ") {
            let mut whole = expression.trim_start_matches(">-").to_owned();
            while let Some(more) = lines.next_if(|next| next.starts_with("          ")) {
                whole.push_str(more);
            }
            expressions.push(whole);
        }
    }
    (expressions, recorded)
}

fn dashboards() -> Vec<(String, Value)> {
    std::fs::read_dir(project("deploy/grafana/dashboards"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|file| {
            let text = std::fs::read_to_string(&file).unwrap();
            let name = file.file_name().unwrap().to_string_lossy().into_owned();
            (name, serde_json::from_str(&text).unwrap())
        })
        .collect()
}

/// The names of the samples in a metrics text.
fn names(exposition: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for line in exposition.lines() {
        let Some(rest) = line.strip_prefix("# TYPE ") else {
            continue;
        };
        let (name, kind) = rest.split_once(' ').unwrap();
        if kind == "histogram" {
            names.extend(["bucket", "sum", "count"].map(|part| format!("{name}_{part}")));
        } else {
            names.insert(name.to_owned());
        }
    }
    assert!(!names.is_empty(), "{exposition}");
    names
}

async fn node_metrics() -> BTreeSet<String> {
    let node = Served::start().await;
    node.board.set_power(PowerSnapshot {
        hottest: Some(("cpu".to_owned(), 50.0)),
        ..node.board.power()
    });
    names(&node.metrics().await)
}

async fn hub_metrics() -> BTreeSet<String> {
    let folder = tempfile::tempdir().unwrap();
    let (_, settings) = settings(&sqlite(folder.path()));
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    names(&hub.metrics().await)
}

async fn router_metrics() -> BTreeSet<String> {
    let folder = tempfile::tempdir().unwrap();
    let http = format!("127.0.0.1:{}", free_port());
    let _router = albireo()
        .args(["router", "--http", &http, "--config"])
        .arg(router_config(folder.path()))
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let metrics = format!("http://{http}/metrics");
    let mut text = String::new();
    until("the router answers", async || {
        text = text_at(&metrics).await;
        !text.is_empty()
    })
    .await;
    names(&text)
}

#[tokio::test]
async fn every_metric_in_a_rule_or_dashboard_is_exported() {
    let mut there = node_metrics().await;
    there.extend(hub_metrics().await);
    there.extend(router_metrics().await);
    let (expressions, recorded) = rules();
    there.extend(recorded);
    assert!(expressions.len() > 20, "{expressions:?}");
    let mut missing = Vec::new();
    let mut look = |place: &str, expression: &str| {
        for metric in metrics_of(expression) {
            if !there.contains(&metric) {
                missing.push(format!("{place}: {metric}"));
            }
        }
    };
    for expression in &expressions {
        look("rules.yml", expression);
    }
    let dashboards = dashboards();
    assert_eq!(dashboards.len(), 2);
    for (name, dashboard) in &dashboards {
        let panels = dashboard["panels"].as_array().unwrap();
        assert!(panels.len() > 10, "{name}");
        for target in panels
            .iter()
            .flat_map(|panel| panel["targets"].as_array().unwrap())
        {
            let expression = target["expr"].as_str().unwrap();
            assert!(!metrics_of(expression).is_empty(), "{name}: {expression}");
            look(name, expression);
        }
        for variable in dashboard["templating"]["list"].as_array().unwrap() {
            let query = &variable["query"]["query"];
            look(name, query.as_str().unwrap_or_default());
        }
    }
    assert!(missing.is_empty(), "no program exports {missing:#?}");
}

#[test]
fn metrics_are_found_in_an_expression_and_labels_are_not() {
    let expression =
        r#"sum by (instance) (rate(albireo_a_total{albireo_b="albireo_c"}[5m])) / process_d"#;
    let expected = ["albireo_a_total", "process_d"].map(str::to_owned);
    assert_eq!(metrics_of(expression), BTreeSet::from(expected));
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
