//! Computes exact percentiles of latencies.

use albireo_wire::Percentiles;

/// The percentile by the nearest-rank method: the smallest value with at least `percent` of all values at or below it.
/// `None` without values.
pub(crate) fn percentile(sorted: &[f32], percent: usize) -> Option<f32> {
    let rank = (sorted.len() * percent).div_ceil(100);
    sorted.get(rank.checked_sub(1)?).copied()
}

/// Count, mean and percentiles; zeros without latencies.
pub(crate) fn percentiles(mut latencies: Vec<f32>) -> Percentiles {
    latencies.sort_unstable_by(f32::total_cmp);
    let at = |percent: usize| f64::from(percentile(&latencies, percent).unwrap_or_default());
    let sum: f64 = latencies.iter().map(|ms| f64::from(*ms)).sum();
    Percentiles {
        count: latencies.len() as u64,
        mean: sum / latencies.len().max(1) as f64,
        p50: at(50),
        p95: at(95),
        p99: at(99),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact_nearest_ranks_and_zeros_without_latencies() {
        let found = percentiles((1..=200_u8).rev().map(f32::from).collect());
        assert_eq!((found.p50, found.p95, found.p99), (100.0, 190.0, 198.0));
        assert_eq!(found.count, 200);
        assert!((found.mean - 100.5).abs() < 1e-9);
        assert_eq!(percentiles(Vec::new()), Percentiles::default());
    }
}
