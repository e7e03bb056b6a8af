//! Writes metrics for Prometheus as text (0.0.4).

use crate::process;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use std::fmt::Write as _;

/// Names and values of a sample's labels.
type Labels<'a> = &'a [(&'a str, &'a str)];

/// A page of metrics: each family with its help, its kind and its samples.
#[derive(Debug, Default)]
pub struct MetricsPage(String);

impl MetricsPage {
    /// One gauge without labels; without a value, only its description.
    pub fn gauge(&mut self, name: &str, help: &str, value: impl Into<Option<f64>>) {
        let samples = value.into().map(|value| ([], value));
        self.family(name, "gauge", help, samples);
    }

    /// One counter without labels.
    pub fn counter(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, "counter", help, [([], value)]);
    }

    /// Gauges of one name, by labels.
    pub fn gauges<'a, const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], f64)>,
    ) {
        self.family(name, "gauge", help, samples);
    }

    /// Counters of one name, by labels.
    pub fn counters<'a, const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], f64)>,
    ) {
        self.family(name, "counter", help, samples);
    }

    /// What the process uses.
    pub fn process(&mut self) {
        for figure in process::figures() {
            if figure.counter {
                self.counter(&format!("{}_total", figure.name), figure.help, figure.value);
            } else {
                self.gauge(figure.name, figure.help, figure.value);
            }
        }
    }

    /// The text of the page.
    pub fn into_text(self) -> String {
        self.0
    }

    fn family<'a, const N: usize>(
        &mut self,
        name: &str,
        kind: &str,
        help: &str,
        samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], f64)>,
    ) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
        for (labels, value) in samples {
            let _ = writeln!(self.0, "{name}{} {value}", written(&labels));
        }
    }
}

fn written(labels: Labels<'_>) -> String {
    if labels.is_empty() {
        return String::new();
    }
    let label = |(name, value): &(&str, &str)| format!("{name}=\"{value}\"");
    let labels: Vec<_> = labels.iter().map(label).collect();
    format!("{{{}}}", labels.join(","))
}

impl IntoResponse for MetricsPage {
    fn into_response(self) -> Response {
        const PLAIN: &str = "text/plain; version=0.0.4; charset=utf-8";
        ([(CONTENT_TYPE, PLAIN)], self.0).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_family_has_its_description_once_and_a_line_for_each_sample() {
        let mut page = MetricsPage::default();
        page.gauge("up", "Whether it works", 1.0);
        page.gauge("sessions", "Sessions", None);
        page.counters(
            "boxes_total",
            "Boxes",
            [
                ([("side", "a"), ("result", "b")], 2.5),
                ([("side", "c"), ("result", "d")], 3.0),
            ],
        );
        assert_eq!(
            page.into_text(),
            "# HELP up Whether it works\n# TYPE up gauge\nup 1\n\
             # HELP sessions Sessions\n# TYPE sessions gauge\n\
             # HELP boxes_total Boxes\n# TYPE boxes_total counter\n\
             boxes_total{side=\"a\",result=\"b\"} 2.5\nboxes_total{side=\"c\",result=\"d\"} 3\n"
        );
    }
}
