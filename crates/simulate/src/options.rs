//! Defines the options of a simulated fleet, and checks them.

use clap::Parser;
use std::net::ToSocketAddrs;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The maximum number of nodes in a run.
const MOST_NODES: usize = 1_000_000;
/// The maximum number of sessions in a run: each is a connection, with much state at both ends.
const MOST_SESSIONS: usize = 20_000;
/// The maximum number of reports that a node has waiting at the start.
const MOST_BACKLOG: f64 = 100_000.0;
/// A day, in seconds.
const DAY_S: f64 = 86_400.0;

/// Headings of the help text.
const REPORTS: &str = "Reports";
const FAULTS: &str = "What goes wrong";

/// The options of `albireo simulate`.
#[derive(Clone, Debug, PartialEq, clap::Args)]
pub struct Options {
    /// Number of nodes.
    #[arg(long, default_value_t = 100)]
    pub nodes: usize,
    /// Zenoh sessions that the nodes share; at most one per node.
    #[arg(long, default_value_t = 4)]
    pub sessions: usize,
    /// Endpoint of a hub or router on this machine.
    #[arg(long, default_value = "tcp/127.0.0.1:7448", value_name = "ENDPOINT")]
    pub connect: String,
    /// Base Zenoh configuration, for TLS.
    #[arg(long, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
    /// Prefix of the nodes' names.
    #[arg(long, default_value = "sim-")]
    pub name: String,
    /// Duration after all sessions are open, seconds.
    #[arg(long = "seconds", default_value = "60", value_name = "SECONDS", value_parser = seconds)]
    pub duration: Duration,
    /// Seconds between two heartbeats, instead of those that the hub wants.
    #[arg(long = "status-seconds", help_heading = REPORTS)]
    pub status_s: Option<f64>,
    /// Length of a clip, seconds.
    #[arg(long = "clip-seconds", help_heading = REPORTS, default_value_t = 40.0)]
    pub clip_s: f64,
    /// Reports that a node gathers before it sends them.
    #[arg(long, help_heading = REPORTS, default_value_t = 12)]
    pub gather: u64,
    /// Reports that every node has waiting at the start.
    #[arg(long, help_heading = REPORTS, default_value_t = 0)]
    pub backlog: u64,
    /// Reports say where their clips were made: each node drives its own rounds in a made-up town.
    #[arg(long, help_heading = REPORTS)]
    pub positions: bool,
    /// Nodes do not subscribe to notices: they learn a new value from the answer to a report.
    #[arg(long = "no-notices", action = clap::ArgAction::SetFalse)]
    pub notices: bool,
    /// Above this threshold, clips cost more energy and time.
    #[arg(long, help_heading = FAULTS, value_name = "U")]
    pub worse_above: Option<f64>,
    /// The factor by which they cost more.
    #[arg(long, help_heading = FAULTS, default_value_t = 1.3, value_name = "FACTOR")]
    pub worse_by: f64,
    /// Marks the invented energy in reports as measured instead of estimated.
    #[arg(skip)]
    pub measured: bool,
    /// Longest time to wait at the end until everything is acknowledged, seconds.
    #[arg(long, help_heading = REPORTS, default_value = "30", value_name = "SECONDS", value_parser = seconds)]
    pub drain: Duration,
    /// Seed of the times and figures; random by default.
    #[arg(long, default_value_t = now_ns(), hide_default_value = true)]
    pub seed: u64,
}

fn seconds(text: &str) -> Result<Duration, &'static str> {
    match text.parse() {
        Ok(seconds) if (0.0..=DAY_S).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("must be a number of seconds, at most a day"),
    }
}

/// Nanoseconds since the Unix epoch.
pub(crate) fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    u64::try_from(since.unwrap_or_default().as_nanos()).unwrap_or(u64::MAX)
}

impl Default for Options {
    fn default() -> Self {
        #[derive(Parser)]
        struct Defaults {
            #[command(flatten)]
            options: Options,
        }
        Defaults::parse_from(["simulate"]).options
    }
}

impl Options {
    /// Checks that the run is bounded and stays on this machine.
    ///
    /// # Errors
    /// The invalid option, and the allowed values.
    pub(crate) fn check(&self) -> Result<(), String> {
        let within = |what: &str, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(format!(
                    "{what} must be from {least} to {most}, not {value}"
                ))
            }
        };
        let nodes = self.nodes as f64;
        let sessions = self.sessions as f64;
        within("nodes", nodes, 1.0, MOST_NODES as f64)?;
        within("sessions", sessions, 1.0, nodes.min(MOST_SESSIONS as f64))?;
        if let Some(status_s) = self.status_s {
            within("status-seconds", status_s, 0.1, DAY_S)?;
        }
        within("clip-seconds", self.clip_s, 0.1, DAY_S)?;
        // A batch has fewer reports in any case; gathering more only delays them.
        within("gather", self.gather as f64, 1.0, 500.0)?;
        within("backlog", self.backlog as f64, 0.0, MOST_BACKLOG)?;
        within("worse-by", self.worse_by, 0.1, 10.0)?;
        if !is_on_this_machine(&self.connect) {
            return Err(format!(
                "`{}` is not on this machine: a simulated fleet connects only over loopback (tcp/127.0.0.1:7448)",
                self.connect
            ));
        }
        Ok(())
    }
}

/// Returns true if an endpoint such as `tcp/127.0.0.1:7448` is on this machine.
fn is_on_this_machine(endpoint: &str) -> bool {
    let Some((_protocol, address)) = endpoint.split_once('/') else {
        return false;
    };
    // What follows are parameters of the connection.
    let host = address.split(['?', '#']).next().unwrap_or_default();
    match host.to_socket_addrs() {
        Ok(mut addresses) => addresses.all(|address| address.ip().is_loopback()),
        Err(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_local_endpoints_and_sizes_within_limits_are_accepted() {
        let checked = |change: &dyn Fn(&mut Options)| {
            let mut options = Options::default();
            change(&mut options);
            options.check()
        };
        assert_eq!(checked(&|_| {}), Ok(()));
        assert_eq!(
            checked(&|options| options.connect = "tls/localhost:7447".into()),
            Ok(())
        );
        for connect in ["tcp/192.0.2.1:7447", "tcp/0.0.0.0:7447", "7447", "tcp/"] {
            assert!(
                checked(&|options| options.connect = connect.into()).is_err(),
                "{connect}"
            );
        }
        assert!(checked(&|options| options.nodes = 0).is_err());
        assert!(checked(&|options| options.nodes = 2_000_000).is_err());
        assert!(checked(&|options| options.backlog = u64::MAX).is_err());
        assert!(checked(&|options| options.worse_by = f64::NAN).is_err());
        assert!(checked(&|options| options.worse_by = -1.0).is_err());
        let more_sessions_than_nodes = |options: &mut Options| {
            options.nodes = 3;
            options.sessions = 4;
        };
        assert!(checked(&more_sessions_than_nodes).is_err());
        assert!(checked(&|options| options.clip_s = f64::NAN).is_err());
        assert!(checked(&|options| options.gather = 0).is_err());
    }
}
