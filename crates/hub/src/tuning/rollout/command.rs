//! Commands of people to a rollout.

use super::super::members::Millis;
use super::record::{Entry, What};
use super::{Phase, Rollout};
use crate::named::named;

named! {
    /// What a person may ask of a rollout.
    pub enum Command {
        /// Its time stops.
        Pause = "pause",
        /// Time goes on; a stage that is held is soaked again.
        Resume = "resume",
        /// The next stage now, whatever the gates say.
        Next = "next",
        /// All nodes get their old values back.
        Return = "return",
        /// It ends, and every node keeps what it has.
        Stop = "stop",
    }
}

/// Why a command cannot be followed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a rollout that is {phase} cannot be asked to {command}")]
pub struct CommandError {
    phase: &'static str,
    command: Command,
}

impl Rollout {
    /// Follows a person's command.
    ///
    /// # Errors
    /// [`CommandError`] when it makes no sense where the rollout is.
    pub fn command(
        &mut self,
        command: Command,
        who: &str,
        now: Millis,
    ) -> Result<(), CommandError> {
        let returning = matches!(self.phase, Phase::Returning { .. } | Phase::Returned);
        let ended = self.phase.has_ended();
        let is_held = matches!(self.phase, Phase::Held { .. });
        let (what, possible) = match command {
            Command::Pause => (
                What::Paused,
                !ended && !returning && self.paused_ms.is_none(),
            ),
            Command::Resume => (What::Resumed, self.paused_ms.is_some() || is_held),
            Command::Next => {
                let finishing = matches!(self.phase, Phase::Finishing { .. });
                (What::Next, !ended && !returning && !finishing)
            }
            Command::Return => (What::Return, !returning),
            Command::Stop => (What::Stopped, !ended),
        };
        if !possible {
            return Err(CommandError {
                phase: if self.paused_ms.is_some() {
                    "paused"
                } else {
                    self.phase.name()
                },
                command,
            });
        }
        self.note(now, Entry::by(who, what));
        if command != Command::Pause {
            self.wake(now);
        }
        match command {
            Command::Pause => self.paused_ms = Some(now),
            Command::Resume if is_held => self.soak(now),
            Command::Resume => {}
            Command::Next => self.advance(now),
            Command::Return => self.go_back(now, format!("by hand: {who}")),
            Command::Stop => self.phase = Phase::Stopped,
        }
        Ok(())
    }

    /// Ends a pause, which does not count as time of what began before it.
    fn wake(&mut self, now: Millis) {
        let Some(paused) = self.paused_ms.take() else {
            return;
        };
        for member in &mut self.members {
            if member.outcome.is_open() {
                member.asked_ms += now - paused;
            }
        }
        match &mut self.phase {
            Phase::Applying { since_ms }
            | Phase::Soaking { since_ms, .. }
            | Phase::Finishing { since_ms } => *since_ms += now - paused,
            _ => {}
        }
    }
}
