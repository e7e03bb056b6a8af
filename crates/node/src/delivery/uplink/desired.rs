//! Applies and acknowledges the hub's desired setting.

use crate::settings::Settings;
use crate::state::board::Board;
use albireo_wire::{Desired, DesiredSetting, RefusedRevision, SettingSource};
use serde::{Deserialize, Serialize};

/// The name under which the settings file keeps what the node knows.
const SETTING: &str = "desired";

/// What a node knows of its desired setting, over restarts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(in crate::delivery) struct KnownRevision {
    /// The highest revision that came into force; 0 for none.
    pub in_force: u64,
    /// The refused desired setting, if it has a higher revision.
    pub refused: Option<RefusedRevision>,
}

impl KnownRevision {
    /// The highest revision seen.
    pub(in crate::delivery) fn revision(&self) -> u64 {
        let refused = self.refused.as_ref();
        refused.map_or(self.in_force, |refused| refused.revision)
    }
}

/// Returns what the node knows.
pub(in crate::delivery) fn known(settings: &Settings) -> KnownRevision {
    settings.get(SETTING).unwrap_or_default()
}

/// Applies `desired`, once per revision, and returns true if anything changed. A lower revision never replaces a higher
/// one. The setting and its revision are kept by one write: a power loss leaves both or none.
pub(in crate::delivery) fn take(desired: &Desired, settings: &Settings, board: &Board) -> bool {
    let before = known(settings);
    let highest = before.revision();
    let revision = desired.revision;
    if revision < highest {
        tracing::warn!(
            revision,
            known = highest,
            "ignored a desired setting older than the known one"
        );
    }
    if revision <= highest {
        return false;
    }
    settings.set_in_turn(settings.turns.place(), |transaction| {
        let hub = SettingSource::Hub;
        let applied = match desired.setting {
            None => Ok(()),
            Some(DesiredSetting::Threshold(threshold)) => {
                transaction.thresholds(&board.cameras, threshold, hub)
            }
            Some(DesiredSetting::Target(target)) => {
                transaction.target(target, hub).map_err(Into::into)
            }
        };
        let after = match applied {
            Ok(()) => KnownRevision {
                in_force: revision,
                refused: None,
            },
            Err(error) => {
                let reason = error.to_string();
                tracing::warn!(revision, reason, "rejected a desired setting");
                let refused = Some(RefusedRevision { revision, reason });
                KnownRevision { refused, ..before }
            }
        };
        transaction.keep(SETTING, &after);
    });
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PreparedNode;
    use crate::settings::Transaction;
    use crate::settings::tests::{config, prepared, thresholds};
    use albireo_wire::{Target, Threshold};
    use std::path::Path;

    const HALF: Option<Target> = Some(Target::SkipRate(0.5));

    struct Node(PreparedNode);

    impl Node {
        fn start(state: &Path) -> Self {
            Self(prepared(&config(Some(state), "albireo")))
        }

        fn take(&self, revision: u64, setting: DesiredSetting) -> bool {
            let desired = Desired {
                revision,
                setting: Some(setting),
                ..Desired::nothing()
            };
            take(&desired, &self.0.settings, &self.0.board)
        }

        fn known(&self) -> KnownRevision {
            known(&self.0.settings)
        }

        fn target(&self) -> Option<Target> {
            self.0.board.target.report().target
        }
    }

    #[test]
    fn a_value_for_the_policy_before_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let node = Node::start(folder.path());
        let place = node.0.settings.turns.place();
        let switch = |transaction: &mut Transaction<'_>| transaction.policy("expected-loss");
        node.0.settings.set_in_turn(place, switch).unwrap();
        let before = thresholds(&node.0.board);
        assert!(node.take(3, DesiredSetting::Threshold(Threshold::new("u", 7e-4))));
        assert_eq!(thresholds(&node.0.board), before);
        let reason = node.known().refused.unwrap().reason;
        assert_eq!(
            reason,
            "the threshold of the policy in use is `lambda`, not `u`"
        );
    }

    #[test]
    fn each_revision_applies_once_and_what_it_set_holds_until_a_newer_one_or_a_manual_change() {
        let half = DesiredSetting::Target(HALF);
        let value = DesiredSetting::Threshold(Threshold::new("u", 0.07));
        let folder = tempfile::tempdir().unwrap();
        let node = Node::start(folder.path());
        assert!(node.take(3, half));
        assert_eq!(node.target(), HALF);
        assert_eq!(node.known().in_force, 3);
        // An older value, and the same target again, change nothing.
        assert!(!node.take(2, value));
        assert!(!node.take(3, half));
        assert_eq!(node.target(), HALF);
        drop(node);
        let node = Node::start(folder.path());
        assert_eq!(node.target(), HALF);
        assert_eq!(node.known().revision(), 3);
        // A threshold turned at the node ends it, until the hub desires something new.
        node.0.settings.set_by_hand(&node.0.board.cameras[1..], 0.01).unwrap();
        assert!(!node.take(3, half));
        assert_eq!(node.target(), None);
        assert!(node.take(4, half));
        assert_eq!(node.target(), HALF);
        assert!(node.take(5, value));
        let off = node.0.board.target.report().off;
        assert_eq!(off.as_deref(), Some("the threshold was set by the hub"));
        assert!(!node.take(4, half));
        // What cannot be held is refused and changes nothing.
        let senseless = DesiredSetting::Target(Some(Target::SkipRate(1.5)));
        assert!(node.take(6, senseless));
        let known = node.known();
        let refused = known.refused.unwrap();
        assert_eq!(refused.revision, 6);
        assert_eq!(known.in_force, 5);
        let said = "`skip_rate` must be";
        assert!(refused.reason.contains(said), "{refused:?}");
        assert_eq!(node.target(), None);
        assert_eq!(thresholds(&node.0.board), [0.07; 2]);
        // Nothing to hold leaves the threshold where it is.
        assert!(node.take(7, half));
        assert!(node.take(8, DesiredSetting::Target(None)));
        let known = node.known();
        assert_eq!(node.target(), None);
        assert_eq!(known.in_force, 8);
        assert_eq!(known.refused, None);
        let values = thresholds(&node.0.board);
        let is_kept = |u: &f64| (1.5e-4..=0.07).contains(u);
        assert!(values.iter().all(is_kept), "{values:?}");
    }
}
