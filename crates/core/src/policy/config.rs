//! The `[policy]` section of the configuration and the list of its policies.

use super::Ablation::{KillErd, KillErd10d, KillOnly};
use super::Pixels::{Flow, Off};
use super::{
    Albireo, Ctd, CtdSettings, ErdOnly, ExpectedLoss, FixedSkip, FixedSkipSettings, InTracker,
    Policy, Profile, Statues, StatuesSettings, Trigger, Vanilla,
};
use serde::{Deserialize, Serialize};

/// The policy and its settings. Each camera gets its own policy from [`build`](PolicyConfig::build).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// Name of the policy: one of [`known_policies`].
    pub name: String,
    /// The profile for cases where the paper's text and the published code disagree.
    pub profile: Profile,
    /// The uncertainty threshold of `albireo` and its ablations.
    pub u: f64,
    /// The price λ of a detector call under `expected-loss`.
    pub lambda: f64,
    /// Settings of `fixed-skip`.
    #[serde(skip_serializing_if = "is_default")]
    pub fixed_skip: FixedSkipSettings,
    /// Settings of `ctd`.
    #[serde(skip_serializing_if = "is_default")]
    pub ctd: CtdSettings,
    /// Settings of `statues`.
    #[serde(skip_serializing_if = "is_default")]
    pub statues: StatuesSettings,
    /// The schedules of `fixed-skip-in-tracker` and `even-skip-in-tracker`.
    #[serde(skip_serializing_if = "is_default")]
    pub in_tracker: InTracker,
}

/// Tables of baselines are written only if they differ from the default.
fn is_default<T: Default + PartialEq>(settings: &T) -> bool {
    *settings == T::default()
}

impl Default for PolicyConfig {
    fn default() -> Self {
        Self {
            name: Albireo::NAME.to_owned(),
            profile: Profile::default(),
            u: Albireo::THRESHOLD.default,
            lambda: ExpectedLoss::THRESHOLD.default,
            fixed_skip: FixedSkipSettings::default(),
            ctd: CtdSettings::default(),
            statues: StatuesSettings::default(),
            in_tracker: InTracker::default(),
        }
    }
}

/// The reason why no policy can be built from the configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolicyConfigError {
    /// No policy has this name.
    #[error("policy.name: there is no policy `{name}`; {}", instead_of(name))]
    UnknownPolicy {
        /// The name found.
        name: String,
    },
    /// The argument after the policy's name is invalid.
    #[error("`{policy}:{argument}`: {reason}")]
    Argument {
        /// The policy's name.
        policy: &'static str,
        /// The argument given.
        argument: String,
        /// The reason why it is invalid.
        reason: String,
    },
    /// A setting does not exist or has an invalid value.
    #[error("policy.{table}: {reason}")]
    Setting {
        /// The table that contains the setting.
        table: &'static str,
        /// The problem and the allowed values.
        reason: String,
    },
}

/// A policy that the configuration can name: its name, its construction, and the field with the value of its threshold,
/// if it has one.
struct Entry(
    &'static str,
    fn(&PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError>,
    Option<fn(&mut PolicyConfig) -> &mut f64>,
);

// The triggers of the policies that share the objects of expected-loss.
pub(super) const PRICED: fn(&PolicyConfig) -> Trigger =
    |c| Trigger::ExpectedLoss { lambda: c.lambda };
pub(super) const FIXED: fn(&PolicyConfig) -> Trigger = |c| Trigger::FixedSkip { n: c.in_tracker.n };
pub(super) const EVEN: fn(&PolicyConfig) -> Trigger = |c| Trigger::Even {
    skip_rate: c.in_tracker.skip_rate,
};

fn boxed<P: Policy + 'static>(
    policy: Result<P, PolicyConfigError>,
) -> Result<Box<dyn Policy>, PolicyConfigError> {
    Ok(Box::new(policy?))
}

/// All policies, one line each.
#[rustfmt::skip]
const POLICIES: &[Entry] = &[
    Entry(Albireo::NAME, |c| boxed(Albireo::from_config(c)), Some(|c| &mut c.u)),
    Entry(Vanilla::NAME, |_| boxed(Ok(Vanilla::default())), None),
    Entry(FixedSkip::NAME, |c| boxed(FixedSkip::from_config(c)), Some(|c| &mut c.fixed_skip.n)),
    Entry(Ctd::NAME, |c| boxed(Ctd::from_config(c)), Some(|c| &mut c.ctd.threshold)),
    Entry(Statues::NAME, |c| boxed(Statues::from_config(c)), Some(|c| &mut c.statues.component_size)),
    Entry(ErdOnly::NAME, |_| boxed(Ok(ErdOnly::default())), None),
    Entry(KillOnly.name(), |c| boxed(Albireo::ablated(KillOnly, c)), Some(|c| &mut c.u)),
    Entry(KillErd.name(), |c| boxed(Albireo::ablated(KillErd, c)), Some(|c| &mut c.u)),
    Entry(KillErd10d.name(), |c| boxed(Albireo::ablated(KillErd10d, c)), Some(|c| &mut c.u)),
    Entry(ExpectedLoss::NAME, |c| boxed(ExpectedLoss::with(PRICED(c), Off)), Some(|c| &mut c.lambda)),
    Entry(ExpectedLoss::FIXED_SKIP_NAME, |c| boxed(ExpectedLoss::with(FIXED(c), Off)), Some(|c| &mut c.in_tracker.n)),
    Entry(ExpectedLoss::EVEN_SKIP_NAME, |c| boxed(ExpectedLoss::with(EVEN(c), Off)), Some(|c| &mut c.in_tracker.skip_rate)),
    Entry(ExpectedLoss::FLOW_NAMES[0], |c| boxed(ExpectedLoss::with(PRICED(c), Flow)), Some(|c| &mut c.lambda)),
    Entry(ExpectedLoss::FLOW_NAMES[1], |c| boxed(ExpectedLoss::with(FIXED(c), Flow)), Some(|c| &mut c.in_tracker.n)),
    Entry(ExpectedLoss::FLOW_NAMES[2], |c| boxed(ExpectedLoss::with(EVEN(c), Flow)), Some(|c| &mut c.in_tracker.skip_rate)),
];

/// The valid values of [`PolicyConfig::name`].
pub fn known_policies() -> impl Iterator<Item = &'static str> {
    POLICIES.iter().map(|Entry(name, ..)| *name)
}

/// Suggests a replacement for an unknown name: a policy within two typing errors, otherwise the list of all.
fn instead_of(name: &str) -> String {
    match known_policies().map(|known| (strsim::osa_distance(name, known), known)).min() {
        Some((distance, meant)) if distance <= 2 => format!("did you mean `{meant}`?"),
        _ => {
            let quoted: Vec<_> = known_policies().map(|name| format!("`{name}`")).collect();
            format!("the policies are {}", quoted.join(", "))
        }
    }
}

impl PolicyConfig {
    /// Builds a new policy, at the start of a stream.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if the name is unknown or a setting is invalid.
    pub fn build(&self) -> Result<Box<dyn Policy>, PolicyConfigError> {
        let Entry(_, build, _) = self.entry()?;
        build(self)
    }

    /// Parses `NAME[:ARGUMENT]` from a command line: the policy and the value of its threshold. Without an argument
    /// that value is unchanged, as are all other settings. [`build`](Self::build) checks that the value is in range.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if the name is unknown, the argument is not a number, or the policy takes none; the
    /// configuration is then unchanged.
    pub fn select(&mut self, text: &str) -> Result<(), PolicyConfigError> {
        let (name, argument) = match text.split_once(':') {
            Some((name, argument)) => (name, Some(argument)),
            None => (text, None),
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

    /// Sets the threshold of the configured policy to `argument`, a number as text.
    ///
    /// # Errors
    /// [`PolicyConfigError`] if the name is unknown, the policy has no threshold, or `argument` is not a number.
    pub fn set_argument(&mut self, argument: &str) -> Result<(), PolicyConfigError> {
        let &Entry(policy, _, threshold) = self.entry()?;
        let wrong = |reason: &str| PolicyConfigError::Argument {
            policy,
            argument: argument.to_owned(),
            reason: reason.to_owned(),
        };
        let place = threshold.ok_or_else(|| wrong("this policy takes no argument"))?;
        *place(self) =
            argument.trim().parse().map_err(|_| wrong("the argument must be a number"))?;
        Ok(())
    }

    fn entry(&self) -> Result<&'static Entry, PolicyConfigError> {
        let named = POLICIES.iter().find(|Entry(name, ..)| *name == self.name);
        named.ok_or_else(|| PolicyConfigError::UnknownPolicy {
            name: self.name.clone(),
        })
    }
}

#[cfg(test)]
mod tests;
