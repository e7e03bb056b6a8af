//! The `[policy]` section, as a table whose keys nobody checks yet.

use serde::{Deserialize, Serialize};

/// The settings of the policy.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PolicyConfig(pub toml::Table);
