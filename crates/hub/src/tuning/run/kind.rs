//! Tells a rollout from a trial, with the plan of each.

use super::super::plan::{Basics, RolloutPlan, TrialPlan};
use albireo_wire::Threshold;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A rollout or a trial, with its plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Kind {
    /// A change in stages, each gated on measurements.
    Rollout {
        /// The new value.
        to: Threshold,
        /// The plan.
        plan: RolloutPlan,
    },
    /// A comparison of values on random groups.
    Trial {
        /// The plan.
        plan: TrialPlan,
    },
}

impl Kind {
    /// Its name.
    pub(crate) const fn name(&self) -> &'static str {
        match self {
            Self::Rollout { .. } => "rollout",
            Self::Trial { .. } => "trial",
        }
    }

    /// The fields that both plans have.
    pub const fn basics(&self) -> &Basics {
        match self {
            Self::Rollout { plan, .. } => &plan.basics,
            Self::Trial { plan } => &plan.basics,
        }
    }
}
