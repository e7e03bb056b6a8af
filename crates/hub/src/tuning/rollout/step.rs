//! How a rollout goes on by itself: from a stage's reports over its soak to its verdict.

use super::super::gate::{Evidence, GateResult, Verdict, judge, overall};
use super::super::members::{Member, Millis, Outcome, Target};
use super::super::metric::BeforeAfter;
use super::record::{Entry, What};
use super::{LOOKS, MeasurementRequest, OnFailure, Phase, Rollout, Window, seconds};

impl Rollout {
    /// Lets time pass. Returns what has to be measured, if something has.
    pub fn tick(&mut self, now: Millis) -> Option<MeasurementRequest> {
        if self.paused_ms.is_some() || self.phase.has_ended() {
            return None;
        }
        if !matches!(self.phase, Phase::Returning { .. }) {
            self.withdraw_the_missed(now);
        }
        match self.phase {
            Phase::Applying { since_ms } => self.applying(since_ms, now),
            Phase::Soaking { since_ms, looks } if !self.measuring => {
                let soak = seconds(self.plan.soak_s);
                let due = match looks {
                    0 => soak / 2,
                    1 => soak,
                    _ => soak + seconds(self.plan.patience_s),
                };
                if now - since_ms >= due {
                    self.measuring = true;
                    return Some(self.windows());
                }
            }
            Phase::Finishing { .. } => {
                let open = |m: &Member| matches!(m.outcome, Outcome::Pending | Outcome::Waiting);
                if !self.members.iter().any(open) {
                    self.phase = Phase::Done;
                    let text = self.stragglers();
                    self.note(now, Entry::new(What::Done).with(text));
                }
            }
            Phase::Returning { since_ms, .. } => {
                let patience = seconds(self.plan.apply_within_s);
                let settled = |m: &Member| !m.is_due() && m.outcome.is_decided();
                // One that comes and goes shall not hold the return open for ever.
                if self.members.iter().all(settled) || now - since_ms >= 4 * patience {
                    self.phase = Phase::Returned;
                    let text = self.stragglers();
                    self.note(now, Entry::new(What::Returned).with(text));
                }
            }
            Phase::Soaking { .. }
            | Phase::Held { .. }
            | Phase::Done
            | Phase::Returned
            | Phase::Stopped => {}
        }
        None
    }

    fn applying(&mut self, since: Millis, now: Millis) {
        let (mut applied, mut failed, mut waiting, mut open) = (0, 0, 0, 0);
        for member in self.members.iter().filter(|m| m.group == self.stage) {
            match member.outcome {
                Outcome::Applied { .. } => applied += 1,
                Outcome::Refused { .. } | Outcome::TimedOut => failed += 1,
                Outcome::Waiting | Outcome::Missed => waiting += 1,
                Outcome::Pending | Outcome::Untouched => open += 1,
            }
        }
        if open > 0 {
            return;
        }
        let counts =
            format!("{applied} applied, {failed} refused or timed out, {waiting} out of reach");
        if applied == 0 && failed == 0 {
            // Nobody is there to measure.
            if now - since >= seconds(self.plan.offline_deadline_s) {
                self.hold(
                    now,
                    format!("no node of stage {} came back in time", self.stage + 1),
                );
            }
        } else if (applied as f64) < self.plan.fewest_applied * f64::from(applied + failed) {
            let reason = format!(
                "too few nodes of stage {} took the value: {counts}",
                self.stage + 1
            );
            self.fail(now, reason);
        } else {
            self.phase = Phase::Soaking {
                since_ms: now,
                looks: 0,
            };
            self.note(now, Entry::new(What::Soaking).with(counts));
        }
    }

    fn windows(&self) -> MeasurementRequest {
        let baseline = seconds(self.plan.baseline_s);
        let nodes = self
            .members
            .iter()
            .filter(|m| m.group == self.stage)
            .filter_map(|member| {
                Some(Window {
                    node: member.node.clone(),
                    old: member.before,
                    from_ms: member.asked_ms - baseline,
                    asked_ms: member.asked_ms,
                    applied_ms: member.outcome.applied_at()?,
                })
            });
        MeasurementRequest {
            knob: self.knob,
            nodes: nodes.collect(),
        }
    }

    /// The measurements could not be had: they are asked for again at the next tick.
    pub fn not_measured(&mut self) {
        self.measuring = false;
    }

    /// Takes the measurements that were asked for, and goes on, back, or waits.
    pub fn measured(&mut self, now: Millis, nodes: &[BeforeAfter]) {
        if !std::mem::take(&mut self.measuring) || self.paused_ms.is_some() {
            return;
        }
        let Phase::Soaking { since_ms, looks } = self.phase else {
            return;
        };
        let results = judge(&self.plan.gates, nodes, self.evidence());
        let verdict = overall(&results);
        let names = |verdict| named(&results, verdict);
        let text = match verdict {
            Verdict::Passed => "all gates passed".to_owned(),
            Verdict::Failed => format!("failed: {}", names(Verdict::Failed)),
            Verdict::Undecided => format!("undecided: {}", names(Verdict::Undecided)),
        };
        let looks = looks + 1;
        self.phase = Phase::Soaking { since_ms, looks };
        let failed = format!(
            "stage {}: {}",
            self.stage + 1,
            named(&results, Verdict::Failed)
        );
        let undecided = named(&results, Verdict::Undecided);
        self.note(
            now,
            Entry::new(What::Judged)
                .with(text)
                .with_gates(verdict, results),
        );
        match verdict {
            Verdict::Failed => self.fail(now, failed),
            Verdict::Passed if looks >= 2 => self.advance(now),
            Verdict::Undecided if looks >= LOOKS => {
                let reason = format!("stage {} could not be judged: {undecided}", self.stage + 1);
                self.hold(now, reason);
            }
            Verdict::Passed | Verdict::Undecided => {}
        }
    }

    /// How sure a verdict must be: the error that the plan allows is shared by all looks.
    fn evidence(&self) -> Evidence {
        let error = (1.0 - self.plan.confidence) / f64::from(LOOKS);
        Evidence {
            level: 1.0 - 2.0 * error,
            fewest_clips: self.plan.fewest_clips,
        }
    }

    pub(super) fn advance(&mut self, now: Millis) {
        self.measuring = false;
        if self.stage + 1 < self.stages {
            self.enter_stage(self.stage + 1, now);
        } else {
            self.phase = Phase::Finishing { since_ms: now };
        }
    }

    pub(super) fn enter_stage(&mut self, stage: usize, now: Millis) {
        self.stage = stage;
        self.phase = Phase::Applying { since_ms: now };
        let mut count = 0;
        for member in self.members.iter_mut().filter(|m| m.group == stage) {
            member.aim(Target::New);
            // Open until it is asked, so that the stage cannot be over before it has begun.
            member.outcome = Outcome::Pending;
            count += 1;
        }
        self.note(now, Entry::new(What::Stage).with(format!("{count} nodes")));
    }

    fn fail(&mut self, now: Millis, reason: String) {
        match self.plan.on_failure {
            OnFailure::Return => self.go_back(now, reason),
            OnFailure::Hold => self.hold(now, reason),
        }
    }

    fn hold(&mut self, now: Millis, reason: String) {
        self.measuring = false;
        self.note(now, Entry::new(What::Held).with(reason.clone()));
        self.phase = Phase::Held {
            since_ms: now,
            reason,
        };
    }

    pub(super) fn go_back(&mut self, now: Millis, reason: String) {
        self.measuring = false;
        for member in &mut self.members {
            member.aim(Target::Old);
            if member.asked == Target::Untouched {
                member.outcome = Outcome::Untouched;
            }
        }
        self.note(now, Entry::new(What::Returning).with(reason.clone()));
        self.phase = Phase::Returning {
            since_ms: now,
            reason,
        };
    }

    /// A node that stayed away beyond its deadline does not get the value when it returns: nobody would look at what it does there.
    fn withdraw_the_missed(&mut self, now: Millis) {
        let deadline = seconds(self.plan.offline_deadline_s);
        let mut missed = Vec::new();
        for member in &mut self.members {
            if member.outcome == Outcome::Waiting && now - member.asked_ms >= deadline {
                member.outcome = Outcome::Missed;
                member.aim(Target::Old);
                missed.push(member.node.clone());
            }
        }
        if !missed.is_empty() {
            self.note(now, Entry::new(What::Missed).with(list(&missed)));
        }
    }

    fn stragglers(&self) -> String {
        let not_there =
            |m: &&Member| !matches!(m.outcome, Outcome::Applied { .. } | Outcome::Untouched);
        let names: Vec<String> = (self.members.iter().filter(not_there))
            .map(|m| format!("{} {}", m.node, m.outcome.name()))
            .collect();
        if names.is_empty() {
            "every node reported it".to_owned()
        } else {
            format!("without {}", list(&names))
        }
    }
}

/// The first names of a list, and how many more.
fn list(names: &[String]) -> String {
    const SHOWN: usize = 10;
    let mut text = names[..names.len().min(SHOWN)].join(", ");
    if names.len() > SHOWN {
        text.push_str(&format!(" and {} more", names.len() - SHOWN));
    }
    text
}

fn named(results: &[GateResult], verdict: Verdict) -> String {
    let names: Vec<String> = (results.iter().filter(|r| r.verdict == verdict))
        .map(|r| match r.figure {
            Some(figure) => format!("{} ({figure})", r.gate),
            None => format!("{} (not measured)", r.gate),
        })
        .collect();
    names.join(", ")
}
