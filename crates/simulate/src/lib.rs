//! Simulates a fleet of nodes for a hub over real Zenoh sessions: status, reports, and reactions to desired settings.
//! Reports what it sent and what was acknowledged.

mod error;
mod node;
mod options;
mod play;
mod random;
mod summary;
mod totals;
mod travel;

pub use error::SimulateError;
pub use options::Options;
pub use summary::Summary;
pub use totals::{Counts, DelaySummary};

use futures_util::stream::{self, StreamExt, TryStreamExt};
use node::SimNode;
use play::Player;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use totals::Totals;
use zenoh::Session;

/// The number of sessions opened concurrently.
const OPEN_AT_ONCE: usize = 64;
/// The time between two progress lines.
const PROGRESS_EVERY: Duration = Duration::from_secs(10);

/// The tasks of all nodes.
type Playing = JoinSet<Result<(), SimulateError>>;

/// Simulates the fleet until its time is over or `shutdown`. `progress` receives a line at intervals.
///
/// # Errors
/// [`SimulateError`] if the options are out of bounds or a session cannot be opened.
pub async fn run(
    options: Options,
    shutdown: CancellationToken,
    mut progress: impl FnMut(String),
) -> Result<Summary, SimulateError> {
    options.check().map_err(SimulateError)?;
    let options = Arc::new(options);
    let totals = Arc::new(Totals::default());
    progress(format!(
        "waiting for the hub or router at {}, however long it takes (sessions: {}); Ctrl-C ends the wait",
        options.connect, options.sessions
    ));
    let opening = Instant::now();
    let sessions = open_sessions(&options, &shutdown).await?;
    let opened_s = opening.elapsed().as_secs_f64();
    progress(format!(
        "{} sessions open after {opened_s:.1} s",
        sessions.len()
    ));

    let end = CancellationToken::new();
    let began = Instant::now();
    let mut playing = start_players(&options, &totals, &sessions, began, &end)?;

    let tell = || progress(progress_line(began, &totals));
    let until = began + options.duration;
    play_until(until, &shutdown, &mut playing, tell).await?;
    let played_s = began.elapsed().as_secs_f64();
    end.cancel();
    let draining = Instant::now();
    // What is not acknowledged by then is given up.
    if let Ok(ended) = tokio::time::timeout(options.drain, all_ended(&mut playing)).await {
        ended?;
    }
    let drained_s = draining.elapsed().as_secs_f64();
    playing.shutdown().await;
    for session in sessions {
        if let Err(error) = session.close().await {
            tracing::debug!(%error, "session not closed");
        }
    }
    let counts = *totals.counts.lock();
    Ok(Summary {
        nodes: options.nodes,
        sessions: options.sessions,
        opened_s,
        played_s,
        drained_s,
        counts,
        answers: totals.answers.summary(),
    })
}

async fn open_sessions(
    options: &Options,
    shutdown: &CancellationToken,
) -> Result<Vec<Session>, SimulateError> {
    let opened = stream::iter(0..options.sessions)
        .map(|index| play::open(options, index))
        .buffer_unordered(OPEN_AT_ONCE)
        .try_collect();
    tokio::select! {
        sessions = opened => sessions,
        () = shutdown.cancelled() => {
            let reason = "stopped before all sessions were open".to_owned();
            Err(SimulateError(reason))
        }
    }
}

/// Starts all nodes, which take turns in the choice of a session.
fn start_players(
    options: &Arc<Options>,
    totals: &Arc<Totals>,
    sessions: &[Session],
    began: Instant,
    end: &CancellationToken,
) -> Result<Playing, SimulateError> {
    let started_ns = options::now_ns();
    let mut playing = Playing::new();
    for (index, session) in (0..options.nodes).zip(sessions.iter().cycle()) {
        let node = SimNode::new(index, options, started_ns);
        let player = Player::new(
            session.clone(),
            node,
            Arc::clone(options),
            Arc::clone(totals),
        )?;
        playing.spawn(player.play(began, end.clone()));
    }
    Ok(playing)
}

/// Lets the nodes play until that time or `shutdown`, and calls `tell` at intervals.
///
/// # Errors
/// As soon as a node fails.
async fn play_until(
    until: Instant,
    shutdown: &CancellationToken,
    playing: &mut Playing,
    mut tell: impl FnMut(),
) -> Result<(), SimulateError> {
    let mut every = tokio::time::interval(PROGRESS_EVERY);
    loop {
        tokio::select! {
            () = tokio::time::sleep_until(until) => return Ok(()),
            () = shutdown.cancelled() => return Ok(()),
            // Before the end, a node ends only if it has failed.
            ended = all_ended(playing) => return ended,
            _ = every.tick() => tell(),
        }
    }
}

/// Waits until every node has sent its remaining reports.
///
/// # Errors
/// As soon as one fails.
async fn all_ended(playing: &mut Playing) -> Result<(), SimulateError> {
    while let Some(ended) = playing.join_next().await {
        ended.map_err(SimulateError::at("a simulated session failed"))??;
    }
    Ok(())
}

/// Formats the counts so far as a line.
fn progress_line(began: Instant, totals: &Totals) -> String {
    let counts = *totals.counts.lock();
    let answers = totals.answers.summary();
    format!(
        "{:>5.0} s  {} status, {} made, {} acknowledged, {} busy, {} unanswered, p99 {:.0} ms",
        began.elapsed().as_secs_f64(),
        counts.statuses,
        counts.made,
        counts.acknowledged,
        counts.busy,
        counts.no_reply,
        answers.p99_ms,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_node_that_fails_ends_the_run_at_once() {
        let mut playing = Playing::new();
        playing.spawn(std::future::pending());
        playing.spawn(async { Err(SimulateError("no session".to_owned())) });
        let began = Instant::now();
        let until = began + Duration::from_secs(3600);
        let shutdown = CancellationToken::new();
        let ended = play_until(until, &shutdown, &mut playing, || ()).await;
        assert!(ended.unwrap_err().to_string().contains("no session"));
        assert_eq!(began.elapsed(), Duration::ZERO);
    }
}
