//! Parses the command line and runs a subcommand. Each subcommand has a file with its arguments and a `run`.

#[cfg(feature = "hub")]
mod acl;
#[cfg(feature = "hub")]
mod cert;
mod check;
#[cfg(feature = "eval")]
mod compare;
mod completions;
#[cfg(feature = "eval")]
mod demo;
mod detect;
#[cfg(feature = "development")]
mod development;
#[cfg(feature = "hub")]
mod diag;
#[cfg(feature = "eval")]
pub mod eval;
#[cfg(feature = "eval")]
mod export;
#[cfg(feature = "hub")]
mod fleet;
pub mod frames;
#[cfg(feature = "hub")]
mod hub;
mod man;
mod node;
#[cfg(feature = "eval")]
mod play;
mod power;
mod progress;
mod publish;
#[cfg(feature = "eval")]
pub mod replay;
#[cfg(feature = "hub")]
mod router;
#[cfg(feature = "simulate")]
mod simulate;
mod terminal;
mod values;
mod variables;

use albireo_service::{logging, panics};
use anyhow::Context;
use clap::{Parser, Subcommand};
use std::io::Write;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::TcpListener;

/// Time limit for threads that still run after everything else has ended.
const STRAGGLERS: Duration = Duration::from_millis(500);

#[cfg(feature = "eval")]
const CLOSING: &str = "\
Examples:
  albireo demo                             run everything at once
  albireo check config/node.toml           list the mistakes in a configuration
  albireo detect model.onnx frame.jpg      run a detector on a picture
  albireo power                            list the power meters of this machine
  albireo compare                          measure the policies on this machine
  albireo publish /dev/video0              send a camera to a node elsewhere
  albireo replay drive.mp4                 play a video to a node as a camera
  albireo node --config config/node.toml   run a node
  ALBIREO_NODE__NAME=car-7 albireo node    run one with defaults and a name
  albireo hub --config config/hub.toml     run the hub of a fleet
  albireo diag                             collect diagnostics into one archive";

#[cfg(not(feature = "eval"))]
const CLOSING: &str = "\
This program was built for a board, without the feature `eval`. A program built
with it has demo, replay, compare and eval, and can play a camera to this node
from another machine.";

/// Run a video object detector only on the frames that need it, and track the objects on the others.
#[derive(Debug, Parser)]
#[command(
    version, about, after_help = CLOSING, subcommand_required = true, arg_required_else_help = true,
    max_term_width = 80
)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

/// The subcommands, in the order in which a newcomer uses them.
#[derive(Debug, Subcommand)]
enum Command {
    #[cfg(feature = "eval")]
    /// Run a camera, a node and a hub in one process, with nothing to configure.
    Demo(demo::DemoArguments),
    /// Check a configuration file and list all its mistakes.
    Check(check::CheckArguments),
    /// Describe a detector, and run it on pictures.
    Detect(detect::DetectArguments),
    /// List the power meters that work on this machine, with their rails and present watts.
    Power(power::PowerArguments),
    #[cfg(feature = "eval")]
    /// Play a clip to a live node under several policies, and measure what each costs and finds.
    Compare(compare::CompareArguments),
    /// Send a live camera's frames to a node on another machine.
    Publish(publish::PublishArguments),
    #[cfg(feature = "eval")]
    /// Publish a video, a folder of pictures, a recording or the recorded road as a camera.
    Replay(replay::ReplayArguments),
    /// Run a node: frames in, detections and clip reports out.
    Node(node::NodeArguments),
    #[cfg(feature = "hub")]
    /// Collect diagnostics from a node or a hub into one archive.
    Diag(diag::DiagArguments),
    #[cfg(feature = "hub")]
    /// Run a hub: it stores a fleet's reports, shows its state and changes its settings.
    Hub(hub::HubArguments),
    #[cfg(feature = "hub")]
    /// Show and tune a fleet through its hub, from the terminal.
    Fleet(Box<fleet::FleetArguments>),
    #[cfg(feature = "hub")]
    /// Run the router between the nodes of a fleet and its hubs.
    Router(router::RouterArguments),
    #[cfg(feature = "hub")]
    /// Make, renew and revoke the certificates of a fleet.
    Cert(cert::CertArguments),
    #[cfg(feature = "hub")]
    /// Generate the router's access rules from the certificates.
    Acl(acl::AclArguments),
    #[cfg(feature = "simulate")]
    /// Send a hub the load of a fleet without cameras.
    Simulate(Box<simulate::SimulateArguments>),
    #[cfg(feature = "eval")]
    /// Export recorded frames as COCO or MOTChallenge, for training and labelling.
    Export(export::ExportArguments),
    #[cfg(feature = "eval")]
    /// Replay recordings through any policy, and compare accuracy and detector calls.
    Eval(Box<eval::EvalArguments>),
    /// Write the manual pages of all subcommands into a folder.
    Man(man::ManArguments),
    /// Print the completions of a shell.
    Completions(completions::CompletionsArguments),
}

impl Command {
    /// The variables that the subcommand's libraries need.
    fn variables(&self) -> &'static [variables::Variable] {
        match self {
            Self::Node(_) => &[variables::NO_TELEMETRY, variables::FEW_HEAPS],
            Self::Check(_) | Self::Detect(_) => &[variables::NO_TELEMETRY],
            #[cfg(feature = "eval")]
            Self::Compare(_) | Self::Eval(_) | Self::Demo(_) => &[variables::NO_TELEMETRY],
            _ => &[],
        }
    }

    /// Runs the subcommand and returns the exit code of the process.
    fn run(self) -> anyhow::Result<i32> {
        match self {
            Self::Node(arguments) => node::run(&arguments)?,
            #[cfg(feature = "hub")]
            Self::Hub(arguments) => hub::run(&arguments)?,
            #[cfg(feature = "hub")]
            Self::Fleet(arguments) => return block_on(fleet::run(*arguments)),
            #[cfg(feature = "hub")]
            Self::Diag(arguments) => block_on(diag::run(arguments))?,
            #[cfg(feature = "hub")]
            Self::Router(arguments) => router::run(arguments)?,
            #[cfg(feature = "hub")]
            Self::Cert(arguments) => cert::run(&arguments)?,
            #[cfg(feature = "hub")]
            Self::Acl(arguments) => acl::run(&arguments)?,
            Self::Check(arguments) => check::run(&arguments)?,
            Self::Detect(arguments) => detect::run(&arguments)?,
            Self::Power(arguments) => power::run(&arguments)?,
            Self::Publish(arguments) => block_on(publish::run(arguments))?,
            #[cfg(feature = "eval")]
            Self::Compare(arguments) => block_on(compare::run(arguments))?,
            #[cfg(feature = "eval")]
            Self::Replay(arguments) => block_on(async {
                let shutdown = albireo_service::signals::shutdown()?;
                replay::run(arguments, shutdown).await?;
                Ok(())
            })?,
            #[cfg(feature = "eval")]
            Self::Export(arguments) => export::run(&arguments)?,
            #[cfg(feature = "eval")]
            Self::Eval(arguments) => eval::run(&arguments)?,
            #[cfg(feature = "simulate")]
            Self::Simulate(arguments) => block_on(simulate::run(*arguments))?,
            #[cfg(feature = "eval")]
            Self::Demo(arguments) => block_on(demo::run(arguments))?,
            Self::Man(arguments) => man::run(&arguments)?,
            Self::Completions(arguments) => completions::run(&arguments)?,
        }
        Ok(0)
    }
}

/// Runs the subcommand that the arguments of this process name, prints its error to standard error, and ends the
/// process. Invalid arguments end it with a message.
pub fn run() -> ! {
    let command = Arguments::parse().command;
    panics::end_if_nothing_can_be_printed();
    variables::start_with(command.variables());
    let mut code = match command.run() {
        Ok(code) => code,
        Err(error) => {
            let said = format!("albireo: {}", in_words(&error));
            logging::last_words(&terminal::error(&said));
            1
        }
    };
    // This exit runs none of the C library's exit handlers: they would tear ONNX Runtime down while a thread of it may
    // still load a model. All that must be kept was committed before; only what standard output and the log hold back
    // is still to be written.
    if let Err(error) = std::io::stdout().flush() {
        code = panics::say_unprinted("stdout", &error.to_string());
    }
    logging::finish();
    signal_hook::low_level::exit(code)
}

/// Formats an error and its causes in one line, without the locations in Zenoh's sources. Skips a cause that already
/// stands behind a colon in the text before it.
fn in_words(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1) {
        let addition = format!(": {cause}");
        // `b is 3` does not stand in `a: b is 30`.
        let goes_on = |rest: &str| rest.starts_with(char::is_alphanumeric);
        let is_said = text.split(&addition).skip(1).any(|rest| !goes_on(rest));
        if !is_said {
            text.push_str(&addition);
        }
    }
    albireo_service::session::plain(&text)
}

/// Runs an asynchronous subcommand.
fn block_on<T>(work: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("the asynchronous runtime cannot be started")?;
    let ended = runtime.block_on(work);
    // A thread that reads a file without an answer (a power monitor whose bus hangs) must not keep the program alive.
    runtime.shutdown_timeout(STRAGGLERS);
    ended
}

/// Listens on the address of the setting `key`.
async fn listen(key: &str, address: SocketAddr) -> anyhow::Result<TcpListener> {
    let refused = |error: std::io::Error| {
        let way_out = match error.kind() {
            std::io::ErrorKind::AddrInUse => {
                " (by a running node or hub? another port in the same key works, too)"
            }
            _ => "",
        };
        anyhow::anyhow!("{key}: {address} cannot be listened on: {error}{way_out}")
    };
    TcpListener::bind(address).await.map_err(refused)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    /// The help of a command as a terminal of 80 columns shows it.
    struct ShownHelp {
        command: String,
        text: String,
        /// The end of the help as it was written.
        closing: String,
    }

    /// The help of the program and of all its subcommands.
    fn all_helps() -> Vec<ShownHelp> {
        let mut program = Arguments::command().term_width(80);
        program.build();
        let mut helps = Vec::new();
        collect_helps(&mut program, &mut helps);
        assert!(helps.len() > 20);
        helps
    }

    fn collect_helps(command: &mut clap::Command, helps: &mut Vec<ShownHelp>) {
        helps.push(ShownHelp {
            command: command.get_name().to_owned(),
            text: command.render_long_help().to_string(),
            closing: command.get_after_help().map(ToString::to_string).unwrap_or_default(),
        });
        for subcommand in command.get_subcommands_mut() {
            collect_helps(subcommand, helps);
        }
    }

    #[test]
    fn no_help_is_wider_than_80_columns() {
        for help in all_helps() {
            // Clap never breaks the line of the usage.
            for line in help.text.lines().filter(|line| !line.starts_with("Usage:")) {
                assert!(line.chars().count() <= 80, "{}: {line}", help.command);
            }
        }
    }

    #[test]
    fn no_line_at_the_end_of_a_help_is_broken() {
        for help in all_helps() {
            for line in help.closing.lines() {
                let is_whole = help.text.lines().any(|shown| shown == line);
                assert!(is_whole, "{}: {line}", help.command);
            }
        }
    }

    #[test]
    fn an_error_is_printed_with_every_cause() {
        let error = anyhow::anyhow!("b is 3").context("a").context("reading");
        assert_eq!(in_words(&error), "reading: a: b is 3");
    }

    #[test]
    fn a_cause_that_only_begins_like_the_text_before_it_is_printed() {
        let error = anyhow::anyhow!("b is 3").context("a: b is 30");
        assert_eq!(in_words(&error), "a: b is 30: b is 3");
    }

    #[test]
    fn a_cause_that_the_text_before_it_names_is_not_printed_again() {
        let cause = std::io::Error::other("no such file");
        let error = anyhow::Error::new(cause)
            .context("cannot read a.csv: no such file")
            .context("evaluating");
        let expected = "evaluating: cannot read a.csv: no such file";
        assert_eq!(in_words(&error), expected);
    }

    /// Lists the commands whose option `--detector` cannot be written `--model`.
    #[cfg(feature = "eval")]
    fn collect_without_model(command: &clap::Command, without: &mut Vec<String>) {
        for argument in command.get_arguments() {
            let others = argument.get_all_aliases().unwrap_or_default();
            if argument.get_long() == Some("detector") && !others.contains(&"model") {
                without.push(command.get_name().to_owned());
            }
        }
        for subcommand in command.get_subcommands() {
            collect_without_model(subcommand, without);
        }
    }

    #[cfg(feature = "eval")]
    #[test]
    fn every_command_with_a_detector_takes_it_as_a_model_too() {
        let mut without = Vec::new();
        collect_without_model(&Arguments::command(), &mut without);
        assert_eq!(without, [""; 0]);
        let words = "albireo eval video drive.mp4 --model other.onnx";
        assert!(Arguments::try_parse_from(words.split(' ')).is_ok());
    }

    #[cfg(feature = "hub")]
    #[test]
    fn a_number_that_json_cannot_hold_is_refused_before_a_hub_is_asked() {
        for command in ["set-u nan", "set-u inf", "set-target recall=nan"] {
            let words = format!("albireo fleet {command} --select all");
            let refused = Arguments::try_parse_from(words.split(' ')).err().unwrap();
            assert!(refused.to_string().contains("is not a number"), "{refused}");
        }
    }

    #[test]
    fn an_endpoint_that_is_none_is_refused_at_once() {
        let words = "albireo publish --connect nonsense";
        let refused = Arguments::try_parse_from(words.split(' ')).err().unwrap();
        assert!(refused.to_string().contains("tcp/"), "{refused}");
    }
}
