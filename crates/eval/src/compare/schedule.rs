//! The order in which runs are played.

/// One run of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Number of the round, from 0: each round plays every variant once.
    pub round: usize,
    /// Which variant, from 0.
    pub variant: usize,
}

/// `repeat` rounds of `variants` runs. Every second round goes backwards (A B, B A, A B, …), so that what
/// changes steadily while the comparison runs, such as the board's temperature, falls on all alike.
pub fn schedule(variants: usize, repeat: usize) -> Vec<Turn> {
    (0..repeat)
        .flat_map(|round| {
            (0..variants).map(move |place| Turn {
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
    fn every_second_round_goes_backwards() {
        let order: Vec<_> = schedule(3, 3).iter().map(|turn| turn.variant).collect();
        assert_eq!(order, [0, 1, 2, 2, 1, 0, 0, 1, 2]);
        assert_eq!(
            schedule(2, 1)[1],
            Turn {
                round: 0,
                variant: 1
            }
        );
    }

    #[test]
    fn a_steady_drift_falls_on_all_variants_alike() {
        for variants in 1..5 {
            let mut places = vec![0; variants];
            for (place, turn) in schedule(variants, 4).iter().enumerate() {
                places[turn.variant] += place;
            }
            assert!(places.iter().all(|sum| *sum == places[0]), "{places:?}");
        }
    }
}
