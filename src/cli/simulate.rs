//! `albireo simulate`: plays a fleet of nodes to a hub.

use albireo_service::signals;
use albireo_simulate::{Behaviour, Options};
use anyhow::{Context, bail};
use std::path::PathBuf;
use std::time::Duration;

const EXAMPLES: &str = "\
The nodes are real to a hub: status, reports, pulls and
notices go over real Zenoh sessions. Their pictures, energy and latencies are
made up, and say so (`simulated`). Only endpoints of this machine are connected
to. Exit code 1 when a report was not acknowledged in the end.

Examples:
  albireo simulate
      100 nodes on 4 sessions for a minute
  albireo simulate --nodes 10000 --sessions 50 --seconds 300 --pid hub=4711 \\
      --pid router=4712
      the load of 10,000 nodes for five minutes, and what hub and router cost
      meanwhile
  albireo simulate --nodes 40 --clip-seconds 1 --status-seconds 2 --gather 1 \\
      --seconds 600 --spoilt-above 4e-4
      a small fast fleet to which values above 4e-4 do harm: for walking a
      rollout
  albireo simulate --nodes 10000 --sessions 50 --backlog 90 --seconds 60
      after an hour's outage: every node has 90 reports to deliver";

/// Headings of the help.
const REPORTS: &str = "Reports";
const FAULTS: &str = "What goes wrong";

/// Arguments of `albireo simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Nodes.
    #[arg(long, default_value_t = 100)]
    nodes: usize,
    /// Zenoh sessions that they share; at most one a node.
    #[arg(long, default_value_t = 4)]
    sessions: usize,
    /// Endpoint of a hub or router on this machine.
    #[arg(long, default_value = "tcp/127.0.0.1:7448", value_name = "ENDPOINT")]
    connect: String,
    /// A Zenoh configuration to begin with, for TLS.
    #[arg(long, value_name = "FILE")]
    zenoh_config: Option<PathBuf>,
    /// What the nodes' names begin with.
    #[arg(long, default_value = "sim-")]
    name: String,
    /// How long, seconds, from when all sessions are open.
    #[arg(long, alias = "for", default_value_t = 60.0, value_name = "SECONDS")]
    seconds: f64,
    /// Seconds between two heartbeats.
    #[arg(long = "status-seconds", help_heading = REPORTS, alias = "status-s", default_value_t = 30.0)]
    status_s: f64,
    /// Length of a clip, seconds.
    #[arg(long = "clip-seconds", help_heading = REPORTS, alias = "clip-s", default_value_t = 40.0)]
    clip_s: f64,
    /// Reports that a node gathers before it sends them.
    #[arg(long, help_heading = REPORTS, default_value_t = 12)]
    gather: u64,
    /// Reports that every node has to deliver when it starts.
    #[arg(long, help_heading = REPORTS, default_value_t = 0)]
    backlog: u64,
    /// Nodes do not listen for notices: they learn of a value from the answer to a report.
    #[arg(long)]
    no_notices: bool,
    /// Above this threshold clips cost more energy and time.
    #[arg(long, help_heading = FAULTS, value_name = "U")]
    spoilt_above: Option<f64>,
    /// How many times as much.
    #[arg(long, help_heading = FAULTS, default_value_t = 1.3, value_name = "FACTOR")]
    spoilt_by: f64,
    /// How long to go on in the end until everything is acknowledged, seconds.
    #[arg(long, help_heading = REPORTS, default_value_t = 30.0, value_name = "SECONDS")]
    drain: f64,
    /// Seed of the times and figures; random by default.
    #[arg(long)]
    seed: Option<u64>,
    /// A process whose cost is reported too, `hub=4711`; may be given several times.
    #[arg(long = "pid", value_name = "NAME=PID", value_parser = named_pid)]
    pids: Vec<(String, u32)>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn named_pid(text: &str) -> Result<(String, u32), String> {
    let (name, pid) = text
        .split_once('=')
        .ok_or("write NAME=PID, such as hub=4711")?;
    let pid = pid
        .parse()
        .map_err(|_| format!("`{pid}` is no process number"))?;
    Ok((name.to_owned(), pid))
}

fn seconds(name: &str, seconds: f64) -> anyhow::Result<Duration> {
    let duration = Duration::try_from_secs_f64(seconds).with_context(|| format!("--{name}"))?;
    if duration > albireo_simulate::LONGEST {
        bail!("--{name}: at most a day");
    }
    Ok(duration)
}

pub(super) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let json = arguments.json;
    let options = options(arguments)?;
    let shutdown = signals::shutdown().context(signals::CONTEXT)?;
    let summary = albireo_simulate::run(options, shutdown, |line| eprintln!("{line}")).await?;
    if json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print!("{summary}");
    }
    if !summary.is_drained() {
        bail!(
            "{} of {} reports were not acknowledged",
            summary.made - summary.acknowledged,
            summary.made
        );
    }
    Ok(())
}

fn options(arguments: Arguments) -> anyhow::Result<Options> {
    let clock = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    Ok(Options {
        nodes: arguments.nodes,
        sessions: arguments.sessions,
        connect: arguments.connect,
        zenoh_config: arguments.zenoh_config,
        name: arguments.name,
        duration: seconds("for", arguments.seconds)?,
        status_s: arguments.status_s,
        clip_s: arguments.clip_s,
        gather: arguments.gather,
        backlog: arguments.backlog,
        notices: !arguments.no_notices,
        behaviour: Behaviour {
            spoilt_above: arguments.spoilt_above,
            spoilt_by: arguments.spoilt_by,
            measured: false,
        },
        drain: seconds("drain", arguments.drain)?,
        seed: arguments
            .seed
            .unwrap_or_else(|| clock.map_or(1, |now| now.as_nanos() as u64)),
        watch: arguments.pids,
    })
}
