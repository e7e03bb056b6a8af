//! `albireo hub`: runs a hub until a signal stops it, or moves its database.

use super::values::counted;
use super::{block_on, listen, progress};
use albireo_hub::config::{DatabaseConfig, HubConfig};
use albireo_hub::store::transfer;
use albireo_service::{config, logging, signals};
use std::path::PathBuf;

/// Arguments of `albireo hub`.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "\
Without --config the built-in defaults apply; config/hub.toml lists them all. An
environment variable overrides a single key: ALBIREO_SECTION__KEY, with two
underscores between section and key. Ctrl-C or SIGTERM stops it: received
reports are committed and acknowledged first.

Examples:
  albireo hub --config /etc/albireo/hub.toml
  albireo check config/hub.toml
  ALBIREO_DATABASE__URL=postgres://hub@db.example/fleet albireo hub
  albireo hub move albireo-hub.db postgres://hub@db.example/fleet"
)]
pub(super) struct HubArguments {
    #[command(subcommand)]
    command: Option<HubCommand>,
    /// The hub's configuration file.
    #[arg(long, short, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
}

#[derive(Debug, clap::Subcommand)]
enum HubCommand {
    /// Copy a hub's SQLite file into an empty PostgreSQL database.
    #[command(after_help = "\
Stop the hub first, and start it with the new database.url afterwards: anything
it stores in the file in between is not moved. Nodes keep their reports until a
hub acknowledges them, so none is lost or counted twice. The file is not
changed.
PGPASSWORD keeps the password out of the command line.

Example:
  PGPASSWORD=secret albireo hub move /var/lib/albireo/hub.db \\
      postgres://hub@db.example/fleet")]
    Move {
        /// The file, as a path or as sqlite:FILE.
        from: String,
        /// The URL of the database: postgres://USER@HOST/DATABASE.
        to: String,
    },
}

pub(super) fn run(arguments: &HubArguments) -> anyhow::Result<()> {
    if let Some(HubCommand::Move { from, to }) = &arguments.command {
        return block_on(move_database(from, to));
    }
    let config: HubConfig = config::load(arguments.config.as_deref())?;
    logging::start(&config.log)?;
    for finding in config.exposed_here(arguments.config.as_deref()) {
        tracing::warn!("{finding}");
    }
    block_on(async {
        let shutdown = signals::shutdown()?;
        let listener = listen("http.listen", config.http.listen).await?;
        Ok(albireo_hub::run(&config, listener, shutdown).await?)
    })
}

async fn move_database(from: &str, to: &str) -> anyhow::Result<()> {
    let database = DatabaseConfig {
        url: to.to_owned(),
        ..DatabaseConfig::default()
    };
    // The number of rows is known once the database has been looked at.
    let bar = progress::bar(Some(0), "rows, {msg}");
    let moved_bar = bar.clone();
    let show = move |progress: transfer::MoveProgress| {
        moved_bar.set_length(progress.total);
        moved_bar.set_position(progress.rows);
        moved_bar.set_message(progress.table);
    };
    let rows = transfer::to_postgres(from, &database, show).await?;
    bar.finish_and_clear();
    println!(
        "{} now has {} of {from}",
        database.shown(),
        counted(rows, "row", "rows")
    );
    Ok(())
}
