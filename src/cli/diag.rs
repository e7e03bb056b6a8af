//! `albireo diag`: collects the diagnostics of a node or a hub into one archive.

use super::fleet::client::Client;
use anyhow::{Context, bail};
use reqwest::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use reqwest::{Method, Response};
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `albireo diag`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  albireo diag                                  the node of this machine
  albireo diag http://127.0.0.1:8090            a hub
  ALBIREO_HTTP__TOKEN=… albireo diag http://car-7.example:8080 -o car-7.tar
  ALBIREO_HTTP__TOKEN=$ALBIREO_HUB_TOKEN albireo diag $ALBIREO_HUB
      the hub of `albireo fleet`")]
pub(super) struct DiagArguments {
    /// HTTP interface of the node or the hub.
    #[arg(default_value = "http://127.0.0.1:8080", value_name = "URL")]
    url: String,
    /// The service's token; safer in the environment, because other users see the command line.
    #[arg(long, env = "ALBIREO_HTTP__TOKEN", hide_env_values = true)]
    token: Option<String>,
    /// Where to write the archive, instead of the name that the service gives it; an existing file is not
    /// overwritten.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

pub(super) async fn run(arguments: DiagArguments) -> anyhow::Result<()> {
    let remedy = "is the node or hub running, and is this its address?";
    let client = Client::new(&arguments.url, arguments.token, remedy)?;
    let response = client.plain(Method::GET, "/api/v1/diag").await?;
    let media_type = response.headers().get(CONTENT_TYPE);
    let is_archive = media_type.is_some_and(|kind| kind == "application/x-tar");
    if !is_archive {
        bail!(
            "{} returned no archive; is it a node or a hub?",
            arguments.url
        );
    }
    let file = arguments
        .output
        .or_else(|| named(&response))
        .unwrap_or_else(|| "albireo-diag.tar".into());
    let archive = response
        .bytes()
        .await
        .context("the connection ended before the archive was complete")?;
    let shown = file.display();
    let mut opened =
        File::create_new(&file).with_context(|| format!("{shown} cannot be written"))?;
    if let Err(error) = opened.write_all(&archive) {
        // A part of an archive would only be in the way of the next attempt.
        let _ = std::fs::remove_file(&file);
        return Err(error).with_context(|| format!("{shown} cannot be written"));
    }
    println!("{shown}: {} bytes; tar xf {shown}", archive.len());
    Ok(())
}

/// Returns the file name that the service gives the archive, without any path in it.
fn named(response: &Response) -> Option<PathBuf> {
    let header = response.headers().get(CONTENT_DISPOSITION)?.to_str().ok()?;
    let (_, name) = header.split_once("filename=\"")?;
    let name = name.strip_suffix('"')?;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.starts_with("albireo-") && name.chars().all(is_plain) {
        Some(name.into())
    } else {
        None
    }
}
