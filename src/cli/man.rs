//! `albireo man`: writes the manual pages, from the same descriptions as `--help`.

use anyhow::Context;
use clap::CommandFactory;
use std::path::PathBuf;

/// Arguments of `albireo man`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Writes albireo.1 and one page per subcommand, such as albireo-node.1. The
packages include them.

Examples:
  albireo man /usr/local/share/man/man1
  albireo man /tmp/man && man -l /tmp/man/albireo-node.1")]
pub(super) struct ManArguments {
    /// Folder for the pages, which is created if needed.
    folder: PathBuf,
}

pub(super) fn run(arguments: &ManArguments) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{} cannot be created", folder.display()))?;
    clap_mangen::generate_to(super::Arguments::command(), folder)
        .with_context(|| format!("the pages cannot be written to {}", folder.display()))
}
