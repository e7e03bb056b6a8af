//! Latencies of a clip and their exact percentiles.

use albireo_wire::Percentiles;

/// The latencies of one clip, milliseconds. A clip is reported in parts, which bounds their number.
#[derive(Debug, Default)]
pub(crate) struct Latencies(Vec<f32>);

impl Latencies {
    /// Adds one.
    pub(crate) fn add(&mut self, ms: f64) {
        self.0.push(ms as f32);
    }

    /// How many there are.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Count, mean and percentiles by the nearest-rank method; zeros without latencies.
    pub(crate) fn into_percentiles(self) -> Percentiles {
        let Self(mut sorted) = self;
        sorted.sort_unstable_by(f32::total_cmp);
        // Nearest rank: the smallest value with at least `percent` of all values at or below it.
        let at = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100);
            let value = rank.checked_sub(1).and_then(|i| sorted.get(i));
            value.map_or(0.0, |ms| f64::from(*ms))
        };
        let sum: f64 = sorted.iter().map(|ms| f64::from(*ms)).sum();
        Percentiles {
            count: sorted.len() as u64,
            mean: sum / sorted.len().max(1) as f64,
            p50: at(50),
            p95: at(95),
            p99: at(99),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact_nearest_ranks() {
        let mut latencies = Latencies::default();
        for ms in (1..=200).rev() {
            latencies.add(f64::from(ms));
        }
        let found = latencies.into_percentiles();
        assert_eq!((found.p50, found.p95, found.p99), (100.0, 190.0, 198.0));
        assert_eq!(found.count, 200);
        assert!((found.mean - 100.5).abs() < 1e-9);
    }

    #[test]
    fn a_clip_without_latencies_has_zeros_and_no_nan() {
        assert_eq!(
            Latencies::default().into_percentiles(),
            Percentiles::default()
        );
    }
}
