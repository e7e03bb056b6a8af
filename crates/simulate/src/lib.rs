//! Plays a fleet of nodes to a hub over real Zenoh sessions: status, reports with their cursors, reactions to what is
//! desired. It reports what it sent, what was acknowledged, and what it and other processes cost.

mod cost;
mod error;
mod node;
mod options;
mod session;
mod summary;
mod totals;

pub use cost::ProcessCost;
pub use error::SimulateError;
pub use options::{Behaviour, LONGEST, MOST_NODES, Options};
pub use summary::Summary;
pub use totals::DelaySummary;

use cost::Process;
use node::SimNode;
use session::Player;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use totals::{Totals, read};

/// Sessions that are opened at the same time.
const OPEN_AT_ONCE: usize = 64;
/// Time between two lines of progress.
const PROGRESS_EVERY: Duration = Duration::from_secs(10);

/// Plays the fleet until its time is over or `shutdown`. `progress` gets a line from time to time.
///
/// # Errors
/// When the options are out of bounds or a session cannot be opened.
pub async fn run(
    options: Options,
    shutdown: CancellationToken,
    mut progress: impl FnMut(String),
) -> Result<Summary, SimulateError> {
    options.check().map_err(SimulateError::Options)?;
    let options = Arc::new(options);
    let totals = Arc::new(Totals::default());
    let opening = Instant::now();
    let players = tokio::select! {
        players = open_all(&options, &totals) => players?,
        () = shutdown.cancelled() => return Err(SimulateError::Stopped),
    };
    let opened_s = opening.elapsed().as_secs_f64();
    progress(format!(
        "{} sessions open after {opened_s:.1} s",
        players.len()
    ));

    let mut processes = vec![Process::new("simulator", std::process::id())];
    processes.extend(
        options
            .watch
            .iter()
            .map(|(name, pid)| Process::new(name, *pid)),
    );
    processes.iter_mut().for_each(Process::begin);
    let (end, stop) = (CancellationToken::new(), CancellationToken::new());
    let began = Instant::now();
    let mut playing = JoinSet::new();
    for player in players {
        playing.spawn(player.play(began, end.clone(), stop.clone()));
    }

    let mut every = tokio::time::interval(PROGRESS_EVERY);
    let until = began + options.duration;
    loop {
        tokio::select! {
            () = tokio::time::sleep_until(until) => break,
            () = shutdown.cancelled() => break,
            _ = every.tick() => progress(line(began, &totals, &mut processes)),
        }
    }
    let played_s = began.elapsed().as_secs_f64();
    // What the drain costs is not what the load costs.
    for process in &mut processes {
        process.sample();
    }
    let costs = processes.iter().map(Process::cost).collect();
    end.cancel();
    let draining = Instant::now();
    let stopper = stop.clone();
    let drain = options.drain;
    tokio::spawn(async move {
        tokio::time::sleep(drain).await;
        stopper.cancel();
    });
    let (mut made, mut acknowledged) = (0, 0);
    while let Some(ended) = playing.join_next().await {
        let (more, of_them) = ended?;
        made += more;
        acknowledged += of_them;
    }
    Ok(Summary {
        nodes: options.nodes,
        sessions: options.sessions,
        opened_s,
        played_s,
        drained_s: draining.elapsed().as_secs_f64(),
        made,
        acknowledged,
        statuses: read(&totals.statuses),
        batches: read(&totals.batches),
        batch_bytes: read(&totals.bytes),
        pulls: read(&totals.pulls),
        busy: read(&totals.busy),
        refused: read(&totals.refused),
        no_reply: read(&totals.no_reply),
        answers: totals.answers.summary(),
        settled: totals.settled.summary(),
        costs,
    })
}

/// Opens every session, a few at a time, with its share of the nodes.
async fn open_all(
    options: &Arc<Options>,
    totals: &Arc<Totals>,
) -> Result<Vec<Player>, SimulateError> {
    let started_ns = session::now_ns();
    let places = Arc::new(Semaphore::new(OPEN_AT_ONCE));
    let mut opening = JoinSet::new();
    for index in 0..options.sessions {
        let (options, totals, places) =
            (Arc::clone(options), Arc::clone(totals), Arc::clone(&places));
        opening.spawn(async move {
            // Never closed, so there is always a place in the end.
            let _place = places.acquire_owned().await;
            let session = session::open(&options, index).await?;
            let nodes = (index..options.nodes).step_by(options.sessions);
            let nodes = nodes
                .map(|node| {
                    let mut node = SimNode::new(node, &options, started_ns);
                    if options.backlog == 0 {
                        node.begin_within(options.gather);
                    }
                    node
                })
                .collect();
            Player::new(session, nodes, options, totals).await
        });
    }
    let mut players = Vec::with_capacity(options.sessions);
    while let Some(opened) = opening.join_next().await {
        players.push(opened??);
    }
    Ok(players)
}

fn line(began: Instant, totals: &Totals, processes: &mut [Process]) -> String {
    let answers = totals.answers.summary();
    let mut text = format!(
        "{:>5.0} s  {} status, {} made, {} acknowledged, {} busy, {} unanswered, p99 {:.0} ms",
        began.elapsed().as_secs_f64(),
        read(&totals.statuses),
        read(&totals.made),
        read(&totals.acknowledged),
        read(&totals.busy),
        read(&totals.no_reply),
        answers.p99_ms,
    );
    for process in processes {
        process.sample();
        text += &format!("; {}", process.cost());
    }
    text
}
