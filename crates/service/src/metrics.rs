//! Writes metrics in the Prometheus text format (0.0.4).

use crate::http::wrong_tokens;
use crate::identity::Certificates;
use crate::process;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use std::fmt::Write as _;

/// A page of metrics: each family with its help, its kind and its samples.
#[derive(Debug, Default)]
pub struct MetricsPage(String);

impl MetricsPage {
    /// Adds one gauge without labels; without a value, only its description.
    pub fn gauge(&mut self, name: &str, help: &str, value: impl Into<Option<f64>>) {
        let samples = value.into().map(|value| ([], value));
        self.family(name, "gauge", help, samples);
    }

    /// Adds one counter without labels.
    pub fn counter(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, "counter", help, [([], value)]);
    }

    /// Adds the gauges of one name, by labels.
    pub fn gauges<'a, const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], f64)>,
    ) {
        self.family(name, "gauge", help, samples);
    }

    /// Adds the counters of one name, by labels.
    pub fn counters<'a, const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], f64)>,
    ) {
        self.family(name, "counter", help, samples);
    }

    /// Adds the resource usage of the process, as far as it can be read, the log lines that were dropped, and the requests
    /// with a wrong token.
    pub fn process(&mut self) {
        self.counter(
            "albireo_http_wrong_tokens_total",
            "HTTP requests with a wrong token",
            wrong_tokens() as f64,
        );
        self.counter(
            "albireo_log_lines_dropped_total",
            "Log lines that were not written, because nobody read standard error fast enough",
            crate::logging::dropped_lines() as f64,
        );
        // Where the system has no such figures, there are none.
        let _ = process::add(self);
    }

    /// Adds until when certificates are valid.
    pub fn certificates(&mut self, certificates: &Certificates) {
        let ends = certificates.status();
        self.gauges(
            "albireo_certificate_until_timestamp_seconds",
            "End of a certificate that this program uses or trusts, seconds since the Unix epoch",
            ends.iter()
                .map(|one| ([("certificate", one.name.as_str())], one.until_s as f64)),
        );
    }

    /// Adds the latency histograms of one name, by labels.
    pub fn histograms<'a, const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], LatencyHistogram)>,
    ) {
        self.describe(name, "histogram", help);
        for (labels, histogram) in samples {
            let mut count = 0;
            for (at, within) in histogram.within.iter().enumerate() {
                count += within;
                let bound = BOUNDS_S.get(at).map_or_else(|| "+Inf".to_owned(), f64::to_string);
                let mut all = vec![("le", bound.as_str())];
                all.extend(labels);
                self.sample(&format!("{name}_bucket"), &all, count as f64);
            }
            self.sample(&format!("{name}_sum"), &labels, histogram.sum_s);
            self.sample(&format!("{name}_count"), &labels, count as f64);
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
        self.describe(name, kind, help);
        for (labels, value) in samples {
            self.sample(name, &labels, value);
        }
    }

    // Writing to a String cannot fail.
    fn describe(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let label = |(name, value): &(&str, &str)| {
            let escaped = value.replace('\\', r"\\").replace('"', r#"\""#).replace('\n', r"\n");
            format!("{name}=\"{escaped}\"")
        };
        let written: Vec<_> = labels.iter().map(label).collect();
        let _ = if written.is_empty() {
            writeln!(self.0, "{name} {value}")
        } else {
            writeln!(self.0, "{name}{{{}}} {value}", written.join(","))
        };
    }
}

/// Upper bounds of latencies, seconds: fine around the 1 ms allowed for a predicted frame and around a detector's tens
/// of milliseconds.
const BOUNDS_S: [f64; 15] = [
    0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.25, 0.5, 1.0,
    2.5,
];

/// The number of latencies between each pair of neighbouring bounds, below the first and above the last, and their sum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LatencyHistogram {
    within: [u64; BOUNDS_S.len() + 1],
    sum_s: f64,
}

impl LatencyHistogram {
    /// Counts a latency.
    pub fn observe(&mut self, seconds: f64) {
        let at = BOUNDS_S.partition_point(|bound| *bound < seconds);
        if let Some(within) = self.within.get_mut(at) {
            *within += 1;
        }
        self.sum_s += seconds;
    }
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
    fn a_family_has_one_description_and_one_line_per_sample() {
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
        let expected = "# HELP up Whether it works\n# TYPE up gauge\nup 1\n\
                        # HELP sessions Sessions\n# TYPE sessions gauge\n\
                        # HELP boxes_total Boxes\n# TYPE boxes_total counter\n\
                        boxes_total{side=\"a\",result=\"b\"} 2.5\nboxes_total{side=\"c\",result=\"d\"} 3\n";
        assert_eq!(page.into_text(), expected);
    }

    #[test]
    fn histogram_buckets_are_cumulative_and_include_their_bound() {
        let mut histogram = LatencyHistogram::default();
        for seconds in [0.0001, 0.5, 0.75, 4.0] {
            histogram.observe(seconds);
        }
        let mut page = MetricsPage::default();
        page.histograms("t", "Time", [([("of", "a\"\\\n")], histogram)]);
        let text = page.into_text();
        for line in [
            r#"t_bucket{le="0.0001",of="a\"\\\n"} 1"#,
            r#"t_bucket{le="0.25",of="a\"\\\n"} 1"#,
            r#"t_bucket{le="0.5",of="a\"\\\n"} 2"#,
            r#"t_bucket{le="1",of="a\"\\\n"} 3"#,
            r#"t_bucket{le="+Inf",of="a\"\\\n"} 4"#,
            r#"t_sum{of="a\"\\\n"} 5.2501"#,
            r#"t_count{of="a\"\\\n"} 4"#,
        ] {
            let is_there = text.lines().any(|written| written == line);
            assert!(is_there, "{line}: {text}");
        }
    }
}
