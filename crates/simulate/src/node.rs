//! Simulates one node and its reactions to desired settings, without network or clock.

mod report;

use super::options::Options;
use super::random::mix;
use albireo_wire::{
    CameraState, CameraStatus, Desired, DesiredSetting, EnergyQuality, HealthState, HealthStatus,
    Heartbeat, NodeStatus, NodeTarget, OutboxStatus, RefusedRevision, ReportBatch, SettingSource,
    StatusMessage, Target, TargetStatus, Threshold, VERSION,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The initial value of every node.
pub(crate) const FIRST_U: f64 = 3e-4;
/// The node's only camera.
const CAMERA: &str = "front";
/// The range of `u`, as in the policy.
const RANGE: std::ops::RangeInclusive<f64> = 1e-9..=1.0;
/// The range within which a target moves `u`.
const HELD_WITHIN: std::ops::RangeInclusive<f64> = 1.5e-4..=2e-3;
/// The skip rate at [`FIRST_U`].
const FIRST_SKIP: f64 = 0.55;
/// The increase of the skip rate per decade of `u`.
const SKIP_PER_DECADE: f64 = 0.2;
/// Seconds between two heartbeats while the hub has not said another number.
const HEARTBEAT_S: f64 = 30.0;

/// What is drawn from a node's seed: each has a number of its own, so that one draw says nothing of another.
const DRAW_RUN: u64 = 2;
const DRAW_OWN_SKIP: u64 = 5;
const DRAW_START: u64 = 6;
/// These two are followed by one number per report.
const DRAW_REPORT: u64 = 1_000;
const DRAW_ID: u64 = 2_000_000;
/// Followed by one number for each parameter of a node's way.
pub(crate) const DRAW_WAY: u64 = 3_000_000;

/// The share of frames that a node skips at this `u`, before what is its own and its clip's.
fn skip_rate(u: f64) -> f64 {
    FIRST_SKIP + SKIP_PER_DECADE * (u / FIRST_U).log10()
}

/// A value of `u`, and the number of the first report that used it.
#[derive(Clone, Copy, Debug)]
struct InForce {
    from: u64,
    u: f64,
}

/// One simulated node. Its reports are computed from their numbers, so a backlog of hours uses no memory.
#[derive(Debug)]
pub(crate) struct SimNode {
    pub(crate) name: String,
    seed: u64,
    region: &'static str,
    started_ns: u64,
    options: Arc<Options>,
    /// The number of reports made.
    pub(crate) made: u64,
    /// The number of reports that a hub has acknowledged: the oldest ones.
    pub(crate) acknowledged: u64,
    /// The revision in force.
    pub(crate) revision: u64,
    /// All values so far, in order.
    values: Vec<InForce>,
    source: SettingSource,
    refused: Option<RefusedRevision>,
    /// The target it holds, with its status.
    target: Option<NodeTarget>,
    seq: u64,
    is_full_due: bool,
    /// Seconds between two heartbeats.
    pub(crate) heartbeat_s: f64,
}

impl SimNode {
    /// Creates node number `index` of a run that began at `began_ns`. Without a backlog it starts at a random point
    /// between two batches, like in a fleet that has run for long: otherwise nothing would be reported until the first
    /// batch is gathered.
    pub(crate) fn new(index: usize, options: &Arc<Options>, began_ns: u64) -> Self {
        let seed = mix(options.seed, index as u64);
        let made = match options.backlog {
            0 => mix(seed, DRAW_START) % options.gather.max(1),
            backlog => backlog,
        };
        Self {
            name: format!("{}{index:06}", options.name),
            region: ["north", "east", "south", "west"][index % 4],
            started_ns: began_ns.saturating_sub((made as f64 * options.clip_s * 1e9) as u64),
            options: Arc::clone(options),
            made,
            acknowledged: 0,
            revision: 0,
            values: vec![InForce {
                from: 0,
                u: FIRST_U,
            }],
            source: SettingSource::Configuration,
            refused: None,
            target: None,
            seq: 0,
            is_full_due: true,
            heartbeat_s: options.status_s.unwrap_or(HEARTBEAT_S),
            seed,
        }
    }

    /// The number of waiting reports.
    pub(crate) const fn waiting(&self) -> u64 {
        self.made - self.acknowledged
    }

    /// The oldest waiting reports at the time `now_ns`, at most `most`.
    pub(crate) fn batch(&self, most: u64, now_ns: u64) -> Option<ReportBatch> {
        let count = self.waiting().min(most);
        if count == 0 {
            return None;
        }
        let numbers = self.acknowledged..self.acknowledged + count;
        Some(ReportBatch {
            v: VERSION,
            node: self.name.clone(),
            t_ms: now_ns / 1_000_000,
            ages: Vec::new(),
            reports: numbers.map(|number| self.report(number)).collect(),
        })
    }

    /// Marks the oldest `reports` waiting reports as acknowledged.
    pub(crate) fn acknowledge(&mut self, reports: u64) {
        self.acknowledged = (self.acknowledged + reports).min(self.made);
    }

    /// Applies a desired setting. Returns true if the status must be sent immediately.
    pub(crate) fn apply(&mut self, desired: &Desired) -> bool {
        self.is_full_due |= desired.send_full_status;
        let hub_wants_s = desired.heartbeat_s.map_or(HEARTBEAT_S, f64::from);
        self.heartbeat_s = self.options.status_s.unwrap_or(hub_wants_s);
        let refused_revision = self.refused.as_ref().map_or(0, |refused| refused.revision);
        if desired.revision <= self.revision.max(refused_revision) {
            return desired.send_full_status;
        }
        let Some(setting) = desired.setting else {
            return desired.send_full_status;
        };
        self.is_full_due = true;
        match self.put_in_force(setting) {
            Ok(()) => {
                self.refused = None;
                self.revision = desired.revision;
            }
            Err(reason) => {
                self.refused = Some(RefusedRevision {
                    revision: desired.revision,
                    reason: reason.to_owned(),
                });
            }
        }
        true
    }

    /// Puts a setting in force.
    ///
    /// # Errors
    /// The reason why it cannot be in force.
    fn put_in_force(&mut self, setting: DesiredSetting) -> Result<(), &'static str> {
        match setting {
            DesiredSetting::Target(None) => self.target = None,
            DesiredSetting::Target(Some(target)) => self.hold(target),
            DesiredSetting::Threshold(threshold) => {
                if threshold.name.as_str() != "u" {
                    return Err("the threshold of the policy in use is `u`");
                }
                if !RANGE.contains(&threshold.value) {
                    return Err("`u` must be a number from 1e-9 to 1");
                }
                self.source = SettingSource::Hub;
                self.target = None;
                self.set_u(threshold.value);
            }
        }
        Ok(())
    }

    /// Sets the value for the reports that follow.
    fn set_u(&mut self, u: f64) {
        let from = self.made;
        self.values.push(InForce { from, u });
    }

    /// Holds a target. The simulated street has a skip rate for each `u`, so the target is reached immediately, as if a
    /// controller had settled; there are no figures for power and recall.
    fn hold(&mut self, target: Target) {
        let mut held = NodeTarget {
            target,
            source: SettingSource::Hub,
            status: None,
            actual: None,
        };
        match target {
            Target::SkipRate(rate) => {
                let wanted_u = FIRST_U * 10_f64.powf((rate - FIRST_SKIP) / SKIP_PER_DECADE);
                let u = wanted_u.clamp(*HELD_WITHIN.start(), *HELD_WITHIN.end());
                self.set_u(u);
                held.actual = Some(skip_rate(u));
                let status = if wanted_u > u {
                    TargetStatus::CannotBeMet
                } else if wanted_u < u {
                    TargetStatus::MoreThanKept
                } else {
                    TargetStatus::Held
                };
                held.status = Some(status);
            }
            Target::Recall(_) => held.status = Some(TargetStatus::NoAudit),
            Target::Watts(_) => held.status = Some(TargetStatus::NoPower),
        }
        self.target = Some(held);
    }

    /// The value in force.
    pub(crate) fn u(&self) -> f64 {
        self.values.last().map_or(FIRST_U, |last| last.u)
    }

    /// The value that report number `number` used.
    fn u_of(&self, number: u64) -> f64 {
        let mut newest_first = self.values.iter().rev();
        let used = newest_first.find(|value| value.from <= number);
        used.map_or(FIRST_U, |value| value.u)
    }

    /// The payload of the next status; a heartbeat if nothing changed.
    pub(crate) fn status_payload(&mut self, now_ns: u64) -> Result<Vec<u8>, serde_json::Error> {
        let message = self.status(now_ns);
        if message.full.is_some() {
            return serde_json::to_vec(&message);
        }
        let heartbeat = Heartbeat {
            run: message.run,
            seq: message.seq,
            waiting: message.waiting,
        };
        heartbeat.to_payload()
    }

    /// The next status; a full one at first, after a change, and on request.
    pub(crate) fn status(&mut self, now_ns: u64) -> StatusMessage {
        let is_full_due = std::mem::take(&mut self.is_full_due);
        let full = is_full_due.then(|| Box::new(self.full()));
        let seq = self.seq;
        self.seq += 1;
        StatusMessage {
            v: VERSION,
            run: self.run(),
            started_ns: self.started_ns,
            seq,
            t_ns: now_ns,
            health: HealthState::Ready,
            waiting: self.waiting(),
            revision: self.revision,
            full,
        }
    }

    /// The number of this run of the process, another one whenever the fleet is started.
    fn run(&self) -> u32 {
        mix(mix(self.seed, self.started_ns), DRAW_RUN) as u32
    }

    fn full(&self) -> NodeStatus {
        NodeStatus {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            labels: [("region", self.region), ("simulated", "yes")]
                .map(|(label, value)| (label.to_owned(), value.to_owned()))
                .into(),
            cameras: vec![CameraStatus {
                name: CAMERA.to_owned(),
                state: CameraState::Live,
                threshold: Some(Threshold::new("u", self.u())),
                threshold_source: self.source,
            }],
            policy: "albireo".to_owned(),
            model: "simulated".to_owned(),
            provider: Some("simulated".to_owned()),
            power_source: "simulated".to_owned(),
            power_quality: self.quality(),
            health: HealthStatus {
                state: HealthState::Ready,
                reasons: BTreeMap::new(),
            },
            outbox: OutboxStatus {
                waiting: self.waiting(),
                lost: 0,
                undeliverable: 0,
                durable: false,
            },
            refused: self.refused.clone(),
            target: self.target,
            target_off: None,
            certificates: Vec::new(),
        }
    }

    /// The energy quality to report. It is pretended: no figure comes from a meter.
    fn quality(&self) -> EnergyQuality {
        if self.options.measured {
            EnergyQuality::Measured
        } else {
            EnergyQuality::Estimated
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;
    use uuid::Uuid;

    fn node(options: Options) -> SimNode {
        let options = Options { seed: 1, ..options };
        SimNode::new(3, &Arc::new(options), 1_000_000_000_000_000_000)
    }

    fn desired(revision: u64, value: f64) -> Desired {
        Desired {
            revision,
            setting: Some(DesiredSetting::Threshold(Threshold::new("u", value))),
            ..Desired::nothing()
        }
    }

    #[test]
    fn a_fleet_that_is_started_again_has_other_runs_and_the_same_reports() {
        let options = Arc::new(Options {
            backlog: 3,
            seed: 1,
            ..Options::default()
        });
        let mut first = SimNode::new(0, &options, 1_000_000_000_000_000_000);
        let mut second = SimNode::new(0, &options, 1_000_000_060_000_000_000);
        assert_ne!(first.status(0).run, second.status(0).run);
        assert_eq!(first.status(0).run, first.status(1).run);
        let counts = |node: &SimNode| -> Vec<_> {
            let batch = node.batch(3, 0).unwrap();
            batch.reports.iter().map(|report| report.frames).collect()
        };
        assert_eq!(counts(&first), counts(&second));
    }

    #[test]
    fn an_older_revision_is_ignored() {
        let mut node = node(Options::default());
        node.apply(&desired(5, 1e-3));
        let is_status_due = node.apply(&desired(4, 1e-4));
        assert!(!is_status_due);
        assert_eq!(node.u(), 1e-3);
        assert_eq!(node.revision, 5);
    }

    #[test]
    fn a_status_is_due_after_the_first_message_of_a_revision() {
        let mut node = node(Options::default());
        let after_first = node.apply(&desired(5, 1e-3));
        let after_second = node.apply(&desired(5, 1e-3));
        assert!(after_first);
        assert!(!after_second);
    }

    #[test]
    fn a_value_out_of_range_is_refused_and_the_refusal_is_reported_once() {
        let mut node = node(Options::default());
        node.apply(&desired(5, 1e-3));
        let is_status_due = node.apply(&desired(6, 7.0));
        assert!(is_status_due);
        assert_eq!(node.u(), 1e-3);
        assert_eq!(node.revision, 5);
        let full = node.status(0).full.unwrap();
        assert_eq!(full.refused.unwrap().revision, 6);

        let is_status_due = node.apply(&desired(6, 7.0));
        assert!(!is_status_due);
        assert_eq!(node.status(0).full, None, "nothing has changed since");

        node.apply(&desired(7, 2e-3));
        let full = node.status(0).full.unwrap();
        assert_eq!(full.refused, None);
    }

    #[test]
    fn a_report_has_the_threshold_in_force_when_its_clip_was_made() {
        let mut node = node(Options {
            backlog: 3,
            ..Options::default()
        });
        node.apply(&desired(1, 1e-2));
        node.made += 2;
        let batch = node.batch(10, 0).unwrap();
        let values = batch.reports.iter().map(|report| report.threshold.unwrap().value);
        let expected = [FIRST_U, FIRST_U, FIRST_U, 1e-2, 1e-2];
        assert_eq!(values.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn the_states_of_a_report_count_each_of_its_frames_once() {
        let node = node(Options {
            backlog: 50,
            ..Options::default()
        });
        let batch = node.batch(50, 0).unwrap();
        for report in batch.reports {
            assert_eq!(report.states.frames(), report.frames);
        }
    }

    #[test]
    fn nodes_start_at_every_point_of_a_batch_and_no_clip_is_in_the_future() {
        let started = 1_000_000_000_000_000_000;
        let options = Arc::new(Options {
            gather: 8,
            seed: 1,
            ..Options::default()
        });
        let mut waiting = BTreeSet::new();
        for index in 0..100 {
            let node = SimNode::new(index, &options, started);
            waiting.insert(node.waiting());
            if let Some(batch) = node.batch(10, started) {
                for report in &batch.reports {
                    assert!(report.started_ns < started);
                }
            }
        }
        assert_eq!(waiting, (0..8).collect());
    }

    proptest! {
        #[test]
        fn every_report_is_sent_under_one_id_until_it_is_acknowledged(steps in prop::collection::vec((0u64..5, 1u64..8, any::<bool>()), 1..50)) {
            let mut node = node(Options::default());
            let mut id_of = BTreeMap::<u64, Uuid>::new();
            let mut acknowledged = 0;
            for (more, most, is_answered) in steps {
                node.made += more;
                if let Some(batch) = node.batch(most, 1_000_000_000_000_000_000) {
                    let reports = batch.reports.len() as u64;
                    for (count, report) in (acknowledged + 1..).zip(&batch.reports) {
                        prop_assert_eq!(report.count, Some(count));
                        let first_id = *id_of.entry(count).or_insert(report.id);
                        prop_assert_eq!(report.id, first_id);
                    }
                    if is_answered {
                        acknowledged += reports;
                        node.acknowledge(reports);
                    }
                }
                prop_assert_eq!(node.acknowledged, acknowledged);
                prop_assert!(acknowledged <= node.made);
            }
            let distinct: BTreeSet<&Uuid> = id_of.values().collect();
            prop_assert_eq!(distinct.len(), id_of.len(), "two reports under one id");
        }
    }
}
