//! The command line: one file a subcommand. Each has its arguments and a `run` that says how it ended.

mod check;
mod logging;
mod node;
mod signals;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

const EXAMPLES: &str = "\
Examples:
  albireo check config/node.toml         say what is wrong with a configuration
  albireo node --config config/node.toml run a node
  ALBIREO_NODE__NAME=car-7 albireo node  run a node on the defaults under another name";

/// An adaptive efficiency layer around an unchanged video object detector, for nodes on the edge.
#[derive(Debug, Parser)]
#[command(version, about, after_help = EXAMPLES, subcommand_required = true, arg_required_else_help = true)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a node: frames in, detections and clip reports out.
    Node(node::Arguments),
    /// Check a configuration file and say everything that is wrong with it.
    Check(check::Arguments),
}

impl Arguments {
    /// Does what was asked. Says on standard error what went wrong.
    pub fn run(self) -> ExitCode {
        let ended = match self.command {
            Command::Node(arguments) => node::run(&arguments),
            Command::Check(arguments) => check::run(&arguments),
        };
        match ended {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("albireo: {error:#}");
                ExitCode::FAILURE
            }
        }
    }
}
//! The program's subcommands, one file each.

pub mod replay;
