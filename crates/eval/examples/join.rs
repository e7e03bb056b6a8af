//! Prints how many runs of the detector four cameras need that share them, with and without `detector.join`, for the same
//! number of pictures. The cameras are in step; a run has 1, 2 or 4 pictures, as in a node with `detector.batch_size = 4`.
//!
//! `cargo run --release -p albireo-eval --example join -- DIR`
#![allow(clippy::print_stdout)]

use albireo_core::detection::Detection;
use albireo_core::policy::{
    FrameEvidence, FrameHead, MinConfidence, Outcome, Policy, PolicyConfig, decide,
};
use albireo_eval::boxes::ScoredBox;
use albireo_eval::data::{Clip, recorded};
use albireo_eval::judge::{Classes, Interpolation, Truth, accuracy};
use albireo_eval::summary::Difference;
use clap::Parser;
use std::error::Error;
use std::path::{Path, PathBuf};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Cameras that share the detector.
const CAMERAS: usize = 4;

/// Another detector's recording of a video that is among the others.
const TWICE: &str = "KITTI-13";

/// Detections below this are dropped, as by `detector.confidence`.
const CONFIDENCE: f64 = 0.5;

/// The policies and shares of the table.
const POLICIES: &str =
    "albireo:1e-3 albireo:3e-3 expected-loss:0.3 expected-loss:0.6 expected-loss:1 expected-loss:2";
const SHARES: [f64; 3] = [0.1, 0.3, 0.5];

#[derive(Parser)]
struct Arguments {
    /// A folder with sequences.json, detections/ and groundtruth/.
    folder: PathBuf,
}

/// Recordings in groups of four, each as long as the shortest of its group.
pub(crate) struct Groups(Vec<Vec<Camera>>);

struct Camera {
    clip: Clip,
    detections: Vec<Vec<Detection>>,
}

/// What all groups took under one policy.
pub(crate) struct Point {
    threshold: f64,
    pub(crate) runs: usize,
    pub(crate) pictures: usize,
    /// AP@50 of the published boxes, in percent, of each clip.
    ap50: Vec<f64>,
}

impl Point {
    /// The mean difference of the clips' AP@50 to those of `other`, with its interval.
    pub(crate) fn change(&self, other: &Self) -> Option<Difference> {
        let changes: Vec<f64> =
            self.ap50.iter().zip(&other.ap50).map(|(own, its)| own - its).collect();
        Difference::of(&changes)
    }
}

impl Camera {
    fn new(clip: &Clip, frames: usize) -> Self {
        let mut clip = clip.clone();
        clip.frames = frames;
        let shorten = |boxes: &mut Vec<Vec<ScoredBox>>| boxes.truncate(frames);
        clip.truth.iter_mut().for_each(shorten);
        clip.ignored.truncate(frames);
        let stored = clip.detections.take().unwrap_or_default();
        let picture = clip.picture;
        let usable = |found: &Vec<ScoredBox>| {
            let sure = found.iter().filter(|found| found.confidence >= CONFIDENCE);
            sure.map(|found| found.normalise(picture)).collect()
        };
        let detections = stored.iter().take(frames).map(usable).collect();
        Self { clip, detections }
    }
}

impl Groups {
    /// The clips of `folder` with ground truth, the shortest together.
    pub(crate) fn read(folder: &Path) -> Result<Self> {
        let mut clips = recorded::read(folder)?.only_with_detections(folder)?.clips;
        clips.retain(|clip| clip.truth.is_some() && clip.name != TWICE);
        clips.sort_by_key(|clip| clip.frames);
        let groups = clips.chunks_exact(CAMERAS).map(|clips| {
            let shortest = clips.iter().map(|clip| clip.frames).min().unwrap_or_default();
            clips.iter().map(|clip| Camera::new(clip, shortest)).collect()
        });
        Ok(Self(groups.collect()))
    }

    fn clips(&self) -> usize {
        self.0.iter().map(Vec::len).sum()
    }

    fn moments(&self) -> usize {
        self.0.iter().map(|group| group[0].detections.len()).sum()
    }

    /// Runs `NAME:THRESHOLD` on every camera; calls within `share` of the threshold join.
    pub(crate) fn run(&self, policy: &str, share: f64) -> Result<Point> {
        let mut config = PolicyConfig::default();
        config.select(policy)?;
        let mut point = Point {
            threshold: config.build()?.threshold().unwrap_or_default(),
            runs: 0,
            pictures: 0,
            ap50: Vec::new(),
        };
        for group in &self.0 {
            run_group(group, &config, share, &mut point)?;
        }
        Ok(point)
    }

    /// The policy `name` at the lowest threshold, of those tried, with at most as many `pictures`.
    pub(crate) fn with_pictures(&self, name: &str, share: f64, pictures: usize) -> Result<Point> {
        let mut config = PolicyConfig::default();
        config.select(name)?;
        let spec = config.build()?.threshold_spec().ok_or("it has no threshold")?;
        let mut low = spec.minimum.max(1e-6).ln();
        let mut high = spec.maximum.ln();
        for _ in 0..16 {
            let middle = f64::midpoint(low, high);
            let reached = self.run(&format!("{name}:{:e}", middle.exp()), share)?;
            if reached.pictures > pictures {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.run(&format!("{name}:{:e}", high.exp()), share)
    }
}

/// Adds what the cameras of a group take to `point`.
fn run_group(group: &[Camera], config: &PolicyConfig, share: f64, point: &mut Point) -> Result<()> {
    let mut policies = Vec::new();
    for _ in group {
        policies.push(config.build()?);
    }
    let frames = group[0].detections.len();
    let mut boxes = vec![Vec::with_capacity(frames); group.len()];
    for frame in 0..frames {
        let pictures = decide_moment(group, &mut policies, frame, share, &mut boxes);
        point.pictures += pictures;
        // As many runs as it has binary digits that are 1: three pictures are a run of two and one of one.
        point.runs += pictures.count_ones() as usize;
    }
    for (camera, boxes) in group.iter().zip(&boxes) {
        let objects = camera.clip.truth.as_ref().ok_or("a clip has no ground truth")?;
        let ignored = &camera.clip.ignored;
        let truth = Truth { objects, ignored };
        let found = accuracy(boxes, truth, Classes::Pooled, Interpolation::AllPoints);
        point.ap50.push(100.0 * found.ok_or("a clip has no objects")?.ap50);
    }
    Ok(())
}

/// Decides one frame of every camera, one after the other, and adds its published boxes; returns the number of pictures for
/// the detector. A camera knows only of the calls of those that came before it.
fn decide_moment(
    group: &[Camera],
    policies: &mut [Box<dyn Policy>],
    frame: usize,
    share: f64,
    boxes: &mut [Vec<Vec<ScoredBox>>],
) -> usize {
    let mut pictures = 0;
    let mut outcome = Outcome::default();
    for place in 0..CAMERAS {
        // None is always the first.
        let camera = (frame + place) % CAMERAS;
        let Camera { clip, detections } = &group[camera];
        let policy = &mut *policies[camera];
        let a_run_has_room = (1..CAMERAS).contains(&pictures);
        policy.set_join(if a_run_has_room { share } else { 0.0 });
        let head = FrameHead {
            index: frame as u64,
            step: 1,
            picture: clip.picture,
        };
        let mut known = FrameEvidence::in_view(&detections[frame]);
        let Ok(()) = decide(policy, head, &mut known, &mut outcome);
        pictures += usize::from(outcome.cause.is_some());
        MinConfidence::new(None, CONFIDENCE).select(&mut outcome.boxes);
        let published = outcome.boxes.iter().map(|shown| ScoredBox {
            corners: shown.bounding_box.pixel_corners(clip.picture),
            class: shown.class,
            confidence: shown.confidence,
            object: None,
        });
        boxes[camera].push(published.collect());
    }
    pictures
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let groups = Groups::read(&arguments.folder)?;
    let clips = groups.clips();
    let moments = groups.moments();
    println!("{clips} clips in groups of {CAMERAS}, {moments} moments\n");
    println!(
        "| policy | pictures | runs | join | threshold | pictures | runs | Δ runs | Δ AP@50 |"
    );
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for policy in POLICIES.split(' ') {
        let alone = groups.run(policy, 0.0)?;
        let name = policy.split(':').next().unwrap_or(policy);
        for share in SHARES {
            let joining = groups.with_pictures(name, share, alone.pictures)?;
            let fewer = 100.0 * (joining.runs as f64 / alone.runs as f64 - 1.0);
            let change = joining.change(&alone).ok_or("there is no clip")?;
            // There is no interval if nothing has changed.
            let [lower, upper] = change.interval.unwrap_or_default();
            print!(
                "| `{policy}` | {} | {} | {share} ",
                alone.pictures, alone.runs
            );
            print!(
                "| {:.2e} | {} | {} ",
                joining.threshold, joining.pictures, joining.runs
            );
            println!(
                "| {fewer:+.0} % | {:+.1} [{lower:+.1}, {upper:+.1}] |",
                change.mean
            );
        }
    }
    Ok(())
}
