//! Computes the reports of a simulated node from their numbers.

use super::{CAMERA, DRAW_ID, DRAW_OWN_SKIP, DRAW_REPORT, SimNode, skip_rate};
use crate::random::{mix, normal};
use crate::travel::travel;
use albireo_wire::{
    ClipEnd, ClipEnergy, ClipReport, DomainEnergy, DroppedFrames, FrameStates, Percentiles,
    Threshold, ThresholdChange, VERSION,
};
use rand_core::SeedableRng;
use rand_pcg::Pcg64Mcg;
use uuid::{Builder, Uuid};

/// Frames per second.
const FRAMES_PER_S: f64 = 30.0;
/// The power that a detector on every frame adds, watts.
const DETECTOR_WATTS: f64 = 9.0;
/// The power of the rest of the node, watts.
const OTHER_WATTS: f64 = 6.0;
/// Median latencies of a frame and of the detector, milliseconds.
const TOTAL_MS: f64 = 4.0;
const DETECTOR_MS: f64 = 18.0;

/// What is random in a clip.
struct Drawn {
    skip_rate: f64,
    joules: f64,
    /// The power that the detector would have added on the skipped frames.
    saved_watts: f64,
    p99_ms: f64,
}

impl SimNode {
    /// What report number `number` says of a clip at this `u`. The deviations are plausible, and fitted to nothing.
    fn draw(&self, number: u64, u: f64) -> Drawn {
        let mut of_clip = Pcg64Mcg::seed_from_u64(mix(self.seed, DRAW_REPORT + number));
        let mut noise = || normal(&mut of_clip);
        let mut of_node = Pcg64Mcg::seed_from_u64(mix(self.seed, DRAW_OWN_SKIP));
        // Nodes differ more than the clips of one node.
        let own = 0.08 * normal(&mut of_node);
        let skip_rate = (skip_rate(u) + own + 0.03 * noise()).clamp(0.0, 0.99);
        let is_worse = self.options.worse_above.is_some_and(|limit| u > limit);
        let worse = if is_worse { self.options.worse_by } else { 1.0 };
        let watts = OTHER_WATTS + DETECTOR_WATTS * (1.0 - skip_rate) + 0.2 * noise();
        Drawn {
            skip_rate,
            joules: (watts * worse * self.options.clip_s).max(0.1),
            saved_watts: DETECTOR_WATTS * skip_rate * worse,
            p99_ms: (28.0 * worse + noise()).max(1.0),
        }
    }

    /// Report number `number`, from 0, drawn from the node's seed.
    pub(super) fn report(&self, number: u64) -> ClipReport {
        let u = self.u_of(number);
        let frames = (self.options.clip_s * FRAMES_PER_S).round().max(1.0);
        let drawn = self.draw(number, u);
        let skipped = (drawn.skip_rate * frames).round() as u64;
        let detected = frames as u64 - skipped;
        let states = FrameStates {
            e: skipped / 5,
            p: skipped - skipped / 5,
            ei: detected / 20,
            i: detected - detected / 20,
            ai: 0,
        };
        let latency = |median_ms: f64, count: u64| Percentiles {
            count,
            mean: median_ms * 1.05,
            p50: median_ms,
            p95: median_ms * 1.3,
            // Not below the others, also with a threshold that makes frames faster.
            p99: drawn.p99_ms.max(median_ms * 1.5),
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
            threshold_changes: vec![ThresholdChange {
                seq: number * frames as u64,
                threshold: Threshold::new("u", u),
            }],
            model: "simulated".to_owned(),
            provider: "simulated".to_owned(),
            total_latency_ms: latency(TOTAL_MS, frames as u64),
            detector_latency_ms: latency(DETECTOR_MS, detected),
            detector_used_ms: DETECTOR_MS * detected as f64,
            energy: self.energy(drawn.joules, drawn.saved_watts, frames),
            board: None,
            audit: None,
            travel: self.options.positions.then(|| travel(self.seed, number, self.options.clip_s)),
        }
    }

    /// The energy of a clip of `frames` frames that used `joules` and saved so many watts.
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
        let drawn = mix(self.seed, DRAW_ID + number).to_le_bytes();
        let mut random = [0; 10];
        random[..8].copy_from_slice(&drawn);
        let made_ms = (started_ns as f64 / 1e6 + self.options.clip_s * 1e3) as u64;
        Builder::from_unix_timestamp_millis(made_ms, &random).into_uuid()
    }
}
