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

/// A knob that is off by less than this share stays: every change is announced and noted in the clip's report.
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
    degraded: u64,
    detector_us: u64,
    /// Joules, and the seconds that they are of.
    power: Option<(f64, f64)>,
}

impl TargetTask {
    pub(crate) fn new(board: Arc<Board>, power: PowerHandle) -> Self {
        Self { board, power }
    }

    /// Steps until `shutdown`.
    pub(crate) async fn run(self, shutdown: CancellationToken) {
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
        // While no detector answers, the load says nothing of the knob: it stays where it is.
        if now.degraded > before.degraded && now.detector_us == before.detector_us {
            return;
        }
        let measured = Measured {
            seconds: now.at.saturating_duration_since(before.at).as_secs_f64(),
            frames: now.frames.saturating_sub(before.frames),
            skipped: now.skipped.saturating_sub(before.skipped),
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
        let power = self.power.snapshot();
        let total = Domain::Total.as_str();
        let mut so_far = SoFar {
            at: Instant::now(),
            frames: 0,
            skipped: 0,
            degraded: 0,
            detector_us: 0,
            power: (power.joules.get(total).copied()).zip(power.covered_s.get(total).copied()),
        };
        let mut audit = AuditSums::default();
        for camera in self.board.cameras() {
            let work = camera.take_work();
            so_far.frames += work.frames;
            so_far.skipped += work.skipped;
            so_far.degraded += work.degraded;
            so_far.detector_us += work.detector_us;
            audit.merge(&work.audit);
        }
        (so_far, audit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::target::TargetConfig;
    use crate::state::target::tests::board;
    use albireo_core::target::Target;
    use albireo_wire::SettingSource;

    /// A second of ten frames: how many of them skipped the detector, and how many could not have it.
    fn second(before: SoFar, skipped: u64, degraded: u64) -> SoFar {
        SoFar {
            at: before.at + Duration::from_secs(1),
            frames: before.frames + 10,
            skipped: before.skipped + skipped,
            degraded: before.degraded + degraded,
            detector_us: before.detector_us + 20_000 * (10 - skipped - degraded),
            power: None,
        }
    }

    #[tokio::test]
    async fn an_outage_of_the_detector_moves_no_knob() {
        let board = board(None, "expected-loss:0.3", TargetConfig::default());
        board
            .set_target(Some(Target::SkipRate(0.5)), SettingSource::Local)
            .unwrap();
        let task = TargetTask::new(Arc::clone(&board), PowerHandle::none());
        let (mut now, _) = task.so_far();
        let mut pass = |seconds, skipped, degraded| {
            for _ in 0..seconds {
                let before = now;
                now = second(before, skipped, degraded);
                task.step(&before, &now, AuditSums::default());
            }
            board.cameras()[0].threshold().unwrap()
        };
        let before = pass(8, 2, 0);
        assert!(before > 0.3, "{before}");
        assert_eq!(pass(60, 2, 8), before);
        assert!(pass(8, 2, 0) > before);
    }
}
