//! `albireo eval video`: runs a real detector once over videos or pictures, then every policy on its detections.

use super::{LOOKED, RunArguments, keep, listed, policies, print, settings, streams_asked};
use crate::cli::progress;
use crate::cli::terminal;
use crate::cli::values::counted;
use albireo_eval::data::{Clip, LoadReport, recorded};
use albireo_eval::data::{GroundTruth, Rules, StepTimes, TruthFormat, vanilla_as_truth};
use albireo_eval::footage::{Downsampled, FrameSource, SourceName, VideoEncoding};
use albireo_eval::pictures::{LOWEST_CONFIDENCE, ModelRunner, PassSettings, run_pass};
use albireo_eval::report::Report;
use albireo_eval::result::{ClipResult, Spread};
use albireo_eval::run;
use albireo_eval::run::attach_pictures;
use albireo_eval::run::streams::{self, StreamResults};
use albireo_eval::settings::{ScreenRule, Settings};
use albireo_eval::spec::PolicySpec;
use albireo_eval::summary;
use albireo_vision::detector::{ClassNames, DetectorConfig, ExecutionProvider, HeadSetting};
use albireo_vision::picture::ColorOrder;
use albireo_vision::screen::ScreenConfig;
use anyhow::{bail, ensure};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use std::collections::{BTreeSet, HashSet};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// The detector that the project brings.
const DEFAULT_DETECTOR: &str = "models/yolox_nano.onnx";

/// Time limit of a detector run, milliseconds. No camera waits for it, so the limit is high.
const TIMEOUT_MS: u64 = 60_000;

/// Arguments of `albireo eval video`.
#[derive(Debug, Args)]
pub(super) struct VideoArguments {
    /// Video files (these need ffmpeg), folders of JPEG and PNG files, tar archives of such folders, or MCAP files with
    /// pictures of Foxglove or ROS 2 (each of their topics is a clip); `demo` is
    /// demo/road.tar at 25 frames/s with its ground truth. Each is a clip named after its file; each folder of an archive
    /// is one
    #[arg(required = true, value_name = "CLIP")]
    clips: Vec<SourceName>,
    /// How a video's frames are encoded on the way from ffmpeg to the detector.
    #[arg(long, value_enum, default_value_t)]
    encoding: VideoEncoding,
    /// Ground truth; may be repeated. Clips that it does not name are left out. Without any, `demo` is judged by
    /// demo/truth.json, and all else against Vanilla's own output. Judged are all classes of the model; but of COCO's
    /// eighty, and by the ground truth of a driving benchmark, the six that BDD100K shares with COCO.
    #[arg(long, value_name = "PATH", requires = "truth_format")]
    ground_truth: Vec<PathBuf>,
    /// Layout of the ground truth.
    #[arg(long, value_enum, requires = "ground_truth")]
    truth_format: Option<TruthFormat>,
    #[command(flatten)]
    pass: PassArguments,
    #[command(flatten)]
    run: RunArguments,
}

/// The models of the pass, and what is kept of it.
#[derive(Debug, Args)]
pub(super) struct PassArguments {
    /// The detector: an ONNX file.
    #[arg(long, alias = "model", help_heading = LOOKED, value_name = "MODEL", default_value = DEFAULT_DETECTOR)]
    detector: PathBuf,
    /// How the detector's output is read: the name of a head, or `columns=x1 y1 x2 y2 score class`.
    #[arg(long, help_heading = LOOKED, default_value_t)]
    head: HeadSetting,
    /// Names of the detector's classes, one per line; `coco` for COCO's 80 [default: those of its metadata, or the head's
    /// own list]
    #[arg(long, help_heading = LOOKED, value_name = "FILE")]
    class_names: Option<PathBuf>,
    /// The execution provider that runs the detector.
    #[arg(long, help_heading = LOOKED, value_enum, default_value_t = ExecutionProvider::Cpu)]
    provider: ExecutionProvider,
    /// The empty-scene screen, an ONNX file. Its verdicts take the place of --screen.
    #[arg(long, help_heading = LOOKED, value_name = "MODEL")]
    screen_model: Option<PathBuf>,
    /// Order of the screen's colour planes.
    #[arg(long, help_heading = LOOKED, value_enum, default_value_t = ColorOrder::Rgb, requires = "screen_model")]
    screen_color_order: ColorOrder,
    /// Number of the screen's output that means "empty".
    #[arg(long, help_heading = LOOKED, default_value_t = 0, requires = "screen_model", value_parser = clap::value_parser!(u8).range(0..=1))]
    screen_empty_class: u8,
    /// Save detections, screen verdicts and ground truth here, clip by clip, in the layout of `albireo eval recorded`; a
    /// folder that has some already is refused.
    #[arg(long, help_heading = LOOKED, value_name = "DIR")]
    save_detections: Option<PathBuf>,
    /// Process at most this many frames of each clip.
    #[arg(long, help_heading = LOOKED, value_name = "COUNT", value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    frames: Option<usize>,
}

impl PassArguments {
    /// The options that were given another value than their default: without a pass they have no effect.
    pub(super) fn given(&self) -> Vec<&'static str> {
        let options = [
            ("--detector", self.detector != Path::new(DEFAULT_DETECTOR)),
            ("--head", self.head != HeadSetting::default()),
            ("--class-names", self.class_names.is_some()),
            ("--provider", self.provider != ExecutionProvider::Cpu),
            ("--screen-model", self.screen_model.is_some()),
            ("--save-detections", self.save_detections.is_some()),
            ("--frames", self.frames.is_some()),
        ];
        let mut given = Vec::new();
        for (option, is_given) in options {
            if is_given {
                given.push(option);
            }
        }
        given
    }
}

/// Runs `albireo eval video`. Clips are processed one after the other, and dropped when every policy is done.
pub(super) fn run(video: &VideoArguments) -> anyhow::Result<()> {
    let arguments = with_screen(video)?;
    let names = clip_names(&video.clips)?;
    let has_pixels = true;
    let policies = policies(&arguments, has_pixels)?;
    let settings = settings(&arguments)?;
    ensure!(
        video.ground_truth.is_empty() || arguments.fps.is_none(),
        "--fps leaves out frames of which --ground-truth tells: save the detections of all frames with --save-detections, and \
         give --fps to `albireo eval recorded`"
    );
    let mut models = start_models(&video.pass)?;
    let truth = ground_truth(video, arguments.settings.rules()?, models.class_names())?;
    if let Some(truth) = &truth {
        truth.check(&names)?;
        models.evaluate(truth.classes());
    }
    let mut evaluation = Evaluation {
        video,
        pass_settings: PassSettings {
            max_frames: video.pass.frames,
            ..PassSettings::for_policies(&policies)?
        },
        models,
        arguments,
        names,
        policies,
        settings,
        truth,
        report: LoadReport::default(),
        results: Vec::new(),
        streams: Vec::new(),
        times: Vec::new(),
        kept: Vec::new(),
    };
    evaluation.check_pictures()?;
    for clips in &video.clips {
        for mut source in clips.open_clips(evaluation.arguments.rate, video.encoding)? {
            let rate = evaluation.rate(clips, source.as_ref());
            match evaluation.arguments.fps {
                None => evaluation.add(source.as_mut(), rate)?,
                Some(fps) => {
                    ensure!(
                        rate.is_some(),
                        "--fps {fps}: pictures do not say how many of them are a second: add --rate"
                    );
                    let mut slower = Downsampled::new(source.as_mut(), fps);
                    let lower_rate = slower.rate();
                    evaluation.add(&mut slower, Some(lower_rate))?;
                }
            }
        }
    }
    evaluation.conclude()
}

/// Returns the arguments with the screen rule that follows from the models.
fn with_screen(video: &VideoArguments) -> anyhow::Result<RunArguments> {
    let mut arguments = video.run.clone();
    let confidence = arguments.settings.confidence;
    ensure!(
        (LOWEST_CONFIDENCE..=1.0).contains(&confidence),
        "--confidence {confidence} is not between {LOWEST_CONFIDENCE} and 1"
    );
    if video.pass.screen_model.is_some() {
        arguments.settings.screen = ScreenRule::Recorded;
    } else if arguments.settings.screen == ScreenRule::Recorded {
        bail!("--screen recorded needs the verdicts of a screen: name one with --screen-model");
    }
    Ok(arguments)
}

/// Reads the ground truth that was named, or the one that belongs to the clips, for a model with `classes`.
fn ground_truth(
    video: &VideoArguments,
    rules: Rules,
    classes: &[String],
) -> anyhow::Result<Option<GroundTruth>> {
    // The demonstration's own tells of every frame, so it cannot judge a clip of which frames were left out.
    if video.truth_format.is_none() && video.run.fps.is_some() {
        return Ok(None);
    }
    let places = truth_places(&video.clips, &video.ground_truth, video.truth_format);
    let Some((paths, format)) = places else {
        return Ok(None);
    };
    let truth = GroundTruth::for_model(&paths, format, rules, classes)?;
    Ok(Some(truth))
}

/// The files of the ground truth that was named, or of the one that belongs to the clips if it belongs to all of them.
pub(super) fn truth_places(
    clips: &[SourceName],
    named: &[PathBuf],
    format: Option<TruthFormat>,
) -> Option<(Vec<PathBuf>, TruthFormat)> {
    if let Some(format) = format {
        return Some((named.to_vec(), format));
    }
    let mut own = BTreeSet::new();
    for clip in clips {
        own.insert(PathBuf::from(clip.truth()?));
    }
    Some((own.into_iter().collect(), TruthFormat::Bdd100k))
}

/// The names of all clips; results, truth and files are told apart by them.
pub(super) fn clip_names(clips: &[SourceName]) -> anyhow::Result<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for clip in clips {
        names.extend(clip.clip_names()?);
    }
    let mut seen = HashSet::new();
    for name in &names {
        let is_new = seen.insert(name);
        ensure!(
            is_new,
            "two clips are named `{name}`: rename one of the files"
        );
    }
    Ok(names)
}

/// An evaluation over clips that are looked at one after the other.
struct Evaluation<'a> {
    video: &'a VideoArguments,
    arguments: RunArguments,
    names: Vec<String>,
    policies: Vec<PolicySpec>,
    settings: Settings,
    pass_settings: PassSettings,
    models: ModelRunner,
    /// Ground truth; without any, clips are judged against Vanilla's own output.
    truth: Option<GroundTruth>,
    report: LoadReport,
    results: Vec<ClipResult>,
    streams: Vec<StreamResults>,
    times: Vec<StepTimes>,
    /// The clips without their pictures, for `--save-detections`.
    kept: Vec<Clip>,
}

impl Evaluation<'_> {
    /// Holds the number and size of each clip's pictures against the ground truth before the detector runs: a mistake is
    /// found now and not after hours. How many frames a video has is known only when it was played.
    fn check_pictures(&self) -> anyhow::Result<()> {
        let Some(mut truth) = self.truth.clone() else {
            return Ok(());
        };
        let are_pictures = |clips: &&SourceName| {
            matches!(
                clips,
                SourceName::Pictures(_) | SourceName::Archive(_) | SourceName::Demo
            )
        };
        let mut left_out = LoadReport::default();
        let mut boxes = 0;
        let mut are_all_known = self.video.clips.iter().all(|clips| are_pictures(&clips));
        for clips in self.video.clips.iter().filter(are_pictures) {
            for mut source in clips.open_clips(self.arguments.rate, self.video.encoding)? {
                let known = source.frames().and_then(|frames| usize::try_from(frames).ok());
                let Some(whole) = known else {
                    are_all_known = false;
                    continue;
                };
                // A picture that cannot be used is reported in the pass.
                let Ok(Some(first)) = source.next() else {
                    are_all_known = false;
                    continue;
                };
                let most = self.pass_settings.max_frames.unwrap_or(whole);
                let mut clip = Clip::new(source.name().to_owned(), first.size, whole.min(most));
                clip.file_names = source.file_names();
                let is_alone = self.names.len() == 1;
                // The pass gives each clip its truth once more, and reports what is left out.
                truth.attach_to(&mut clip, is_alone, Some(whole), &mut left_out)?;
                boxes += clip.truth_boxes();
            }
        }
        if are_all_known && let Err(nothing) = left_out.check_boxes(boxes) {
            let most = self.pass_settings.max_frames;
            let line = without_boxes(&self.video.ground_truth, most, nothing);
            eprintln!("{}", terminal::error(&line));
        }
        Ok(())
    }

    /// Returns the frames per second of a clip: those that were asked for, the video's own, or those of the ground truth.
    /// Pictures alone have none.
    fn rate(&self, name: &SourceName, source: &dyn FrameSource) -> Option<f64> {
        if let Some(asked) = self.arguments.rate {
            return Some(asked);
        }
        match name {
            SourceName::Video(_)
            | SourceName::VideoFiles(_)
            | SourceName::Recording(..)
            | SourceName::Demo => Some(source.rate()),
            SourceName::Pictures(_) | SourceName::Archive(_) => {
                self.truth.as_ref()?.rate(source.name(), self.names.len() == 1)
            }
        }
    }

    /// Runs the detector over a clip of `rate` frames per second, and all policies on its detections.
    fn add(&mut self, source: &mut dyn FrameSource, rate: Option<f64>) -> anyhow::Result<()> {
        let mut clip = pass_over(
            source,
            &mut self.models,
            &self.pass_settings,
            &mut self.report,
        )?;
        clip.frame_rate = rate;
        // The clips that are kept are without pictures.
        let pass = clip.pass.take();
        if let Some(pass) = &pass {
            self.times.extend(&pass.times);
        }
        if let Some(truth) = &mut self.truth {
            // The frames behind a limit were not looked at.
            let looked_at = clip.frames + clip.unusable.len();
            let was_cut = self.pass_settings.max_frames == Some(looked_at);
            let frames_of_source = if was_cut {
                source.frames().and_then(|frames| usize::try_from(frames).ok())
            } else {
                Some(looked_at)
            };
            let is_alone = self.names.len() == 1;
            truth.attach_to(&mut clip, is_alone, frames_of_source, &mut self.report)?;
        }
        if let Some(folder) = &self.video.pass.save_detections {
            // Whatever happens to the next clip, this one is on the disk.
            self.kept.push(clip.clone());
            recorded::write_last(folder, &self.kept)?;
        }
        clip.pass = pass;
        if self.truth.is_none() {
            clip.truth = Some(vanilla_as_truth(&clip, self.settings.confidence));
        } else if clip.truth.is_none() {
            let note = format!("{}: not in the ground truth, left out", clip.name);
            self.report.notes.push(note);
            return Ok(());
        }

        let no_progress = || ();
        let mut results = run::run([&clip], &self.policies, &self.settings, &no_progress)?;
        // The pictures of the frames that lost most are read again: keeping all pictures until these frames are known
        // would take too much memory.
        if let Err(error) = attach_pictures(source, &mut results, &clip.unusable) {
            let name = &clip.name;
            let note = format!("{name}: no pictures of the frames that lost most: {error}");
            self.report.notes.push(note);
        }
        self.results.extend(results);
        for (number, stream) in streams_asked(&self.arguments).into_iter().enumerate() {
            let of_stream = streams::run([&clip], &self.policies, &self.settings, stream)?;
            match self.streams.get_mut(number) {
                Some(clips_before) => clips_before.extend(of_stream),
                None => self.streams.push(of_stream),
            }
        }
        Ok(())
    }

    /// Says what was noticed in the pass, writes the report to `--out`, and prints the results.
    fn conclude(mut self) -> anyhow::Result<()> {
        let pass = &self.video.pass;
        end_pass(pass, &self.report);
        let basis = match self.truth {
            Some(_) if self.video.ground_truth.is_empty() => {
                "by the ground truth that comes with the demonstration".to_owned()
            }
            Some(_) => {
                let files = self.video.ground_truth.iter().map(|file| file.display().to_string());
                format!(
                    "by the ground truth of {}",
                    files.collect::<Vec<_>>().join(", ")
                )
            }
            None => format!(
                "against vanilla: its own output at confidence {} is used as ground truth",
                self.settings.confidence
            ),
        };
        let mut notes = times_of_steps(&self.times);
        for input in self.models.inputs() {
            notes.push(("Input of the detector".to_owned(), input));
        }
        let mut settings = vec![("Judged".to_owned(), basis.clone())];
        settings.extend(listed(&self.arguments, &self.results)?);
        settings.push((
            "Detector".to_owned(),
            format!(
                "{} (head {}), run by {}",
                pass.detector.display(),
                pass.head,
                self.models.provider().as_str()
            ),
        ));
        if let Some(screen) = &pass.screen_model {
            settings.push(("Screen model".to_owned(), screen.display().to_string()));
        }
        settings.extend(notes.iter().cloned());

        // The results came clip by clip; a report is in order of policies.
        self.results.sort_by_key(|result| {
            let mut policies = self.policies.iter();
            policies.position(|policy| policy.label == result.policy)
        });
        let report = Report {
            title: title(&self.names),
            settings,
            data: self.report,
            policies: summary::summarise(&self.results),
            clips: self.results,
        };
        keep(&report, &self.streams, &self.arguments)?;
        terminal::print(&format!("Judged {basis}"));
        print(&report, &self.streams, &self.arguments);
        print_screens(&report.clips);
        for (name, value) in notes {
            terminal::print(&format!("{name}: {value}"));
        }
        Ok(())
    }
}

/// Warns that the ground truth of these files has `nothing` for the first frames of the clips, of each so many at
/// `most`. It is no mistake: a clip can be without objects.
pub(super) fn without_boxes(
    files: &[PathBuf],
    most: Option<usize>,
    nothing: impl Display,
) -> String {
    // The demonstration has its own.
    let mut names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    if names.is_empty() {
        names.push("demo".to_owned());
    }
    let limit = most.map(|most| format!(" (--frames {most})")).unwrap_or_default();
    format!(
        "albireo: {}: of the frames that are played{limit}: {nothing}",
        names.join(", ")
    )
}

/// Returns the report's heading: the clips' names, or the first of many.
fn title(names: &[String]) -> String {
    match names {
        [first, second, third, _, ..] => {
            format!("{first}, {second}, {third} and {} more", names.len() - 3)
        }
        few => few.join(", "),
    }
}

/// Selects the time of one step.
type StepTime = fn(&StepTimes) -> f64;

/// Lists the time of each step that was taken.
fn times_of_steps(times: &[StepTimes]) -> Vec<(String, String)> {
    let steps: [(&str, StepTime); 5] = [
        ("the detector", |times| times.detector),
        ("the screen", |times| times.screen),
        ("decoding", |times| times.decode),
        ("decoding to grey", |times| times.grey),
        ("decoding to a small grey picture", |times| times.small),
    ];
    let frames = counted(times.len() as u64, "frame", "frames");
    let mut rows = Vec::new();
    for (step, time) in steps {
        let Some(spread) = Spread::of(times.iter().map(time).collect()) else {
            continue;
        };
        // The time of a step that was not taken is 0.
        if spread.mean == 0.0 {
            continue;
        }
        let value = format!(
            "mean {:.2} ms, p50 {:.2}, p95 {:.2}, p99 {:.2} (measured on this machine, {frames})",
            spread.mean, spread.p50, spread.p95, spread.p99,
        );
        rows.push((format!("Time of {step}"), value));
    }
    rows
}

/// Loads the models of the pass, if there is a place for what is kept of it.
fn start_models(pass: &PassArguments) -> anyhow::Result<ModelRunner> {
    if let Some(folder) = &pass.save_detections {
        recorded::check_unused(folder)?;
    }
    let detector = DetectorConfig {
        model: pass.detector.clone(),
        head: pass.head.clone(),
        class_names: pass.class_names.clone().map(ClassNames::File),
        // The evaluation maps classes itself.
        report_classes: Some(Vec::new()),
        confidence: LOWEST_CONFIDENCE,
        providers: vec![pass.provider],
        timeout_ms: TIMEOUT_MS,
        ..DetectorConfig::default()
    };
    let screen = ScreenConfig {
        model: pass.screen_model.clone(),
        color_order: pass.screen_color_order,
        empty_is_second: pass.screen_empty_class == 1,
        timeout_ms: TIMEOUT_MS,
        ..ScreenConfig::default()
    };
    Ok(ModelRunner::start(&detector, &screen)?)
}

/// Says what was noticed in the pass, and where its detections are.
fn end_pass(pass: &PassArguments, report: &LoadReport) {
    for line in report.lines() {
        eprintln!("{line}");
    }
    if let Some(folder) = &pass.save_detections {
        eprintln!("Detections written to {}", folder.display());
    }
}

/// Passes over a clip, with a progress bar on a terminal and a line otherwise.
fn pass_over(
    source: &mut dyn FrameSource,
    models: &mut ModelRunner,
    settings: &PassSettings,
    report: &mut LoadReport,
) -> anyhow::Result<Clip> {
    let most = settings.max_frames.map(|most| most as u64);
    let total = match (source.frames(), most) {
        (Some(known), Some(most)) => Some(known.min(most)),
        (known, most) => known.or(most),
    };
    let bar = progress::bar(total, "frames").with_prefix(format!("{}: ", source.name()));
    if bar.is_hidden() {
        let frames = match total {
            Some(total) => counted(total, "frame", "frames"),
            None => "all frames".to_owned(),
        };
        eprintln!("{}: processing {frames}", source.name());
    }
    let clip = run_pass(source, models, settings, report, &mut || bar.inc(1));
    bar.finish_and_clear();
    Ok(clip?)
}

/// Runs the detector over videos and pictures. `rate` is the frames per second of pictures.
pub(super) fn detect_all(
    clips: &[SourceName],
    rate: Option<f64>,
    pass: &PassArguments,
) -> anyhow::Result<Vec<Clip>> {
    if pass.save_detections.is_some() {
        // Their tables are named after them.
        clip_names(clips)?;
    }
    let mut models = start_models(pass)?;
    let settings = PassSettings {
        max_frames: pass.frames,
        ..PassSettings::default()
    };
    let mut report = LoadReport::default();
    let mut detected_clips = Vec::new();
    for clip in clips {
        for mut source in clip.open_clips(rate, VideoEncoding::default())? {
            let mut detected = pass_over(source.as_mut(), &mut models, &settings, &mut report)?;
            // Pictures have no rate of their own; what was assumed for playing is no fact to be saved.
            if matches!(clip, SourceName::Pictures(_) | SourceName::Archive(_)) {
                detected.frame_rate = rate;
            }
            detected_clips.push(detected);
            if let Some(folder) = &pass.save_detections {
                recorded::write_last(folder, &detected_clips)?;
            }
        }
    }
    end_pass(pass, &report);
    Ok(detected_clips)
}

/// Prints how many frames the screen or the pause called empty, in a line per policy under which there are any. The
/// results are in the order of the policies.
fn print_screens(results: &[ClipResult]) {
    for clips in results.chunk_by(|a, b| a.policy == b.policy) {
        if let Some(line) = called_empty(clips) {
            terminal::print(&line);
        }
    }
}

/// Says how many frames of a policy's clips were called empty, and how many of these wrongly; `None` if none was.
fn called_empty(clips: &[ClipResult]) -> Option<String> {
    let policy = &clips.first()?.policy;
    let mut empty = 0;
    let mut frames = 0;
    let mut occupied = 0;
    let mut missed = 0;
    for clip in clips {
        empty += clip.states.e;
        frames += clip.frames;
        occupied += clip.occupied_frames;
        missed += clip.false_empty_frames;
    }
    if empty == 0 {
        return None;
    }
    let wrongly = if occupied == 0 {
        "none wrongly: the detector finds nothing in any frame".to_owned()
    } else {
        let share = 100.0 * missed as f64 / occupied as f64;
        format!(
            "false-empty rate {share:.1} % ({missed} of the {occupied} frames in which the detector finds something)"
        )
    };
    Some(format!(
        "Screen under {policy}: {empty} of {frames} frames called empty; {wrongly}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use std::slice::from_ref;

    #[derive(Parser)]
    struct PassCommand {
        #[command(flatten)]
        pass: PassArguments,
    }

    #[test]
    fn a_pass_never_replaces_the_detections_of_an_earlier_one() {
        let folder = tempfile::tempdir().unwrap();
        let saved = folder.path().to_str().unwrap();
        std::fs::write(folder.path().join("sequences.json"), "{}").unwrap();
        let words = ["", "--detector", "nothere.onnx", "--save-detections", saved];
        let pass = PassCommand::parse_from(words).pass;
        // It is refused before the models are loaded, of which there are none.
        let refused = start_models(&pass).err().unwrap().to_string();
        assert!(refused.contains("another folder"), "{refused}");
    }

    #[test]
    fn frames_without_a_box_are_told_with_the_files_and_the_limit() {
        let files = ["a.json", "b.json"].map(PathBuf::from);
        let most = Some(20);
        let said = without_boxes(&files, most, "no box");
        let expected =
            "albireo: a.json, b.json: of the frames that are played (--frames 20): no box";
        assert_eq!(said, expected);
    }

    #[test]
    fn without_a_frame_that_has_something_in_it_there_is_no_rate_of_wrongly_empty_frames() {
        let mut clip = ClipResult::default();
        assert_eq!(called_empty(from_ref(&clip)), None);
        clip.frames = 10;
        clip.states.e = 4;
        let said = called_empty(from_ref(&clip)).unwrap();
        let nothing = "the detector finds nothing in any frame";
        assert!(said.ends_with(nothing), "{said}");
        clip.occupied_frames = 5;
        clip.false_empty_frames = 1;
        let said = called_empty(from_ref(&clip)).unwrap();
        let rate = "false-empty rate 20.0 % (1 of the 5 frames";
        assert!(said.contains(rate), "{said}");
    }
}
