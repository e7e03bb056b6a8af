//! `trial`: values compared on random groups of nodes.

use super::table::Table;
use super::units::{counts, figure, finite, interval, named, seconds, threshold, when};
use super::{Context, Ended};
use albireo_hub::http::{TrialView, Trials};
use albireo_hub::tuning::effect::Scale;
use albireo_hub::tuning::metric::Figure;
use anyhow::Context as _;
use serde_json::json;

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Begin one.
    Start(StartArguments),
    /// All, the newest first.
    Ls,
    /// One with its result.
    Show {
        /// Its number; the newest where none is given.
        id: Option<i64>,
    },
    /// End it now, with what was measured; the old values return.
    End {
        /// Its number.
        id: i64,
    },
}

/// Arguments of `albireo fleet trial start`.
#[derive(Debug, clap::Args)]
pub(super) struct StartArguments {
    /// The values, two or more; each is compared with the first.
    #[arg(required = true, num_args = 2.., value_parser = finite)]
    values: Vec<f64>,
    /// Which nodes; may be given several times.
    #[arg(long, required = true, value_name = "SELECTOR")]
    select: Vec<String>,
    /// The knob's name, for nodes under another policy.
    #[arg(long, default_value = "u")]
    knob: String,
    /// How long the values hold.
    #[arg(long = "for", value_parser = seconds, default_value = "1h", value_name = "TIME")]
    duration: f64,
    /// Draws the groups.
    #[arg(long)]
    seed: Option<u64>,
    /// Fewest clips of a node in the result.
    #[arg(long, value_name = "N")]
    fewest_clips: Option<u64>,
    /// Why; kept in the history.
    #[arg(long, default_value = "")]
    why: String,
}

pub(super) async fn run(context: &Context, command: Command) -> anyhow::Result<Ended> {
    let client = &context.client;
    let trial: TrialView = match command {
        Command::Start(arguments) => {
            let value = |value: &f64| json!({ (arguments.knob.as_str()): value });
            let body = named(json!({
                "values": arguments.values.iter().map(value).collect::<Vec<_>>(),
                "select": arguments.select,
                "duration_s": arguments.duration,
                "fewest_clips": arguments.fewest_clips,
                "seed": arguments.seed,
                "why": arguments.why,
            }));
            client.post("/api/v1/trials", &body).await?
        }
        Command::Ls => {
            let trials: Trials = client.get("/api/v1/trials", &[]).await?;
            context.print(&trials, list)?;
            return Ok(Ended::Well);
        }
        Command::Show { id } => {
            let id = match id {
                Some(id) => id,
                None => {
                    let newest = [("limit", "1".to_owned())];
                    let newest: Trials = client.get("/api/v1/trials", &newest).await?;
                    let trial = newest.trials.first().context("there are no trials yet")?;
                    trial.id
                }
            };
            client.get(&format!("/api/v1/trials/{id}"), &[]).await?
        }
        Command::End { id } => {
            client
                .post(&format!("/api/v1/trials/{id}/end"), &json!({}))
                .await?
        }
    };
    context.print(&trial, whole)?;
    Ok(Ended::Well)
}

fn values(trial: &TrialView) -> String {
    let values = trial.plan.values.iter();
    values.map(threshold).collect::<Vec<_>>().join(", ")
}

fn list(trials: &Trials) -> String {
    let mut table = Table::new(&[">id", "values", "state", "begun", "who", "why"]);
    for trial in &trials.trials {
        table.row([
            trial.id.to_string(),
            values(trial),
            trial.phase.name().to_owned(),
            when(trial.begun_ms),
            trial.who.clone(),
            trial.plan.why.clone(),
        ]);
    }
    table.to_string()
}

fn whole(trial: &TrialView) -> String {
    let mut text = format!(
        "trial {} of {}: {}; {}; seed {}\n",
        trial.id,
        values(trial),
        trial.phase.name(),
        counts(&trial.counts),
        trial.seed,
    );
    let Some(result) = &trial.result else {
        return text;
    };
    let level = result.confidence * 100.0;
    text += &format!(
        "changes beyond that of the first value's nodes; all intervals together hold at {level} %\n"
    );
    let mut table = Table::new(&[
        "figure",
        ">value",
        ">nodes",
        ">clips",
        ">before",
        ">during",
        "difference",
    ]);
    for shown in Figure::ALL {
        for arm in &result.values {
            let Some(found) = arm.figures.iter().find(|found| found.figure == shown) else {
                continue;
            };
            let difference = found.difference.as_ref();
            table.row([
                shown.to_string(),
                threshold(&arm.value),
                found.nodes.to_string(),
                found.clips.to_string(),
                figure(found.before),
                figure(found.mean),
                difference.map_or("-".to_owned(), |d| {
                    interval(d, shown.scale() == Scale::Relative)
                }),
            ]);
        }
    }
    text + &table.to_string()
}
