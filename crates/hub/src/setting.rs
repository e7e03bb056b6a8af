//! Compares desired settings with what nodes have.

use albireo_wire::{DesiredSetting, Target, Threshold};

/// Whether a node with that threshold and that target has the setting. A threshold that a target has moved to is on its way
/// elsewhere, and does not count.
pub(crate) fn is_applied(
    setting: DesiredSetting,
    threshold: Option<Threshold>,
    target: Option<Target>,
) -> bool {
    match setting {
        DesiredSetting::Threshold(wanted) => threshold == Some(wanted) && target.is_none(),
        DesiredSetting::Target(wanted) => target == wanted,
    }
}
