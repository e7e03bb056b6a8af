//! Lists the variants of a comparison: policies with the values of their thresholds.

use crate::error::EvalError;
use crate::spec::{Base, PolicySpec, Sweep, pause_label, swept};
use albireo_core::policy::{Albireo, EmptyRoad, Policy};

/// Returns the variants of `asked` (`NAME[:ARGUMENT][,pause_s=…][,after_s=…]` each) in order, without repetitions. A
/// policy with the threshold `u` and without an argument of its own occurs once for each value of `thresholds`;
/// everything else is as in `base`.
///
/// # Errors
/// [`EvalError`] for an unknown policy, a value out of range, values of `u` that no policy takes, or
/// fewer than two variants.
pub fn variants(
    asked: &[String],
    thresholds: &[f64],
    base: Base<'_>,
) -> Result<Vec<PolicySpec>, EvalError> {
    let asked: Vec<&str> = asked.iter().map(String::as_str).collect();
    let mut sweeps = Vec::new();
    if !thresholds.is_empty() {
        sweeps.push(Sweep {
            name: Albireo::THRESHOLD.name.to_owned(),
            values: thresholds.to_vec(),
        });
    }
    let found = swept(&asked, &sweeps, base, label)?;
    if let [alone] = found.as_slice() {
        return Err(EvalError::new(format!(
            "`{}` is the only policy: name a second one, such as --policy vanilla --policy albireo",
            alone.label
        )));
    }
    Ok(found)
}

fn label(policy: &dyn Policy, empty_road: EmptyRoad) -> String {
    let name = policy.name();
    let label = match (policy.threshold_spec(), policy.threshold()) {
        (Some(spec), Some(value)) if value != 0.0 && value.abs() < 0.01 => {
            format!("{name} {}={value:e}", spec.name)
        }
        (Some(spec), Some(value)) => format!("{name} {}={value}", spec.name),
        _ => name.to_owned(),
    };
    label + &pause_label(empty_road)
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::policy::PolicyConfig;

    fn labels(asked: &[&str], thresholds: &[f64]) -> Result<Vec<String>, String> {
        let asked: Vec<_> = asked.iter().map(|name| (*name).to_owned()).collect();
        let config = PolicyConfig::default();
        let base = Base {
            config: &config,
            empty_road: EmptyRoad::default(),
        };
        variants(&asked, thresholds, base)
            .map(|found| found.into_iter().map(|variant| variant.label).collect())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn each_threshold_is_a_variant_of_the_policies_that_have_one() {
        let asked = ["vanilla", "albireo", "albireo:1e-3", "vanilla"];
        let found = labels(&asked, &[3e-4, 5e-4]).unwrap().join(", ");
        let expected = "vanilla, albireo u=3e-4, albireo u=5e-4, albireo u=1e-3";
        assert_eq!(found, expected);
    }

    #[test]
    fn a_policy_is_labelled_with_its_own_argument() {
        let found = labels(&["vanilla", "fixed-skip:3"], &[]).unwrap();
        assert_eq!(found, ["vanilla", "fixed-skip n=3"]);
    }

    #[test]
    fn an_impossible_comparison_is_rejected_with_a_remedy() {
        let refused = |asked: &[&str], thresholds: &[f64]| labels(asked, thresholds).unwrap_err();
        assert!(refused(&["vanilla", "fixed-skip"], &[3e-4]).contains("--policy albireo"));
        assert!(refused(&["albireo"], &[]).contains("name a second one"));
        let reason = refused(&["vanilla", "albireo"], &[7.0]);
        assert!(reason.contains("--policy albireo:7e0"), "{reason}");
    }
}
