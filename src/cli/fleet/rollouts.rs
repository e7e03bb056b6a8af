//! `rollout`: changes in stages.

use super::table::{Table, WIDTH, cut, wrapped};
use super::units::{counts, figure, finite, items, named, seconds, span, text_of, threshold, when};
use super::{Context, Ended};
use serde_json::{Value, json};
use std::fmt::Write;
use std::time::Duration;

/// Time between two looks with `--follow`.
const LOOK: Duration = Duration::from_secs(2);

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    /// Begin one.
    Start(Box<StartArguments>),
    /// All, the newest first.
    Ls,
    /// One with its stages, its verdicts and their numbers.
    Show {
        /// Its number; the newest where none is given.
        id: Option<u64>,
        /// Look again until it is done, held or back.
        #[arg(long)]
        follow: bool,
    },
    /// Let time stand still for it.
    Pause {
        /// Its number.
        id: u64,
    },
    /// Continue it; a stage that is held soaks again.
    Resume {
        /// Its number.
        id: u64,
    },
    /// The next stage now, whatever the gates say.
    Next {
        /// Its number.
        id: u64,
    },
    /// Give all its nodes their old values back.
    Return {
        /// Its number.
        id: u64,
    },
    /// End it; every node keeps what it has.
    Stop {
        /// Its number.
        id: u64,
    },
}

const START_EXAMPLES: &str = "\
Gates bound what the change may cost: skip_rate>=-0.05 (may fall by 0.05),
joules<=+5% (of a clip), edp, latency_p99, degraded, recall, precision. The
change is that of the stage's nodes beyond that of the nodes not asked yet, over
the same hours; with fewer than eight on either side a gate is not measured. A
gate with ? at its end holds only where the metric is reported. Measured and
estimated energy are two figures.

Examples:
  albireo fleet rollout start 5e-4 --select all
  albireo fleet rollout start 5e-4 --select 'cam-*' --stages 8,25%,50% \\
      --soak 8h \\
      --gate 'joules<=+5%' --gate 'latency_p99<=+10%' --on-failure hold --why
      'quieter streets'";

/// Arguments of `albireo fleet rollout start`.
#[derive(Debug, clap::Args)]
#[command(after_help = START_EXAMPLES)]
pub(super) struct StartArguments {
    /// The new value.
    #[arg(value_parser = finite)]
    value: f64,
    /// Which nodes; may be given several times.
    #[arg(long, required = true, value_name = "SELECTOR")]
    select: Vec<String>,
    /// The knob's name, for nodes under another policy.
    #[arg(long, default_value = "u")]
    knob: String,
    /// How many nodes have the value in each stage, numbers or percent (rounded up), the last 100%.
    #[arg(long, value_delimiter = ',', value_name = "SIZES")]
    stages: Vec<String>,
    /// How long a stage is held before it is judged.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    soak: Option<f64>,
    /// How much longer, where it could not be judged.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    patience: Option<f64>,
    /// How far back the measurements before the change go.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    baseline: Option<f64>,
    /// What the change may cost; may be given several times, and replaces the gates by default.
    #[arg(long = "gate", value_name = "GATE")]
    gates: Vec<String>,
    /// How sure a verdict must be.
    #[arg(long, value_name = "SHARE", value_parser = finite)]
    confidence: Option<f64>,
    /// Fewest clips of a node before and after.
    #[arg(long, value_name = "N")]
    fewest_clips: Option<u64>,
    /// When a gate fails: give the old value back, or hold.
    #[arg(long, value_parser = ["return", "hold"])]
    on_failure: Option<String>,
    /// How long a node in reach may take to report the value.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    apply_within: Option<f64>,
    /// How long a node may stay out of reach; then its value is withdrawn.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    offline_deadline: Option<f64>,
    /// Draws the order of the nodes.
    #[arg(long)]
    seed: Option<u64>,
    /// Why; kept in the history.
    #[arg(long, default_value = "")]
    why: String,
    /// Look until it is done, held or back.
    #[arg(long)]
    follow: bool,
}

pub(super) async fn run(context: &Context, command: Command) -> anyhow::Result<Ended> {
    let (id, order) = match command {
        Command::Start(arguments) => return start(context, *arguments).await,
        Command::Ls => {
            let rollouts = context.client.get("/api/v1/rollouts", &[]).await?;
            context.print(&rollouts, list)?;
            return Ok(Ended::Well);
        }
        Command::Show { id, follow } => {
            let id = match id {
                Some(id) => id,
                None => context.client.newest("rollouts").await?,
            };
            if follow {
                return self::follow(context, id).await;
            }
            let rollout = context
                .client
                .get(&format!("/api/v1/rollouts/{id}"), &[])
                .await?;
            context.print(&rollout, whole)?;
            return Ok(judge(&rollout));
        }
        Command::Pause { id } => (id, "pause"),
        Command::Resume { id } => (id, "resume"),
        Command::Next { id } => (id, "next"),
        Command::Return { id } => (id, "return"),
        Command::Stop { id } => (id, "stop"),
    };
    let rollout = context
        .client
        .post(&format!("/api/v1/rollouts/{id}/{order}"), &json!({}))
        .await?;
    context.print(&rollout, |rollout| headline(rollout) + "\n")?;
    Ok(Ended::Well)
}

async fn start(context: &Context, arguments: StartArguments) -> anyhow::Result<Ended> {
    // What is not given has the hub's default.
    let given = |list: Vec<String>| (!list.is_empty()).then_some(list);
    let body = named(json!({
        (arguments.knob): arguments.value,
        "select": arguments.select,
        "stages": given(arguments.stages),
        "soak_s": arguments.soak,
        "patience_s": arguments.patience,
        "baseline_s": arguments.baseline,
        "gates": given(arguments.gates),
        "confidence": arguments.confidence,
        "fewest_clips": arguments.fewest_clips,
        "on_failure": arguments.on_failure,
        "apply_within_s": arguments.apply_within,
        "offline_deadline_s": arguments.offline_deadline,
        "seed": arguments.seed,
        "why": arguments.why,
    }));
    let rollout = context.client.post("/api/v1/rollouts", &body).await?;
    let id = rollout["id"].as_u64().unwrap_or(0);
    if arguments.follow {
        return follow(context, id).await;
    }
    context.print(&rollout, |rollout| {
        let mut text = headline(rollout) + "\n";
        for left in items(&rollout["left_out"]) {
            let line = format!(
                "  without {}: {}",
                left["node"].as_str().unwrap_or("?"),
                left["why"].as_str().unwrap_or("?")
            );
            text += &(cut(&line, WIDTH) + "\n");
        }
        text + &format!("albireo fleet rollout show {id} --follow\n")
    })?;
    Ok(Ended::Well)
}

async fn follow(context: &Context, id: u64) -> anyhow::Result<Ended> {
    let mut printed = 0;
    loop {
        let rollout = context
            .client
            .get(&format!("/api/v1/rollouts/{id}"), &[])
            .await?;
        let record = rollout["record"].as_array().cloned().unwrap_or_default();
        for entry in record.iter().skip(printed) {
            if context.json {
                println!("{entry}");
            } else {
                print!("{}", entry_text(entry, begun_ms(&rollout)));
            }
        }
        printed = record.len().max(printed);
        let phase = rollout["phase"].as_str().unwrap_or_default();
        if matches!(phase, "done" | "returned" | "stopped" | "held") {
            if !context.json {
                println!("{}", headline(&rollout));
            }
            return Ok(judge(&rollout));
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn begun_ms(rollout: &Value) -> i64 {
    rollout["begun_ms"].as_i64().unwrap_or(0)
}

fn judge(rollout: &Value) -> Ended {
    match rollout["phase"].as_str() {
        Some("done" | "stopped") => Ended::Well,
        Some("returned" | "returning") => Ended::Failed,
        _ => Ended::Open,
    }
}

fn state(rollout: &Value) -> String {
    let phase = rollout["phase"].as_str().unwrap_or("?");
    if rollout["paused"].as_bool() == Some(true) {
        format!("{phase}, paused")
    } else {
        phase.to_owned()
    }
}

fn headline(rollout: &Value) -> String {
    let stages = rollout["stages"].as_array().map_or(0, Vec::len);
    let mut text = format!(
        "rollout {} to {}: {}, stage {} of {stages}",
        rollout["id"],
        threshold(&rollout["to"]),
        state(rollout),
        rollout["stage"],
    );
    if let Some(reason) = rollout["reason"].as_str() {
        text += &format!(" ({reason})");
    }
    text
}

fn list(rollouts: &Value) -> String {
    let mut table = Table::new(&[
        ">id", ">to", "state", ">stage", ">nodes", "begun", "who", "why",
    ]);
    for rollout in items(&rollouts["rollouts"]) {
        let stages = items(&rollout["stages"]);
        let nodes: u64 = stages
            .iter()
            .filter_map(|stage| stage["nodes"].as_u64())
            .sum();
        table.row([
            rollout["id"].to_string(),
            threshold(&rollout["to"]),
            state(rollout),
            format!("{}/{}", rollout["stage"], stages.len()),
            nodes.to_string(),
            when(&rollout["begun_ms"]),
            text_of(&rollout["who"]),
            text_of(&rollout["plan"]["why"]),
        ]);
    }
    table.to_string()
}

fn whole(rollout: &Value) -> String {
    let mut text = headline(rollout) + "\n";
    let plan = &rollout["plan"];
    let join = |list: &Value| {
        list.as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect::<Vec<_>>()
            .join(", ")
    };
    let soak = plan["soak_s"].as_f64().unwrap_or(0.0);
    let _ = writeln!(
        text,
        "  nodes {}; stages {}; soak {}",
        join(&plan["select"]),
        join(&plan["stages"]),
        span(soak as i64)
    );
    let _ = writeln!(
        text,
        "  gates {}; on failure {}",
        join(&plan["gates"]),
        plan["on_failure"].as_str().unwrap_or("?")
    );
    for (i, stage) in items(&rollout["stages"]).iter().enumerate() {
        let counts = counts(stage);
        let counts = if counts.is_empty() {
            "not begun".to_owned()
        } else {
            counts
        };
        let _ = writeln!(
            text,
            "  stage {}: {} nodes, {counts}",
            i + 1,
            stage["nodes"]
        );
    }
    for entry in items(&rollout["record"]) {
        text += &entry_text(entry, begun_ms(rollout));
    }
    text
}

/// An entry of a rollout's record, with its time since the rollout began.
fn entry_text(entry: &Value, begun_ms: i64) -> String {
    let who = entry["who"]
        .as_str()
        .map(|who| format!(" by {who}"))
        .unwrap_or_default();
    let said = match entry["text"].as_str().unwrap_or_default() {
        "" => String::new(),
        text => format!(": {text}"),
    };
    let line = format!(
        "{:>10}  stage {}  {}{who}{said}",
        format!(
            "+{}",
            span((entry["at_ms"].as_i64().unwrap_or(begun_ms) - begun_ms) / 1000)
        ),
        entry["stage"],
        entry["what"].as_str().unwrap_or("?"),
    );
    // Why a stage failed is what it is all about: it is not cut.
    let mut text = wrapped(&line, 15);
    let gates = items(&entry["gates"]);
    if gates.is_empty() {
        return text;
    }
    let mut table = Table::new(&[
        "   gate", "figure", ">nodes", ">others", ">before", ">after", "change", "verdict",
    ]);
    for gate in gates {
        let name = gate["gate"].as_str().unwrap_or("?");
        let percent = name.contains('%');
        let shown = |value: &Value| match value.as_f64() {
            Some(value) if percent => format!("{:+.1}%", value * 100.0),
            Some(value) => format!("{value:+.4}"),
            None => "-".to_owned(),
        };
        let change = &gate["change"];
        let change = match change.is_null() {
            true => "-".to_owned(),
            false => format!(
                "{} [{}, {}]",
                shown(&change["estimate"]),
                shown(&change["lower"]),
                shown(&change["upper"])
            ),
        };
        let mean = |value: &Value| value.as_f64().map_or_else(|| "-".to_owned(), figure);
        table.row([
            format!("   {name}"),
            gate["figure"].as_str().unwrap_or("not measured").to_owned(),
            gate["nodes"].to_string(),
            gate["compared"].to_string(),
            mean(&gate["before"]),
            mean(&gate["after"]),
            change,
            gate["verdict"].as_str().unwrap_or("?").replace('_', " "),
        ]);
    }
    text += &table.to_string();
    text
}
