//! Selects the policies of a run from `NAME[:ARGUMENT]` on the command line and sweeps, and gives them their labels
//! in traces, tables and plots.

use crate::error::EvalError;
use crate::settings::ScreenRule;
use albireo_core::policy::{
    Albireo, Ctd, FixedSkip, Policy, PolicyConfig, PolicyConfigError, Statues, Vanilla,
};
use std::collections::BTreeSet;

/// Name and label of the policy with which all others are compared.
pub const BASELINE: &str = "vanilla";

/// The policies of `--policy all`: every policy with the settings that the paper reports, and our own. Those that look at
/// pixels are left out if there are none.
const ALL: [&str; 22] = [
    "albireo:3e-4",
    "albireo:5e-4",
    "albireo:7e-4",
    "albireo:1e-3",
    "fixed-skip:2",
    "fixed-skip:3",
    "fixed-skip:5",
    "ctd:0.30",
    "ctd:0.50",
    "ctd:0.70",
    "ctd:0.90",
    "statues:25",
    "statues:75",
    "statues:200",
    "statues:500",
    "erd-only",
    "kill-only:3e-4",
    "kill+erd:3e-4",
    "kill+erd-10d:3e-4",
    "expected-loss:0.1",
    "expected-loss:0.3",
    "expected-loss:0.5",
];

/// A policy with its settings: one line of the results.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicySpec {
    /// Its name in results, unique in a run: `albireo-u3e-4-erd-nonempty`, `fixedskip-2`, `vanilla`.
    pub label: String,
    /// The configuration from which it is built.
    pub config: PolicyConfig,
}

impl PolicySpec {
    /// Builds the policy.
    ///
    /// # Errors
    /// When its configuration is invalid.
    pub(crate) fn build(&self) -> Result<Box<dyn Policy>, EvalError> {
        self.config
            .build()
            .map_err(|error| EvalError::new(format!("policy {}: {error}", self.label)))
    }
}

/// Values of a setting to try one after the other: `u=3e-4,5e-4`.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Name of the setting, as the policy's threshold is named.
    pub name: String,
    /// The values to try.
    pub values: Vec<f64>,
}

impl std::str::FromStr for Sweep {
    type Err = EvalError;

    fn from_str(text: &str) -> Result<Self, EvalError> {
        let wrong = |reason: String| EvalError::new(format!("--sweep {text}: {reason}"));
        let (name, values) = text.split_once('=').ok_or_else(|| {
            wrong("write NAME=VALUE,VALUE,…, for instance u=3e-4,5e-4".to_owned())
        })?;
        let values = values
            .split(',')
            .map(|value| {
                value.trim().parse().map_err(|_| wrong(format!("`{value}` is not a number")))
            })
            .collect::<Result<Vec<f64>, _>>()?;
        Ok(Self {
            name: name.trim().to_owned(),
            values,
        })
    }
}

/// Returns the policies to run: the baseline, then `asked` in order with all values of `sweeps`, without repetitions.
/// `screen` is part of the labels; `pixels` is true if there are pictures to look at.
///
/// # Errors
/// [`EvalError`] for an unknown policy, an argument it does not take, a value out of range, or a sweep
/// that applies to none of them.
pub fn resolve(
    asked: &[String],
    sweeps: &[Sweep],
    base: &PolicyConfig,
    screen: ScreenRule,
    pixels: bool,
) -> Result<Vec<PolicySpec>, EvalError> {
    let asked = asked.iter().flat_map(|asked| match asked.as_str() {
        "all" => ALL
            .iter()
            // Statues looks at pixels.
            .filter(|name| pixels || !name.starts_with(Statues::NAME))
            .copied()
            .collect(),
        asked => vec![asked],
    });
    let asked: Vec<&str> = std::iter::once(BASELINE).chain(asked).collect();
    swept(&asked, sweeps, base, |policy| label(policy, screen))
}

/// A policy, and the configuration from which it was built.
type Built = (PolicyConfig, Box<dyn Policy>);

/// Returns the policies `asked` for (`NAME[:ARGUMENT]` each) in order, without repetitions, with everything else as in
/// `base`. A policy whose threshold is swept occurs once for each value, unless it has an argument of its own.
///
/// # Errors
/// [`EvalError`] for an unknown policy, an argument it does not take, a value out of range, or a sweep
/// that applies to none of them.
pub(crate) fn swept(
    asked: &[&str],
    sweeps: &[Sweep],
    base: &PolicyConfig,
    label: impl Fn(&dyn Policy) -> String,
) -> Result<Vec<PolicySpec>, EvalError> {
    let mut found = Vec::new();
    let mut applied = vec![false; sweeps.len()];
    for asked in asked {
        let one = build(asked, base)?;
        let spec = one.1.threshold_spec();
        let sweep =
            sweeps.iter().position(|sweep| spec.is_some_and(|spec| spec.name == sweep.name));
        match sweep {
            Some(index) if !asked.contains(':') => {
                applied[index] = true;
                for value in &sweeps[index].values {
                    found.push(build(&format!("{asked}:{value:e}"), base)?);
                }
            }
            _ => found.push(one),
        }
    }
    match applied.iter().position(|applied| !applied) {
        Some(unused) => Err(EvalError::new(format!(
            "no policy of this run has a setting `{}` left to try values of: add one that has it, such as --policy albireo",
            sweeps[unused].name
        ))),
        None => {
            let mut seen = BTreeSet::new();
            let mut specs: Vec<PolicySpec> = found
                .into_iter()
                .map(|(config, policy)| PolicySpec {
                    label: label(policy.as_ref()),
                    config,
                })
                .collect();
            specs.retain(|spec| seen.insert(spec.label.clone()));
            Ok(specs)
        }
    }
}

/// Reads `NAME[:ARGUMENT]` and makes sure that the policy can be built.
fn build(asked: &str, base: &PolicyConfig) -> Result<Built, EvalError> {
    let refused =
        |error: PolicyConfigError| EvalError::new(error).context(format!("--policy {asked}"));
    let mut config = base.clone();
    config.select(asked).map_err(refused)?;
    let policy = config.build().map_err(refused)?;
    Ok((config, policy))
}

/// True if the policy's threshold is the paper's `u`.
pub(crate) fn takes_u(policy: &dyn Policy) -> bool {
    policy.threshold_spec().is_some_and(|spec| spec.name == Albireo::THRESHOLD.name)
}

/// Labels a policy as the published traces do, if they contain it.
fn label(policy: &dyn Policy, screen: ScreenRule) -> String {
    let name = match policy.name() {
        FixedSkip::NAME => "fixedskip",
        name => name,
    };
    let setting = match (policy.threshold_spec(), policy.threshold()) {
        (Some(_), Some(value)) if takes_u(policy) => format!("-u{value:e}"),
        (Some(_), Some(value)) if policy.name() == Ctd::NAME => format!("-{value:.2}"),
        (Some(_), Some(value)) => format!("-{value}"),
        _ => String::new(),
    };
    // The screen is part of the label of policies that use it.
    let screened = !matches!(
        policy.name(),
        Vanilla::NAME | FixedSkip::NAME | Ctd::NAME | Statues::NAME
    );
    if screened {
        format!("{name}{setting}-erd-{}", screen.as_str())
    } else {
        format!("{name}{setting}")
    }
}

/// Shortens a label by the part that all policies of a run share.
pub(crate) fn short_label(label: &str) -> &str {
    label.split_once("-erd-").map_or(label, |(start, _)| start)
}

/// Splits a label into its family, shared by all settings of a policy, and its setting: `albireo-u3e-4-erd-nonempty` is
/// `albireo` at `u = 3e-4`, `fixedskip-2` is `fixedskip` at `2`, `vanilla` has none.
pub(crate) fn split_label(label: &str) -> (&str, String) {
    let base = label.split_once("-erd-").map_or(label, |(base, _)| base);
    if let Some((family, u)) = base.rsplit_once("-u")
        && u.parse::<f64>().is_ok()
    {
        return (family, format!("u = {u}"));
    }
    match base.rsplit_once('-') {
        Some((family, setting)) if setting.parse::<f64>().is_ok() => (family, setting.to_owned()),
        _ => (base, String::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(asked: &[&str], sweeps: &[&str], pixels: bool) -> Result<Vec<String>, EvalError> {
        let asked: Vec<String> = asked.iter().map(|&name| name.to_owned()).collect();
        let sweeps = sweeps.iter().map(|text| text.parse::<Sweep>());
        let sweeps: Vec<Sweep> = sweeps.collect::<Result<_, _>>()?;
        let base = PolicyConfig::default();
        let specs = resolve(&asked, &sweeps, &base, ScreenRule::Nonempty, pixels)?;
        Ok(specs.into_iter().map(|spec| spec.label).collect())
    }

    #[test]
    fn a_label_is_split_into_family_and_setting() {
        for (label, family, setting) in [
            ("albireo-u3e-4-erd-nonempty", "albireo", "u = 3e-4"),
            ("kill+erd-10d-u1e-3", "kill+erd-10d", "u = 1e-3"),
            ("fixedskip-2", "fixedskip", "2"),
            ("ctd-0.50", "ctd", "0.50"),
            ("erd-only-erd-detections", "erd-only", ""),
            ("vanilla", "vanilla", ""),
        ] {
            assert_eq!(split_label(label), (family, setting.to_owned()));
        }
    }

    #[test]
    fn policies_have_the_labels_of_the_published_traces_and_the_baseline_is_always_there() {
        let (asked, expected): (Vec<_>, Vec<_>) = [
            ("vanilla", "vanilla"),
            ("albireo", "albireo-u3e-4-erd-nonempty"),
            ("albireo:1e-3", "albireo-u1e-3-erd-nonempty"),
            ("fixed-skip:2", "fixedskip-2"),
            ("ctd:0.5", "ctd-0.50"),
            ("statues:75", "statues-75"),
            ("erd-only", "erd-only-erd-nonempty"),
            ("kill-only", "kill-only-u3e-4-erd-nonempty"),
            ("kill+erd", "kill+erd-u3e-4-erd-nonempty"),
            ("kill+erd-10d", "kill+erd-10d-u3e-4-erd-nonempty"),
        ]
        .into_iter()
        .unzip();
        for asked in [&asked[..], &asked[1..]] {
            assert_eq!(labels(asked, &[], false).unwrap(), expected);
        }
    }

    #[test]
    fn all_is_every_policy_and_setting_that_the_data_allows() {
        for (pixels, count) in [(false, 19), (true, 23)] {
            assert_eq!(labels(&["all"], &[], pixels).unwrap().len(), count);
        }
    }

    #[test]
    fn a_sweep_runs_every_value_once_and_leaves_the_others_alone() {
        let labels = labels(&["albireo", "vanilla"], &["u=3e-4,7e-4,3e-4"], false).unwrap();
        let [three, seven] = ["albireo-u3e-4-erd-nonempty", "albireo-u7e-4-erd-nonempty"];
        assert_eq!(labels, ["vanilla", three, seven]);
    }

    #[test]
    fn an_unreadable_sweep_is_rejected_by_name() {
        for (sweep, part) in [
            ("u", "NAME=VALUE"),
            ("u=1e-3,zwei", "`zwei` is not a number"),
        ] {
            let refused = labels(&["albireo"], &[sweep], false).unwrap_err();
            assert!(refused.to_string().contains(part), "{refused}");
        }
    }
}
