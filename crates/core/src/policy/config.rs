//! The `[policy]` section of the configuration, and the list of policies it can name.

use super::albireo_flow::AlbireoFlow;
use super::{
    Ablation, AdaptiveRate, AdaptiveRateSettings, Albireo, AlbireoSettings, Ctd, CtdSettings,
    ErdOnly, ExpectedLoss, FixedSkip, FixedSkipSettings, FrameDrop, FrameDropSettings, InTracker,
    Policy, Profile, Statues, StatuesSettings, Vanilla,
};
use serde::{Deserialize, Serialize};

/// A table of settings by name, as it stands in the configuration.
pub(crate) type Table = serde_json::Map<String, serde_json::Value>;

/// Which policy decides, and its settings. Each camera gets a policy of its own from
/// [`build`](PolicyConfig::build).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// Name of the policy: one of [`known_policies`].
    pub name: String,
    /// What holds where the paper's text and the published code disagree.
    pub profile: Profile,
    /// The uncertainty threshold of `albireo` and its ablations.
    pub u: f64,
    /// The price λ of a detector call under `expected-loss`.
    pub lambda: f64,
    /// Single settings of the Albireo policy that differ from the profile's: the fields of
    /// [`AlbireoSettings`], as deep as it goes. Every policy that keeps objects has them, as far as it
    /// has the parts they are about.
    pub albireo: Table,
    /// Settings of `fixed-skip`.
    #[serde(skip_serializing_if = "is_default")]
    pub fixed_skip: FixedSkipSettings,
    /// Settings of `ctd`.
    #[serde(skip_serializing_if = "is_default")]
    pub ctd: CtdSettings,
    /// Settings of `statues`.
    #[serde(skip_serializing_if = "is_default")]
    pub statues: StatuesSettings,
    /// Settings of `adaptive-rate`.
    #[serde(skip_serializing_if = "is_default")]
    pub adaptive_rate: AdaptiveRateSettings,
    /// Settings of `frame-drop`.
    #[serde(skip_serializing_if = "is_default")]
    pub frame_drop: FrameDropSettings,
    /// Single settings of `expected-loss`, and of the schedules that share its objects, that differ from
    /// the default: the fields of [`ExpectedLossSettings`](super::ExpectedLossSettings), as deep as it
    /// goes.
    pub expected_loss: Table,
    /// The schedules of `fixed-skip-in-tracker` and `even-skip-in-tracker`.
    pub in_tracker: InTracker,
}

/// The tables of baselines are written only where they say something: a configuration does not show them.
fn is_default<T: Default + PartialEq>(settings: &T) -> bool {
    *settings == T::default()
}

impl Default for PolicyConfig {
    fn default() -> Self {
        Self {
            name: Albireo::NAME.to_owned(),
            profile: Profile::default(),
            u: Albireo::KNOB.default,
            lambda: ExpectedLoss::KNOB.default,
            albireo: Table::new(),
            fixed_skip: FixedSkipSettings::default(),
            ctd: CtdSettings::default(),
            statues: StatuesSettings::default(),
            adaptive_rate: AdaptiveRateSettings::default(),
            frame_drop: FrameDropSettings::default(),
            expected_loss: Table::new(),
            in_tracker: InTracker::default(),
        }
    }
}

/// Why no policy can be made from the configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolicyConfigError {
    /// No policy has this name.
    #[error(
        "policy.name: there is no policy `{name}`; the policies are {}",
        names()
    )]
    UnknownPolicy {
        /// The name found.
        name: String,
    },
    /// The threshold is out of range.
    #[error("policy.u: {0}")]
    Threshold(#[from] super::KnobError),
    /// The argument behind the policy's name makes no sense.
    #[error("`{policy}:{argument}`: {reason}")]
    Argument {
        /// The policy's name.
        policy: &'static str,
        /// What was given.
        argument: String,
        /// What was expected.
        reason: String,
    },
    /// A setting that does not exist, or has a value it cannot have.
    #[error("policy.{table}: {reason}")]
    Setting {
        /// The table it stands in.
        table: &'static str,
        /// What is wrong and what is allowed.
        reason: String,
    },
}

/// A policy that the configuration can name.
struct Entry {
    name: &'static str,
    build: fn(&PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError>,
    /// Where the value of its knob stands; `None` without a knob.
    knob_value: Option<fn(&mut PolicyConfig) -> &mut f64>,
}

const fn entry(
    name: &'static str,
    build: fn(&PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError>,
    knob_value: Option<fn(&mut PolicyConfig) -> &mut f64>,
) -> Entry {
    Entry {
        name,
        build,
        knob_value,
    }
}

const KILL_ONLY: Ablation = Ablation::KillOnly;
const KILL_ERD: Ablation = Ablation::KillErd;
const KILL_ERD_10D: Ablation = Ablation::KillErd10d;

const IN_TRACKER_FIXED: &str = ExpectedLoss::FIXED_SKIP_NAME;
const IN_TRACKER_EVEN: &str = ExpectedLoss::EVEN_SKIP_NAME;

/// All policies: one line each.
#[rustfmt::skip]
const POLICIES: &[Entry] = &[
    entry(Albireo::NAME, Albireo::from_config, Some(|c| &mut c.u)),
    entry(Vanilla::NAME, Vanilla::from_config, None),
    entry(FixedSkip::NAME, FixedSkip::from_config, Some(|c| &mut c.fixed_skip.n)),
    entry(Ctd::NAME, Ctd::from_config, Some(|c| &mut c.ctd.threshold)),
    entry(Statues::NAME, Statues::from_config, Some(|c| &mut c.statues.component_size)),
    entry(AdaptiveRate::NAME, AdaptiveRate::from_config, Some(|c| &mut c.adaptive_rate.drift)),
    entry(FrameDrop::NAME, FrameDrop::from_config, Some(|c| &mut c.frame_drop.n)),
    entry(ErdOnly::NAME, ErdOnly::from_config, None),
    entry(KILL_ONLY.name(), |c| Albireo::ablated(KILL_ONLY, c), Some(|c| &mut c.u)),
    entry(KILL_ERD.name(), |c| Albireo::ablated(KILL_ERD, c), Some(|c| &mut c.u)),
    entry(KILL_ERD_10D.name(), |c| Albireo::ablated(KILL_ERD_10D, c), Some(|c| &mut c.u)),
    entry(ExpectedLoss::NAME, ExpectedLoss::from_config, Some(|c| &mut c.lambda)),
    entry(IN_TRACKER_FIXED, ExpectedLoss::fixed_skip, Some(|c| &mut c.in_tracker.n)),
    entry(IN_TRACKER_EVEN, ExpectedLoss::even_skip, Some(|c| &mut c.in_tracker.skip_rate)),
    entry(AlbireoFlow::NAME, AlbireoFlow::from_config, Some(|c| &mut c.u)),
    entry(ExpectedLoss::FLOW_NAME, |c| ExpectedLoss::from_config(&c.with_flow()), Some(|c| &mut c.lambda)),
    entry(ExpectedLoss::FIXED_SKIP_FLOW_NAME, |c| ExpectedLoss::fixed_skip(&c.with_flow()), Some(|c| &mut c.in_tracker.n)),
    entry(ExpectedLoss::EVEN_SKIP_FLOW_NAME, |c| ExpectedLoss::even_skip(&c.with_flow()), Some(|c| &mut c.in_tracker.skip_rate)),
];

/// The names that [`PolicyConfig::name`] can have.
pub(crate) fn known_policies() -> impl Iterator<Item = &'static str> {
    POLICIES.iter().map(|entry| entry.name)
}

fn names() -> String {
    let quoted: Vec<_> = known_policies().map(|name| format!("`{name}`")).collect();
    quoted.join(", ")
}

impl PolicyConfig {
    /// A new policy, at the start of a stream.
    ///
    /// # Errors
    /// [`PolicyConfigError`] when the name is not known or a setting cannot be used.
    pub fn build(&self) -> Result<Box<dyn Policy>, PolicyConfigError> {
        (self.entry()?.build)(self)
    }

    /// Takes `NAME[:ARGUMENT]`, as a command line has it: the policy, and the value of its knob. Without
    /// an argument that value stays what it is; nothing else is touched. Whether the value is in range
    /// [`build`](Self::build) tells.
    ///
    /// # Errors
    /// [`PolicyConfigError`] when the name is not known, or the argument is no number or the policy takes
    /// none; the configuration is as before then.
    pub fn select(&mut self, asked: &str) -> Result<(), PolicyConfigError> {
        let (name, argument) = match asked.split_once(':') {
            Some((name, argument)) => (name, Some(argument)),
            None => (asked, None),
        };
        let before = std::mem::replace(&mut self.name, name.to_owned());
        let taken = match argument {
            Some(argument) => self.set_argument(argument),
            None => self.entry().map(|_| ()),
        };
        if taken.is_err() {
            self.name = before;
        }
        taken
    }

    /// Sets the knob of the policy that is configured to `argument`, a number as text.
    ///
    /// # Errors
    /// [`PolicyConfigError`] when the name is not known, the policy has no knob, or this is no number.
    pub fn set_argument(&mut self, argument: &str) -> Result<(), PolicyConfigError> {
        let entry = self.entry()?;
        let wrong = |reason: &str| PolicyConfigError::Argument {
            policy: entry.name,
            argument: argument.to_owned(),
            reason: reason.to_owned(),
        };
        let place = entry
            .knob_value
            .ok_or_else(|| wrong("this policy takes no argument"))?;
        *place(self) = argument
            .trim()
            .parse()
            .map_err(|_| wrong("the argument must be a number"))?;
        Ok(())
    }

    /// The same with `pixels = "flow"` in the settings of expected-loss.
    fn with_flow(&self) -> Self {
        let mut config = self.clone();
        config.expected_loss.insert("pixels".into(), "flow".into());
        config
    }

    /// The settings of Albireo: the profile's, with single ones in their place.
    ///
    /// # Errors
    /// [`PolicyConfigError::Setting`] for one that does not exist or cannot have its value.
    pub(crate) fn albireo_settings(&self) -> Result<AlbireoSettings, PolicyConfigError> {
        with_overrides(&AlbireoSettings::of(self.profile), &self.albireo).map_err(|reason| {
            PolicyConfigError::Setting {
                table: Albireo::NAME,
                reason,
            }
        })
    }

    fn entry(&self) -> Result<&'static Entry, PolicyConfigError> {
        POLICIES
            .iter()
            .find(|entry| entry.name == self.name)
            .ok_or_else(|| PolicyConfigError::UnknownPolicy {
                name: self.name.clone(),
            })
    }
}

/// `settings` with the values of `overrides` in place of its own, table by table.
///
/// # Errors
/// A sentence that names the setting that does not exist or the value it cannot have.
pub(super) fn with_overrides<T: Serialize + for<'a> Deserialize<'a>>(
    settings: &T,
    overrides: &Table,
) -> Result<T, String> {
    let mut merged = serde_json::to_value(settings).map_err(|error| error.to_string())?;
    let own = merged.as_object_mut().ok_or("the settings are no table")?;
    merge(own, overrides, &mut String::new())?;
    serde_json::from_value(merged).map_err(|error| error.to_string())
}

fn merge(own: &mut Table, overrides: &Table, path: &mut String) -> Result<(), String> {
    for (key, value) in overrides {
        let Some(present) = own.get_mut(key) else {
            let known: Vec<_> = own.keys().map(|key| format!("`{path}{key}`")).collect();
            let known = known.join(", ");
            return Err(format!(
                "there is no setting `{path}{key}`; there are {known}"
            ));
        };
        match (present, value) {
            (serde_json::Value::Object(present), serde_json::Value::Object(value)) => {
                let length = path.len();
                path.push_str(key);
                path.push('.');
                merge(present, value, path)?;
                path.truncate(length);
            }
            (present, value) if same_kind(present, value) => *present = value.clone(),
            (present, value) => {
                return Err(format!(
                    "`{path}{key}` cannot be {value}; the profile's value is {present}"
                ));
            }
        }
    }
    Ok(())
}

fn same_kind(a: &serde_json::Value, b: &serde_json::Value) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
}

#[cfg(test)]
mod tests;
