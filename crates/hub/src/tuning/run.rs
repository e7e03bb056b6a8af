//! Runs a rollout, which gives a value to more and more nodes, or a trial, which gives values to random groups at the
//! same time.
//!
//! A [`Run`] is a state machine without clock, network or database. The caller passes in the nodes' states
//! ([`Run::observe`]), the time ([`Run::tick`]), measurements that were requested ([`Run::measured`]) and commands
//! ([`Run::command`]), and gets the values that are due ([`Run::due`]). The whole state is serialised; a run that is
//! read from the database continues.

mod command;
mod kind;
mod measured;
mod phase;
mod record;

/// So many nodes, in words.
pub(super) fn counted_nodes(count: usize) -> String {
    let nodes = if count == 1 { "node" } else { "nodes" };
    format!("{count} {nodes}")
}

#[cfg(test)]
mod tests;
mod values;
mod window;

pub use command::Command;
use command::is_awaited;
pub use kind::Kind;
pub use measured::{ArmFigure, ArmResult, TrialResult};
pub use phase::Phase;
pub use record::{Entry, LeftOut, StageView, What};
pub(crate) use window::{BeforeAfterWindows, Measured, Window};

use super::effect::FEWEST_NODES;
use super::gate::Verdict;
use super::member::{Member, Millis, shuffle};
use super::outcome::Outcome;
use super::plan::OnFailure;
use crate::presence::NodeView;
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// Most times that a stage's gates are judged: half-way (when they can only fail), at the end of the soak, and at the
/// end of the patience.
const LOOKS: u8 = 3;
/// Failed measurements after which a rollout is held, and a trial ends without a result.
const MOST_FAILED_MEASUREMENTS: u8 = 20;
/// Most entries of a record; older ones are dropped.
const MOST_ENTRIES: usize = 500;

/// A rollout or a trial: its plan, nodes, phase and record.
#[skip_serializing_none]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Run {
    /// Its number, among those of its kind.
    pub id: i64,
    /// Who began it.
    pub who: String,
    /// When, milliseconds since the Unix epoch.
    pub begun_ms: Millis,
    /// When it ended; absent while it runs.
    pub ended_ms: Option<Millis>,
    /// Its kind and plan.
    #[serde(flatten)]
    pub kind: Kind,
    /// The seed that drew the order of the nodes, or the groups.
    pub seed: u64,
    /// Its phase.
    pub phase: Phase,
    /// When the phase began.
    pub since_ms: Millis,
    /// How often this stage's gates were judged.
    #[serde(default)]
    pub looks: u8,
    /// Why it is held, or why the old values return.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// The stage it is in, from 1.
    pub stage: usize,
    /// How often this stage has soaked: once, and once more after each resumed hold.
    pub soaks: u8,
    /// When it was paused; absent unless it is.
    pub paused_ms: Option<Millis>,
    /// Who ended a trial before its time.
    pub ended_by: Option<String>,
    /// The result of a trial, once it is over; absent if it could not be measured.
    pub result: Option<TrialResult>,
    /// Its record, oldest entry first; absent in a list.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub record: Vec<Entry>,
    /// Its nodes, in the order of their stages; absent in a list.
    #[serde(rename = "nodes", default, skip_serializing_if = "Vec::is_empty")]
    pub members: Vec<Member>,
    /// Its stages or groups.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(required)]
    pub stages: Vec<StageView>,
    /// Selected nodes that take no part; only in the answer to the request that begins it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// Failed measurements in a row.
    #[serde(skip)]
    failed_attempts: u8,
    /// True if it changed since it was saved.
    #[serde(skip)]
    pub(crate) unsaved: bool,
}

/// What ends the measurements of a trial.
#[derive(Clone, Copy, Debug)]
pub(crate) enum EndedBy<'a> {
    /// Its duration is over.
    Time,
    /// Somebody ended it before its time.
    Person(&'a str),
}

impl Run {
    /// Begins with `nodes`, in the order that the seed draws: a rollout with the reachable ones first, a trial only with
    /// those, since the others would not be measured.
    ///
    /// # Errors
    /// When the plan is invalid, or there are too few nodes.
    pub(crate) fn begin(
        kind: Kind,
        mut nodes: Vec<Member>,
        seed: u64,
        who: &str,
        now: Millis,
    ) -> Result<Self, String> {
        // The draw depends only on the seed and the nodes.
        nodes.sort_by(|a, b| a.node.cmp(&b.node));
        shuffle(&mut nodes, seed);
        let (mut members, far): (Vec<_>, Vec<_>) =
            nodes.into_iter().partition(|member| member.reachable);
        match &kind {
            Kind::Rollout { plan, .. } => {
                plan.check()?;
                members.extend(far);
                if members.is_empty() {
                    return Err("select: no selected node can take part".to_owned());
                }
                let ends = plan.stage_ends(members.len());
                for (place, member) in members.iter_mut().enumerate() {
                    // Nodes in no stage keep the old value; their group is one more than the last stage.
                    member.group = ends.iter().filter(|end| **end <= place).count();
                }
            }
            Kind::Trial { plan } => {
                plan.check()?;
                let nodes = members.len();
                let values = plan.values.len();
                if nodes < values * FEWEST_NODES {
                    return Err(format!(
                        "select: too few nodes are in reach, {nodes} for {values} values: each needs at least {FEWEST_NODES}"
                    ));
                }
                for (place, member) in members.iter_mut().enumerate() {
                    member.group = place % values;
                }
            }
        }
        let mut run = Self {
            id: 0,
            who: who.to_owned(),
            begun_ms: now,
            ended_ms: None,
            kind,
            seed,
            phase: Phase::Applying,
            since_ms: now,
            looks: 0,
            reason: String::new(),
            stage: 1,
            soaks: 0,
            paused_ms: None,
            ended_by: None,
            result: None,
            record: Vec::new(),
            members,
            stages: Vec::new(),
            left_out: Vec::new(),
            failed_attempts: 0,
            unsaved: false,
        };
        run.noted_by(now, What::Begun, who);
        run.enter_stage(1, now);
        Ok(run)
    }

    /// Counts the nodes of its stages or groups by outcome, without those that were given no value.
    pub(crate) fn count_stages(&mut self) {
        let mut stages = vec![StageView::default(); self.stage_count()];
        for member in &self.members {
            // Nodes that a rollout leaves out are in no stage.
            let Some(stage) = stages.get_mut(member.group) else {
                continue;
            };
            stage.nodes += 1;
            if member.given.outcome != Outcome::Untouched {
                *stage.counts.entry(member.given.outcome).or_default() += 1;
            }
        }
        self.stages = stages;
    }

    /// The number of its stages or groups.
    pub(crate) fn stage_count(&self) -> usize {
        match &self.kind {
            Kind::Rollout { plan, .. } => plan.stage_ends(self.members.len()).len(),
            Kind::Trial { plan } => plan.values.len(),
        }
    }

    /// Updates the members by the states of their nodes.
    pub(crate) fn observe(&mut self, now: Millis, view: impl Fn(&str) -> Option<NodeView>) {
        // Time stops in a pause: reports during it count as if they came at its beginning.
        let now = self.paused_ms.unwrap_or(now);
        let patience = self.patience();
        for member in &mut self.members {
            let Some(node) = view(&member.node) else {
                continue;
            };
            member.reachable = node.is_reachable();
            if let Some(value) = member.value {
                let setting = DesiredSetting::Threshold(value);
                let has_changed = member.given.observe(&node, setting, patience, now);
                if has_changed {
                    self.unsaved = true;
                }
            }
        }
    }

    /// Lets time pass. Returns the windows to measure if it is time.
    pub(crate) fn tick(&mut self, now: Millis) -> Option<Vec<BeforeAfterWindows>> {
        if self.paused_ms.is_some() || self.phase.has_ended() {
            return None;
        }
        self.withdraw_the_missed(now);
        let waited = now - self.since_ms;
        let is_over = waited >= self.lasts();
        match self.phase {
            Phase::Applying => self.applying(waited, now),
            Phase::Soaking | Phase::Running if is_over => return Some(self.windows(now)),
            Phase::Held if is_over => self.go_back("nobody decided in time", now),
            Phase::Finishing if !self.members.iter().any(is_awaited) => self.end(now),
            // A node that comes and goes must not keep the return open for ever.
            Phase::Returning if is_over || self.has_returned() => self.end(now),
            _ => {}
        }
        None
    }

    /// True if every node in reach reports the value that it had before.
    fn has_returned(&self) -> bool {
        let pending = |member: &Member| member.given.outcome == Outcome::Pending;
        self.due().is_empty() && !self.members.iter().any(pending)
    }

    fn applying(&mut self, waited: Millis, now: Millis) {
        let outcomes: Vec<Outcome> = self
            .members
            .iter()
            .filter(|member| self.is_in_stage(member))
            .map(|member| member.given.outcome)
            .collect();
        // A node that comes and goes must not delay the others.
        if outcomes.contains(&Outcome::Pending) && waited < 2 * self.patience() {
            return;
        }
        let count = |wanted: Outcome| outcomes.iter().filter(|one| **one == wanted).count();
        let applied = count(Outcome::Applied);
        let failed = count(Outcome::Refused) + count(Outcome::TimedOut);
        let away = outcomes.len() - applied - failed;
        let counts =
            format!("{applied} applied, {failed} refused or timed out, {away} out of reach");
        let stage = self.stage;
        if let Kind::Rollout { plan, .. } = &self.kind {
            if applied == 0 && failed == 0 {
                // There is no node to measure.
                if waited >= milliseconds(plan.offline_deadline_s) {
                    self.hold(&format!("no node of stage {stage} returned in time"), now);
                }
                return;
            }
            if (applied as f64) < plan.fewest_applied * (applied + failed) as f64 {
                let reason = format!("too few nodes of stage {stage} applied the value: {counts}");
                self.fail(&reason, now);
                return;
            }
        }
        self.soak(now);
        self.noted(now, What::Soaking, &counts);
    }

    fn soak(&mut self, now: Millis) {
        self.soaks = self.soaks.saturating_add(1);
        let phase = match self.kind {
            Kind::Rollout { .. } => Phase::Soaking,
            Kind::Trial { .. } => Phase::Running,
        };
        self.enter(phase, "", now);
    }

    /// The duration of the phase, or the time from its beginning to the next measurement.
    fn lasts(&self) -> Millis {
        match (&self.kind, self.phase) {
            (Kind::Trial { plan }, Phase::Running) => milliseconds(plan.duration_s),
            (Kind::Rollout { plan, .. }, Phase::Held) => milliseconds(plan.held_for_s),
            (Kind::Rollout { plan, .. }, Phase::Soaking) => {
                let next_look_s = match self.looks {
                    0 => plan.soak_s / 2.0,
                    1 => plan.soak_s,
                    _ => plan.soak_s + plan.patience_s,
                };
                milliseconds(next_look_s)
            }
            _ => 4 * self.patience(),
        }
    }

    /// Notes that a measurement failed; the next tick asks for it again. After many failures a rollout is held, and a trial
    /// ends without a result.
    pub(crate) fn not_measured(&mut self, now: Millis) {
        self.failed_attempts += 1;
        if self.failed_attempts >= MOST_FAILED_MEASUREMENTS {
            self.failed_attempts = 0;
            let reason = "the clips could not be read";
            match self.kind {
                Kind::Rollout { .. } => self.hold(reason, now),
                Kind::Trial { .. } => self.go_back(reason, now),
            }
        }
    }

    /// Applies the requested measurements: a rollout advances, returns or waits; a trial ends.
    pub(crate) fn measured(&mut self, found: &Measured, now: Millis) {
        self.failed_attempts = 0;
        let Kind::Rollout { plan, .. } = &self.kind else {
            self.end_trial(found, EndedBy::Time, now);
            return;
        };
        let judgement = self.judge(plan, found);
        self.looks += 1;
        let reason = format!("stage {}: {}", self.stage, judgement.text);
        self.add_entry(Entry {
            text: judgement.text,
            verdict: Some(judgement.verdict),
            gates: judgement.gates,
            ..self.entry(now, What::Judged)
        });
        match judgement.verdict {
            Verdict::Failed => self.fail(&reason, now),
            Verdict::Passed | Verdict::NotMeasured if self.looks >= 2 => self.advance(now),
            Verdict::Undecided if self.looks >= LOOKS => self.hold(&reason, now),
            _ => {}
        }
    }

    /// Ends a trial with the measurements of its [`windows`](Self::windows); the old values return.
    pub(crate) fn end_trial(&mut self, found: &Measured, by: EndedBy<'_>, now: Millis) {
        let Kind::Trial { plan } = &self.kind else {
            return;
        };
        if !matches!(self.phase, Phase::Applying | Phase::Running) {
            return;
        }
        self.result = Some(self.compare(plan, found, now));
        match by {
            EndedBy::Time => self.go_back("the time is over", now),
            EndedBy::Person(who) => {
                self.ended_by = Some(who.to_owned());
                self.go_back(&format!("by hand: {who}"), now);
            }
        }
    }

    fn advance(&mut self, now: Millis) {
        if self.stage < self.stage_count() {
            self.enter_stage(self.stage + 1, now);
        } else {
            self.enter(Phase::Finishing, "", now);
        }
    }

    fn enter_stage(&mut self, stage: usize, now: Millis) {
        self.stage = stage;
        self.soaks = 0;
        self.enter(Phase::Applying, "", now);
        let is_trial = matches!(self.kind, Kind::Trial { .. });
        let mut count = 0;
        for member in &mut self.members {
            member.was_reachable = member.reachable;
            if is_trial || member.group + 1 == stage {
                // Before it is given the value, so that the phase cannot end before it has begun.
                member.given.outcome = Outcome::Pending;
                count += 1;
            }
        }
        self.noted(now, What::Stage, &counted_nodes(count));
    }

    fn fail(&mut self, reason: &str, now: Millis) {
        match &self.kind {
            Kind::Rollout { plan, .. } if plan.on_failure == OnFailure::Hold => {
                self.hold(reason, now);
            }
            _ => self.go_back(reason, now),
        }
    }

    fn hold(&mut self, reason: &str, now: Millis) {
        self.enter(Phase::Held, reason, now);
        self.noted(now, What::Held, reason);
    }

    fn go_back(&mut self, reason: &str, now: Millis) {
        self.enter(Phase::Returning, reason, now);
        self.noted(now, What::Returning, reason);
        for member in self.members.iter_mut().filter(|member| member.value.is_none()) {
            member.given.outcome = Outcome::Untouched;
        }
    }

    fn end(&mut self, now: Millis) {
        let (phase, what) = match (&self.kind, self.phase) {
            (Kind::Rollout { .. }, Phase::Returning) => (Phase::Returned, What::Returned),
            _ => (Phase::Done, What::Done),
        };
        let mut names = Vec::new();
        for member in &self.members {
            let outcome = member.given.outcome;
            if !matches!(outcome, Outcome::Applied | Outcome::Untouched) {
                names.push(format!("{} {outcome}", member.node));
            }
        }
        let text = match names.as_slice() {
            [] => "every node reported its value".to_owned(),
            names => format!("without {}", list(names)),
        };
        // The reason of the stage stays, which entering a phase replaces.
        self.enter(phase, &self.reason.clone(), now);
        self.noted(now, what, &text);
    }

    fn enter(&mut self, phase: Phase, reason: &str, now: Millis) {
        self.phase = phase;
        self.since_ms = now;
        self.looks = 0;
        self.reason = reason.to_owned();
        self.unsaved = true;
    }

    /// Leaves out the nodes for which `was_changed` is true: they keep the value that somebody else gave them.
    pub(crate) fn leave_out(&mut self, was_changed: impl Fn(&Member) -> bool) {
        for member in self.members.iter_mut().filter(|member| was_changed(member)) {
            member.value = None;
        }
    }

    /// Withdraws the values of nodes that missed their deadline.
    fn withdraw_the_missed(&mut self, now: Millis) {
        let deadline = match &self.kind {
            Kind::Rollout { plan, .. } if self.phase != Phase::Returning => {
                milliseconds(plan.offline_deadline_s)
            }
            _ => return,
        };
        let mut missed = Vec::new();
        for member in &mut self.members {
            if member.given.outcome == Outcome::Waiting && now - member.given.given_ms >= deadline {
                member.given.outcome = Outcome::Missed;
                missed.push(member.node.clone());
            }
        }
        if !missed.is_empty() {
            self.noted(now, What::Missed, &list(&missed));
        }
    }

    /// True if the member gets its value in this stage; true for all members of a trial.
    fn is_in_stage(&self, member: &Member) -> bool {
        matches!(self.kind, Kind::Trial { .. }) || member.group + 1 == self.stage
    }

    fn patience(&self) -> Millis {
        milliseconds(self.kind.basics().apply_within_s)
    }

    /// Notes in the record what has happened.
    fn noted(&mut self, at_ms: Millis, what: What, text: &str) {
        self.add_entry(Entry {
            text: text.to_owned(),
            ..self.entry(at_ms, what)
        });
    }

    /// Notes in the record what somebody has done.
    fn noted_by(&mut self, at_ms: Millis, what: What, who: &str) {
        self.add_entry(Entry {
            who: Some(who.to_owned()),
            ..self.entry(at_ms, what)
        });
    }

    /// An entry about the present stage, without anything more.
    fn entry(&self, at_ms: Millis, what: What) -> Entry {
        Entry {
            at_ms,
            stage: self.stage,
            what,
            who: None,
            text: String::new(),
            verdict: None,
            gates: Vec::new(),
        }
    }

    fn add_entry(&mut self, entry: Entry) {
        self.unsaved = true;
        if self.record.len() >= MOST_ENTRIES {
            self.record.remove(0);
        }
        self.record.push(entry);
    }
}

pub(crate) fn milliseconds(seconds: f64) -> Millis {
    (seconds * 1000.0) as Millis
}

/// The first names of a list, and the number of the others.
fn list(names: &[String]) -> String {
    const SHOWN: usize = 10;
    let mut text = names[..names.len().min(SHOWN)].join(", ");
    if names.len() > SHOWN {
        text.push_str(&format!(" and {} more", names.len() - SHOWN));
    }
    text
}
