//! `albireo eval board`: measures policies on this machine over the clips of a data set, and goes on where it was
//! stopped.

mod setup;

use super::JUDGED;
use super::video::{clip_names, truth_places, without_boxes};
use crate::cli::play::clip::{self, Extent, Loaded};
use crate::cli::play::{Player, check_pace, choose_meter, node_configuration, with_truth};
use crate::cli::progress;
use crate::cli::terminal::{self, program};
use crate::cli::values::{counted, not_negative, parse_rate};
use albireo_eval::board::{ClipRun, RunsFile, TRACED_CLIPS};
use albireo_eval::data::classes::Evaluated;
use albireo_eval::data::{Clip, GroundTruth, LoadReport, Rules, TruthFormat};
use albireo_eval::footage::{FrameSource, SourceName, VideoEncoding};
use albireo_eval::judge::{Classes, Interpolation, Truth, accuracy};
use albireo_eval::settings::ScreenRule;
use albireo_eval::spec::{Base, PolicySpec, Sweep, resolve_with_pause};
use albireo_node::config::NodeConfig;
use albireo_service::{logging, signals};
use albireo_vision::detector::{DetectorConfig, DetectorNetwork};
use anyhow::{Context, bail};
use clap::Args;
use indicatif::HumanDuration;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Heading of the help.
const PLAYING: &str = "How it is played";

/// Only errors, and not those of the outbox and of readiness: the node keeps no reports, and is not ready immediately,
/// on purpose.
const LOG_LEVEL: &str = "error,albireo_node::outbox=off,albireo_service::readiness=off";

/// What can be done about a clip that takes too long at its own rate.
const WITHOUT_PACE: &str =
    "play it without --paced, name a higher --rate for pictures, or split it and its ground truth";

/// Arguments of `albireo eval board`.
#[derive(Debug, Args)]
#[command(after_help = "\
Each run starts a node as `albireo node` does and plays one whole clip to it
under one policy; the meter of the node measures it. A clip may have 1 GiB of
encoded pictures, and a run may take an hour: split a longer one. On every
second clip the policies run in reverse order. Each run is on disk when it is
done: stopped, by Ctrl-C or a power cut, the same command without --restart goes
on with the runs that are missing. It refuses if a setting that changes results
is another one than before, and names it.

There is a file for each detector, precision, power mode and machine. `albireo
eval join` makes tables of one or several.

Examples:
  albireo eval board demo --out results
      vanilla and albireo on the demonstration's road, by this machine's meter
  albireo eval board bdd100k/images/track/val \\
      --ground-truth bdd100k/labels/box_track_20/val --truth-format bdd100k \\
      --config /etc/albireo/node.toml --sweep u=3e-4,5e-4,7e-4,1e-3,3e-3 \\
      --precision fp16 --out results
      the paper's sweep over a whole data set, with this board's detector")]
pub(super) struct BoardArguments {
    /// Video files, folders of pictures, folders of such folders, or tar archives; `demo` is the demonstration's road
    #[arg(required = true, value_name = "CLIP")]
    clips: Vec<SourceName>,
    /// A policy by its name in the configuration, as NAME or NAME:SETTING; may be repeated. `all` stands for the
    /// paper's policies with its settings and expected-loss at 0.1, 0.3 and 0.5. Vanilla always runs as well
    #[arg(long, value_name = "NAME[:SETTING]", default_value = "albireo")]
    policy: Vec<String>,
    /// Values of a setting to try one after the other, for instance u=3e-4,5e-4
    #[arg(long, value_name = "NAME=VALUE,…")]
    sweep: Vec<Sweep>,
    /// Ground truth; may be repeated. `demo` has its own
    #[arg(long, help_heading = JUDGED, value_name = "PATH", requires = "truth_format")]
    ground_truth: Vec<PathBuf>,
    /// Layout of the ground truth
    #[arg(long, help_heading = JUDGED, value_enum, requires = "ground_truth")]
    truth_format: Option<TruthFormat>,
    /// How boxes are judged where the ground truth marks crowds, distractors or ignored regions
    #[arg(long, help_heading = JUDGED, value_enum, default_value = "benchmark")]
    rules: Rules,
    /// Play frames at the clip's own rate, as a camera does, and not each as soon as the node has taken the last one
    #[arg(long, help_heading = PLAYING)]
    paced: bool,
    /// Frames per second of a source that has none of its own
    #[arg(long, help_heading = PLAYING, value_name = "FPS", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Warm-up before each run, seconds of the clip
    #[arg(long, help_heading = PLAYING, value_name = "SECONDS", default_value_t = 1.0, value_parser = not_negative)]
    warm_up: f64,
    /// Rest before each run, seconds
    #[arg(long, help_heading = PLAYING, value_name = "SECONDS", default_value_t = 0.0, value_parser = not_negative)]
    cool_down: f64,
    /// Configuration of the node: detector, screen, policy settings and meter are taken from it
    #[arg(long, short, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// The detector, an ONNX file [default: the configuration's]
    #[arg(long, alias = "model", value_name = "FILE")]
    detector: Option<PathBuf>,
    /// The detector's precision, for the tables [default: fp16 for TensorRT with detector.gpu.fp16, else as exported]
    #[arg(long, value_name = "NAME")]
    precision: Option<String>,
    /// The power mode, for the tables [default: the machine's own name for it]
    #[arg(long, value_name = "NAME")]
    power_mode: Option<String>,
    /// The machine's name, for the tables [default: its host name]
    #[arg(long, value_name = "NAME")]
    machine: Option<String>,
    /// Write the file of runs here
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Measure all again, for instance with other settings; the runs before are kept in a new file beside, FILE.before,
    /// FILE.before-2 and so on
    #[arg(long)]
    restart: bool,
}

/// Runs the command; progress goes to standard error.
///
/// # Errors
/// When an argument is invalid, the ground truth does not fit the clips, a node does not start, or a run cannot be
/// kept.
pub(super) async fn run(arguments: &BoardArguments) -> anyhow::Result<()> {
    let names = clip_names(&arguments.clips)?;
    let alone = names.len() == 1;
    let mut config = node_configuration(
        arguments.config.as_deref(),
        arguments.detector.as_deref(),
        LOG_LEVEL,
    )?;
    let policies = policies(arguments, &config)?;
    let mut truth = ground_truth(arguments, &mut config.detector).await?;
    truth.check(&names)?;
    logging::start(&config.log)?;
    let shutdown = signals::shutdown()?;
    let meter = choose_meter(&mut config.power).await?;
    let clips = measured_clips(arguments, &mut truth, alone)?;
    let setup = setup::describe(arguments, &config)?;
    let mut file = RunsFile::open(&arguments.out, &setup, arguments.restart)?;
    if let Some(kept) = file.kept() {
        eprintln!("The runs before are kept in {}", kept.display());
    }
    for clip in &clips {
        if let Some(content) = &clip.content {
            file.check_clip(&clip.name, content)?;
        }
    }
    let scheduled = scheduled(&clips, &policies, &file);
    let all = clips.len() * policies.len();
    eprintln!(
        "{}, {}: {} of {} done; power: {meter}; {}",
        counted(clips.len() as u64, "clip", "clips"),
        counted(policies.len() as u64, "policy", "policies"),
        all - scheduled.len(),
        counted(all as u64, "run", "runs"),
        file.path().display()
    );
    let mut measuring = Measuring {
        arguments,
        config,
        truth,
        alone,
        left_out: BTreeMap::new(),
        unusable: Vec::new(),
        loaded: None,
    };
    // A clip whose number of frames nobody knows counts as one frame.
    let frames_to_play: u64 = scheduled.iter().map(|(clip, _)| clip.frames.unwrap_or(1)).sum();
    let bar = progress::bar(Some(frames_to_play), "frames  {msg}");
    let start = Instant::now();
    let mut done = 0;
    for (number, (clip, policy)) in scheduled.iter().enumerate() {
        let name = format!("{} under {}", clip.name, policy.label);
        bar.set_message(name.clone());
        // Without a terminal for the bar, a line per run shows the progress.
        if bar.is_hidden() {
            let left = time_left(start.elapsed(), done, frames_to_play);
            eprintln!("run {} of {}: {name}{left}", number + 1, scheduled.len());
        }
        let frames = clip.frames.unwrap_or(1);
        let steps = |sent: u64, _: &str| bar.set_position(done + sent.min(frames));
        let tell = |line: &str| bar.suspend(|| eprintln!("{line}"));
        let played = measuring.play(clip, policy, &file, steps, tell, &shutdown).await;
        if shutdown.is_cancelled() {
            bar.finish_and_clear();
            eprintln!("{}", stopped(number as u64, arguments.restart));
            return Ok(());
        }
        file.add(played.context(name)?)?;
        done += frames;
    }
    bar.finish_and_clear();
    measuring.print_left_out();
    let runs = file.path().display();
    let program = program();
    eprintln!("Every run is in {runs}; next: {program} eval join {runs} --out tables");
    Ok(())
}

/// Says how many runs were added before the stop, and how to go on: a restart would begin again.
fn stopped(runs: u64, restart: bool) -> String {
    let command = if restart {
        "The same command without --restart"
    } else {
        "The same command"
    };
    let more = counted(runs, "run", "runs");
    format!("Stopped, with {more} more. {command} goes on with the others.")
}

/// Reads the ground truth for the classes of the node's model, which is loaded for their names. If the ground truth has
/// classes of its own, and the configuration names none to report, sets `detector` to report those that both have, and
/// prints them.
async fn ground_truth(
    arguments: &BoardArguments,
    detector: &mut DetectorConfig,
) -> anyhow::Result<GroundTruth> {
    let places = truth_places(
        &arguments.clips,
        &arguments.ground_truth,
        arguments.truth_format,
    );
    let (paths, format) = places.context(
        "--ground-truth PATH --truth-format LAYOUT: the boxes have to be judged by something",
    )?;
    let mut config = detector.clone();
    if config.report_classes.is_none() {
        // An empty list reports all.
        config.report_classes = Some(Vec::new());
    }
    let network = tokio::task::spawn_blocking(move || DetectorNetwork::open(&config))
        .await
        .context("loading the detector")??;
    let names = network.class_names();
    let truth = GroundTruth::for_model(&paths, format, arguments.rules, names)?;
    if let Evaluated::Own(evaluated) = truth.classes()
        && detector.report_classes.is_none()
    {
        let is_judged = |name: &&String| truth.classes().find(name).is_ok();
        let reported: Vec<String> = names.iter().filter(is_judged).cloned().collect();
        eprintln!(
            "Of its model's {} classes the node reports those that the ground truth has ({}): {}",
            evaluated.len(),
            reported.len(),
            reported.join(", ")
        );
        detector.report_classes = Some(reported);
    }
    Ok(truth)
}

/// `, about 2 hours left`, from the frames that were played since the start.
fn time_left(elapsed: Duration, done: u64, all: u64) -> String {
    if done == 0 {
        return String::new();
    }
    let left = all.saturating_sub(done);
    let time = elapsed.mul_f64(left as f64 / done as f64);
    format!(", about {} left", HumanDuration(time))
}

fn policies(arguments: &BoardArguments, config: &NodeConfig) -> anyhow::Result<Vec<PolicySpec>> {
    let base = Base {
        config: &config.policy,
        empty_road: config.screen.empty_road(),
    };
    let pixels = true;
    let specs = resolve_with_pause(
        &arguments.policy,
        &arguments.sweep,
        base,
        ScreenRule::Nonempty,
        pixels,
    )?;
    // The screen is the node's own, which is part of the setup and of no label.
    let plain = |spec: PolicySpec| PolicySpec {
        label: spec.label.split("-erd-").next().unwrap_or_default().to_owned(),
        ..spec
    };
    Ok(specs.into_iter().map(plain).collect())
}

/// A clip of the measurement, found and checked before the first run.
struct MeasuredClip {
    name: String,
    source: SourceName,
    /// Its number in the source, if that has several.
    number: usize,
    /// The number of its frames; that of a video is what its file says, if it does.
    frames: Option<u64>,
    /// What it is in words, as [`ClipRun::content`]; `None` for a video, whose frames are counted when it is read: its
    /// file may count some that cannot be played.
    content: Option<String>,
    /// True if the power trace of its runs is kept.
    is_traced: bool,
}

/// Lists the clips that the ground truth names, and holds each one's number of frames and size of pictures against it:
/// a mistake is found now and not after hours. Prints which clips are left out, and what of the ground truth.
fn measured_clips(
    arguments: &BoardArguments,
    truth: &mut GroundTruth,
    alone: bool,
) -> anyhow::Result<Vec<MeasuredClip>> {
    let mut sources = Vec::new();
    for named in &arguments.clips {
        sources.extend(named.split()?);
    }
    let mut clips = Vec::new();
    let mut report = truth.take_report();
    let mut all = 0;
    let mut unlabelled = 0;
    let mut boxes = 0;
    for source in sources {
        let is_video = matches!(source, SourceName::Video(_) | SourceName::VideoFiles(_));
        let opened = source.open_clips(arguments.rate, VideoEncoding::default())?;
        for (number, mut footage) in opened.into_iter().enumerate() {
            let name = footage.name().to_owned();
            if !truth.has(&name, alone) {
                eprintln!("{name}: not in the ground truth, left out");
                continue;
            }
            clip::check_size(&*footage)?;
            let frames = footage.frames();
            let mut content = None;
            if let Some(frames) = frames
                && !is_video
            {
                if arguments.paced {
                    let rate = paced_rate(arguments, truth, alone, &*footage);
                    check_pace(frames, rate, WITHOUT_PACE).with_context(|| name.clone())?;
                }
                let Some(first) = clip::first_picture(&mut *footage)? else {
                    bail!("{name}: it has no pictures that can be read");
                };
                let judged = with_truth(truth, &*footage, first.size, alone, &mut report)?;
                all += judged.frames;
                unlabelled += judged.unlabelled();
                boxes += judged.truth_boxes();
                content = Some(content_of(&judged));
            }
            if let Some(frames) = frames
                && is_video
                && let Some(first) = clip::first_picture(&mut *footage)?
                && let Some(doubt) = clip::doubt_of_size(&name, &first, frames)
            {
                eprintln!("{doubt}");
            }
            clips.push(MeasuredClip {
                name,
                source: source.clone(),
                number,
                frames,
                content,
                is_traced: clips.len() < TRACED_CLIPS,
            });
        }
    }
    // The labels of a video are held against it when it is read.
    if clips.iter().all(|clip: &MeasuredClip| clip.content.is_some())
        && let Err(nothing) = report.check_boxes(boxes)
    {
        let all_frames = None;
        let line = without_boxes(&arguments.ground_truth, all_frames, nothing);
        eprintln!("{}", terminal::error(&line));
    }
    for line in report.lines() {
        eprintln!("Ground truth: {line}");
    }
    if unlabelled > 0 {
        eprintln!("Ground truth: {}", labelled(all - unlabelled, all));
    }
    Ok(clips)
}

/// Says how many of all frames are labelled, and what that means.
fn labelled(frames: usize, all: usize) -> String {
    format!(
        "{frames} of {all} frames are labelled. Accuracy is that of these; the others count for calls, time and energy."
    )
}

/// The frames per second at which a clip is paced: those that the user names, else those of the ground truth, else the
/// source's own.
fn paced_rate(
    arguments: &BoardArguments,
    truth: &GroundTruth,
    alone: bool,
    footage: &dyn FrameSource,
) -> f64 {
    if arguments.rate.is_some() {
        // The source was opened with it.
        return footage.rate();
    }
    truth.rate(footage.name(), alone).unwrap_or_else(|| footage.rate())
}

/// Describes what the clip is, so that later runs can be held against it. The digest is of what boxes are judged by:
/// neither the order of a frame's labels nor the numbers of the objects count, which differ between files of the same
/// labels.
fn content_of(clip: &Clip) -> String {
    let mut digest = crc32fast::Hasher::new();
    for frame in 0..clip.frames {
        let mut labels = Vec::new();
        if let Some(truth) = &clip.truth
            && let Some(objects) = truth.get(frame)
        {
            for object in objects {
                labels.push(format!("{:?} {:?}", object.corners, object.class));
            }
        }
        if let Some(marks) = clip.ignored.get(frame) {
            for mark in marks {
                labels.push(format!("{mark:?}"));
            }
        }
        labels.sort_unstable();
        digest.update(format!("{frame} {}\n", labels.join(", ")).as_bytes());
    }
    format!(
        "{} pictures of {}, ground truth {:08x}",
        clip.frames,
        clip.picture,
        digest.finalize()
    )
}

/// The runs that are missing, clip by clip; on every second clip the policies are in reverse order.
fn scheduled<'a>(
    clips: &'a [MeasuredClip],
    policies: &'a [PolicySpec],
    file: &RunsFile,
) -> Vec<(&'a MeasuredClip, &'a PolicySpec)> {
    let mut runs = Vec::new();
    for (number, clip) in clips.iter().enumerate() {
        let missing = policies.iter().filter(|policy| !file.has(&clip.name, &policy.label));
        let mut of_clip: Vec<_> = missing.map(|policy| (clip, policy)).collect();
        // A machine that warms up must not favour the policy that is always first.
        if number % 2 == 1 {
            of_clip.reverse();
        }
        runs.extend(of_clip);
    }
    runs
}

/// Plays runs and judges them.
struct Measuring<'a> {
    arguments: &'a BoardArguments,
    config: NodeConfig,
    truth: GroundTruth,
    alone: bool,
    /// The number of boxes of each class that the ground truth does not have.
    left_out: BTreeMap<String, u64>,
    /// The clips with pictures that cannot be decoded, and their number.
    unusable: Vec<(String, usize)>,
    /// The clip that is in memory, and its ground truth: all its policies are played before the next.
    loaded: Option<(Player, Clip)>,
}

impl Measuring<'_> {
    /// Prints what was not judged or not used, at the end.
    fn print_left_out(&self) {
        for (class, boxes) in &self.left_out {
            eprintln!(
                "not judged: {} of the class `{class}`, which the ground truth does not have",
                counted(*boxes, "box", "boxes")
            );
        }
        if let [(first, _), ..] = self.unusable.as_slice() {
            let pictures: usize = self.unusable.iter().map(|(_, pictures)| pictures).sum();
            eprintln!(
                "not used: {} of {} (first: {first}), which count as frames without boxes",
                counted(pictures as u64, "picture", "pictures"),
                counted(self.unusable.len() as u64, "clip", "clips")
            );
        }
    }

    /// Plays a clip under a policy and judges what the node found. Keeps the clip in memory for the next policy.
    ///
    /// # Errors
    /// When the clip is another one than that of its runs in `file`, or cannot be read or played.
    async fn play(
        &mut self,
        of: &MeasuredClip,
        policy: &PolicySpec,
        file: &RunsFile,
        progress: impl Fn(u64, &str),
        tell: impl Fn(&str),
        shutdown: &tokio_util::sync::CancellationToken,
    ) -> anyhow::Result<ClipRun> {
        let loaded = match self.loaded.take() {
            Some((player, clip)) if clip.name == of.name => (player, clip),
            other => {
                // Only one clip is in memory.
                drop(other);
                self.load(of, tell).await?
            }
        };
        let (player, clip) = self.loaded.insert(loaded);
        // Of pictures and their labels it was known before they were read.
        let content = of.content.clone().unwrap_or_else(|| content_of(clip));
        file.check_clip(&of.name, &content)?;
        let played = player.play(policy, progress, shutdown).await?;
        let mut run = ClipRun::of(&played.report, &of.name, &policy.label);
        run.content = content;
        run.frame_ms = played.frame_ms(player.rate);
        run.cpu_s = Some(played.cpu.as_secs_f64());
        run.memory_mb = played.memory_mb;
        if of.is_traced {
            run.traces.clone_from(&played.traces);
        }
        run.unlabelled = clip.unlabelled() as u64;
        let first = player.warm_up_frames();
        let evaluated = self.truth.classes();
        let boxes = played.judged_boxes(first, clip.frames, evaluated, &mut self.left_out);
        let truth = Truth {
            objects: clip.truth.as_deref().unwrap_or_default(),
            ignored: &clip.ignored,
        };
        let judged = accuracy(&boxes, truth, Classes::Pooled, Interpolation::AllPoints);
        run.ap50 = judged.map(|found| found.ap50);
        run.map = judged.map(|found| found.map);
        Ok(run)
    }

    /// Reads a clip into memory and makes its player. Tells and notes which of its pictures are unusable, and tells how
    /// many frames are labelled.
    async fn load(
        &mut self,
        of: &MeasuredClip,
        tell: impl Fn(&str),
    ) -> anyhow::Result<(Player, Clip)> {
        let arguments = self.arguments;
        let opened = of.source.open_clips(arguments.rate, VideoEncoding::default())?;
        let source = opened.into_iter().nth(of.number).context("the clip is gone")?;
        let rate = paced_rate(arguments, &self.truth, self.alone, &*source);
        let files = source.file_names();
        let extent = Extent::Whole;
        let loaded = tokio::task::spawn_blocking(move || clip::load(source, extent))
            .await
            .context("reading the clip")??;
        for remark in &loaded.remarks {
            tell(remark);
        }
        if let Some(warning) = loaded.warning() {
            tell(&warning);
            self.unusable.push((of.name.clone(), loaded.unusable.len()));
        }
        let Loaded {
            pictures,
            size,
            left_out,
            ..
        } = loaded;
        let frames = pictures.frames().unwrap_or_default();
        if arguments.paced {
            check_pace(frames, rate, WITHOUT_PACE)?;
        }
        let mut report = LoadReport::default();
        let mut clip = Clip::new(of.name.clone(), size, usize::try_from(frames)?);
        clip.file_names = files;
        let whole = Some(clip.frames + left_out.len());
        clip.unusable = left_out;
        self.truth.attach_to(&mut clip, self.alone, whole, &mut report)?;
        let unlabelled = clip.unlabelled();
        // Of clips that are no videos all this was said before the first run.
        if of.content.is_none() {
            for line in report.lines() {
                tell(&format!("{}: {line}", of.name));
            }
            if unlabelled > 0 {
                let sentence = labelled(clip.frames - unlabelled, clip.frames);
                tell(&format!("{}: {sentence}", of.name));
            }
        }
        let player = Player {
            config: self.config.clone(),
            clip: pictures,
            extent,
            size,
            rate: arguments.paced.then_some(rate),
            warm_up_s: arguments.warm_up,
            cool_down: Duration::from_secs_f64(arguments.cool_down),
        };
        Ok((player, clip))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::detection::ClassId;
    use albireo_core::geometry::{Corners, PictureSize};
    use albireo_eval::boxes::ScoredBox;

    #[test]
    fn a_stopped_restart_is_told_to_go_on_without_restarting() {
        let restart = true;
        let said = stopped(2, restart);
        let way_on = "with 2 runs more. The same command without --restart goes on";
        assert!(said.contains(way_on), "{said}");
        assert!(!stopped(1, !restart).contains("--restart"));
    }

    fn object(x: f64, number: u64) -> ScoredBox {
        ScoredBox {
            corners: Corners {
                x1: x,
                y1: 0.0,
                x2: x + 9.0,
                y2: 9.0,
            },
            class: ClassId(2),
            confidence: 1.0,
            object: Some(number),
        }
    }

    /// The content of a clip with these labels.
    fn content(frames: [Vec<ScoredBox>; 2]) -> String {
        let mut clip = Clip::new("a".to_owned(), PictureSize::new(64, 48), 2);
        clip.truth = Some(frames.into());
        content_of(&clip)
    }

    #[test]
    fn the_same_labels_have_one_digest_in_any_order() {
        let labels = content([vec![object(1.0, 0), object(5.0, 1)], vec![]]);
        let reordered = content([vec![object(5.0, 7), object(1.0, 3)], vec![]]);
        assert_eq!(labels, reordered);
    }

    #[test]
    fn a_box_at_another_place_or_in_another_frame_changes_the_digest() {
        let labels = content([vec![object(1.0, 0), object(5.0, 1)], vec![]]);
        for other in [
            [vec![object(1.0, 0), object(5.5, 1)], vec![]],
            [vec![object(1.0, 0)], vec![object(5.0, 1)]],
        ] {
            assert_ne!(labels, content(other));
        }
    }
}
