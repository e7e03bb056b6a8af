//! `rollout`: changes in stages.

use super::table::{Table, WIDTH, cut, wrapped};
use super::units::{
    counts, figure, finite, interval, name_of, named, nodes, seconds, span, threshold, when,
};
use super::{Context, Ended};
use albireo_hub::http::{RolloutView, Rollouts};
use albireo_hub::tuning::rollout::{Entry, Phase};
use anyhow::Context as _;
use serde_json::json;
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
        id: Option<i64>,
        /// Look again until it is done, held or back.
        #[arg(long)]
        follow: bool,
    },
    /// Let time stand still for it.
    Pause {
        /// Its number.
        id: i64,
    },
    /// Continue it; a stage that is held soaks again.
    Resume {
        /// Its number.
        id: i64,
    },
    /// The next stage now, whatever the gates say.
    Next {
        /// Its number.
        id: i64,
    },
    /// Give all its nodes their old values back.
    Return {
        /// Its number.
        id: i64,
    },
    /// End it; every node keeps what it has.
    Stop {
        /// Its number.
        id: i64,
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
            let rollouts: Rollouts = context.client.get("/api/v1/rollouts", &[]).await?;
            context.print(&rollouts, list)?;
            return Ok(Ended::Well);
        }
        Command::Show { id, follow } => {
            let id = match id {
                Some(id) => id,
                None => {
                    let newest = [("limit", "1".to_owned())];
                    let newest: Rollouts = context.client.get("/api/v1/rollouts", &newest).await?;
                    let rollout = newest.rollouts.first();
                    rollout.context("there are no rollouts yet")?.id
                }
            };
            if follow {
                return self::follow(context, id).await;
            }
            let rollout = rollout(context, id).await?;
            context.print(&rollout, whole)?;
            return Ok(judge(&rollout));
        }
        Command::Pause { id } => (id, "pause"),
        Command::Resume { id } => (id, "resume"),
        Command::Next { id } => (id, "next"),
        Command::Return { id } => (id, "return"),
        Command::Stop { id } => (id, "stop"),
    };
    let rollout: RolloutView = context
        .client
        .post(&format!("/api/v1/rollouts/{id}/{order}"), &json!({}))
        .await?;
    context.print(&rollout, |rollout| headline(rollout) + "\n")?;
    Ok(Ended::Well)
}

async fn start(context: &Context, arguments: StartArguments) -> anyhow::Result<Ended> {
    // What is not given has the hub's default.
    let nonempty = |list: Vec<String>| (!list.is_empty()).then_some(list);
    let body = named(json!({
        (arguments.knob): arguments.value,
        "select": arguments.select,
        "stages": nonempty(arguments.stages),
        "soak_s": arguments.soak,
        "patience_s": arguments.patience,
        "baseline_s": arguments.baseline,
        "gates": nonempty(arguments.gates),
        "confidence": arguments.confidence,
        "fewest_clips": arguments.fewest_clips,
        "on_failure": arguments.on_failure,
        "apply_within_s": arguments.apply_within,
        "offline_deadline_s": arguments.offline_deadline,
        "seed": arguments.seed,
        "why": arguments.why,
    }));
    let rollout: RolloutView = context.client.post("/api/v1/rollouts", &body).await?;
    if arguments.follow {
        return follow(context, rollout.id).await;
    }
    context.print(&rollout, |rollout| {
        let mut text = headline(rollout) + "\n";
        for left_out in &rollout.left_out {
            let line = format!("  without {}: {}", left_out.node, left_out.why);
            text += &(cut(&line, WIDTH) + "\n");
        }
        text + &format!("albireo fleet rollout show {} --follow\n", rollout.id)
    })?;
    Ok(Ended::Well)
}

async fn rollout(context: &Context, id: i64) -> anyhow::Result<RolloutView> {
    let path = format!("/api/v1/rollouts/{id}");
    context.client.get(&path, &[]).await
}

async fn follow(context: &Context, id: i64) -> anyhow::Result<Ended> {
    let mut printed = 0;
    loop {
        let rollout = rollout(context, id).await?;
        let record = rollout.record.as_deref().unwrap_or_default();
        for entry in record.iter().skip(printed) {
            if context.json {
                println!("{}", serde_json::to_string(entry)?);
            } else {
                print!("{}", entry_text(entry, rollout.begun_ms));
            }
        }
        printed = record.len().max(printed);
        use Phase::{Done, Held, Returned, Stopped};
        if matches!(rollout.phase, Done | Returned | Stopped | Held { .. }) {
            if !context.json {
                println!("{}", headline(&rollout));
            }
            return Ok(judge(&rollout));
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn judge(rollout: &RolloutView) -> Ended {
    match rollout.phase {
        Phase::Done | Phase::Stopped => Ended::Well,
        Phase::Returned | Phase::Returning { .. } => Ended::Failed,
        _ => Ended::Open,
    }
}

fn state(rollout: &RolloutView) -> String {
    let paused = if rollout.paused { ", paused" } else { "" };
    format!("{}{paused}", rollout.phase.name())
}

fn headline(rollout: &RolloutView) -> String {
    let text = format!(
        "rollout {} to {}: {}, stage {} of {}",
        rollout.id,
        threshold(&rollout.to),
        state(rollout),
        rollout.stage,
        rollout.stages.len(),
    );
    match &rollout.phase {
        Phase::Held { reason, .. } | Phase::Returning { reason, .. } => {
            format!("{text} ({reason})")
        }
        _ => text,
    }
}

fn list(rollouts: &Rollouts) -> String {
    let mut table = Table::new(&[
        ">id", ">to", "state", ">stage", ">nodes", "begun", "who", "why",
    ]);
    for rollout in &rollouts.rollouts {
        let nodes: usize = rollout.stages.iter().map(|stage| stage.nodes).sum();
        table.row([
            rollout.id.to_string(),
            threshold(&rollout.to),
            state(rollout),
            format!("{}/{}", rollout.stage, rollout.stages.len()),
            nodes.to_string(),
            when(rollout.begun_ms),
            rollout.who.clone(),
            rollout.plan.why.clone(),
        ]);
    }
    table.to_string()
}

fn whole(rollout: &RolloutView) -> String {
    let plan = &rollout.plan;
    let mut text = headline(rollout) + "\n";
    let _ = writeln!(
        text,
        "  nodes {}; stages {}; soak {}",
        plan.select,
        joined(&plan.stages),
        span(plan.soak_s as i64)
    );
    let _ = writeln!(
        text,
        "  gates {}; on failure {}",
        joined(&plan.gates),
        name_of(&plan.on_failure)
    );
    for (number, stage) in (1..).zip(&rollout.stages) {
        let counts = match stage.counts.is_empty() {
            true => "not begun".to_owned(),
            false => counts(&stage.counts),
        };
        let _ = writeln!(
            text,
            "  stage {number}: {}, {counts}",
            nodes(stage.nodes as u64)
        );
    }
    for entry in rollout.record.iter().flatten() {
        text += &entry_text(entry, rollout.begun_ms);
    }
    text
}

fn joined(list: &[impl ToString]) -> String {
    let texts: Vec<String> = list.iter().map(ToString::to_string).collect();
    texts.join(", ")
}

/// An entry of a rollout's record, with its time since the rollout began.
fn entry_text(entry: &Entry, begun_ms: i64) -> String {
    let who = entry.who.as_ref().map(|who| format!(" by {who}"));
    let text = match entry.text.as_str() {
        "" => String::new(),
        text => format!(": {text}"),
    };
    let line = format!(
        "{:>10}  stage {}  {}{}{text}",
        format!("+{}", span((entry.at_ms - begun_ms) / 1000)),
        entry.stage,
        name_of(&entry.what),
        who.unwrap_or_default(),
    );
    // Why a stage failed is what it is all about: it is not cut.
    let mut text = wrapped(&line, 15);
    if entry.gates.is_empty() {
        return text;
    }
    let mut table = Table::new(&[
        "   gate", "figure", ">nodes", ">others", ">before", ">after", "change", "verdict",
    ]);
    let mean = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), figure);
    for result in &entry.gates {
        let measured = result.figure.map(|figure| figure.to_string());
        let change = result.change.as_ref();
        table.row([
            format!("   {}", result.gate),
            measured.unwrap_or_else(|| "not measured".to_owned()),
            result.nodes.to_string(),
            result.compared.to_string(),
            mean(result.before),
            mean(result.after),
            change.map_or("-".to_owned(), |change| {
                interval(change, result.gate.relative)
            }),
            name_of(&result.verdict),
        ]);
    }
    text += &table.to_string();
    text
}
