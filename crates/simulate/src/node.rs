//! Simulates one node, its reports and its reactions to desired settings, without network or clock.

use super::options::Options;
use super::travel::travel;
use albireo_wire::{
    CameraState, CameraStatus, ClipEnd, ClipEnergy, ClipReport, Desired, DesiredSetting,
    DomainEnergy, DroppedFrames, EnergyQuality, FrameStates, HealthState, HealthStatus, Heartbeat,
    NodeStatus, NodeTarget, OutboxStatus, Percentiles, RefusedRevision, ReportBatch, SettingSource,
    StatusMessage, Target, TargetStatus, Threshold, VERSION,
};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;
use std::sync::Arc;
use uuid::{Builder, Uuid};

/// The initial value of every node.
pub(crate) const FIRST_U: f64 = 3e-4;
/// The node's only camera.
const CAMERA: &str = "front";
/// Frames per second.
const FRAMES_PER_S: f64 = 30.0;
/// The range of `u`, as in the policy.
const RANGE: std::ops::RangeInclusive<f64> = 1e-9..=1.0;
/// The range within which a target moves `u`.
const HELD_WITHIN: std::ops::RangeInclusive<f64> = 1.5e-4..=2e-3;
/// The skip rate at [`FIRST_U`].
const FIRST_SKIP: f64 = 0.55;
/// The increase of the skip rate per decade of `u`.
const SKIP_PER_DECADE: f64 = 0.2;
/// The power that a detector on every frame adds, watts.
const DETECTOR_WATTS: f64 = 9.0;

/// The share of frames that a node skips at this `u`, before what is its own and its clip's.
fn skip_rate(u: f64) -> f64 {
    FIRST_SKIP + SKIP_PER_DECADE * (u / FIRST_U).log10()
}

/// One simulated node. Its reports are computed from their numbers, so a backlog of hours uses no memory.
#[derive(Debug)]
pub(crate) struct SimNode {
    pub(crate) name: String,
    seed: u64,
    region: &'static str,
    started_ns: u64,
    options: Arc<Options>,
    /// Reports made, and reports that a hub has acknowledged.
    pub(crate) made: u64,
    pub(crate) acknowledged: u64,
    /// The revision in force.
    pub(crate) revision: u64,
    /// The values with the first report that used each, in order.
    values: Vec<(u64, f64)>,
    source: SettingSource,
    refused: Option<RefusedRevision>,
    /// The target it holds, with its status.
    target: Option<NodeTarget>,
    seq: u64,
    full_due: bool,
    /// Seconds between two heartbeats.
    pub(crate) heartbeat_s: f64,
}

impl SimNode {
    /// Creates node number `index` of a run that began at `began_ns`. Without a backlog it starts at a random point between
    /// two batches, like in a fleet that has run for long: otherwise nothing would be reported until the first batch is
    /// gathered.
    pub(crate) fn new(index: usize, options: &Arc<Options>, began_ns: u64) -> Self {
        let seed = mix(options.seed, index as u64);
        let made = match options.backlog {
            0 => mix(seed, 6) % options.gather.max(1),
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
            values: vec![(0, FIRST_U)],
            source: SettingSource::Configuration,
            refused: None,
            target: None,
            seq: 0,
            full_due: true,
            heartbeat_s: options.status_s.unwrap_or(30.0),
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
        (count > 0).then(|| ReportBatch {
            v: VERSION,
            node: self.name.clone(),
            t_ms: now_ns / 1_000_000,
            ages: Vec::new(),
            reports: (self.acknowledged..self.acknowledged + count)
                .map(|n| self.report(n))
                .collect(),
        })
    }

    /// Marks the oldest `reports` waiting reports as acknowledged.
    pub(crate) fn answered(&mut self, reports: u64) {
        self.acknowledged = (self.acknowledged + reports).min(self.made);
    }

    /// Applies a desired setting. Returns true if the status must be sent immediately.
    pub(crate) fn take(&mut self, desired: &Desired) -> bool {
        self.full_due |= desired.send_full_status;
        let wanted_s = desired.heartbeat_s.unwrap_or(30).into();
        self.heartbeat_s = self.options.status_s.unwrap_or(wanted_s);
        let refused_revision = self.refused.as_ref().map_or(0, |refused| refused.revision);
        if desired.revision <= self.revision.max(refused_revision) {
            return desired.send_full_status;
        }
        let refusal = match desired.setting {
            None => return desired.send_full_status,
            Some(DesiredSetting::Target(target)) => {
                self.target = target.map(|target| self.hold(target));
                None
            }
            Some(DesiredSetting::Threshold(wanted)) => match wanted.name.as_str() {
                "u" if RANGE.contains(&wanted.value) => {
                    self.source = SettingSource::Hub;
                    self.target = None;
                    self.values.push((self.made, wanted.value));
                    None
                }
                "u" => Some("`u` must be a number from 1e-9 to 1"),
                _ => Some("the threshold of the policy in use is `u`"),
            },
        };
        self.full_due = true;
        self.refused = refusal.map(|reason| RefusedRevision {
            revision: desired.revision,
            reason: reason.to_owned(),
        });
        if refusal.is_none() {
            self.revision = desired.revision;
        }
        true
    }

    /// Holds a target. The simulated street has a skip rate for each `u`, so the target is reached
    /// immediately, as if a controller had settled; there are no figures for power and recall.
    fn hold(&mut self, target: Target) -> NodeTarget {
        let (status, actual) = match target {
            Target::SkipRate(rate) => {
                let u = FIRST_U * 10_f64.powf((rate - FIRST_SKIP) / SKIP_PER_DECADE);
                let held = u.clamp(*HELD_WITHIN.start(), *HELD_WITHIN.end());
                self.values.push((self.made, held));
                let status = if u > held {
                    TargetStatus::CannotBeMet
                } else if u < held {
                    TargetStatus::MoreThanKept
                } else {
                    TargetStatus::Held
                };
                (status, Some(skip_rate(held)))
            }
            Target::Recall(_) => (TargetStatus::NoAudit, None),
            _ => (TargetStatus::NoPower, None),
        };
        NodeTarget {
            target,
            source: SettingSource::Hub,
            status: Some(status),
            actual,
        }
    }

    /// The value in force.
    pub(crate) fn u(&self) -> f64 {
        self.values.last().map_or(FIRST_U, |(_, u)| *u)
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
        let full = std::mem::take(&mut self.full_due).then(|| Box::new(self.full()));
        let seq = self.seq;
        self.seq += 1;
        StatusMessage {
            v: VERSION,
            run: mix(self.seed, 2) as u32,
            started_ns: self.started_ns,
            seq,
            t_ns: now_ns,
            health: HealthState::Ready,
            waiting: self.waiting(),
            revision: self.revision,
            full,
        }
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

    /// The energy quality to report; no figure comes from a meter.
    fn quality(&self) -> EnergyQuality {
        if self.options.measured {
            EnergyQuality::Measured
        } else {
            EnergyQuality::Estimated
        }
    }

    /// Report number `number`, from 0, drawn from the node's seed.
    fn report(&self, number: u64) -> ClipReport {
        let u = self
            .values
            .iter()
            .rev()
            .find(|(from, _)| *from <= number)
            .map_or(FIRST_U, |(_, u)| *u);
        let mut random = Pcg64Mcg::seed_from_u64(mix(self.seed, 1_000 + number));
        let mut noise = || normal(&mut random);
        let frames = (self.options.clip_s * FRAMES_PER_S).round().max(1.0);
        // A factor of ten in `u` changes a fifth of the frames; nodes and clips differ.
        let own = 0.08 * normal(&mut Pcg64Mcg::seed_from_u64(mix(self.seed, 5)));
        let skip = (skip_rate(u) + own + 0.03 * noise()).clamp(0.0, 0.99);
        let is_worse = self.options.worse_above.is_some_and(|limit| u > limit);
        let worse = if is_worse { self.options.worse_by } else { 1.0 };
        let watts = 6.0 + DETECTOR_WATTS * (1.0 - skip) + 0.2 * noise();
        let joules = (watts * worse * self.options.clip_s).max(0.1);
        let p99 = (28.0 * worse + noise()).max(1.0);
        let skipped = (skip * frames).round() as u64;
        let detected = frames as u64 - skipped;
        let states = FrameStates {
            e: skipped / 5,
            p: skipped - skipped / 5,
            ei: detected / 20,
            i: detected - detected / 20,
            ai: 0,
        };
        let latency = |middle: f64, count: u64| Percentiles {
            count,
            mean: middle * 1.05,
            p50: middle,
            p95: middle * 1.6,
            p99,
        };
        let started = self.started_ns + (number as f64 * self.options.clip_s * 1e9) as u64;
        ClipReport {
            v: VERSION,
            id: self.report_id(number, started),
            count: Some(number + 1),
            node: self.name.clone(),
            camera: CAMERA.to_owned(),
            clip: format!("window-{number}"),
            part: 0,
            ended_by: ClipEnd::Window,
            started_ns: started,
            duration_s: self.options.clip_s,
            frames: frames as u64,
            skip_rate: states.skip_rate(0),
            states,
            degraded_frames: 0,
            dropped: DroppedFrames::default(),
            policy: "albireo".to_owned(),
            threshold: Some(Threshold::new("u", u)),
            target: None,
            threshold_changes: vec![albireo_wire::ThresholdChange {
                seq: number * frames as u64,
                threshold: Threshold::new("u", u),
            }],
            model: "simulated".to_owned(),
            provider: "simulated".to_owned(),
            total_latency_ms: latency(4.0, frames as u64),
            detector_latency_ms: latency(18.0, detected),
            detector_used_ms: 18.0 * detected as f64,
            energy: self.energy(joules, DETECTOR_WATTS * skip * worse, frames),
            board: None,
            audit: None,
            travel: self.options.positions.then(|| travel(self.seed, number, self.options.clip_s)),
        }
    }

    /// The energy of a clip of `frames` that used `joules` and saved so many watts.
    fn energy(&self, joules: f64, saved_watts: f64, frames: f64) -> ClipEnergy {
        let seconds = self.options.clip_s;
        ClipEnergy {
            joules: Some(joules),
            node_joules: Some(joules),
            saved_joules_estimated: Some(saved_watts * seconds),
            edp: Some(joules * seconds * 1e3 / frames),
            quality: self.quality(),
            source: "simulated".to_owned(),
            total_from: "simulated".to_owned(),
            samples: (seconds * 10.0) as u64,
            coverage: 1.0,
            domains: vec![DomainEnergy {
                domain: "total".to_owned(),
                joules,
                mean_watts: joules / seconds,
                peak_watts: Some(joules / seconds * 1.3),
            }],
        }
    }

    /// The id of the report of a clip that began at `started_ns`, drawn from the node's seed and the clip's time.
    fn report_id(&self, number: u64, started_ns: u64) -> Uuid {
        let drawn = mix(self.seed, 2_000_000 + number).to_le_bytes();
        let mut random = [0; 10];
        random[..8].copy_from_slice(&drawn);
        let made_ms = (started_ns as f64 / 1e6 + self.options.clip_s * 1e3) as u64;
        Builder::from_unix_timestamp_millis(made_ms, &random).into_uuid()
    }
}

/// Mixes two numbers to one (splitmix64's finalizer).
pub(crate) const fn mix(a: u64, b: u64) -> u64 {
    let mut z = a ^ b.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Maps a hash to a number from 0 to 1.
pub(crate) fn unit(hash: u64) -> f64 {
    (hash >> 11) as f64 / (1u64 << 53) as f64
}

/// An approximately normal number: the sum of twelve uniform numbers, less six.
fn normal(random: &mut Pcg64Mcg) -> f64 {
    (0..12).map(|_| unit(random.next_u64())).sum::<f64>() - 6.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

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
    fn an_older_revision_is_ignored_and_a_rejection_is_reported_once() {
        let mut node = node(Options::default());
        assert!(node.take(&desired(5, 1e-3)));
        assert!(!node.take(&desired(5, 1e-3)) && !node.take(&desired(4, 1e-4)));
        assert_eq!((node.u(), node.revision), (1e-3, 5));
        assert!(node.take(&desired(6, 7.0)));
        assert_eq!((node.u(), node.revision), (1e-3, 5));
        let full = node.status(0).full.unwrap();
        assert_eq!(full.refused.unwrap().revision, 6);
        assert!(!node.take(&desired(6, 7.0)));
        assert_eq!(node.status(0).full, None, "nothing has changed since");
        assert!(node.take(&desired(7, 2e-3)));
        assert_eq!(node.status(0).full.unwrap().refused, None);
    }

    #[test]
    fn a_report_has_the_threshold_in_force_when_its_clip_was_made() {
        let mut node = node(Options {
            backlog: 3,
            ..Options::default()
        });
        node.take(&desired(1, 1e-2));
        node.made += 2;
        let batch = node.batch(10, 0).unwrap();
        let values = batch.reports.iter().map(|r| r.threshold.unwrap().value);
        let expected = [FIRST_U, FIRST_U, FIRST_U, 1e-2, 1e-2];
        assert_eq!(values.collect::<Vec<_>>(), expected);
        assert!(batch.reports.iter().all(|r| r.states.frames() == r.frames));
    }

    #[test]
    fn nodes_start_at_every_point_of_a_batch_and_no_clip_is_in_the_future() {
        let started = 1_000_000_000_000_000_000;
        let options = Arc::new(Options {
            gather: 8,
            ..Options::default()
        });
        let mut waiting = BTreeSet::new();
        for index in 0..100 {
            let node = SimNode::new(index, &options, started);
            waiting.insert(node.waiting());
            let batch = node.batch(10, started);
            let mut reports = batch.iter().flat_map(|batch| &batch.reports);
            assert!(reports.all(|report| report.started_ns < started));
        }
        assert_eq!(waiting, (0..8).collect());
    }

    proptest! {
        #[test]
        fn every_report_is_sent_under_one_id_until_it_is_acknowledged(steps in prop::collection::vec((0u64..5, 1u64..8, any::<bool>()), 1..50)) {
            let mut node = node(Options::default());
            let mut sent = BTreeSet::new();
            let mut acknowledged = 0;
            for (more, most, answered) in steps {
                node.made += more;
                if let Some(batch) = node.batch(most, 1_000_000_000_000_000_000) {
                    let counts: Vec<_> = batch.reports.iter().filter_map(|report| report.count).collect();
                    let wanted: Vec<_> = (acknowledged + 1..).take(counts.len()).collect();
                    prop_assert_eq!(&counts, &wanted);
                    sent.extend(batch.reports.iter().map(|report| report.id));
                    if answered {
                        acknowledged += counts.len() as u64;
                        node.answered(counts.len() as u64);
                    }
                    prop_assert!(node.acknowledged == acknowledged && acknowledged <= node.made);
                }
            }
            prop_assert!(sent.len() as u64 >= acknowledged && sent.len() as u64 <= node.made);
        }
    }
}
