//! The command `diag`: fetches a hub's diagnostics as one archive.

use super::{Context, Ended};
use std::path::PathBuf;

/// Arguments of `albireo fleet diag`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Where to write it; an existing file is not overwritten.
    #[arg(long, short, value_name = "FILE", default_value = "albireo-hub.tar")]
    output: PathBuf,
}

pub(super) async fn fetch(context: &Context, arguments: Arguments) -> anyhow::Result<Ended> {
    let archive = context.client.file("/api/v1/diag").await?.bytes().await?;
    crate::cli::diag::save(&arguments.output, &archive)?;
    let shown = arguments.output.display().to_string();
    let saved = serde_json::json!({ "file": shown, "bytes": archive.len() });
    context.print(&saved, |_| {
        format!("{shown}: {} bytes; tar xf {shown}\n", archive.len())
    })?;
    Ok(Ended::Well)
}
