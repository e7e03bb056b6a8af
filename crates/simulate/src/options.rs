//! The options of a simulated fleet, and their bounds.

use serde::Serialize;
use std::net::ToSocketAddrs;
use std::path::PathBuf;
use std::time::Duration;

/// Most nodes of a run.
pub const MOST_NODES: usize = 1_000_000;
/// Most sessions of a run: each is a connection with threads' worth of state on both ends.
pub(crate) const MOST_SESSIONS: usize = 20_000;
/// Longest run.
pub const LONGEST: Duration = Duration::from_secs(86_400);

/// How the nodes' figures depend on the threshold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Behaviour {
    /// Above this threshold a clip costs more energy and time; nowhere when absent.
    pub spoilt_above: Option<f64>,
    /// How many times as much.
    pub spoilt_by: f64,
    /// Whether the reports call their made-up energy measured; otherwise estimated.
    pub measured: bool,
}

impl Default for Behaviour {
    fn default() -> Self {
        Self {
            spoilt_above: None,
            spoilt_by: 1.3,
            measured: false,
        }
    }
}

/// What is to be played.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Options {
    /// Nodes.
    pub nodes: usize,
    /// Zenoh sessions that they share.
    pub sessions: usize,
    /// Endpoint of the router or hub, on this machine.
    pub connect: String,
    /// A Zenoh configuration to begin with, for TLS.
    pub zenoh_config: Option<PathBuf>,
    /// What the nodes' names begin with.
    pub name: String,
    /// How long, once all sessions are open.
    pub duration: Duration,
    /// Time between two heartbeats, seconds.
    pub status_s: f64,
    /// Length of a clip, seconds.
    pub clip_s: f64,
    /// Reports that a node gathers before it sends them.
    pub gather: u64,
    /// Reports that every node has when it starts, as after an outage.
    pub backlog: u64,
    /// Whether each node listens to its notice.
    pub notices: bool,
    /// How figures depend on the threshold.
    pub behaviour: Behaviour,
    /// How long to go on at the end until everything is acknowledged.
    pub drain: Duration,
    /// Draws instances, figures and times; two runs of one seed are the same nodes.
    pub seed: u64,
    /// Processes whose cost is reported beside the simulator's own.
    pub watch: Vec<(String, u32)>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            nodes: 100,
            sessions: 4,
            connect: "tcp/127.0.0.1:7448".to_owned(),
            zenoh_config: None,
            name: "sim-".to_owned(),
            duration: Duration::from_secs(60),
            status_s: 30.0,
            clip_s: 40.0,
            gather: 12,
            backlog: 0,
            notices: true,
            behaviour: Behaviour::default(),
            drain: Duration::from_secs(30),
            seed: 1,
            watch: Vec::new(),
        }
    }
}

impl Options {
    /// Whether the run is bounded and stays on this machine.
    ///
    /// # Errors
    /// What is wrong and what would do.
    pub fn check(&self) -> Result<(), String> {
        let within = |what: &str, value: usize, most: usize| {
            if (1..=most).contains(&value) {
                Ok(())
            } else {
                Err(format!("{what} must be from 1 to {most}, not {value}"))
            }
        };
        within("nodes", self.nodes, MOST_NODES)?;
        within("sessions", self.sessions, MOST_SESSIONS.min(self.nodes))?;
        if self.duration > LONGEST || self.drain > LONGEST {
            return Err("no time may be longer than a day".to_owned());
        }
        for (what, seconds) in [("status", self.status_s), ("clip", self.clip_s)] {
            if !(0.1..=86_400.0).contains(&seconds) {
                return Err(format!(
                    "the time of a {what} must be from 0.1 to 86400 seconds"
                ));
            }
        }
        // More would not fit into the largest batch that a hub takes.
        if !(1..=500).contains(&self.gather) {
            return Err("gather must be from 1 to 500".to_owned());
        }
        let on_this_machine = endpoint_host(&self.connect).is_some_and(is_loopback);
        if !on_this_machine {
            return Err(format!(
                "`{}` is not on this machine: a simulated fleet is played over loopback only (tcp/127.0.0.1:7448)",
                self.connect
            ));
        }
        Ok(())
    }
}

/// Host and port of `tcp/127.0.0.1:7448`.
fn endpoint_host(endpoint: &str) -> Option<&str> {
    let (_, address) = endpoint.split_once('/')?;
    address.split(['?', '#']).next()
}

fn is_loopback(address: &str) -> bool {
    match address.to_socket_addrs() {
        Ok(mut addresses) => addresses.all(|address| address.ip().is_loopback()),
        Err(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fleet_is_played_to_this_machine_only_and_within_bounds() {
        let with = |change: &dyn Fn(&mut Options)| {
            let mut options = Options::default();
            change(&mut options);
            options.check()
        };
        assert_eq!(with(&|_| {}), Ok(()));
        assert_eq!(with(&|o| o.connect = "tls/localhost:7447".into()), Ok(()));
        for connect in ["tcp/192.0.2.1:7447", "tcp/0.0.0.0:7447", "7447", "tcp/"] {
            assert!(with(&|o| o.connect = connect.into()).is_err(), "{connect}");
        }
        assert!(with(&|o| o.nodes = 0).is_err());
        assert!(with(&|o| o.nodes = 2_000_000).is_err());
        assert!(
            with(&|o| o.sessions = 200).is_err(),
            "more sessions than nodes"
        );
        assert!(with(&|o| o.clip_s = f64::NAN).is_err());
        assert!(with(&|o| o.gather = 0).is_err());
    }
}
