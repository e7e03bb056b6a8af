//! The Pareto frontier of cost and value.

/// One choice: what it costs (less is better) and what it is worth (more is better).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Less is better.
    pub cost: f64,
    /// More is better.
    pub value: f64,
}

/// Indices of the choices that no other beats: none has at most the cost and at least the value, and is
/// better in one of the two. Sorted by rising cost; equal choices are all on it. Choices with a NaN never
/// are.
pub(crate) fn frontier(choices: &[Choice]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..choices.len())
        .filter(|&index| !choices[index].cost.is_nan() && !choices[index].value.is_nan())
        .collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (choices[a], choices[b]);
        a.cost.total_cmp(&b.cost).then(b.value.total_cmp(&a.value))
    });
    let mut frontier: Vec<usize> = Vec::new();
    for index in order {
        let beaten = frontier.last().is_some_and(|&best| {
            choices[best].value >= choices[index].value && choices[best] != choices[index]
        });
        if !beaten {
            frontier.push(index);
        }
    }
    frontier
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn beats(a: Choice, b: Choice) -> bool {
        a.cost <= b.cost && a.value >= b.value && a != b
    }

    #[test]
    fn a_choice_beaten_on_both_counts_is_not_on_the_frontier() {
        let choices = [(3.0, 0.9), (1.0, 0.5), (2.0, 0.4), (2.0, 0.7)]
            .map(|(cost, value)| Choice { cost, value });
        assert_eq!(frontier(&choices), [1, 3, 0]);
    }

    #[test]
    fn a_choice_without_a_value_is_not_on_the_frontier() {
        let choices = [
            Choice {
                cost: 1.0,
                value: f64::NAN,
            },
            Choice {
                cost: 2.0,
                value: 0.1,
            },
        ];
        assert_eq!(frontier(&choices), [1]);
    }

    proptest! {
        #[test]
        fn the_frontier_is_exactly_the_unbeaten(points in proptest::collection::vec((0..6u8, 0..6u8), 0..20)) {
            let choices: Vec<Choice> = points
                .iter()
                .map(|&(cost, value)| Choice { cost: cost.into(), value: value.into() })
                .collect();
            let mut found = frontier(&choices);
            found.sort_unstable();
            let expected: Vec<usize> = (0..choices.len())
                .filter(|&i| !choices.iter().any(|&other| beats(other, choices[i])))
                .collect();
            prop_assert_eq!(found, expected);
        }
    }
}
