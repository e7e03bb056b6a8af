//! `trial`: values compared on random groups of nodes.

use super::table::Table;
use super::units::{counts, figure, finite, items, named, seconds, text_of, threshold, when};
use super::{Context, Ended};
use serde_json::{Value, json};

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Begin one.
    Start(StartArguments),
    /// All, the newest first.
    Ls,
    /// One with its result.
    Show {
        /// Its number; the newest where none is given.
        id: Option<u64>,
    },
    /// End it now, with what was measured; the old values return.
    End {
        /// Its number.
        id: u64,
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
    let trial = match command {
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
            let trials = client.get("/api/v1/trials", &[]).await?;
            context.print(&trials, list)?;
            return Ok(Ended::Well);
        }
        Command::Show { id } => {
            let id = match id {
                Some(id) => id,
                None => client.newest("trials").await?,
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

fn values(trial: &Value) -> String {
    let values = items(&trial["plan"]["values"]).iter();
    values.map(threshold).collect::<Vec<_>>().join(", ")
}

fn list(trials: &Value) -> String {
    let mut table = Table::new(&[">id", "values", "state", "begun", "who", "why"]);
    for trial in items(&trials["trials"]) {
        table.row([
            trial["id"].to_string(),
            values(trial),
            text_of(&trial["phase"]),
            when(&trial["begun_ms"]),
            text_of(&trial["who"]),
            text_of(&trial["plan"]["why"]),
        ]);
    }
    table.to_string()
}

fn whole(trial: &Value) -> String {
    let counts = counts(trial);
    let mut text = format!(
        "trial {} of {}: {}; {}; seed {}\n",
        trial["id"],
        values(trial),
        trial["phase"].as_str().unwrap_or("?"),
        counts,
        trial["seed"],
    );
    let result = &trial["result"];
    if result.is_null() {
        return text;
    }
    let level = result["confidence"].as_f64().unwrap_or(0.0) * 100.0;
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
    let difference = |of: &Value, name: &str| {
        let relative = ["joules", "edp", "latency"]
            .iter()
            .any(|start| name.starts_with(start));
        let shown = |end: &str| match of[end].as_f64() {
            Some(value) if relative => format!("{:+.1}%", value * 100.0),
            Some(value) => format!("{value:+.4}"),
            None => "?".to_owned(),
        };
        match of.is_null() {
            true => "-".to_owned(),
            false => format!(
                "{} [{}, {}]",
                shown("estimate"),
                shown("lower"),
                shown("upper")
            ),
        }
    };
    let arms = items(&result["values"]);
    let figures = [
        "joules_measured",
        "joules_estimated",
        "edp_measured",
        "edp_estimated",
        "skip_rate",
        "latency_p99",
        "degraded",
    ];
    for name in figures {
        for arm in arms {
            let of = items(&arm["figures"]).iter().find(|f| f["figure"] == name);
            let Some(found) = of else { continue };
            table.row([
                name.to_owned(),
                threshold(&arm["value"]),
                found["nodes"].to_string(),
                found["clips"].to_string(),
                figure(found["before"].as_f64().unwrap_or(0.0)),
                figure(found["mean"].as_f64().unwrap_or(0.0)),
                difference(&found["difference"], name),
            ]);
        }
    }
    text + &table.to_string()
}
