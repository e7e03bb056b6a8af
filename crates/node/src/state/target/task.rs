//! Once a second: what was measured goes to the controller, and the knob's new value to the cameras.

use crate::state::board::Board;
use albireo_core::audit::AuditSums;
use albireo_core::target::Measured;
use albireo_power::{Domain, PowerHandle};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Time between two steps.
const PERIOD: Duration = Duration::from_secs(1);

/// Time after which the knob's value is kept for a restart.
const KEEP_EVERY: u32 = 60;

/// A knob that is off by less than this share stays: every change is told and noted in the clip's report.
const LEAST_CHANGE: f64 = 0.02;

/// Holds the target of a node.
pub(crate) struct TargetTask {
    board: Arc<Board>,
    power: PowerHandle,
}

/// Sums since the node started.
#[derive(Clone, Copy)]
struct SoFar {
    at: Instant,
    frames: u64,
    skipped: u64,
    detector_us: u64,
    /// Joules, and the seconds that they are of.
    power: Option<(f64, f64)>,
}

impl TargetTask {
    pub(crate) fn new(board: Arc<Board>, power: PowerHandle) -> Self {
        Self { board, power }
    }

    /// Steps until `shutdown`.
    pub(crate) async fn run(&self, shutdown: CancellationToken) {
        let mut ticks = tokio::time::interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let (mut before, _) = self.so_far();
        let mut steps = 0_u32;
        loop {
            tokio::select! {
                () = shutdown.cancelled() => break,
                _ = ticks.tick() => {}
            }
            let (now, audit) = self.so_far();
            self.step(&before, &now, audit);
            before = now;
            steps = steps.wrapping_add(1);
            if steps.is_multiple_of(KEEP_EVERY) {
                self.keep_place().await;
            }
        }
        self.keep_place().await;
    }

    async fn keep_place(&self) {
        let board = Arc::clone(&self.board);
        if board.target().is_on() {
            // It writes a file.
            let _ = tokio::task::spawn_blocking(move || board.target().keep_place()).await;
        }
    }

    fn step(&self, before: &SoFar, now: &SoFar, audit: AuditSums) {
        let measured = Measured {
            seconds: now.at.saturating_duration_since(before.at).as_secs_f64(),
            frames: now.frames.saturating_sub(before.frames),
            skipped: now.skipped.saturating_sub(before.skipped),
            detector_ms: now.detector_us.saturating_sub(before.detector_us) as f64 / 1e3,
            watts: (now.power.zip(before.power)).and_then(|((to, to_s), (from, from_s))| {
                (to_s > from_s).then(|| (to - from) / (to_s - from_s))
            }),
            audit,
        };
        self.board.target().step(&measured, |value| {
            for camera in self.board.cameras() {
                let near = camera
                    .threshold()
                    .is_some_and(|there| (value / there).ln().abs() < LEAST_CHANGE);
                if !near {
                    camera.move_threshold(value);
                }
            }
        });
    }

    fn so_far(&self) -> (SoFar, AuditSums) {
        let mut so_far = SoFar {
            at: Instant::now(),
            frames: 0,
            skipped: 0,
            detector_us: 0,
            power: (self.power.so_far().iter())
                .find(|sum| sum.domain == Domain::Total)
                .map(|sum| (sum.joules, sum.covered_s)),
        };
        let mut audit = AuditSums::default();
        for camera in self.board.cameras() {
            let work = camera.take_work();
            so_far.frames += work.frames;
            so_far.skipped += work.skipped;
            so_far.detector_us += work.detector_us;
            audit.merge(&work.audit);
        }
        (so_far, audit)
    }
}
