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
    use crate::state::board::set_by_hand;
    use crate::state::board::tests::{board_of, config, thresholds};
    use albireo_wire::{Target, Threshold};
    use std::path::Path;
    use std::sync::Arc;

    const HALF: Option<Target> = Some(Target::SkipRate(0.5));

    fn opened(state: &Path) -> (Arc<Board>, DesiredKeeper) {
        let board = board_of(&config(Some(state), "albireo"));
        let keeper = DesiredKeeper::open(&board.settings);
        (board, keeper)
    }

    fn desired(revision: u64, setting: DesiredSetting) -> Desired {
        Desired {
            revision,
            setting: Some(setting),
            ..Desired::nothing()
        }
    }

    fn with_value(revision: u64, value: f64) -> Desired {
        desired(revision, Threshold::new("u", value).into())
    }

    fn with_target(revision: u64, target: Option<Target>) -> Desired {
        desired(revision, DesiredSetting::Target(target))
    }

    fn target(board: &Board) -> Option<Target> {
        board.target.report().target
    }

    #[test]
    fn a_target_and_a_value_replace_each_other_by_one_revision() {
        let folder = tempfile::tempdir().unwrap();
        let (board, keeper) = opened(folder.path());
        assert!(keeper.take(&with_target(3, HALF), &board));
        assert_eq!((target(&board), keeper.kept().in_force), (HALF, 3));
        // An older value, and the same target again, change nothing.
        assert!(!keeper.take(&with_value(2, 0.07), &board));
        assert!(!keeper.take(&with_target(3, HALF), &board));
        assert_eq!(target(&board), HALF);
        assert!(keeper.take(&with_value(4, 0.07), &board));
        assert_eq!((target(&board), thresholds(&board)), (None, vec![0.07; 2]));
        let off = board.target.report().off;
        assert_eq!(off.as_deref(), Some("the threshold was set by the hub"));
        assert!(!keeper.take(&with_target(3, HALF), &board));
        assert_eq!(target(&board), None);
        // Nothing to hold leaves the threshold where it is.
        assert!(keeper.take(&with_target(5, HALF), &board));
        assert!(keeper.take(&with_target(6, None), &board));
        assert_eq!((target(&board), keeper.kept().in_force), (None, 6));
        assert_eq!(keeper.kept().refused, None);
        assert!(
            thresholds(&board)
                .iter()
                .all(|u| (1.5e-4..=0.07).contains(u))
        );
    }

    #[test]
    fn a_target_that_cannot_be_held_is_refused_with_a_reason_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let (board, keeper) = opened(folder.path());
        assert!(keeper.take(&with_value(1, 0.07), &board));
        assert!(keeper.take(&with_target(2, Some(Target::SkipRate(1.5))), &board));
        let refused = keeper.kept().refused.unwrap();
        assert_eq!((refused.revision, keeper.kept().in_force), (2, 1));
        assert!(
            refused.reason.contains("`skip_rate` must be"),
            "{refused:?}"
        );
        assert_eq!((target(&board), thresholds(&board)), (None, vec![0.07; 2]));
    }

    #[test]
    fn a_target_of_the_hub_survives_a_restart_and_ends_with_a_manual_change() {
        let folder = tempfile::tempdir().unwrap();
        let (before, keeper) = opened(folder.path());
        assert!(keeper.take(&with_target(7, HALF), &before));
        drop((before, keeper));
        let (restarted, keeper) = opened(folder.path());
        assert_eq!((target(&restarted), keeper.kept().revision), (HALF, 7));
        // A threshold turned at the node ends it, until the hub desires something new.
        set_by_hand(&restarted.cameras[1..], 0.01).unwrap();
        assert!(!keeper.take(&with_target(7, HALF), &restarted));
        assert_eq!(target(&restarted), None);
        assert!(keeper.take(&with_target(8, HALF), &restarted));
        assert_eq!(target(&restarted), HALF);
    }
}
