//! Latencies of a clip and their exact percentiles.

use albireo_wire::Percentiles;
use std::time::Duration;

/// Latencies kept for the percentiles of one clip. Beyond it (36 minutes at 30 frames a second) they are
/// those of an even random sample of this many; count and mean are exact always.
pub(crate) const MOST_KEPT: usize = 65_536;

/// The latencies of one clip.
#[derive(Debug, Default)]
pub(crate) struct Latencies {
    kept_ms: Vec<f32>,
    count: u64,
    sum_ms: f64,
}

impl Latencies {
    /// Adds one.
    pub(crate) fn add(&mut self, latency: Duration) {
        let ms = latency.as_secs_f64() * 1e3;
        self.count += 1;
        self.sum_ms += ms;
        if self.kept_ms.len() < MOST_KEPT {
            self.kept_ms.push(ms as f32);
            return;
        }
        // Vitter's algorithm R: the n-th value takes a random place among n, and stays if that is kept.
        let place = scramble(self.count) % self.count;
        if let Some(slot) = usize::try_from(place)
            .ok()
            .and_then(|i| self.kept_ms.get_mut(i))
        {
            *slot = ms as f32;
        }
    }

    /// How many were added.
    #[cfg(test)]
    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// Count, mean and percentiles by the nearest-rank method; zeros without latencies.
    pub(crate) fn into_percentiles(self) -> Percentiles {
        let mut sorted = self.kept_ms;
        sorted.sort_unstable_by(f32::total_cmp);
        // Nearest rank: the smallest value with at least `percent` of all values at or below it.
        let at = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100);
            rank.checked_sub(1)
                .and_then(|i| sorted.get(i))
                .map_or(0.0, |ms| f64::from(*ms))
        };
        Percentiles {
            count: self.count,
            mean: if self.count == 0 {
                0.0
            } else {
                self.sum_ms / self.count as f64
            },
            p50: at(50),
            p95: at(95),
            p99: at(99),
        }
    }
}

/// A well-mixed function of `n` (splitmix64, Steele et al. 2014): the same clip gives the same sample.
fn scramble(n: u64) -> u64 {
    let mut z = n.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact_nearest_ranks() {
        let mut latencies = Latencies::default();
        for ms in (1..=200).rev() {
            latencies.add(Duration::from_millis(ms));
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

    #[test]
    fn memory_is_bounded_and_the_sample_stays_even() {
        let mut latencies = Latencies::default();
        let n = 4 * MOST_KEPT as u64;
        for i in 0..n {
            latencies.add(Duration::from_micros(i));
        }
        assert_eq!(latencies.kept_ms.len(), MOST_KEPT);
        let found = latencies.into_percentiles();
        assert_eq!(found.count, n);
        let whole_ms = n as f64 * 1e-3;
        assert!((found.mean - whole_ms / 2.0).abs() < 1.0);
        assert!((found.p50 / whole_ms - 0.50).abs() < 0.01, "{found:?}");
        assert!((found.p99 / whole_ms - 0.99).abs() < 0.01, "{found:?}");
    }
}
