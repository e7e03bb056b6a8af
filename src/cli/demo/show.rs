//! Prints the demonstration's output: addresses, a live line, a line for every clip, and a summary.

use crate::cli::terminal::program;
use crate::cli::values::counted;
use albireo_node::config::NodeConfig;
use albireo_node::state::board::{Board, Event, News};
use albireo_wire::{ClipEnergy, ClipReport, DetectionsMessage, EnergyQuality, FrameStates};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::BTreeMap;
use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio_util::sync::CancellationToken;

/// Longest wait for the last clip's report after the end.
const LAST_REPORT: Duration = Duration::from_secs(3);

/// Follows a node's board and prints.
pub(super) struct Show {
    board: Arc<Board>,
    events: Receiver<Arc<Event>>,
    shutdown: CancellationToken,
    started: Instant,
    has_heading: bool,
    bar: ProgressBar,
}

/// The reports of all clips.
#[derive(Debug, Default)]
pub(super) struct Summary {
    seconds: f64,
    reports: Vec<Arc<ClipReport>>,
}

impl Show {
    pub(super) fn new(board: &Arc<Board>, shutdown: CancellationToken) -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout());
        if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
            bar.set_style(style);
        }
        Self {
            board: Arc::clone(board),
            events: board.subscribe(),
            shutdown,
            started: Instant::now(),
            has_heading: false,
            bar,
        }
    }

    /// The addresses of node and hub, what was `moved` from its port and why, how to query them, and what the columns of the
    /// table mean.
    pub(super) fn banner(
        &self,
        config: &NodeConfig,
        page: SocketAddr,
        hub_page: SocketAddr,
        moved: &[String],
    ) -> String {
        let model = config.detector.model.display();
        let mut lines = vec![format!("albireo demo: a recorded road -> Zenoh -> {model}")];
        lines.extend(moved.iter().map(|moved| format!("  {moved}")));
        lines.push(format!("  page     http://{page}/"));
        lines.push(format!("  counters curl http://{page}/api/v1/frame-states"));
        let camera = self.board.cameras.first();
        if let Some(spec) = camera.and_then(|camera| camera.threshold_spec()) {
            // Twice the default, so that the difference is visible.
            let value = (2.0 * spec.default).min(spec.maximum);
            let body = serde_json::json!({ spec.name: value });
            lines.push(format!(
                "  tune it  curl -X PUT http://{page}/api/v1/threshold -d '{body}'"
            ));
        }
        if self.board.can_pause() {
            lines.push(format!(
                "  pause    curl -X PUT http://{page}/api/v1/screen -d '{{\"pause_s\": 0.2}}'"
            ));
            lines.push(
                "           on the empty road every fifth frame is looked at: 564 calls a round,\n           not 827"
                    .to_owned(),
            );
        }
        lines.push(format!(
            "  policy   curl -X PUT http://{page}/api/v1/policy \\\n             -d '{{\"name\": \"expected-loss\"}}'"
        ));
        lines.push(format!("  fleet's page  http://{hub_page}/"));
        lines.push(format!("  hub      curl http://{hub_page}/api/v1/clips"));
        lines.push(format!(
            "  fleet    {} fleet --hub http://{hub_page} ls",
            program()
        ));
        lines.push(LEGEND.to_owned());
        lines.join("\n")
    }

    /// Prints until the shutdown and the last clip's report.
    pub(super) async fn run(mut self) -> Summary {
        let mut summary = Summary::default();
        let shutdown = self.shutdown.clone();
        let end = async {
            shutdown.cancelled().await;
            tokio::time::sleep(LAST_REPORT).await;
        };
        tokio::pin!(end);
        loop {
            let event = tokio::select! {
                biased;
                event = self.events.recv() => event,
                () = &mut end => break,
            };
            match event.as_ref().map(|event| &event.news) {
                Ok(News::Frame(frame)) => {
                    if !self.has_heading && !frame.detections.boxes.is_empty() {
                        let seconds = self.started.elapsed().as_secs_f64();
                        self.say(&format!("first detection after {seconds:.1} s"));
                        self.heading();
                    }
                    summary.seconds = self.started.elapsed().as_secs_f64();
                    self.bar.set_message(live_line(&self.board, &frame.detections));
                    self.bar.tick();
                }
                Ok(News::Clip(report)) => {
                    self.heading();
                    self.say(&clip_line(report));
                    summary.reports.push(Arc::clone(report));
                    if shutdown.is_cancelled() {
                        break;
                    }
                }
                Ok(_) | Err(RecvError::Lagged(_)) => {}
                Err(RecvError::Closed) => break,
            }
        }
        self.bar.finish_and_clear();
        summary
    }

    /// Prints the heading of the clips' table once.
    fn heading(&mut self) {
        if !self.has_heading {
            self.has_heading = true;
            self.say(&format!("\n{}", row(HEADING.map(str::to_owned))));
        }
    }

    fn say(&self, line: &str) {
        self.bar.suspend(|| print(line, &self.shutdown));
    }
}

/// Prints a line. Where nobody reads on, as behind `head`, the demonstration ends.
pub(super) fn print(line: &str, shutdown: &CancellationToken) {
    if writeln!(std::io::stdout(), "{line}").is_err() {
        shutdown.cancel();
    }
}

/// Without the states of a screen, which the demonstration does not have.
const HEADING: [&str; 9] = [
    "clip", "policy", "frames", "P", "I", "AI", "skip", "J", "J·ms",
];

/// What the table's columns are.
const LEGEND: &str = "\
P predicted, I by the detector, AI the same with an object that it missed;
J energy, J·ms energy times time per frame; * estimated (no meter), + partly";

/// Formats the current frame as one line.
fn live_line(board: &Board, message: &DetectionsMessage) -> String {
    let mut classes = BTreeMap::<&str, u32>::new();
    for found in &message.boxes {
        *classes.entry(&found.class).or_default() += 1;
    }
    let objects: Vec<_> = classes.iter().map(|(class, count)| format!("{count} {class}")).collect();
    let skip_rate = board.cameras.first().map_or(0.0, |camera| camera.snapshot().skip_rate());
    let threshold =
        message.threshold.map_or_else(String::new, |threshold| format!("  {threshold}"));
    let line = format!(
        "frame {:>5}  {:<3} {:>5.1} ms{threshold}  skip {:>4.1} %  {}",
        message.seq,
        message.state,
        message.latency_ms.total,
        skip_rate * 100.0,
        objects.join(", ")
    );
    // The line must fit an 80-column terminal beside the spinner.
    line.chars().take(77).collect()
}

/// Formats a row of the table of clips, 80 columns wide.
fn row([clip, policy, frames, p, i, ai, skip, joules, edp]: [String; 9]) -> String {
    format!(
        "{clip:<19} {policy:<13} {frames:>6} {p:>4} {i:>4} {ai:>4} {skip:>6} {joules:>7} {edp:>9}"
    )
}

/// Formats a clip's row under [`HEADING`].
fn clip_line(report: &ClipReport) -> String {
    let states = &report.states;
    let mark = mark(&report.energy);
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or_else(
            || "-".to_owned(),
            |value| format!("{value:.decimals$}{mark}"),
        )
    };
    row([
        report.clip.clone(),
        report.policy.clone(),
        report.frames.to_string(),
        states.p.to_string(),
        states.i.to_string(),
        states.ai.to_string(),
        format!("{:.1}%", report.skip_rate * 100.0),
        number(report.energy.joules, 1),
        number(report.energy.edp, 0),
    ])
}

/// Returns the mark for energy that no meter has measured, or that does not cover the whole clip.
fn mark(energy: &ClipEnergy) -> &'static str {
    match (energy.quality, energy.is_whole()) {
        (EnergyQuality::Estimated, true) => "*",
        (EnergyQuality::Estimated, false) => "*+",
        (EnergyQuality::Partial, _) => "+",
        (EnergyQuality::Measured | EnergyQuality::Unavailable, _) => "",
    }
}

impl Summary {
    pub(super) fn print(&self) {
        let mut states = FrameStates::default();
        let mut degraded = 0;
        let mut dropped = 0;
        let mut joules = 0.0;
        let mut is_whole = true;
        for report in &self.reports {
            states += report.states;
            degraded += report.degraded_frames;
            dropped += report.dropped.total();
            joules += report.energy.joules.unwrap_or(0.0);
            is_whole &= report.energy.is_whole();
        }
        let frames = states.frames();
        println!(
            "\n{} in {}, {:.0} s; detector skipped on {:.1} % ({} of {frames}), dropped {dropped}",
            counted(frames, "frame", "frames"),
            counted(self.reports.len() as u64, "clip", "clips"),
            self.seconds,
            states.skip_rate(degraded) * 100.0,
            states.skipped(degraded),
        );
        let last = self.reports.last();
        let source = last.map_or("", |last| last.energy.source.as_str());
        let gaps = if is_whole {
            ""
        } else {
            ", without the time that no sample covers (+)"
        };
        // The sum has the quality of its worst part.
        match self.reports.iter().map(|report| report.energy.quality).max() {
            Some(EnergyQuality::Measured | EnergyQuality::Partial) => {
                println!("energy {joules:.1} J, measured by {source}{gaps}");
            }
            Some(EnergyQuality::Estimated) => println!(
                "energy {joules:.1} J: estimated from utilisation (*), without a power meter{gaps}"
            ),
            Some(EnergyQuality::Unavailable) | None => println!("energy not known: no source"),
        }
    }
}
