//! Advances a rollout: from the answers of a stage's nodes over its soak to its verdict.

use super::super::effect::Silence;
use super::super::gate::{ErrorRates, GateResult, Measured, Verdict, judge, overall};
use super::super::members::{Member, Millis, Outcome, Target};
use super::record::{Entry, What};
use super::{LOOKS, MeasurementRequest, Measurements, OnFailure, Phase, Rollout, Window, seconds};

/// Attempts to measure before a rollout is held.
const ATTEMPTS: u8 = 20;

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
                    return Some(self.windows(since_ms, now));
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
            Phase::Held { since_ms, .. } if now - since_ms >= seconds(self.plan.held_for_s) => {
                self.go_back(now, "no decision came in time".to_owned());
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
            self.soak(now);
            self.note(now, Entry::new(What::Soaking).with(counts));
        }
    }

    pub(super) fn soak(&mut self, now: Millis) {
        self.soaks = self.soaks.saturating_add(1);
        self.phase = Phase::Soaking {
            since_ms: now,
            looks: 0,
        };
    }

    fn windows(&self, since: Millis, now: Millis) -> MeasurementRequest {
        let baseline = seconds(self.plan.baseline_s);
        let stage = || self.members.iter().filter(|m| m.group == self.stage);
        let changed = stage().filter_map(|member| {
            let applied = member.outcome.applied_at()?;
            Some(Window {
                node: member.node.clone(),
                old: member.before,
                before_ms: [member.asked_ms - baseline, member.asked_ms],
                new: self.knob,
                // After a resumption only what came after it counts.
                after_ms: [applied.max(since), now],
            })
        });
        let asked = stage().map(|member| member.asked_ms).min().unwrap_or(since);
        let unchanged = (self.members.iter())
            .filter(|member| member.group > self.stage)
            .map(|member| Window {
                node: member.node.clone(),
                old: member.before,
                before_ms: [asked - baseline, asked],
                new: member.before,
                after_ms: [since, now],
            });
        MeasurementRequest {
            changed: changed.collect(),
            unchanged: unchanged.collect(),
        }
    }

    /// The measurements failed: they are asked for again at the next tick, and after many attempts the rollout is held.
    pub(crate) fn not_measured(&mut self, now: Millis) {
        self.measuring = false;
        self.failed_attempts += 1;
        if self.failed_attempts >= ATTEMPTS {
            self.failed_attempts = 0;
            self.hold(now, "the clips could not be read".to_owned());
        }
    }

    /// Takes the measurements that were asked for, and goes on, back, or waits.
    pub fn measured(&mut self, now: Millis, measurements: &Measurements) {
        if !std::mem::take(&mut self.measuring) || self.paused_ms.is_some() {
            return;
        }
        let Phase::Soaking { since_ms, looks } = self.phase else {
            return;
        };
        self.failed_attempts = 0;
        let rates = self.error_rates();
        let measured = Measured {
            changed: &measurements.changed,
            unchanged: &measurements.unchanged,
            fewest_clips: self.plan.fewest_clips,
        };
        let results = judge(&self.plan.gates, measured, rates);
        let (changed, unchanged) = self.silence(measurements);
        let lost = changed.by_chance(unchanged) < rates.fail;
        // Where too few nodes can be measured, a stage passes when its nodes took the value and are alive.
        let alive = 2 * changed.silent <= changed.nodes && changed.silent < changed.nodes;
        let verdict = match overall(&results) {
            _ if lost => Verdict::Failed,
            Verdict::Passed | Verdict::NotMeasured if !alive => Verdict::Undecided,
            verdict => verdict,
        };
        let silent = format!(
            "{} of {} nodes fell silent, {} of {} of the others",
            changed.silent, changed.nodes, unchanged.silent, unchanged.nodes
        );
        let text = match verdict {
            Verdict::Passed => "all gates passed".to_owned(),
            Verdict::NotMeasured => format!("took the value and are alive; {silent}"),
            Verdict::Failed if lost => format!("failed: {silent}"),
            Verdict::Undecided if !alive => format!("undecided: {silent}"),
            Verdict::Failed | Verdict::Undecided => {
                format!("{}: {}", name(verdict), named(&results, verdict))
            }
        };
        let looks = looks + 1;
        self.phase = Phase::Soaking { since_ms, looks };
        let reason = format!("stage {}: {text}", self.stage + 1);
        self.note(
            now,
            Entry::new(What::Judged)
                .with(text)
                .with_gates(verdict, results),
        );
        match verdict {
            Verdict::Failed => self.fail(now, reason),
            Verdict::Passed | Verdict::NotMeasured if looks >= 2 => self.advance(now),
            Verdict::Undecided if looks >= LOOKS => self.hold(now, reason),
            Verdict::Passed | Verdict::NotMeasured | Verdict::Undecided => {}
        }
    }

    /// The nodes that were in reach when the stage began and took the value, and those not asked yet; how many of each
    /// are out of reach now, or made clips before and none since.
    fn silence(&self, measurements: &Measurements) -> (Silence, Silence) {
        let count = |members: &mut dyn Iterator<Item = &Member>, clips: &[super::BeforeAfter]| {
            let mut silence = Silence::default();
            for (member, clips) in members.zip(clips) {
                if member.was_reachable {
                    silence.nodes += 1;
                    silence.silent += u64::from(!member.reachable || clips.fell_silent());
                }
            }
            silence
        };
        let stage =
            |member: &&Member| member.group == self.stage && member.outcome.applied_at().is_some();
        (
            count(
                &mut self.members.iter().filter(stage),
                &measurements.changed,
            ),
            count(
                &mut self.members.iter().filter(|m| m.group > self.stage),
                &measurements.unchanged,
            ),
        )
    }

    /// The error of one look at one figure. What the plan allows for a failure without cause is shared by all stages,
    /// gates and looks; each resumption has half of what the soak before it had. For a pass it is shared by the looks
    /// that can pass: every stage has to pass every gate, so there nothing adds up.
    pub(super) fn error_rates(&self) -> ErrorRates {
        let error = (1.0 - self.plan.confidence) * 0.5_f64.powi(i32::from(self.soaks));
        let figures: usize = (self.plan.gates.iter())
            .map(|gate| gate.metric.figures().len())
            .sum();
        // One more for nodes that fall silent.
        let tests = (self.stages * (figures + 1)) as f64 * f64::from(LOOKS);
        ErrorRates {
            fail: error / tests,
            pass: error / f64::from(LOOKS - 1),
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
        self.soaks = 0;
        self.phase = Phase::Applying { since_ms: now };
        let mut count = 0;
        for member in &mut self.members {
            member.was_reachable = member.reachable;
            if member.group != stage {
                continue;
            }
            member.aim(Target::New);
            // Open until it is asked, so that the stage cannot be over before it has begun.
            member.outcome = Outcome::Pending;
            count += 1;
        }
        let nodes = if count == 1 { "node" } else { "nodes" };
        self.note(
            now,
            Entry::new(What::Stage).with(format!("{count} {nodes}")),
        );
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
        self.members.iter_mut().for_each(Member::give_back);
        self.note(now, Entry::new(What::Returning).with(reason.clone()));
        self.phase = Phase::Returning {
            since_ms: now,
            reason,
        };
    }

    /// Nodes whose value was changed by somebody else since keep it: nothing is given back to them.
    pub(crate) fn leave_out(&mut self, changed_since: impl Fn(&Member) -> bool) {
        for member in self.members.iter_mut() {
            if member.asked != Target::Untouched && changed_since(member) {
                member.asked = Target::Untouched;
                member.target = Target::Untouched;
                member.outcome = Outcome::Untouched;
            }
        }
    }

    /// A node that stayed away beyond its deadline does not get the value when it returns: it would not be judged.
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

const fn name(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Passed => "passed",
        Verdict::Failed => "failed",
        Verdict::Undecided => "undecided",
        Verdict::NotMeasured => "not measured",
    }
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
