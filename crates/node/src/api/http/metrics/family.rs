//! One family of metrics: how it is described, and how its samples are written.

use prometheus_client::encoding::{
    DescriptorEncoder, EncodeGaugeValue, EncodeMetric, MetricEncoder, NoLabelSet,
};
use prometheus_client::metrics::MetricType;
use std::fmt;

/// Names and values of one sample's labels.
pub(super) type Labels<'a> = Vec<(&'static str, &'a str)>;

/// Writes one family of metrics: its description, then a sample for each set of labels.
pub(super) struct Family<'a>(MetricEncoder<'a>);

impl Family<'_> {
    pub(super) fn counter(&mut self, labels: Labels<'_>, value: f64) -> fmt::Result {
        // A family of an empty set of labels would print empty braces.
        if labels.is_empty() {
            self.0.encode_counter::<NoLabelSet, _, u64>(&value, None)
        } else {
            self.0
                .encode_family(&labels)?
                .encode_counter::<NoLabelSet, _, u64>(&value, None)
        }
    }

    pub(super) fn gauge(
        &mut self,
        labels: Labels<'_>,
        value: impl EncodeGaugeValue,
    ) -> fmt::Result {
        if labels.is_empty() {
            self.0.encode_gauge(&value)
        } else {
            self.0.encode_family(&labels)?.encode_gauge(&value)
        }
    }

    pub(super) fn histogram(
        &mut self,
        labels: Labels<'_>,
        value: &impl EncodeMetric,
    ) -> fmt::Result {
        value.encode(self.0.encode_family(&labels)?)
    }
}

/// Begins the family `albireo_{name}` and lets `write` add its samples.
pub(super) fn family(
    encoder: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    kind: MetricType,
    write: impl FnOnce(&mut Family<'_>) -> fmt::Result,
) -> fmt::Result {
    write(&mut Family(
        encoder.encode_descriptor(name, help, None, kind)?,
    ))
}
