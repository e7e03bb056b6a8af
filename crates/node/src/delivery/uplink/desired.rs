//! Applies and acknowledges the setting that the hub desires.

use crate::delivery::outbox::Outbox;
use crate::state::board::{Board, set_thresholds};
use albireo_wire::{Desired, DesiredSetting, RefusedDesired, SettingSource};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

const SETTING: &str = "desired";

/// As it is kept in the state file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
struct Kept {
    /// Highest revision seen.
    revision: u64,
    /// Highest revision that came into force.
    in_force: u64,
    refused: Option<RefusedDesired>,
}

impl Kept {
    /// Notes what came of a revision.
    fn note(&mut self, revision: u64, applied: Result<(), String>) {
        self.revision = revision;
        match applied {
            Ok(()) => {
                self.in_force = revision;
                self.refused = None;
            }
            Err(reason) => {
                tracing::warn!(revision, reason, "a desired value was refused");
                self.refused = Some(RefusedDesired { revision, reason });
            }
        }
    }
}

/// Applies what is desired, once a revision.
#[derive(Debug)]
pub(crate) struct DesiredKeeper {
    kept: Mutex<Kept>,
}

impl DesiredKeeper {
    /// With what was desired before the restart.
    pub(crate) fn open(outbox: &Outbox) -> Self {
        Self {
            kept: Mutex::new(outbox.setting(SETTING).unwrap_or_default()),
        }
    }

    /// The highest revision seen.
    pub(in crate::delivery) fn revision(&self) -> u64 {
        self.kept.lock().revision
    }

    /// The revision whose value is in force, 0 for none.
    pub(in crate::delivery) fn revision_in_force(&self) -> u64 {
        self.kept.lock().in_force
    }

    /// The desired value that was not taken.
    pub(in crate::delivery) fn refused(&self) -> Option<RefusedDesired> {
        self.kept.lock().refused.clone()
    }

    /// Takes what is desired; whether anything changed. A lower revision never replaces a higher.
    pub(in crate::delivery) fn take(&self, desired: &Desired, board: &Board) -> bool {
        let mut kept = self.kept.lock();
        if desired.revision < kept.revision {
            tracing::warn!(
                revision = desired.revision,
                known = kept.revision,
                "an older desired value than the one known: not taken"
            );
            return false;
        }
        let Some(setting) = desired.setting.filter(|_| desired.revision > 0) else {
            let newer = desired.revision > kept.revision;
            kept.revision = desired.revision;
            if newer {
                kept.in_force = desired.revision;
                kept.refused = None;
                board.outbox().set(SETTING, &*kept);
            }
            return newer;
        };
        if desired.revision == kept.revision {
            return false;
        }
        let applied = match setting {
            DesiredSetting::Threshold(threshold) => {
                set_thresholds(board.cameras(), threshold, SettingSource::Hub)
                    .map_err(|error| error.to_string())
            }
            DesiredSetting::Target(target) => {
                (board.set_target(target, SettingSource::Hub)).map_err(|error| error.to_string())
            }
        };
        kept.note(desired.revision, applied);
        board.outbox().set(SETTING, &*kept);
        true
    }
}

#[cfg(test)]
pub(in crate::delivery) mod tests {
    use super::*;
    use crate::delivery::outbox::OutboxConfig;
    use crate::state::board::set_by_hand;
    use crate::state::board::tests::{KNOB, board_on};
    use albireo_wire::{Target, Threshold, VERSION};
    use std::path::Path;
    use std::sync::Arc;

    /// A board of two cameras with the threshold `u`.
    pub(in crate::delivery) fn board(outbox: Outbox) -> Arc<Board> {
        board_on(outbox, KNOB, None)
    }

    fn opened(state: &Path) -> Arc<Board> {
        board(Outbox::open(&OutboxConfig::default(), Some(state)).unwrap())
    }

    fn desired(revision: u64, value: f64) -> Desired {
        Desired {
            v: VERSION,
            revision,
            setting: Some(DesiredSetting::Threshold(Threshold::new("u", value))),
            ..Desired::nothing()
        }
    }

    fn with_target(revision: u64, target: Option<Target>) -> Desired {
        Desired {
            revision,
            setting: Some(DesiredSetting::Target(target)),
            ..Desired::nothing()
        }
    }

    fn target(board: &Board) -> Option<Target> {
        board.target().report().target
    }

    #[test]
    fn a_target_and_a_value_take_each_others_place_by_one_revision() {
        let folder = tempfile::tempdir().unwrap();
        let board = opened(folder.path());
        let outbox = board.outbox();
        let keeper = DesiredKeeper::open(outbox);
        let half = Some(Target::SkipRate(0.5));
        assert!(keeper.take(&with_target(3, half), &board));
        assert_eq!((target(&board), keeper.revision_in_force()), (half, 3));
        // An older value, and the same target again, change nothing.
        assert!(!keeper.take(&desired(2, 0.07), &board));
        assert!(!keeper.take(&with_target(3, half), &board));
        assert_eq!(target(&board), half);
        assert!(keeper.take(&desired(4, 0.07), &board));
        assert_eq!((target(&board), thresholds(&board)), (None, vec![0.07; 2]));
        let off = board.target().report().off;
        assert_eq!(off.as_deref(), Some("the threshold was set by the hub"));
        assert!(!keeper.take(&with_target(3, half), &board));
        assert_eq!(target(&board), None);
        // Nothing to hold leaves the knob where it is.
        assert!(keeper.take(&with_target(5, half), &board));
        assert!(keeper.take(&with_target(6, None), &board));
        assert_eq!((target(&board), keeper.revision_in_force()), (None, 6));
        assert_eq!(keeper.refused(), None);
        assert!(
            thresholds(&board)
                .iter()
                .all(|u| (1.5e-4..=0.07).contains(u))
        );
    }

    #[test]
    fn a_target_that_cannot_be_held_is_refused_in_words_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let board = opened(folder.path());
        let outbox = board.outbox();
        let keeper = DesiredKeeper::open(outbox);
        assert!(keeper.take(&desired(1, 0.07), &board));
        assert!(keeper.take(&with_target(2, Some(Target::SkipRate(1.5))), &board));
        let refused = keeper.refused().unwrap();
        assert_eq!((refused.revision, keeper.revision_in_force()), (2, 1));
        assert!(
            refused.reason.contains("`skip_rate` must be"),
            "{refused:?}"
        );
        assert_eq!((target(&board), thresholds(&board)), (None, vec![0.07; 2]));
    }

    #[test]
    fn a_knob_turned_at_the_node_ends_the_hubs_target_until_the_hub_desires_anew() {
        let folder = tempfile::tempdir().unwrap();
        let board = opened(folder.path());
        let outbox = board.outbox();
        let keeper = DesiredKeeper::open(outbox);
        let half = Some(Target::SkipRate(0.5));
        assert!(keeper.take(&with_target(3, half), &board));
        set_by_hand(&board.cameras()[1..], 0.01).unwrap();
        assert_eq!(target(&board), None);
        assert!(!keeper.take(&with_target(3, half), &board));
        assert_eq!(target(&board), None);
        assert!(keeper.take(&with_target(4, half), &board));
        assert_eq!(target(&board), half);
    }

    #[test]
    fn a_target_of_the_hub_is_there_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let half = Some(Target::SkipRate(0.5));
        let before = opened(folder.path());
        let keeper = DesiredKeeper::open(before.outbox());
        assert!(keeper.take(&with_target(7, half), &before));
        drop((before, keeper));
        let restarted = opened(folder.path());
        let keeper = DesiredKeeper::open(restarted.outbox());
        assert_eq!((target(&restarted), keeper.revision()), (half, 7));
    }

    pub(in crate::delivery) fn thresholds(board: &Board) -> Vec<f64> {
        (board.cameras().iter())
            .filter_map(|camera| camera.threshold())
            .collect()
    }
}
