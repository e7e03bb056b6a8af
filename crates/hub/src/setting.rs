//! Compares desired settings with what nodes have, and writes targets as texts for the database.

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

/// What stands in the column `target` where a target is switched off.
pub(crate) const OFF: &str = "off";

/// A target as it is kept: `skip_rate=0.5`, the number in the shortest text that reads back as the same.
pub(crate) fn target_text(target: Target) -> String {
    format!("{}={}", target.name(), target.value())
}

/// Reads what [`target_text`] wrote.
pub(crate) fn target_of(text: &str) -> Option<Target> {
    let (name, value) = text.split_once('=')?;
    Target::named(name, value.parse().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_kept_target_reads_back_as_the_same(value in prop::num::f64::NORMAL, which in 0..Target::NAMES.len()) {
            let target = Target::named(Target::NAMES[which], value).unwrap();
            prop_assert_eq!(target_of(&target_text(target)), Some(target));
        }
    }

    #[test]
    fn what_is_no_target_is_not_read_as_one() {
        for text in ["", OFF, "skip_rate", "skip_rate=", "speed=1"] {
            assert_eq!(target_of(text), None, "{text}");
        }
    }
}
