//! Selects the policies of a run from `NAME[:ARGUMENT][,pause_s=SECONDS][,after_s=SECONDS]` on the command line and
//! sweeps, and gives them their labels in traces, tables and plots.

use crate::error::EvalError;
use crate::settings::ScreenRule;
use albireo_core::policy::{
    Albireo, Ctd, EmptyRoad, FixedSkip, Policy, PolicyConfig, Statues, Vanilla, WithPause, no_pause,
};

/// Name and label of the policy with which all others are compared.
pub const BASELINE: &str = "vanilla";

/// The policies of `--policy all`: those of the paper with the settings that it reports, and expected-loss. Those that look
/// at pixels are left out if there are none. The variants of expected-loss are for comparisons among themselves.
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
    /// Its name in results, unique in a run: `albireo-u3e-4-erd-nonempty`, `fixed-skip-2`, `vanilla`.
    pub label: String,
    /// The configuration from which it is built.
    pub config: PolicyConfig,
    /// Its pause on an empty road.
    pub empty_road: EmptyRoad,
}

impl PolicySpec {
    /// Builds the policy for a clip of `rate` frames per second.
    ///
    /// # Errors
    /// When its configuration is invalid, or when it has a pause and the rate is not known.
    pub(crate) fn build(&self, rate: Option<f64>) -> Result<Box<dyn Policy>, EvalError> {
        let refused = |what: &str| EvalError::new(format!("policy {}: {what}", self.label));
        let policy = self.config.build().map_err(|error| refused(&error.to_string()))?;
        if self.empty_road.pause_s == 0.0 {
            return Ok(policy);
        }
        if rate.is_none() {
            let what = "a pause is in seconds, and the data has no frame rate: give it with --rate";
            return Err(refused(what));
        }
        let pause = self.empty_road.frames(rate);
        Ok(Box::new(WithPause::new(policy, pause)))
    }
}

/// The settings that a policy has where the command line names none of its own.
#[derive(Clone, Copy, Debug)]
pub struct Base<'a> {
    /// Those of all policies.
    pub config: &'a PolicyConfig,
    /// The pause on an empty road.
    pub empty_road: EmptyRoad,
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
        let Some((name, listed)) = text.split_once('=') else {
            let what = "write NAME=VALUE,VALUE,…, for instance u=3e-4,5e-4";
            return Err(wrong(what.to_owned()));
        };
        let mut values = Vec::new();
        for value in listed.split(',') {
            let number = value.trim().parse::<f64>();
            values.push(number.map_err(|_| wrong(format!("`{value}` is not a number")))?);
        }
        Ok(Self {
            name: name.trim().to_owned(),
            values,
        })
    }
}

/// Returns the policies to run: the baseline, then `asked` in order with all values of `sweeps`, without repetitions.
/// `base` has all other settings. `screen` is part of the labels; `pixels` is true if there are pictures to look at.
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
    let base = Base {
        config: base,
        empty_road: EmptyRoad::default(),
    };
    resolve_with_pause(asked, sweeps, base, screen, pixels)
}

/// [`resolve`], where a policy that names no pause of its own has that of `base`.
///
/// # Errors
/// The same as for [`resolve`].
pub fn resolve_with_pause(
    asked: &[String],
    sweeps: &[Sweep],
    base: Base<'_>,
    screen: ScreenRule,
    pixels: bool,
) -> Result<Vec<PolicySpec>, EvalError> {
    let mut names = vec![BASELINE];
    for name in asked {
        if name == "all" {
            let usable = |name: &&str| pixels || !looks_at_pixels(name);
            names.extend(ALL.into_iter().filter(usable));
        } else {
            names.push(name);
        }
    }
    swept(&names, sweeps, base, |policy, empty_road| {
        label(policy, empty_road, screen)
    })
}

/// True for a policy of [`ALL`] that needs pictures.
fn looks_at_pixels(name: &str) -> bool {
    name.starts_with(Statues::NAME)
}

/// A policy, and what it was built from.
struct Built {
    config: PolicyConfig,
    empty_road: EmptyRoad,
    policy: Box<dyn Policy>,
}

/// Returns the policies `asked` for (`NAME[:ARGUMENT][,pause_s=…][,after_s=…]` each) in order, without repetitions, with
/// everything else as in `base`. A policy whose threshold is swept occurs once for each value, unless it has an argument of its
/// own.
///
/// # Errors
/// [`EvalError`] for an unknown policy, an argument it does not take, a value out of range, or a sweep
/// that applies to none of them.
pub(crate) fn swept(
    asked: &[&str],
    sweeps: &[Sweep],
    base: Base<'_>,
    label_of: impl Fn(&dyn Policy, EmptyRoad) -> String,
) -> Result<Vec<PolicySpec>, EvalError> {
    let mut all = Vec::new();
    let mut applied = vec![false; sweeps.len()];
    for text in asked {
        let built = build(text, base)?;
        let threshold = built.policy.threshold_spec().map(|threshold| threshold.name);
        let (name, pause) = text.split_at(text.find(',').unwrap_or(text.len()));
        let sweep = sweeps.iter().position(|sweep| threshold == Some(&*sweep.name));
        match sweep {
            Some(index) if !name.contains(':') => {
                applied[index] = true;
                for value in &sweeps[index].values {
                    all.push(build(&format!("{name}:{value:e}{pause}"), base)?);
                }
            }
            _ => all.push(built),
        }
    }
    if let Some(unused) = applied.iter().position(|applied| !applied) {
        return Err(EvalError::new(format!(
            "no policy of this run has a setting `{}` left to try values of: add one that has it, such as --policy albireo",
            sweeps[unused].name
        )));
    }
    let mut specs: Vec<PolicySpec> = Vec::new();
    for built in all {
        let label = label_of(built.policy.as_ref(), built.empty_road);
        if specs.iter().all(|spec| spec.label != label) {
            specs.push(PolicySpec {
                label,
                config: built.config,
                empty_road: built.empty_road,
            });
        }
    }
    Ok(specs)
}

/// Reads `NAME[:ARGUMENT][,pause_s=…][,after_s=…]` and makes sure that the policy can be built.
fn build(asked: &str, base: Base<'_>) -> Result<Built, EvalError> {
    let refused = |reason: String| EvalError::new(reason).context(format!("--policy {asked}"));
    let mut parts = asked.split(',');
    let mut config = base.config.clone();
    let name = parts.next().unwrap_or_default();
    config.select(name).map_err(|error| refused(error.to_string()))?;
    let names_pause = asked.contains(',');
    let mut empty_road = read_pause(parts, base.empty_road).map_err(refused)?;
    let policy = config.build().map_err(|error| refused(error.to_string()))?;
    if !policy.takes_pause() {
        if names_pause {
            return Err(refused(no_pause(config.name.as_str())));
        }
        empty_road = EmptyRoad::default();
    }
    Ok(Built {
        config,
        empty_road,
        policy,
    })
}

/// Reads `pause_s=…` and `after_s=…` in place of those of `base`.
fn read_pause<'a>(
    parts: impl Iterator<Item = &'a str>,
    base: EmptyRoad,
) -> Result<EmptyRoad, String> {
    let mut empty_road = base;
    for part in parts {
        let (name, value) = part.split_once('=').unwrap_or((part, ""));
        let place = match name.trim() {
            "pause_s" => &mut empty_road.pause_s,
            "after_s" => &mut empty_road.after_s,
            _ => {
                return Err(format!(
                    "`{part}` is neither pause_s=SECONDS nor after_s=SECONDS"
                ));
            }
        };
        *place = value.trim().parse().map_err(|_| format!("`{part}`: write {name}=SECONDS"))?;
    }
    match empty_road.problem() {
        Some((name, reason)) => Err(format!("{name} {reason}")),
        None => Ok(empty_road),
    }
}

/// The part of a label that tells the pause; empty without one.
pub(crate) fn pause_label(empty_road: EmptyRoad) -> String {
    let EmptyRoad {
        pause_s, after_s, ..
    } = empty_road;
    if pause_s == 0.0 {
        String::new()
    } else if after_s == EmptyRoad::default().after_s {
        format!("+pause{pause_s}")
    } else {
        format!("+pause{pause_s}after{after_s}")
    }
}

/// True if the policy's threshold is the paper's `u`.
pub(crate) fn takes_u(policy: &dyn Policy) -> bool {
    policy.threshold_spec().is_some_and(|spec| spec.name == Albireo::THRESHOLD.name)
}

/// True for 0.5, false for 0.505, whose label would be that of 0.50 or 0.51.
fn is_hundredths(value: f64) -> bool {
    format!("{value:.2}").parse() == Ok(value)
}

/// Labels a policy by its name in the configuration and its setting, as the published traces do (which leave the hyphen of
/// `fixed-skip` out).
fn label(policy: &dyn Policy, empty_road: EmptyRoad, screen: ScreenRule) -> String {
    let name = policy.name();
    let mut setting = match policy.threshold() {
        Some(value) if takes_u(policy) => format!("-u{value:e}"),
        Some(value) if name == Ctd::NAME && is_hundredths(value) => format!("-{value:.2}"),
        Some(value) => format!("-{value}"),
        None => String::new(),
    };
    setting.push_str(&pause_label(empty_road));
    // The screen is part of the label of policies that use it.
    let is_screened = !matches!(
        name,
        Vanilla::NAME | FixedSkip::NAME | Ctd::NAME | Statues::NAME
    );
    if is_screened {
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
/// `albireo` at `u = 3e-4`, `fixed-skip-2` is `fixed-skip` at `2`, `vanilla` has none. A pause belongs to the setting.
pub(crate) fn split_label(label: &str) -> (&str, String) {
    let base = short_label(label);
    if let Some((start, pause)) = base.split_once("+pause") {
        let (family, setting) = split_label(start);
        let setting = format!("{setting} pause {}", pause.replace("after", " after "));
        return (family, setting.trim_start().to_owned());
    }
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

    /// What `pixels` is on stored detections and on pictures.
    const NO_PIXELS: bool = false;
    const PIXELS: bool = true;

    fn specs(asked: &[&str], sweeps: &[&str], pixels: bool) -> Result<Vec<PolicySpec>, EvalError> {
        let asked: Vec<String> = asked.iter().map(|&name| name.to_owned()).collect();
        let sweeps: Vec<Sweep> =
            sweeps.iter().map(|text| text.parse()).collect::<Result<_, _>>()?;
        let base = PolicyConfig::default();
        resolve(&asked, &sweeps, &base, ScreenRule::Nonempty, pixels)
    }

    fn labels_of(specs: Vec<PolicySpec>) -> Vec<String> {
        specs.into_iter().map(|spec| spec.label).collect()
    }

    /// The labels on stored detections.
    fn labels(asked: &[&str], sweeps: &[&str]) -> Result<Vec<String>, EvalError> {
        Ok(labels_of(specs(asked, sweeps, NO_PIXELS)?))
    }

    #[test]
    fn a_label_is_split_into_family_and_setting() {
        for (label, family, setting) in [
            ("albireo-u3e-4-erd-nonempty", "albireo", "u = 3e-4"),
            ("kill+erd-10d-u1e-3", "kill+erd-10d", "u = 1e-3"),
            ("fixed-skip-2", "fixed-skip", "2"),
            ("ctd-0.50", "ctd", "0.50"),
            ("erd-only-erd-detections", "erd-only", ""),
            ("vanilla", "vanilla", ""),
            (
                "albireo-u3e-4+pause0.16-erd-nonempty",
                "albireo",
                "u = 3e-4 pause 0.16",
            ),
            (
                "kill+erd-10d-u1e-3+pause0.2after2",
                "kill+erd-10d",
                "u = 1e-3 pause 0.2 after 2",
            ),
        ] {
            assert_eq!(split_label(label), (family, setting.to_owned()));
        }
    }

    #[test]
    fn policies_have_the_labels_of_the_published_traces_and_the_baseline_is_always_there() {
        let (with_baseline, expected): (Vec<_>, Vec<_>) = [
            ("vanilla", "vanilla"),
            ("albireo", "albireo-u3e-4-erd-nonempty"),
            ("albireo:1e-3", "albireo-u1e-3-erd-nonempty"),
            ("fixed-skip:2", "fixed-skip-2"),
            ("ctd:0.5", "ctd-0.50"),
            ("ctd:0.505", "ctd-0.505"),
            ("statues:75", "statues-75"),
            ("erd-only", "erd-only-erd-nonempty"),
            ("kill-only", "kill-only-u3e-4-erd-nonempty"),
            ("kill+erd", "kill+erd-u3e-4-erd-nonempty"),
            ("kill+erd-10d", "kill+erd-10d-u3e-4-erd-nonempty"),
        ]
        .into_iter()
        .unzip();
        let without_baseline = &with_baseline[1..];
        assert_eq!(labels(&with_baseline, &[]).unwrap(), expected);
        assert_eq!(labels(without_baseline, &[]).unwrap(), expected);
    }

    #[test]
    fn all_is_every_policy_and_setting_that_the_data_allows() {
        let on_pictures = labels_of(specs(&["all"], &[], PIXELS).unwrap());
        assert_eq!(on_pictures.len(), 1 + ALL.len(), "the baseline, too");
        let mut without_statues = on_pictures;
        without_statues.retain(|label| !label.starts_with("statues"));
        assert_eq!(labels(&["all"], &[]).unwrap(), without_statues);
    }

    #[test]
    fn a_sweep_runs_every_value_once_and_leaves_the_others_alone() {
        let labels = labels(&["albireo", "vanilla"], &["u=3e-4,7e-4,3e-4"]).unwrap();
        let [three, seven] = ["albireo-u3e-4-erd-nonempty", "albireo-u7e-4-erd-nonempty"];
        assert_eq!(labels, ["vanilla", three, seven]);
    }

    #[test]
    fn a_pause_is_part_of_a_policy_and_keeps_its_sweep() {
        let asked = ["albireo,pause_s=0.16", "albireo:1e-3,pause_s=0.2,after_s=2"];
        let labels = labels(&asked, &["u=3e-4,7e-4"]).unwrap();
        let [three, seven] = [
            "albireo-u3e-4+pause0.16-erd-nonempty",
            "albireo-u7e-4+pause0.16-erd-nonempty",
        ];
        let other = "albireo-u1e-3+pause0.2after2-erd-nonempty";
        assert_eq!(labels, ["vanilla", three, seven, other]);
    }

    #[test]
    fn an_unreadable_pause_is_rejected_with_what_to_write() {
        for (asked, part) in [
            ("albireo,pause=0.1", "pause_s=SECONDS"),
            ("albireo,pause_s", "write pause_s=SECONDS"),
            ("albireo,pause_s=-1", "from 0 to 60"),
            ("albireo,after_s=nan", "from 0 to 3600"),
            ("vanilla,pause_s=0.1", "takes no pause"),
            ("expected-loss:0.1,pause_s=0.1", "takes no pause"),
        ] {
            let refused = labels(&[asked], &[]).unwrap_err().to_string();
            assert!(refused.contains(part), "{refused}");
        }
    }

    #[test]
    fn a_pause_needs_a_frame_rate() {
        let found = specs(&["albireo,pause_s=0.1"], &[], NO_PIXELS).unwrap();
        let [_baseline, pausing] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert!(pausing.build(Some(10.0)).is_ok());
        let no_rate = None;
        let Err(refused) = pausing.build(no_rate) else {
            panic!("a pause of seconds without a frame rate");
        };
        assert!(refused.to_string().contains("--rate"), "{refused}");
    }

    #[test]
    fn an_unreadable_sweep_is_rejected_by_name() {
        for (sweep, part) in [
            ("u", "NAME=VALUE"),
            ("u=1e-3,zwei", "`zwei` is not a number"),
        ] {
            let refused = labels(&["albireo"], &[sweep]).unwrap_err();
            assert!(refused.to_string().contains(part), "{refused}");
        }
    }
}
