//! `albireo acl`: generates the router's access control from the certificates.

use super::cert::AuthorityPlace;
use super::values::counted;
use albireo_router::access::access_control;
use albireo_router::authority::{PUBLIC, write};
use anyhow::Context;
use std::path::PathBuf;

/// Arguments of `albireo acl`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Zenoh's rules have no templates, so each node gets rules of its own, selected by
the common name of its certificate. Everything else is denied. Generate the
rules again, with the same options, after each `albireo cert node` and
`albireo cert revoke`, and restart the router (`sudo systemctl restart
albireo-router`): its sessions reconnect by themselves.

Examples:
  albireo acl --folder /etc/albireo/authority --output /etc/albireo/access.json
  zenohd --config router.json5 --cfg \"access_control:$(albireo acl)\"")]
pub(super) struct AclArguments {
    #[command(flatten)]
    place: AuthorityPlace,
    /// First part of all keys of the fleet: hub.prefix and node.prefix.
    #[arg(long, value_name = "PREFIX", default_value = "albireo")]
    prefix: String,
    /// Let hubs ask nodes for camera pictures; nodes answer where their configuration allows it.
    #[arg(long)]
    pictures: bool,
    /// File for the rules [default: standard output]
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

pub(super) fn run(arguments: &AclArguments) -> anyhow::Result<()> {
    let authority = arguments.place.open()?;
    let access = access_control(
        &arguments.place.folder,
        authority.entries(),
        &arguments.prefix,
        arguments.pictures,
    )?;
    let text = serde_json::to_string_pretty(&access)? + "\n";
    match &arguments.output {
        None => print!("{text}"),
        Some(file) => {
            // The file is replaced as a whole, because the router may start at any moment.
            write(file, &text, PUBLIC).context("the rules cannot be written")?;
            let subjects = access["subjects"].as_array().map_or(0, Vec::len);
            println!(
                "{}: access for {}",
                file.display(),
                counted(subjects as u64, "certificate", "certificates")
            );
        }
    }
    Ok(())
}
