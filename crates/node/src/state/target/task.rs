//! Once a second: what was measured goes to the controller, and the knob's new value to the cameras.

use crate::state::board::{Board, Totals};
use albireo_core::audit::AuditSums;
use albireo_core::target::Measured;
use albireo_power::PowerHandle;
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

impl TargetTask {
    pub(crate) fn new(board: Arc<Board>, power: PowerHandle) -> Self {
        Self { board, power }
    }

    /// Steps until `shutdown`.
    pub(crate) async fn run(self, shutdown: CancellationToken) {
        let mut ticks = tokio::time::interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let (mut before, mut then) = (self.totals(), Instant::now());
        let mut steps = 0_u32;
        loop {
            tokio::select! {
                () = shutdown.cancelled() => break,
                _ = ticks.tick() => {}
            }
            let (totals, now) = (self.totals(), Instant::now());
            self.step(totals - before, now.saturating_duration_since(then));
            (before, then) = (totals, now);
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

    fn totals(&self) -> Totals {
        self.board.totals(&self.power.snapshot())
    }

    fn step(&self, since: Totals, time: Duration) {
        let mut audit = AuditSums::default();
        for camera in self.board.cameras() {
            audit.merge(&camera.take_audit());
        }
        // While no detector answers, the load says nothing of the knob: it stays where it is.
        if since.degraded > 0 && since.detector_us == 0 {
            return;
        }
        let measured = Measured {
            seconds: time.as_secs_f64(),
            frames: since.frames,
            skipped: since.skipped,
            watts: (since.covered_s > 0.0).then(|| since.joules / since.covered_s),
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::target::TargetConfig;
    use crate::state::target::tests::board;
    use albireo_core::target::Target;
    use albireo_wire::SettingSource;

    #[tokio::test]
    async fn an_outage_of_the_detector_moves_no_knob() {
        let board = board(None, "expected-loss:0.3", TargetConfig::default());
        board
            .set_target(Some(Target::SkipRate(0.5)), SettingSource::Local)
            .unwrap();
        let task = TargetTask::new(Arc::clone(&board), PowerHandle::none());
        // Seconds of ten frames: how many of them skipped the detector, and how many could not have it.
        let pass = |seconds, skipped, degraded| {
            let second = Totals {
                frames: 10,
                skipped,
                degraded,
                detector_us: 20_000 * (10 - skipped - degraded),
                ..Totals::default()
            };
            for _ in 0..seconds {
                task.step(second, Duration::from_secs(1));
            }
            board.cameras()[0].threshold().unwrap()
        };
        let before = pass(8, 2, 0);
        assert!(before > 0.3, "{before}");
        assert_eq!(pass(60, 2, 8), before);
        assert!(pass(8, 2, 0) > before);
    }
}
