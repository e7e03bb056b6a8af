//! A strict reader of the two text formats for metrics, written from their specifications (OpenMetrics
//! 1.0.0, Prometheus text format 0.0.4) and not from the writer.

use std::collections::{BTreeMap, BTreeSet};

/// Samples by name and labels: `name{a="b",c="d"}`, labels in the order written.
pub(crate) type Samples = BTreeMap<String, f64>;

#[derive(Default)]
struct Family {
    kind: Option<String>,
    help: bool,
    /// Buckets of each histogram, by its labels without `le`, as read.
    buckets: BTreeMap<String, Vec<(f64, f64)>>,
    counts: BTreeMap<String, f64>,
    sums: BTreeSet<String>,
}

fn is_name(name: &str) -> bool {
    !name.starts_with(|c: char| c.is_ascii_digit())
        && !name.is_empty()
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b':')
}

/// Labels in order, and what follows the closing brace.
fn labels(text: &str) -> (Vec<(String, String)>, &str) {
    let mut found = Vec::new();
    let mut rest = text;
    loop {
        let (name, after) = rest.split_once("=\"").expect("a label has a quoted value");
        assert!(is_name(name), "label name {name:?}");
        let mut value = String::new();
        let mut characters = after.char_indices();
        let end = loop {
            match characters.next().expect("a closing quote") {
                (at, '"') => break at,
                (_, '\\') => match characters.next().expect("an escaped character").1 {
                    'n' => value.push('\n'),
                    c @ ('\\' | '"') => value.push(c),
                    other => panic!("unknown escape \\{other}"),
                },
                (_, c) => value.push(c),
            }
        };
        assert!(
            found.iter().all(|(known, _)| known != name),
            "label {name} twice"
        );
        found.push((name.to_owned(), value));
        rest = &after[end + 1..];
        match rest.strip_prefix(',') {
            Some(more) => rest = more,
            None => return (found, rest.strip_prefix('}').expect("a closing brace")),
        }
    }
}

fn number(text: &str) -> f64 {
    match text {
        "+Inf" => f64::INFINITY,
        "-Inf" => f64::NEG_INFINITY,
        "NaN" => f64::NAN,
        _ => text
            .parse()
            .unwrap_or_else(|_| panic!("{text:?} is no number")),
    }
}

/// Reads a document; panics with what is wrong with it.
pub(crate) fn read(text: &str, open_metrics: bool) -> Samples {
    assert!(text.ends_with('\n'), "the last line has no end");
    let body = if open_metrics {
        text.strip_suffix("# EOF\n")
            .expect("OpenMetrics ends with # EOF")
    } else {
        text
    };
    let mut families: BTreeMap<String, Family> = BTreeMap::new();
    let mut current = String::new();
    let mut samples = Samples::new();
    for line in body.lines() {
        if let Some(rest) = line.strip_prefix("# ") {
            let (keyword, rest) = rest.split_once(' ').expect("a keyword");
            let (name, value) = rest.split_once(' ').expect("a value");
            assert!(is_name(name), "metric name {name:?}");
            let family = families.entry(name.to_owned()).or_default();
            match keyword {
                "HELP" => assert!(
                    !std::mem::replace(&mut family.help, true),
                    "HELP {name} twice"
                ),
                "TYPE" => {
                    assert!(
                        ["counter", "gauge", "histogram"].contains(&value),
                        "type {value:?}"
                    );
                    assert!(
                        family.kind.replace(value.to_owned()).is_none(),
                        "TYPE {name} twice"
                    );
                }
                other => panic!("unknown line # {other}"),
            }
            current = name.to_owned();
        } else {
            sample(line, &current, &mut families, &mut samples, open_metrics);
        }
    }
    for (name, family) in &families {
        assert!(
            family.help && family.kind.is_some(),
            "{name} is described by halves"
        );
        for (labels, buckets) in &family.buckets {
            assert!(
                buckets.is_sorted_by(|a, b| a.0 < b.0),
                "{name}{{{labels}}} bounds"
            );
            assert!(
                buckets.is_sorted_by(|a, b| a.1 <= b.1),
                "{name}{{{labels}}} not cumulative"
            );
            let last = buckets.last().unwrap();
            assert_eq!(
                last.0,
                f64::INFINITY,
                "{name}{{{labels}}} has no +Inf bucket"
            );
            assert_eq!(
                Some(&last.1),
                family.counts.get(labels),
                "{name}{{{labels}}} count"
            );
            assert!(
                family.sums.contains(labels),
                "{name}{{{labels}}} has no sum"
            );
        }
    }
    samples
}

fn sample(
    line: &str,
    current: &str,
    families: &mut BTreeMap<String, Family>,
    samples: &mut Samples,
    open_metrics: bool,
) {
    let at = line.find(['{', ' ']).expect("a value");
    let (name, rest) = line.split_at(at);
    assert!(is_name(name), "metric name {name:?}");
    let (labels, rest) = match rest.strip_prefix('{') {
        Some(inner) => labels(inner),
        None => (Vec::new(), rest),
    };
    let value = number(rest.strip_prefix(' ').expect("one space before the value"));
    let family = families
        .get_mut(current)
        .expect("samples come after their description");
    let suffix = name.strip_prefix(current).unwrap_or_else(|| {
        panic!("{name} is among the samples of {current}");
    });
    let others: Vec<String> = labels
        .iter()
        .filter(|(label, _)| label != "le")
        .map(|(label, value)| format!("{label}={value:?}"))
        .collect();
    let others = others.join(",");
    match (family.kind.as_deref().expect("TYPE before samples"), suffix) {
        ("gauge", "") => {}
        ("counter", "_total") if open_metrics => assert!(value >= 0.0, "{line}"),
        ("counter", "") if !open_metrics => {
            assert!(name.ends_with("_total") && value >= 0.0, "{line}");
        }
        ("histogram", "_bucket") => {
            let (_, bound) = labels.iter().find(|(label, _)| label == "le").expect("le");
            let buckets = family.buckets.entry(others.clone()).or_default();
            buckets.push((number(bound), value));
        }
        ("histogram", "_count") => {
            family.counts.insert(others.clone(), value);
        }
        ("histogram", "_sum") => {
            family.sums.insert(others.clone());
        }
        (kind, suffix) => panic!("a {kind} has no sample with the ending {suffix:?}: {line}"),
    }
    let all: Vec<String> = labels
        .iter()
        .map(|(label, value)| format!("{label}={value:?}"))
        .collect();
    let series = format!("{name}{{{}}}", all.join(","));
    assert!(
        samples.insert(series.clone(), value).is_none(),
        "{series} twice"
    );
}

#[test]
fn the_reader_refuses_what_the_formats_forbid() {
    let good = "# HELP a b.\n# TYPE a counter\na_total{x=\"1\"} 1\n# EOF\n";
    assert_eq!(read(good, true)["a_total{x=\"1\"}"], 1.0);
    for bad in [
        "# HELP a b.\n# TYPE a counter\na_total{x=\"1\"} 1\n",
        "# HELP a b.\n# TYPE a counter\na{x=\"1\"} 1\n# EOF\n",
        "# HELP a b.\n# TYPE a counter\na_total{x=\"1\"} one\n# EOF\n",
        "# HELP a b.\n# TYPE a counter\na_total{x=\"1} 1\n# EOF\n",
        "# HELP a b.\n# TYPE a gauge\na 1\na 1\n# EOF\n",
        "# TYPE a gauge\na 1\n# EOF\n",
        "# HELP a b.\n# TYPE a gauge\nb 1\n# EOF\n",
        "# HELP a b.\n# TYPE a histogram\na_bucket{le=\"1\"} 1\na_count 1\na_sum 1\n# EOF\n",
    ] {
        let read = std::panic::catch_unwind(|| read(bad, true));
        assert!(read.is_err(), "{bad}");
    }
}
