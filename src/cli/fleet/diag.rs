//! `diag`: what a hub tells of itself, as one archive.

use super::client::Failure;
use super::{Context, Ended};
use anyhow::Context as _;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `albireo fleet diag`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Where to write it; a file that is there already is left alone.
    #[arg(long, short, value_name = "FILE", default_value = "albireo-hub.tar")]
    output: PathBuf,
}

pub(super) async fn fetch(context: &Context, arguments: Arguments) -> Result<Ended, Failure> {
    let archive = context.client.bytes("/api/v1/diag").await?;
    let file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(&arguments.output);
    let shown = arguments.output.display().to_string();
    file.and_then(|mut file| file.write_all(&archive))
        .with_context(|| format!("{shown} cannot be written"))?;
    let told = serde_json::json!({ "file": shown, "bytes": archive.len() });
    context.print(&told, |_| {
        format!("{shown}: {} bytes; tar xf {shown}\n", archive.len())
    })?;
    Ok(Ended::Well)
}
