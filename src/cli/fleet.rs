//! `albireo fleet`: uses a hub from the terminal, as a client of its HTTP interface only.

pub(super) mod client;
mod nodes;
mod runs;
mod set;
mod table;
mod units;

use clap::Subcommand;
use client::Client;
use serde_json::{Value, json};

/// What to do if nothing answers at the hub's address.
const REMEDY: &str = "is the hub running? Name another by --hub or ALBIREO_HUB";

/// Arguments of `albireo fleet`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Nodes are selected by name (cam-7), glob ('cam-*'), label (region=north) or
`all`; parts joined by & must all match ('cam-* & region=north'), a part after !
must not match ('all & !cam-3'). Several --select add up.

Exit codes: 0 done; 1 the hub cannot be reached or refuses; 2 wrong arguments;
3 some nodes refused the value or did not answer in time, or a rollout was
returned; 4 nothing failed, but something is still open: nodes out of reach, a
rollout on hold.

Examples:
  albireo fleet ls                                   all nodes and their states
  albireo fleet show cam-7
      one node: values and health
  albireo fleet set-u 5e-4 --select 'cam-*' --dry-run    who would change
  albireo fleet set-u 5e-4 --select 'cam-*' --why 'less traffic at night'
  albireo fleet set-target skip_rate=0.5 --select region=north
      a target instead of a value
  albireo fleet set-target off --select region=north
  albireo fleet rollout start 5e-4 --select all --stages 1,10%,50%,90% \\
      --soak 30m --gate 'joules<=+5%'
  albireo fleet rollout show --follow
      until it is done, held or returned
  albireo fleet trial start 1e-4 3e-4 1e-3 --select region=north --for 2h
  albireo fleet forget car-7                         a scrapped node
  albireo fleet energy --since 7d --by node
  albireo fleet revisions --node cam-7
      who set what, when and why, and the outcome
  ALBIREO_HUB=http://hub.example:8090 ALBIREO_HUB_TOKEN=… albireo fleet watch")]
pub(super) struct FleetArguments {
    /// The hub
    #[arg(
        long,
        global = true,
        env = "ALBIREO_HUB",
        default_value = "http://127.0.0.1:8090",
        value_name = "URL"
    )]
    hub: String,
    /// The hub's token; safer in the environment, because other users see the command line
    #[arg(long, global = true, env = "ALBIREO_HUB_TOKEN", hide_env_values = true)]
    token: Option<String>,
    /// Print the hub's JSON
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: FleetCommand,
}

#[derive(Debug, Subcommand)]
enum FleetCommand {
    /// List all nodes with their states.
    Ls(nodes::ListArguments),
    /// Show one node.
    Show {
        /// The node's name.
        node: String,
    },
    /// Forget nodes that are gone; their clips and history stay.
    Forget {
        /// The names of the nodes.
        #[arg(required = true)]
        nodes: Vec<String>,
    },
    /// Set the threshold (u, or lambda under expected-loss) of selected nodes.
    SetU {
        /// The new value.
        #[arg(value_parser = units::finite)]
        value: f64,
        /// The threshold's name, for nodes under another policy.
        #[arg(long, default_value = "u")]
        threshold: String,
        #[command(flatten)]
        arguments: set::GiveArguments,
    },
    /// Let selected nodes hold a target instead of a threshold.
    SetTarget {
        /// The target to hold: skip_rate=0.5, recall=0.9 or watts=6, also as JSON ('{"skip_rate": 0.5}'); or off.
        #[arg(value_parser = units::target)]
        target: Value,
        #[command(flatten)]
        arguments: set::GiveArguments,
    },
    /// Show the history of desired settings.
    Revisions(set::RevisionsArguments),
    /// List nodes that were changed locally after they applied the desired setting.
    Drift,
    /// Change a value in stages, each gated on measurements.
    #[command(subcommand)]
    Rollout(runs::RolloutCommand),
    /// Compare values on random groups of nodes.
    #[command(subcommand)]
    Trial(runs::TrialCommand),
    /// Show energy over time.
    Energy(nodes::EnergyArguments),
    /// Show the fleet, refreshed every two seconds.
    Watch {
        /// Stop after this many updates.
        #[arg(long, value_name = "N")]
        looks: Option<u64>,
    },
}

/// The end of a command without an error, with its exit code.
#[derive(Clone, Copy)]
enum Ended {
    /// Everything was done.
    Well = 0,
    /// Some nodes refused or did not answer, or a rollout was returned.
    Failed = 3,
    /// Some nodes or stages are still pending.
    Open = 4,
}

/// The context of every command.
struct Context {
    client: Client,
    json: bool,
}

impl Context {
    /// Prints the hub's answer as JSON, or as formatted by `text`.
    fn print<T: serde::Serialize>(
        &self,
        answer: &T,
        text: impl FnOnce(&T) -> String,
    ) -> anyhow::Result<Ended> {
        if self.json {
            println!("{}", serde_json::to_string_pretty(answer)?);
        } else {
            print!("{}", text(answer));
        }
        Ok(Ended::Well)
    }
}

/// Runs the command, and returns its exit code.
pub(super) async fn run(arguments: FleetArguments) -> anyhow::Result<i32> {
    let context = Context {
        client: Client::new(&arguments.hub, arguments.token, REMEDY)?,
        json: arguments.json,
    };
    let ended = match arguments.command {
        FleetCommand::Ls(arguments) => nodes::list(&context, arguments).await,
        FleetCommand::Show { node } => nodes::show(&context, &node).await,
        FleetCommand::Forget { nodes } => nodes::forget(&context, &nodes).await,
        FleetCommand::SetU {
            value,
            threshold,
            arguments,
        } => set::give(&context, &threshold, json!(value), arguments).await,
        FleetCommand::SetTarget { target, arguments } => {
            set::give(&context, "target", target, arguments).await
        }
        FleetCommand::Revisions(arguments) => set::revisions(&context, arguments).await,
        FleetCommand::Drift => set::drift(&context).await,
        FleetCommand::Rollout(command) => runs::rollout(&context, command).await,
        FleetCommand::Trial(command) => runs::trial(&context, command).await,
        FleetCommand::Energy(arguments) => nodes::energy(&context, arguments).await,
        FleetCommand::Watch { looks } => nodes::watch(&context, looks).await,
    };
    match ended {
        Ok(ended) => Ok(ended as i32),
        Err(error) => Err(context.client.explained(error).await),
    }
}
