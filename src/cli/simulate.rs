//! `albireo simulate`: plays a fleet of nodes to a hub.

use super::values::counted;
use albireo_service::signals;
use albireo_simulate::Options;
use anyhow::bail;

/// Arguments of `albireo simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
To a hub the nodes are real: statuses, reports, pulls and notices go over real
Zenoh sessions. Their pictures, energy and latencies are invented and marked
`simulated`. Connects only to endpoints on this machine. The exit code is 1 if
a report was not acknowledged by the end.

Examples:
  albireo simulate
      100 nodes on 4 sessions for a minute
  albireo simulate --nodes 10000 --sessions 50 --seconds 300
      the load of 10,000 nodes for five minutes
  albireo simulate --nodes 40 --clip-seconds 1 --status-seconds 2 --gather 1 \\
      --seconds 600 --worse-above 4e-4
      a small fast fleet that values above 4e-4 harm, for trying a rollout
  albireo simulate --nodes 10000 --sessions 50 --backlog 90 --seconds 60
      after an hour's outage: every node has 90 reports to deliver
  albireo simulate --nodes 20 --backlog 90 --positions
      an hour of made-up drives, for /api/v1/positions.geojson")]
pub(super) struct SimulateArguments {
    #[command(flatten)]
    options: Options,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

pub(super) async fn run(arguments: SimulateArguments) -> anyhow::Result<()> {
    let shutdown = signals::shutdown()?;
    let progress = |line| eprintln!("{line}");
    let summary = albireo_simulate::run(arguments.options, shutdown, progress).await?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print!("{summary}");
    }
    let made = summary.counts.made;
    let acknowledged = summary.counts.acknowledged;
    if made != acknowledged {
        bail!(
            "{} of {} not acknowledged",
            made - acknowledged,
            counted(made, "report", "reports")
        );
    }
    Ok(())
}
