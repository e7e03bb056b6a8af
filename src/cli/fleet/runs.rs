//! Runs the commands `rollout` and `trial`: changes in stages, and values compared on random groups of nodes.

use super::table::{cut, table};
use super::units::{
    counts, figure, finite, interval, joined, name_of, nodes, seconds, span, threshold, when,
};
use super::{Context, Ended};
use crate::cli::terminal::{program, width};
use albireo_hub::http::Runs;
use albireo_hub::tuning::effect::Scale;
use albireo_hub::tuning::metric::Figure;
use albireo_hub::tuning::run::{Entry, Kind, Phase, Run, TrialResult};
use anyhow::bail;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

/// The time between two updates with `--follow`.
const UPDATE_INTERVAL: Duration = Duration::from_secs(2);

/// The number of a rollout or a trial.
#[derive(Debug, clap::Args)]
pub(super) struct Number {
    /// Its number.
    id: i64,
}

#[derive(Debug, clap::Subcommand)]
pub(super) enum RolloutCommand {
    /// Start a rollout.
    Start(Box<RolloutArguments>),
    /// List all rollouts, the newest first.
    Ls,
    /// Show a rollout with its stages, its verdicts and their numbers.
    Show {
        /// Its number [default: the newest]
        id: Option<i64>,
        /// Show updates until it is done, held or returned.
        #[arg(long)]
        follow: bool,
    },
    /// Pause a rollout and its timers.
    Pause(Number),
    /// Continue a rollout; a stage that is held soaks again.
    Resume(Number),
    /// Begin the next stage now, regardless of the gates.
    Next(Number),
    /// Return all nodes of a rollout to their old values.
    Return(Number),
    /// End a rollout; every node keeps its value.
    Stop(Number),
}

/// Arguments of `albireo fleet rollout start`. What is serialised is the plan of the request.
#[derive(Debug, clap::Args, Serialize)]
#[command(after_help = "\
Gates bound what the change may cost: skip_rate>=-0.05 (may fall by 0.05),
joules<=+5% (of a clip), edp, latency_p99, degraded, recall, precision. The
change of the stage's nodes is compared with that of the nodes not asked yet,
over the same hours; with fewer than eight on either side a gate is not
measured. A gate that ends with ? applies only where the metric is reported.
Measured and estimated energy are separate figures.")]
pub(super) struct RolloutArguments {
    /// The new value.
    #[arg(value_parser = finite)]
    #[serde(skip)]
    value: f64,
    #[command(flatten)]
    #[serde(flatten)]
    basics: Basics,
    /// How many nodes have the value in each stage, numbers or percent (rounded up).
    #[arg(long, value_delimiter = ',', value_name = "SIZES")]
    stages: Vec<String>,
    /// Time that a stage is held before it is judged.
    #[arg(long = "soak", value_parser = seconds, value_name = "TIME")]
    soak_s: Option<f64>,
    /// Further time if the stage could not be judged.
    #[arg(long = "patience", value_parser = seconds, value_name = "TIME")]
    patience_s: Option<f64>,
    /// Bound on what the change may cost; may be repeated, and replaces the default gates.
    #[arg(long = "gate", value_name = "GATE")]
    gates: Vec<String>,
    /// Action when a gate fails: return the old values, or hold.
    #[arg(long, value_parser = ["return", "hold"])]
    on_failure: Option<String>,
    /// Time that a node may stay out of reach; then its value is withdrawn.
    #[arg(long = "offline-deadline", value_parser = seconds, value_name = "TIME")]
    offline_deadline_s: Option<f64>,
    /// Show updates until it is done, held or returned.
    #[arg(long)]
    #[serde(skip)]
    follow: bool,
}

#[derive(Debug, clap::Subcommand)]
pub(super) enum TrialCommand {
    /// Start a trial.
    Start(TrialArguments),
    /// List all trials, the newest first.
    Ls,
    /// Show a trial with its result.
    Show {
        /// Its number [default: the newest]
        id: Option<i64>,
    },
    /// End a trial now, with the results so far; the old values return.
    End(Number),
}

/// Arguments of `albireo fleet trial start`. What is serialised is the plan of the request.
#[derive(Debug, clap::Args, Serialize)]
pub(super) struct TrialArguments {
    /// The values, two or more; each is compared with the first.
    #[arg(required = true, num_args = 2.., value_parser = finite)]
    #[serde(skip)]
    values: Vec<f64>,
    #[command(flatten)]
    #[serde(flatten)]
    basics: Basics,
    /// Time that the values are kept.
    #[arg(long = "for", value_parser = seconds, default_value = "1h", value_name = "TIME")]
    duration_s: f64,
}

/// The arguments that rollouts and trials have in common.
#[derive(Debug, clap::Args, Serialize)]
struct Basics {
    /// The nodes to change; may be given several times.
    #[arg(long, required = true, value_name = "SELECTOR")]
    select: Vec<String>,
    /// The threshold's name, for nodes under another policy.
    #[arg(long, default_value = "u")]
    #[serde(skip)]
    threshold: String,
    /// Length of the measurements before the change.
    #[arg(long = "baseline", value_parser = seconds, value_name = "TIME")]
    baseline_s: Option<f64>,
    /// Confidence level of verdicts and intervals.
    #[arg(long, value_name = "SHARE", value_parser = finite)]
    confidence: Option<f64>,
    /// Fewest clips of a node before and after.
    #[arg(long, value_name = "N")]
    fewest_clips: Option<u64>,
    /// Time that an online node has to report the value.
    #[arg(long = "apply-within", value_parser = seconds, value_name = "TIME")]
    apply_within_s: Option<f64>,
    /// Seed of the random order of the nodes, or of the groups.
    #[arg(long)]
    seed: Option<u64>,
    /// The reason, which is kept in the history.
    #[arg(long, default_value = "")]
    why: String,
}

/// Starts a rollout or a trial with this plan, whose field `name` is `value`. The hub has defaults for absent fields.
async fn begin(
    context: &Context,
    path: &str,
    plan: &impl Serialize,
    name: &str,
    value: Value,
) -> anyhow::Result<Run> {
    let mut body = serde_json::to_value(plan)?;
    body[name] = value;
    if let Some(body) = body.as_object_mut() {
        body.retain(|_, value| !value.is_null() && *value != json!([]));
    }
    context.client.post(path, &body).await
}

pub(super) async fn rollout(context: &Context, command: RolloutCommand) -> anyhow::Result<Ended> {
    use RolloutCommand::{Ls, Next, Pause, Resume, Return, Show, Start, Stop};
    let client = &context.client;
    let (id, order) = match command {
        Start(arguments) => return start(context, *arguments).await,
        Ls => {
            let rollouts: Runs = client.get("/api/v1/rollouts", &[]).await?;
            return context.print(&rollouts, |found| list(&found.runs));
        }
        Show { id, follow } => {
            let id = number(context, "rollouts", id).await?;
            if follow {
                return self::follow(context, id).await;
            }
            let rollout: Run = client.get(&format!("/api/v1/rollouts/{id}"), &[]).await?;
            context.print(&rollout, whole)?;
            return Ok(judge(&rollout));
        }
        Pause(Number { id }) => (id, "pause"),
        Resume(Number { id }) => (id, "resume"),
        Next(Number { id }) => (id, "next"),
        Return(Number { id }) => (id, "return"),
        Stop(Number { id }) => (id, "stop"),
    };
    let path = format!("/api/v1/rollouts/{id}/{order}");
    let rollout: Run = client.post(&path, &json!({})).await?;
    context.print(&rollout, |rollout| headline(rollout) + "\n")
}

pub(super) async fn trial(context: &Context, command: TrialCommand) -> anyhow::Result<Ended> {
    let client = &context.client;
    let trial: Run = match command {
        TrialCommand::Start(plan) => {
            let named = |value: &f64| json!({ (plan.basics.threshold.as_str()): value });
            let values: Value = plan.values.iter().map(named).collect();
            begin(context, "/api/v1/trials", &plan, "values", values).await?
        }
        TrialCommand::Ls => {
            let trials: Runs = client.get("/api/v1/trials", &[]).await?;
            return context.print(&trials, |found| list(&found.runs));
        }
        TrialCommand::Show { id } => {
            let id = number(context, "trials", id).await?;
            client.get(&format!("/api/v1/trials/{id}"), &[]).await?
        }
        TrialCommand::End(Number { id }) => {
            let path = format!("/api/v1/trials/{id}/end");
            client.post(&path, &json!({})).await?
        }
    };
    context.print(&trial, whole)
}

/// Returns the number that was given, or that of the newest.
async fn number(context: &Context, kind: &str, id: Option<i64>) -> anyhow::Result<i64> {
    if let Some(id) = id {
        return Ok(id);
    }
    let path = format!("/api/v1/{kind}");
    let newest = [("limit", "1".to_owned())];
    let found: Runs = context.client.get(&path, &newest).await?;
    match found.runs.first() {
        Some(run) => Ok(run.id),
        None => bail!("there are no {kind} yet"),
    }
}

async fn start(context: &Context, arguments: RolloutArguments) -> anyhow::Result<Ended> {
    let threshold = arguments.basics.threshold.as_str();
    let value = json!(arguments.value);
    let rollout = begin(context, "/api/v1/rollouts", &arguments, threshold, value).await?;
    let id = rollout.id;
    if arguments.follow {
        return follow(context, id).await;
    }
    context.print(&rollout, |rollout| {
        let mut text = headline(rollout) + "\n";
        for left_out in &rollout.left_out {
            let line = format!("  without {}: {}", left_out.node, left_out.why);
            text += &cut(&line, width());
            text.push('\n');
        }
        text + &format!("{} fleet rollout show {id} --follow\n", program())
    })
}

async fn follow(context: &Context, id: i64) -> anyhow::Result<Ended> {
    let mut last: Option<Entry> = None;
    loop {
        let path = format!("/api/v1/rollouts/{id}");
        let run: Run = context.client.get(&path, &[]).await?;
        // The hub keeps only the newest entries, so their positions change.
        let is_last = |entry: &Entry| Some(entry) == last.as_ref();
        let first_new = match run.record.iter().rposition(is_last) {
            Some(position) => position + 1,
            None => 0,
        };
        for entry in &run.record[first_new..] {
            if context.json {
                println!("{}", serde_json::to_string(entry)?);
            } else {
                print!("{}", entry_text(entry, run.begun_ms));
            }
        }
        if let Some(newest) = run.record.last() {
            last = Some(newest.clone());
        }
        if matches!(
            run.phase,
            Phase::Done | Phase::Returned | Phase::Stopped | Phase::Held
        ) {
            if !context.json {
                println!("{}", headline(&run));
            }
            return Ok(judge(&run));
        }
        tokio::time::sleep(UPDATE_INTERVAL).await;
    }
}

fn judge(rollout: &Run) -> Ended {
    match rollout.phase {
        Phase::Done | Phase::Stopped => Ended::Well,
        Phase::Returned | Phase::Returning => Ended::Failed,
        _ => Ended::Open,
    }
}

fn state(run: &Run) -> String {
    let paused = if run.paused_ms.is_some() {
        ", paused"
    } else {
        ""
    };
    format!("{}{paused}", run.phase)
}

/// Formats the value that is rolled out, or the values that are compared.
fn values(kind: &Kind) -> String {
    match kind {
        Kind::Rollout { to, .. } => threshold(to),
        Kind::Trial { plan } => joined(plan.values.iter().map(threshold)),
    }
}

fn headline(run: &Run) -> String {
    let id = run.id;
    let values = values(&run.kind);
    let state = state(run);
    if let Kind::Trial { .. } = run.kind {
        let mut sums = BTreeMap::<_, usize>::new();
        for (outcome, nodes) in run.stages.iter().flat_map(|group| &group.counts) {
            *sums.entry(*outcome).or_default() += nodes;
        }
        let counts = counts(&sums);
        let seed = run.seed;
        return format!("trial {id} of {values}: {state}; {counts}; seed {seed}");
    }
    let reason = match run.phase {
        Phase::Held | Phase::Returning => format!(" ({})", run.reason),
        _ => String::new(),
    };
    let stage = run.stage;
    let stages = run.stages.len();
    format!("rollout {id} to {values}: {state}, stage {stage} of {stages}{reason}")
}

fn list(found: &[Run]) -> String {
    let rows = found.iter().map(|run| {
        let nodes: usize = run.stages.iter().map(|stage| stage.nodes).sum();
        [
            run.id.to_string(),
            values(&run.kind),
            state(run),
            format!("{}/{}", run.stage, run.stages.len()),
            nodes.to_string(),
            when(run.begun_ms),
            run.who.clone(),
            run.kind.basics().why.clone(),
        ]
    });
    table(">id|>to|state|>stage|>nodes|begun|who|why", rows)
}

fn whole(run: &Run) -> String {
    let mut text = headline(run) + "\n";
    let Kind::Rollout { plan, .. } = &run.kind else {
        if let Some(measured) = &run.result {
            text += &result(measured);
        }
        return text;
    };
    let _ = writeln!(
        text,
        "  nodes {}; stages {}; soak {}\n  gates {}; on failure {}",
        plan.basics.select,
        plan.stages.join(", "),
        span(plan.soak_s as i64),
        joined(plan.gates.iter().map(ToString::to_string)),
        name_of(&plan.on_failure)
    );
    for (number, stage) in (1..).zip(&run.stages) {
        let counts = if stage.counts.is_empty() {
            "not begun".to_owned()
        } else {
            counts(&stage.counts)
        };
        let nodes = nodes(stage.nodes as u64);
        let _ = writeln!(text, "  stage {number}: {nodes}, {counts}");
    }
    for entry in &run.record {
        text += &entry_text(entry, run.begun_ms);
    }
    text
}

/// Formats an entry of a rollout's record, with its time since the rollout began.
fn entry_text(entry: &Entry, begun_ms: i64) -> String {
    let who = match &entry.who {
        Some(who) => format!(" by {who}"),
        None => String::new(),
    };
    let reason = match entry.text.as_str() {
        "" => String::new(),
        text => format!(": {text}"),
    };
    // The reason a stage failed is never cut short.
    let mut text = format!(
        "{:>10}  stage {}  {}{}{reason}\n",
        format!("+{}", span((entry.at_ms - begun_ms) / 1000)),
        entry.stage,
        name_of(&entry.what),
        who,
    );
    if entry.gates.is_empty() {
        return text;
    }
    let mean = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), figure);
    let rows = entry.gates.iter().map(|result| {
        let measured = match result.figure {
            Some(figure) => figure.to_string(),
            None => "not measured".to_owned(),
        };
        let is_relative = result.gate.scale == Scale::Relative;
        let change = match &result.change {
            Some(change) => interval(change, is_relative),
            None => "-".to_owned(),
        };
        [
            format!("   {}", result.gate),
            name_of(&result.verdict),
            change,
            mean(result.before),
            mean(result.after),
            result.nodes.to_string(),
            result.compared.to_string(),
            measured,
        ]
    });
    // The verdict comes early: a terminal of 80 columns cuts the end.
    let headings = "   gate|verdict|change|>before|>after|>nodes|>others|figure";
    text += &table(headings, rows);
    text
}

/// Formats the measurements of a trial.
fn result(result: &TrialResult) -> String {
    let level = result.confidence * 100.0;
    let mut rows = Vec::new();
    for shown in Figure::ALL {
        let is_relative = shown.scale() == Scale::Relative;
        for arm in &result.values {
            let Some(found) = arm.figures.iter().find(|found| found.figure == shown) else {
                continue;
            };
            let difference = match &found.difference {
                Some(difference) => interval(difference, is_relative),
                None => "-".to_owned(),
            };
            rows.push([
                shown.to_string(),
                threshold(&arm.value),
                found.nodes.to_string(),
                found.clips.to_string(),
                figure(found.before),
                figure(found.mean),
                difference,
            ]);
        }
    }
    let headings = "figure|>value|>nodes|>clips|>before|>during|difference";
    let table = table(headings, rows);
    format!(
        "changes beyond that of the first value's nodes; all intervals together hold at {level} %\n{table}"
    )
}
