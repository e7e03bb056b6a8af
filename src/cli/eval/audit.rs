//! `albireo eval audit` and `price`: what the audit's figures are worth, and how cameras should share a detector.

use super::frontier::progress;
use albireo_eval::data::{Clips, recorded};
use albireo_eval::frontier::View;
use albireo_eval::{audit_study, price_study};
use clap::Args;
use std::path::PathBuf;

/// The options.
#[derive(Debug, Args)]
pub(super) struct AuditArguments {
    #[command(flatten)]
    recordings: Recordings,
    /// A policy at a setting; may be given several times [default: albireo, expected-loss and fixed-skip at several].
    #[arg(long, value_name = "NAME:SETTING")]
    policy: Vec<String>,
    /// Samples drawn for each policy and share.
    #[arg(long, value_name = "COUNT", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(2..=100_000))]
    seeds: u64,
}

/// The options.
#[derive(Debug, Args)]
pub(super) struct PriceArguments {
    #[command(flatten)]
    recordings: Recordings,
}

/// What is looked at.
#[derive(Debug, Args)]
struct Recordings {
    /// Recorded detections with ground truth: a folder with sequences.json, detections/ and groundtruth/.
    folder: PathBuf,
    /// Detections below this confidence are not shown to the policies.
    #[arg(long, default_value_t = 0.5)]
    confidence: f64,
    /// Use every second frame only, as if the camera were half as fast.
    #[arg(long)]
    half_rate: bool,
    /// Print all figures as JSON instead.
    #[arg(long)]
    json: bool,
}

impl Recordings {
    fn read(&self) -> anyhow::Result<(Clips, View)> {
        anyhow::ensure!(
            (0.0..=1.0).contains(&self.confidence),
            "--confidence {} is not between 0 and 1",
            self.confidence
        );
        let clips = recorded::read(&self.folder)?.only_with_detections(&self.folder)?;
        let view = if self.half_rate {
            View::half_rate(self.confidence)
        } else {
            View::as_recorded(self.confidence)
        };
        Ok((clips, view))
    }
}

/// Runs `albireo eval audit`; the tables go to standard output.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do.
pub(super) fn run(arguments: &AuditArguments) -> anyhow::Result<()> {
    let (clips, view) = arguments.recordings.read()?;
    let usual = audit_study::POLICIES.map(str::to_owned);
    let policies = match arguments.policy.is_empty() {
        true => &usual[..],
        false => &arguments.policy,
    };
    let bar = progress(policies.len(), "policies")?;
    let study = audit_study::study(&clips.clips, &view, policies, arguments.seeds, &|| {
        bar.inc(1);
    });
    bar.finish_and_clear();
    let study = study?;
    if arguments.recordings.json {
        println!("{}", serde_json::to_string_pretty(&study)?);
    } else {
        print!("{}", audit_study::render(&study));
    }
    Ok(())
}

/// Runs `albireo eval price`; the table goes to standard output.
///
/// # Errors
/// A sentence with what was wrong, where, and what to do.
pub(super) fn run_price(arguments: &PriceArguments) -> anyhow::Result<()> {
    let (clips, view) = arguments.recordings.read()?;
    let rates = price_study::SKIP_RATES;
    let bar = progress(price_study::steps(rates.len()), "operating points")?;
    let study = price_study::study(&clips.clips, &view, &rates, &|| bar.inc(1));
    bar.finish_and_clear();
    let study = study?;
    if arguments.recordings.json {
        println!("{}", serde_json::to_string_pretty(&study)?);
    } else {
        print!("{}", price_study::render(&study));
    }
    Ok(())
}
