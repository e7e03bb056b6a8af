//! Thresholds that were changed while running, kept in the state file so that they survive a restart.

use crate::delivery::outbox::Outbox;
use albireo_core::policy::Knob;
use albireo_wire::SettingSource;
use serde::{Deserialize, Serialize};

/// One camera's kept threshold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Kept {
    /// Whose value: a value of `u` is no value of `lambda`.
    knob: String,
    /// The value.
    value: f64,
    /// What the configuration said when it was changed. Once that is edited, the configuration is the
    /// newer word and wins over what was changed at the node; not over the hub's, which has a revision.
    configured: f64,
    /// Who changed it.
    #[serde(default = "local")]
    source: SettingSource,
}

const fn local() -> SettingSource {
    SettingSource::Local
}

fn name(camera: &str) -> String {
    format!("threshold/{camera}")
}

/// The value kept for a camera and who set it, if it still fits its knob and its configuration.
pub(super) fn kept(
    outbox: &Outbox,
    camera: &str,
    knob: &Knob,
    configured: f64,
) -> Option<(f64, SettingSource)> {
    let kept: Kept = outbox.setting(&name(camera))?;
    let is_current = kept.configured == configured || kept.source == SettingSource::Hub;
    let value = (kept.knob == knob.name && is_current)
        .then(|| knob.check(kept.value).ok())
        .flatten()?;
    Some((value, kept.source))
}

/// Keeps a value; when it cannot be written, logs that and goes on.
pub(super) fn keep(
    outbox: &Outbox,
    camera: &str,
    knob: &Knob,
    configured: f64,
    value: f64,
    source: SettingSource,
) {
    let kept = Kept {
        knob: knob.name.to_owned(),
        value,
        configured,
        source,
    };
    if !outbox.set(&name(camera), &kept) && outbox.has_directory() {
        tracing::warn!(
            camera,
            "threshold changed but not kept: it will not survive a restart"
        );
    }
}
