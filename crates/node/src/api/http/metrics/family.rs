//! Writes families of metrics: a description, then a sample for each set of labels.

use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::histogram::Histogram;
use std::fmt;

/// Names and values of a sample's labels, and its value.
pub(super) type Sample<'a, T = f64> = (Vec<(&'static str, &'a str)>, T);

/// What families are written to.
pub(super) struct Page<'a>(pub DescriptorEncoder<'a>);

impl Page<'_> {
    /// One gauge without labels.
    pub(super) fn gauge(&mut self, name: &str, help: &str, value: f64) -> fmt::Result {
        self.gauges(name, help, [(Vec::new(), value)])
    }

    /// One counter without labels.
    pub(super) fn counter(&mut self, name: &str, help: &str, value: f64) -> fmt::Result {
        self.counters(name, help, [(Vec::new(), value)])
    }

    /// A family of gauges.
    pub(super) fn gauges<'s>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = Sample<'s>>,
    ) -> fmt::Result {
        self.family(
            name,
            help,
            MetricType::Gauge,
            samples,
            |mut sample, value| {
                // A whole number is written as one.
                match value as i64 as f64 == value {
                    true => sample.encode_gauge(&(value as i64)),
                    false => sample.encode_gauge(&value),
                }
            },
        )
    }

    /// A family of counters.
    pub(super) fn counters<'s>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = Sample<'s>>,
    ) -> fmt::Result {
        self.family(
            name,
            help,
            MetricType::Counter,
            samples,
            |mut sample, value| sample.encode_counter::<NoLabelSet, _, u64>(&value, None),
        )
    }

    /// A family of histograms.
    pub(super) fn histograms<'s>(
        &mut self,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = Sample<'s, &'s Histogram>>,
    ) -> fmt::Result {
        self.family(
            name,
            help,
            MetricType::Histogram,
            samples,
            |sample, value| value.encode(sample),
        )
    }

    fn family<'s, T>(
        &mut self,
        name: &str,
        help: &str,
        kind: MetricType,
        samples: impl IntoIterator<Item = Sample<'s, T>>,
        write: impl Fn(MetricEncoder<'_>, T) -> fmt::Result,
    ) -> fmt::Result {
        let mut family = self.0.encode_descriptor(name, help, None, kind)?;
        for (labels, value) in samples {
            // A family of an empty set of labels would print empty braces.
            match labels.is_empty() {
                true => return write(family, value),
                false => write(family.encode_family(&labels)?, value)?,
            }
        }
        Ok(())
    }
}
