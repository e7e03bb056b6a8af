//! What the hub desires of the node, and what came of it.

use crate::board::Board;
use crate::outbox::Outbox;
use albireo_wire::{Desired, KnobSource, RefusedDesired};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

const SETTING: &str = "desired";

/// As it is kept in the state file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
struct Kept {
    /// Highest generation seen.
    generation: u64,
    /// Highest generation that came into force.
    in_force: u64,
    /// The knob's name and value desired.
    knob: Option<(String, f64)>,
    refused: Option<RefusedDesired>,
}

/// Applies what is desired, once a generation.
#[derive(Debug)]
pub(crate) struct DesiredKeeper {
    /// Whether a value changed at the node gives way to the hub's when next heard.
    hub_wins: bool,
    kept: Mutex<Kept>,
}

impl DesiredKeeper {
    /// With what was desired before the restart.
    pub(crate) fn open(outbox: &Outbox, hub_wins: bool) -> Self {
        Self {
            hub_wins,
            kept: Mutex::new(outbox.setting(SETTING).unwrap_or_default()),
        }
    }

    /// The highest generation seen.
    pub(super) fn generation(&self) -> u64 {
        self.kept.lock().generation
    }

    /// The generation whose value is in force, 0 for none.
    pub(super) fn generation_in_force(&self) -> u64 {
        self.kept.lock().in_force
    }

    /// The desired value that was not taken.
    pub(super) fn refused(&self) -> Option<RefusedDesired> {
        self.kept.lock().refused.clone()
    }

    /// Takes what is desired; whether anything changed. A lower generation never replaces a higher.
    pub(super) fn take(&self, desired: &Desired, board: &Board, outbox: &Outbox) -> bool {
        let mut kept = self.kept.lock();
        if desired.generation < kept.generation {
            tracing::warn!(
                generation = desired.generation,
                known = kept.generation,
                "an older desired value than the one known: not taken"
            );
            return false;
        }
        let Some(knob) = desired.knob.filter(|_| desired.generation > 0) else {
            let newer = desired.generation > kept.generation;
            kept.generation = desired.generation;
            if newer {
                kept.in_force = desired.generation;
                kept.knob = None;
                kept.refused = None;
                outbox.set(SETTING, &*kept);
            }
            return newer;
        };
        if desired.generation == kept.generation {
            let drifted = board.cameras().iter().any(|camera| {
                camera.knob_source() != KnobSource::Hub || camera.knob_value() != Some(knob)
            });
            if kept.refused.is_some() || !drifted || !self.hub_wins {
                return false;
            }
        }
        let applied = board
            .cameras()
            .iter()
            .try_for_each(|camera| match camera.knob() {
                Some(own) if own.name != knob.name => Err(format!(
                    "the policy in use is turned by `{}`, not by `{}`",
                    own.name, knob.name
                )),
                _ => camera
                    .check_threshold(knob.value)
                    .map(drop)
                    .map_err(|error| error.to_string()),
            })
            .and_then(|()| {
                board.cameras().iter().try_for_each(|camera| {
                    camera
                        .set_threshold_by(knob.value, KnobSource::Hub)
                        .map(drop)
                        .map_err(|error| error.to_string())
                })
            });
        kept.generation = desired.generation;
        kept.knob = Some((knob.name.to_owned(), knob.value));
        match applied {
            Ok(()) => {
                kept.in_force = desired.generation;
                kept.refused = None;
            }
            Err(reason) => {
                tracing::warn!(
                    generation = desired.generation,
                    reason,
                    "a desired value was refused"
                );
                kept.refused = Some(RefusedDesired {
                    generation: desired.generation,
                    reason,
                });
            }
        }
        outbox.set(SETTING, &*kept);
        true
    }
}
