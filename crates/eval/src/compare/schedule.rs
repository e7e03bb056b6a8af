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
        let runs = schedule(2, 3).into_iter();
        let order: Vec<_> = runs.map(|run| (run.round, run.variant)).collect();
        assert_eq!(order, [(0, 0), (0, 1), (1, 1), (1, 0), (2, 0), (2, 1)]);
    }
}
