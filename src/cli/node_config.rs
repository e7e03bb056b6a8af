//! Reads the configuration of a node.

use albireo_node::config::NodeConfig;
use std::path::Path;

/// The configuration of `file`, or the defaults, with what the environment overrides.
pub(super) fn load(file: Option<&Path>) -> anyhow::Result<NodeConfig> {
    #[cfg_attr(not(feature = "development"), expect(unused_mut))]
    let mut config: NodeConfig = albireo_service::config::load(file)?;
    #[cfg(feature = "development")]
    super::development::apply(&mut config)?;
    Ok(config)
}
