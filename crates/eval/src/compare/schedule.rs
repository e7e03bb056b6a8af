//! Decides the order in which runs are played.

/// A run of the comparison to play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScheduledRun {
    /// Number of the round, from 0: each round plays every variant once.
    pub round: usize,
    /// Number of the variant, from 0.
    pub variant: usize,
}

/// Returns `repeat` rounds of `variants` runs. Every second round is in reverse order (A B, B A, A B, …), so that
/// a steady drift, such as the board's temperature, affects all variants alike.
pub fn schedule(variants: usize, repeat: usize) -> Vec<ScheduledRun> {
    (0..repeat)
        .flat_map(|round| {
            (0..variants).map(move |place| ScheduledRun {
                round,
                variant: if round % 2 == 0 {
                    place
                } else {
                    variants - 1 - place
                },
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_second_round_runs_in_reverse_order() {
        let order: Vec<_> = schedule(3, 3).iter().map(|run| run.variant).collect();
        assert_eq!(order, [0, 1, 2, 2, 1, 0, 0, 1, 2]);
        let second = schedule(2, 1)[1];
        assert_eq!((second.round, second.variant), (0, 1));
    }

    #[test]
    fn a_steady_drift_affects_all_variants_alike() {
        for variants in 1..5 {
            let mut places = vec![0; variants];
            for (place, run) in schedule(variants, 4).iter().enumerate() {
                places[run.variant] += place;
            }
            assert!(places.iter().all(|sum| *sum == places[0]), "{places:?}");
        }
    }
}
