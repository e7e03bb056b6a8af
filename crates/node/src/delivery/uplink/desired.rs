//! Applies and acknowledges the hub's desired setting.

use crate::state::board::{Board, set_thresholds};
use crate::state::settings::Settings;
use albireo_wire::{Desired, DesiredSetting, RefusedDesired, SettingSource};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

const SETTING: &str = "desired";

/// The part kept in the state file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(in crate::delivery) struct Kept {
    /// The highest revision seen.
    pub revision: u64,
    /// The highest revision that came into force; 0 for none.
    pub in_force: u64,
    /// The refused desired setting.
    pub refused: Option<RefusedDesired>,
}

/// Applies the desired setting, once per revision.
#[derive(Debug)]
pub(crate) struct DesiredKeeper {
    kept: Mutex<Kept>,
}

impl DesiredKeeper {
    /// Starts with the state from before the restart.
    pub(crate) fn open(settings: &Settings) -> Self {
        Self {
            kept: Mutex::new(settings.get(SETTING).unwrap_or_default()),
        }
    }

    /// Returns the kept state.
    pub(in crate::delivery) fn kept(&self) -> Kept {
        self.kept.lock().clone()
    }

    /// Applies `desired` and returns true if anything changed. A lower revision never replaces a higher one.
    pub(in crate::delivery) fn take(&self, desired: &Desired, board: &Board) -> bool {
        let (mut kept, revision) = (self.kept.lock(), desired.revision);
        if revision < kept.revision {
            let known = kept.revision;
            tracing::warn!(
                revision,
                known,
                "ignored a desired setting older than the known one"
            );
        }
        if revision <= kept.revision {
            return false;
        }
        kept.revision = revision;
        let applied = match desired.setting {
            None => Ok(()),
            Some(DesiredSetting::Threshold(threshold)) => {
                set_thresholds(&board.cameras, threshold, SettingSource::Hub)
                    .map_err(|error| error.to_string())
            }
            Some(DesiredSetting::Target(target)) => {
                (board.set_target(target, SettingSource::Hub)).map_err(|error| error.to_string())
            }
        };
        match applied {
            Ok(()) => {
                kept.in_force = revision;
                kept.refused = None;
            }
            Err(reason) => {
                tracing::warn!(revision, reason, "rejected a desired setting");
                kept.refused = Some(RefusedDesired { revision, reason });
            }
        }
        board.settings.set(SETTING, &*kept);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::board::tests::{board_of, config, set_by_hand, thresholds};
    use albireo_wire::{Target, Threshold};
    use std::path::Path;
    use std::sync::Arc;

    const HALF: Option<Target> = Some(Target::SkipRate(0.5));

    struct Node {
        board: Arc<Board>,
        keeper: DesiredKeeper,
    }

    impl Node {
        fn start(state: &Path) -> Self {
            let board = board_of(&config(Some(state), "albireo"));
            let keeper = DesiredKeeper::open(&board.settings);
            Self { board, keeper }
        }

        fn take(&self, revision: u64, setting: DesiredSetting) -> bool {
            let desired = Desired {
                revision,
                setting: Some(setting),
                ..Desired::nothing()
            };
            self.keeper.take(&desired, &self.board)
        }

        fn target(&self) -> Option<Target> {
            self.board.target.report().target
        }
    }

    #[test]
    fn each_revision_applies_once_and_what_it_set_holds_until_a_newer_one_or_a_manual_change() {
        let half = DesiredSetting::Target(HALF);
        let value = DesiredSetting::Threshold(Threshold::new("u", 0.07));
        let folder = tempfile::tempdir().unwrap();
        let node = Node::start(folder.path());
        assert!(node.take(3, half));
        assert_eq!((node.target(), node.keeper.kept().in_force), (HALF, 3));
        // An older value, and the same target again, change nothing.
        assert!(!node.take(2, value));
        assert!(!node.take(3, half));
        assert_eq!(node.target(), HALF);
        drop(node);
        let node = Node::start(folder.path());
        assert_eq!((node.target(), node.keeper.kept().revision), (HALF, 3));
        // A threshold turned at the node ends it, until the hub desires something new.
        set_by_hand(&node.board.cameras[1..], 0.01).unwrap();
        assert!(!node.take(3, half));
        assert_eq!(node.target(), None);
        assert!(node.take(4, half));
        assert_eq!(node.target(), HALF);
        assert!(node.take(5, value));
        let off = node.board.target.report().off;
        assert_eq!(off.as_deref(), Some("the threshold was set by the hub"));
        assert!(!node.take(4, half));
        // What cannot be held is refused and changes nothing.
        let senseless = DesiredSetting::Target(Some(Target::SkipRate(1.5)));
        assert!(node.take(6, senseless));
        let kept = node.keeper.kept();
        let refused = kept.refused.unwrap();
        assert_eq!((refused.revision, kept.in_force), (6, 5));
        let said = "`skip_rate` must be";
        assert!(refused.reason.contains(said), "{refused:?}");
        assert_eq!(node.target(), None);
        assert_eq!(thresholds(&node.board), [0.07; 2]);
        // Nothing to hold leaves the threshold where it is.
        assert!(node.take(7, half));
        assert!(node.take(8, DesiredSetting::Target(None)));
        let kept = node.keeper.kept();
        assert_eq!(node.target(), None);
        assert_eq!((kept.in_force, kept.refused), (8, None));
        let values = thresholds(&node.board);
        let is_kept = |u: &f64| (1.5e-4..=0.07).contains(u);
        assert!(values.iter().all(is_kept), "{values:?}");
    }
}
