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
    let mut runs = Vec::new();
    for round in 0..repeat {
        for place in 0..variants {
            let variant = if round % 2 == 0 {
                place
            } else {
                variants - 1 - place
            };
            runs.push(ScheduledRun { round, variant });
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_second_round_runs_in_reverse_order() {
        let runs = schedule(3, 3);
        let rounds: Vec<_> = runs.iter().map(|run| run.round).collect();
        assert_eq!(rounds, [0, 0, 0, 1, 1, 1, 2, 2, 2]);
        let order: Vec<_> = runs.iter().map(|run| run.variant).collect();
        assert_eq!(order, [0, 1, 2, 2, 1, 0, 0, 1, 2]);
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
