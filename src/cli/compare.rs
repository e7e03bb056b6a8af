//! `albireo compare`: plays the same clip to a live node under several policies, and compares them.

use super::play::clip::{self, Extent, Loaded};
use super::play::{Played, Player, check_pace, choose_meter, node_configuration, with_truth};
use super::progress;
use super::terminal;
use super::values::{above_zero, counted, not_negative, parse_rate};
use albireo_core::geometry::PictureSize;
use albireo_eval::boxes::ScoredBox;
use albireo_eval::compare::{
    Boxes, ClassNumbers, Comparison, Playback, Run, ScheduledRun, TruthSize, agreement,
    agreement_with_truth, render, schedule, summarise, variants, write,
};
use albireo_eval::data::classes::Evaluated;
use albireo_eval::data::{GroundTruth, LoadReport, Rules, TruthFormat};
use albireo_eval::footage::{FrameSource, SourceName, VideoEncoding};
use albireo_eval::judge::{Ignored, Truth};
use albireo_eval::spec::{BASELINE, Base, PolicySpec};
use albireo_node::config::NodeConfig;
use albireo_service::{logging, signals};
use albireo_vision::detector::HeadSetting;
use anyhow::{Context, bail};
use indicatif::HumanDuration;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// The table shows dropped frames; the node keeps no reports and is not ready immediately on purpose.
const LOG_LEVEL: &str = "warn,albireo_node::input::receiver=error,albireo_node::outbox=error,albireo_service::readiness=error";

/// Headings of the help.
const PLAYING: &str = "How it is played";
const NODE: &str = "The node";

/// Arguments of `albireo compare`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Each run starts a node as `albireo node` does (same code, same configuration),
and a camera that plays the clip to it over a separate Zenoh session. Every
second round is played in reverse order, so that slow changes of the machine
affect all policies alike. A round is one sample; intervals are Student's t over
the rounds. Ctrl-C ends the comparison with the rounds that are complete.

Frames arrive at the clip's own rate, as on a board: energy is then the cost of
a camera over that time, and EDP differs as energy does. With --unpaced each
frame arrives as soon as the node has taken the last one: energy is then the
cost of the clip without waiting.

Without a power meter the command compares CPU time and detector calls, and
marks energy as estimated. `albireo power` lists the meters that work here.

Examples:
  albireo compare
      vanilla, albireo and expected-loss on the demonstration's road, 5 rounds
      of 20 s: about seven minutes
  albireo compare --policy vanilla --policy albireo --u 3e-4 --u 1e-3 \\
      --clip drive.mp4
      two thresholds on your own recording (needs ffmpeg)
  albireo compare --config /etc/albireo/node.toml --clip drive.mp4 --out results
      with this board's detector and meter; every run as JSON and CSV
  albireo compare --detector yolo26n.onnx --u 5e-4 --clip drive.mp4
      another model without a configuration file")]
pub(super) struct CompareArguments {
    /// A policy, as NAME or NAME:SETTING; may be repeated. `,pause_s=SECONDS` behind it adds a pause on an empty road. The
    /// others are compared with the first
    #[arg(long, value_name = "NAME[:SETTING]", default_values = [BASELINE, "albireo", "expected-loss"])]
    policy: Vec<String>,
    /// Threshold of the policies that have one; may be repeated to try several [default: the configuration's]
    #[arg(long, value_name = "U", value_delimiter = ',')]
    u: Vec<f64>,
    /// A video file, a folder of JPEG and PNG files, a tar archive of such folders, or `demo`, which is demo/road.tar
    #[arg(long, value_name = "FILE", default_value = "demo")]
    clip: SourceName,
    /// Rounds; each plays every policy once
    #[arg(long, help_heading = PLAYING, value_name = "COUNT", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
    /// Play at most this many seconds of the clip
    #[arg(long, help_heading = PLAYING, default_value_t = 20.0, value_parser = above_zero)]
    seconds: f64,
    /// Frames per second of a source that has none of its own
    #[arg(long, help_heading = PLAYING, value_name = "FPS", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Play this many times as fast as the clip's own rate
    #[arg(long, help_heading = PLAYING, value_name = "FACTOR", default_value_t = 1.0, value_parser = parse_rate, conflicts_with = "unpaced")]
    speed: f64,
    /// Play as fast as the node accepts frames; none is dropped
    #[arg(long, help_heading = PLAYING)]
    unpaced: bool,
    /// Warm-up before each run, seconds of the clip
    #[arg(long, help_heading = PLAYING, value_name = "SECONDS", default_value_t = 2.0, value_parser = not_negative)]
    warm_up: f64,
    /// Rest before each run, seconds
    #[arg(long, help_heading = PLAYING, value_name = "SECONDS", default_value_t = 3.0, value_parser = not_negative)]
    cool_down: f64,
    /// Configuration of the node: detector, screen, policy settings and meter are taken from it
    #[arg(long, short, help_heading = NODE, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// The detector, an ONNX file [default: the configuration's]
    #[arg(long, alias = "model", help_heading = NODE, value_name = "FILE")]
    detector: Option<PathBuf>,
    /// How the detector's output is read
    #[arg(long, value_enum, help_heading = NODE, requires = "detector")]
    head: Option<HeadSetting>,
    /// The empty-scene screen, an ONNX file
    #[arg(long, help_heading = NODE, value_name = "FILE")]
    screen_model: Option<PathBuf>,
    /// Write compare.json, runs.csv and compare.txt here
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Runs the comparison and prints the result.
///
/// # Errors
/// When an argument is invalid, the clip cannot be read, a node does not start, or the first round is stopped
/// before it is complete.
pub(super) async fn run(arguments: CompareArguments) -> anyhow::Result<()> {
    let (mut config, variants) = prepare(&arguments)?;
    logging::start(&config.log)?;
    let shutdown = signals::shutdown()?;
    let meter = choose_meter(&mut config.power).await?;
    eprintln!("Reading the clip …");
    let source = arguments
        .clip
        .open(arguments.rate, VideoEncoding::default())
        .context("--clip")?;
    let extent = Extent::Seconds(arguments.seconds);
    let loaded = tokio::task::spawn_blocking(move || clip::load(source, extent))
        .await
        .context("reading the clip")?
        .context("--clip")?;
    for said in loaded.warning().iter().chain(&loaded.remarks) {
        eprintln!("{said}");
    }
    if loaded.is_cut {
        eprintln!(
            "{}: only its first {} s are played; --seconds plays more",
            loaded.pictures.name(),
            arguments.seconds
        );
    }
    let Loaded { pictures, size, .. } = loaded;
    let frames = pictures.frames().unwrap_or_default();
    let truth = own_truth(&arguments.clip, size, frames)?;
    let rate = if arguments.unpaced {
        None
    } else {
        let rate = pictures.rate() * arguments.speed;
        check_pace(frames, rate, "see --seconds, --speed and --unpaced")?;
        Some(rate)
    };
    let scheduled = schedule(variants.len(), arguments.repeat as usize);
    let pace = match rate {
        Some(rate) => {
            let played = frames as f64 / pictures.rate() + arguments.warm_up;
            let run = played / arguments.speed + arguments.cool_down + 1.0;
            let all = Duration::from_secs_f64(scheduled.len() as f64 * run);
            format!("{rate} frames/s, about {}", HumanDuration(all))
        }
        None => "full speed".to_owned(),
    };
    eprintln!(
        "{} of {} of {} at {pace}; power: {meter}",
        counted(scheduled.len() as u64, "run", "runs"),
        counted(frames, "frame", "frames"),
        pictures.name(),
    );
    let player = Player {
        config,
        clip: pictures,
        extent,
        size,
        rate,
        warm_up_s: arguments.warm_up,
        cool_down: Duration::from_secs_f64(arguments.cool_down),
    };
    let played = play_all(&player, &variants, &scheduled, &shutdown).await?;
    let comparison = judge(&player, &variants, played, truth.as_ref())?;
    let summary = summarise(&comparison);
    let text = render(&comparison, &summary, terminal::WIDTH);
    // Before it is printed: whoever reads the output may close it, which ends the program.
    if let Some(folder) = &arguments.out {
        write(folder, &comparison, &summary, &text)?;
    }
    print!("{}", render(&comparison, &summary, terminal::width()));
    if let Some(folder) = &arguments.out {
        eprintln!("Written to {}", folder.display());
    }
    Ok(())
}

/// Returns the node's configuration and the variants, checked before anything starts.
fn prepare(arguments: &CompareArguments) -> anyhow::Result<(NodeConfig, Vec<PolicySpec>)> {
    let detector = arguments.detector.as_deref();
    let mut config = node_configuration(arguments.config.as_deref(), detector, LOG_LEVEL)?;
    if detector.is_some() {
        config.screen.model = None;
    }
    if let Some(head) = &arguments.head {
        config.detector.head = head.clone();
    }
    if let Some(screen) = &arguments.screen_model {
        config.screen.model = Some(screen.clone());
    }
    let base = Base {
        config: &config.policy,
        empty_road: config.screen.empty_road(),
    };
    let variants = variants(&arguments.policy, &arguments.u, base)?;
    Ok((config, variants))
}

/// Plays every scheduled run; after a signal, returns only the complete rounds.
async fn play_all(
    player: &Player,
    variants: &[PolicySpec],
    scheduled: &[ScheduledRun],
    shutdown: &CancellationToken,
) -> anyhow::Result<Vec<(ScheduledRun, Played)>> {
    let frames = player.frames_of_a_run();
    let bar = progress::bar(Some(frames * scheduled.len() as u64), "frames  {msg}");
    let mut done = Vec::new();
    for (number, run) in scheduled.iter().enumerate() {
        let variant = &variants[run.variant];
        let of = scheduled.len();
        let label = &variant.label;
        let name = format!("run {} of {of}, {label}", number + 1);
        let before = frames * number as u64;
        // Without a terminal for the bar, a line per run shows the progress.
        if bar.is_hidden() {
            eprintln!("{name} …");
        }
        let progress = |sent: u64, step: &str| {
            bar.set_position(before + sent);
            bar.set_message(format!("{name}: {step}"));
        };
        let played = player.play(variant, progress, shutdown).await;
        if shutdown.is_cancelled() {
            break;
        }
        let played = played.with_context(|| format!("{label}, round {}", run.round + 1))?;
        done.push((*run, played));
    }
    bar.finish_and_clear();
    let complete = done.len() / variants.len() * variants.len();
    if complete == 0 {
        bail!("stopped before the first round was complete: there is nothing to compare");
    }
    if complete < scheduled.len() {
        eprintln!("Stopped: the results cover only the complete rounds.");
    }
    done.truncate(complete);
    Ok(done)
}

/// The ground truth of the frames that are played.
struct OwnTruth {
    objects: Vec<Vec<ScoredBox>>,
    ignored: Vec<Vec<Ignored>>,
    size: TruthSize,
}

/// Reads the ground truth that belongs to the source, for its first `frames` frames; `None` if it has none.
fn own_truth(
    source: &SourceName,
    picture: PictureSize,
    frames: u64,
) -> anyhow::Result<Option<OwnTruth>> {
    let Some(file) = source.truth() else {
        return Ok(None);
    };
    let files = [file.to_path_buf()];
    let mut truth = GroundTruth::read(&files, TruthFormat::Bdd100k, Rules::default())?;
    let frames = usize::try_from(frames)?;
    let mut objects = Vec::new();
    let mut ignored = Vec::new();
    let mut clips = 0;
    let is_alone = false;
    for part in source.open_clips(None, VideoEncoding::default())? {
        if objects.len() >= frames {
            break;
        }
        let mut report = LoadReport::default();
        let mut clip = with_truth(&mut truth, &*part, picture, is_alone, &mut report)?;
        clip.ignored.resize(clip.frames, Vec::new());
        objects.extend(clip.truth.unwrap_or_else(|| vec![Vec::new(); clip.frames]));
        ignored.extend(clip.ignored);
        clips += 1;
    }
    objects.truncate(frames);
    ignored.truncate(frames);
    let size = TruthSize {
        boxes: objects.iter().map(Vec::len).sum(),
        frames,
        clips,
    };
    Ok(Some(OwnTruth {
        objects,
        ignored,
        size,
    }))
}

/// Judges every run's boxes against those of the policy that runs the detector on every frame, and by the clip's `truth`.
fn judge(
    player: &Player,
    variants: &[PolicySpec],
    done: Vec<(ScheduledRun, Played)>,
    truth: Option<&OwnTruth>,
) -> anyhow::Result<Comparison> {
    let vanilla = variants.iter().position(|variant| variant.config.name == BASELINE);
    let boxes_of = vanilla.unwrap_or(0);
    let first = player.warm_up_frames();
    // One numbering for all runs.
    let mut classes = ClassNumbers::default();
    let mut boxes: Vec<Boxes> = Vec::new();
    for (_, played) in &done {
        boxes.push(played.boxes(first, &mut classes));
    }
    // A detector finds the same objects in the same picture, so another round supplies a frame that one round dropped.
    let mut reference = Boxes::new();
    for ((run, _), boxes) in done.iter().zip(&boxes) {
        if run.variant == boxes_of {
            for (frame, found) in boxes {
                reference.entry(*frame).or_insert_with(|| found.clone());
            }
        }
    }
    let provider = done.first().map_or("", |(_, played)| played.report.provider.as_str());
    let model = player.config.detector.model.file_name().unwrap_or_default();
    let playing = Playback {
        clip: player.clip.name().to_owned(),
        frames: player.clip.frames().unwrap_or_default(),
        size: player.size.to_string(),
        rate: player.clip.rate(),
        played_rate: player.rate,
        warm_up_s: player.warm_up_s,
        cool_down_s: player.cool_down.as_secs_f64(),
        detector: format!("{} run by {provider}", model.display()),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        truth: truth.map(|truth| truth.size),
    };
    let mut left_out = BTreeMap::new();
    let mut runs = Vec::new();
    for ((scheduled, played), boxes) in done.into_iter().zip(&boxes) {
        let policy = &variants[scheduled.variant].config;
        let mut by_truth = None;
        if let Some(truth) = truth {
            let found =
                played.judged_boxes(first, truth.size.frames, &Evaluated::Road, &mut left_out);
            let objects = truth.objects.as_slice();
            let ignored = truth.ignored.as_slice();
            by_truth = agreement_with_truth(&found, Truth { objects, ignored });
        }
        runs.push(Run {
            advice: played.advice(policy.build()?.threshold_spec()),
            round: scheduled.round,
            variant: scheduled.variant,
            cpu_s: played.cpu.as_secs_f64(),
            meter_share_of_core: played.meter_share_of_core,
            frame_ms: played.frame_ms(player.rate),
            report: played.report,
            agreement: agreement(boxes, &reference),
            by_truth,
        });
    }
    for (class, boxes) in left_out {
        eprintln!(
            "not judged: {} of the class `{class}`, which the ground truth does not have",
            counted(boxes, "box", "boxes")
        );
    }
    Ok(Comparison {
        playing,
        policies: variants.iter().map(|variant| variant.label.clone()).collect(),
        boxes_of,
        runs,
    })
}
