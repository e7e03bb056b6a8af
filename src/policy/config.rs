//! The `[policy]` section of the configuration, and the list of policies it can name.

use super::{Albireo, ExpectedLoss, Policy, Profile, Trigger, Vanilla};
use serde::{Deserialize, Serialize};

/// A table of settings by name, as it stands in the configuration.
pub type Table = serde_json::Map<String, serde_json::Value>;

/// Which policy decides, and its settings. Each camera gets a policy of its own from
/// [`build`](PolicyConfig::build).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// Name of the policy: one of [`known_policies`].
    pub name: String,
    /// The settings the Albireo policy starts from.
    pub profile: Profile,
    /// The uncertainty threshold of the policies that have one.
    pub u: f64,
    /// The price of a detector call under `expected-loss`.
    pub lambda: f64,
    /// The detector runs on one frame of so many under `fixed-skip-in-tracker`.
    pub every: u32,
    /// Share of frames to skip under `even-skip-in-tracker`.
    pub skip_rate: f64,
    /// Single settings of the Albireo policy that differ from the profile's: the fields of
    /// [`AlbireoSettings`](super::AlbireoSettings), as deep as it goes.
    pub albireo: Table,
    /// Single settings that differ from the default under `expected-loss` and the policies that share
    /// its objects: the fields of [`ExpectedLossSettings`](super::ExpectedLossSettings), as deep as it
    /// goes.
    pub expected_loss: Table,
}

impl Default for PolicyConfig {
    fn default() -> Self {
        Self {
            name: Albireo::NAME.to_owned(),
            profile: Profile::default(),
            u: Albireo::KNOB.default,
            lambda: Trigger::LAMBDA.default,
            every: 2,
            skip_rate: Trigger::SKIP_RATE.default,
            albireo: Table::new(),
            expected_loss: Table::new(),
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
    #[error("policy.{knob}: {error}", knob = knob_name(.0), error = .0)]
    Threshold(#[from] super::KnobError),
    /// A setting that does not exist, or has a value it cannot have.
    #[error("policy.{table}: {reason}")]
    Setting {
        /// The table it stands in.
        table: &'static str,
        /// What is wrong and what is allowed.
        reason: String,
    },
}

/// The knob a refusal is about.
fn knob_name(error: &super::KnobError) -> &'static str {
    match error {
        super::KnobError::OutOfRange { name, .. } => name,
        super::KnobError::Absent { .. } => "name",
    }
}

type Build = fn(&PolicyConfig) -> Result<Box<dyn Policy>, PolicyConfigError>;

/// All policies: one line each.
const POLICIES: &[(&str, Build)] = &[
    (Albireo::NAME, Albireo::from_config),
    (Vanilla::NAME, Vanilla::from_config),
    (ExpectedLoss::NAME, ExpectedLoss::from_config),
    (
        ExpectedLoss::FIXED_SKIP_NAME,
        ExpectedLoss::fixed_skip_from_config,
    ),
    (
        ExpectedLoss::EVEN_SKIP_NAME,
        ExpectedLoss::even_skip_from_config,
    ),
];

/// The names that [`PolicyConfig::name`] can have.
pub fn known_policies() -> impl Iterator<Item = &'static str> {
    POLICIES.iter().map(|(name, _)| *name)
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
        let (_, build) = POLICIES
            .iter()
            .find(|(name, _)| *name == self.name)
            .ok_or_else(|| PolicyConfigError::UnknownPolicy {
                name: self.name.clone(),
            })?;
        build(self)
    }

    /// Where the value of the named policy's knob stands; `None` if it has no knob or there is no such
    /// policy.
    pub fn knob_mut(&mut self) -> Option<&mut f64> {
        match self.name.as_str() {
            Albireo::NAME => Some(&mut self.u),
            ExpectedLoss::NAME => Some(&mut self.lambda),
            ExpectedLoss::EVEN_SKIP_NAME => Some(&mut self.skip_rate),
            _ => None,
        }
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
mod tests {
    use super::*;
    use crate::policy::AlbireoSettings;

    fn config(text: &str) -> PolicyConfig {
        toml::from_str(text).unwrap()
    }

    fn error(text: &str) -> String {
        config(text).build().err().unwrap().to_string()
    }

    #[test]
    fn without_configuration_it_is_albireo_with_the_papers_threshold() {
        let policy = config("").build().unwrap();
        assert_eq!(policy.name(), "albireo");
        assert_eq!(policy.knob_value(), Some(3e-4));
    }

    #[test]
    fn every_known_name_builds_a_policy_of_that_name() {
        for name in known_policies() {
            let config = PolicyConfig {
                name: name.to_owned(),
                ..PolicyConfig::default()
            };
            assert_eq!(config.build().unwrap().name(), name);
        }
    }

    #[test]
    fn the_value_of_every_knob_stands_in_the_configuration() {
        for name in known_policies() {
            let mut config = PolicyConfig {
                name: name.to_owned(),
                ..PolicyConfig::default()
            };
            let declared = config.build().unwrap().knob();
            let value = config.knob_mut().copied();
            assert_eq!(value, declared.map(|knob| knob.default), "{name}");
            let Some(knob) = declared else { continue };
            *config.knob_mut().unwrap() = knob.maximum;
            assert_eq!(config.build().unwrap().knob_value(), Some(knob.maximum));
            *config.knob_mut().unwrap() = knob.maximum * 2.0;
            let message = config.build().err().unwrap().to_string();
            let start = format!("policy.{0}: `{0}` must be", knob.name);
            assert!(message.starts_with(&start), "{message}");
        }
    }

    #[test]
    fn an_unknown_policy_is_refused_with_the_names_there_are() {
        let message = error("name = 'albiro'");
        assert!(message.contains("albiro"), "{message}");
        assert!(message.contains("`albireo`, `vanilla`"), "{message}");
    }

    #[test]
    fn a_bad_threshold_is_refused() {
        for u in ["0", "-1.0", "nan", "inf", "2"] {
            let message = error(&format!("u = {u}"));
            assert!(message.starts_with("policy.u: `u` must be"), "{message}");
        }
    }

    #[test]
    fn a_single_setting_goes_over_the_profile() {
        let config = config(
            "profile = 'reference'\n[albireo]\nt_max = 7\nlife_cycle.r_max = 4\n\
             filter.measurement = { deviation = 0.01, unit = 'normalised' }",
        );
        let settings = with_overrides(&AlbireoSettings::of(config.profile), &config.albireo);
        let settings: AlbireoSettings = settings.unwrap();
        let mut expected = AlbireoSettings::reference();
        expected.t_max = 7;
        expected.life_cycle.r_max = 4;
        expected.filter.measurement.deviation = 0.01;
        expected.filter.measurement.unit = crate::kalman::MeasurementUnit::Normalised;
        assert_eq!(settings, expected);
        assert!(config.build().is_ok());
    }

    #[test]
    fn a_setting_that_does_not_exist_or_cannot_be_is_named() {
        for (text, part) in [
            ("[albireo]\ntmax = 7", "`tmax`"),
            ("[albireo.life_cycle]\nrmax = 7", "`life_cycle.rmax`"),
            ("[albireo]\nt_max = 'x'", "`t_max`"),
            ("[albireo]\nt_max = 0", "`t_max`"),
            ("[albireo]\nperiodic_cap_counts = 'x'", "`x`"),
            (
                "[albireo.filter.initial]\nsize = -1",
                "`filter.initial.size`",
            ),
            (
                "[albireo.filter.process]\nsize = nan",
                "`filter.process.size`",
            ),
            (
                "[albireo.association]\niou_gate = 2",
                "`association.iou_gate`",
            ),
        ] {
            let message = error(text);
            assert!(message.starts_with("policy.albireo: "), "{message}");
            assert!(message.contains(part), "{message}");
        }
    }
}
