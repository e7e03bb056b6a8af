//! Executes the commands that a person gives to a rollout.

use super::super::member::{Member, Millis};
use super::super::outcome::Outcome;
use super::{Phase, Run, What};
use crate::named::named;

named! {
    /// A command to a rollout.
    pub enum Command {
        /// Stops its clock.
        Pause = "pause",
        /// Resumes the clock; a held stage soaks again.
        Resume = "resume",
        /// Begins the next stage now, regardless of the gates.
        Next = "next",
        /// Gives all nodes their old values back.
        Return = "return",
        /// Ends it; every node keeps its value.
        Stop = "stop",
    }
}

impl Run {
    /// Executes a command on a rollout.
    ///
    /// # Errors
    /// The reason that it is not possible in this phase.
    pub(crate) fn command(
        &mut self,
        command: Command,
        who: &str,
        now: Millis,
    ) -> Result<(), String> {
        use Phase::{Finishing, Held, Returned, Returning};
        let returns = matches!(self.phase, Returning | Returned);
        let goes_on = !self.phase.has_ended() && !returns;
        let is_held = self.phase == Held;
        let is_paused = self.paused_ms.is_some();
        let is_possible = match command {
            Command::Pause => goes_on && !is_paused,
            Command::Resume => is_paused || is_held,
            Command::Next => goes_on && self.phase != Finishing,
            Command::Return => !returns,
            Command::Stop => !self.phase.has_ended(),
        };
        if !is_possible {
            let phase = if is_paused {
                "paused"
            } else {
                self.phase.name()
            };
            return Err(format!(
                "a rollout that is {phase} does not accept `{command}`"
            ));
        }
        let what = match command {
            Command::Pause => What::Paused,
            Command::Resume => What::Resumed,
            Command::Next => What::Next,
            Command::Return => What::Return,
            Command::Stop => What::Stopped,
        };
        self.noted_by(now, what, who);
        if command != Command::Pause {
            self.wake(now);
        }
        match command {
            Command::Pause => self.paused_ms = Some(now),
            Command::Resume if is_held => self.soak(now),
            Command::Resume => {}
            Command::Next => self.advance(now),
            Command::Return => self.go_back(&format!("by hand: {who}"), now),
            Command::Stop => self.enter(Phase::Stopped, "", now),
        }
        Ok(())
    }

    /// Ends a pause: moves all times before it by its length.
    fn wake(&mut self, now: Millis) {
        let Some(paused) = self.paused_ms.take() else {
            return;
        };
        self.since_ms += now - paused;
        for member in self.members.iter_mut().filter(|member| is_awaited(member)) {
            member.given.given_ms += now - paused;
        }
    }
}

/// True if a rollout waits for the node's answer.
pub(super) const fn is_awaited(member: &Member) -> bool {
    matches!(member.given.outcome, Outcome::Pending | Outcome::Waiting)
}
