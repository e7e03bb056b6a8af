//! Compares a detector frame in the decision core with the trackers of `trackforge`, `norfair-rs` and
//! `edgefirst-tracker`, on the same boxes and in the same run, by the processor time of the one thread that runs them.
//! Prints a table in Markdown.
//!
//! `make bench-peers`, or `cargo run --release --manifest-path benches/standalone/Cargo.toml`

use albireo_core::detection::Detection;
use albireo_core::policy::{
    Albireo, AlbireoSettings, Evidence, ExpectedLoss, ExpectedLossSettings, FrameHead, Need,
    Outcome, Policy, Profile, Trigger,
};
use albireo_scene::{PICTURE, Scene, processor_seconds, quartiles};
use edgefirst_tracker::bytetrack::ByteTrackBuilder;
use edgefirst_tracker::{DetectionBox, Tracker as _};
use norfair_rs::TrackerConfig;
use std::error::Error;
use std::hint::black_box;
use std::process::{Command, ExitCode};
use trackforge::trackers::byte_track::ByteTrack;
use trackforge::trackers::ocsort::{OcSort, OcSortParams};
use trackforge::trackers::sort::Sort;

const OBJECTS: [usize; 4] = [10, 30, 100, 300];
const FRAMES: usize = 100;
/// The rounds of each contestant. They take turns, so that a slow minute affects all of them.
const ROUNDS: usize = 101;

/// The settings of glibc's allocator, which make it keep freed memory. By default it returns memory to the system and
/// requests it again within a frame. For contestants that allocate per frame, that costs more than their own work.
const TUNABLES: &str = "glibc.malloc.trim_threshold=1073741824:glibc.malloc.mmap_threshold=1073741824:glibc.malloc.top_pad=67108864";
/// The variable from which glibc reads them.
const TUNABLES_VARIABLE: &str = "GLIBC_TUNABLES";

/// A box for trackforge: left, top, width, height in pixels; score; class.
type Measured = ([f32; 4], f32, i64);

/// A box for edgefirst-tracker: corners from 0 to 1, score, class.
#[derive(Clone, Debug)]
struct EdgefirstBox {
    corners: [f32; 4],
    score: f32,
    class: usize,
}

impl DetectionBox for EdgefirstBox {
    fn bbox(&self) -> [f32; 4] {
        self.corners
    }

    fn score(&self) -> f32 {
        self.score
    }

    fn label(&self) -> usize {
        self.class
    }
}

/// A film in the format of each contestant.
struct Film {
    ours: Vec<Vec<Detection>>,
    trackforge: Vec<Vec<Measured>>,
    norfair: Vec<Vec<norfair_rs::Detection>>,
    edgefirst: Vec<Vec<EdgefirstBox>>,
}

impl Film {
    fn new(objects: usize) -> Result<Self, Box<dyn Error>> {
        let forth = Scene::new(objects).film(FRAMES / 2, objects / 20);
        // Forwards and backwards, so that the film repeats without a cut.
        let ours: Vec<_> = forth.iter().chain(forth.iter().rev()).cloned().collect();
        let norfair = ours.iter().map(|frame| frame.iter().map(norfair_box).collect());
        Ok(Self {
            trackforge: each(&ours, measured),
            norfair: norfair.collect::<Result<_, _>>()?,
            edgefirst: each(&ours, edgefirst_box),
            ours,
        })
    }
}

fn each<T>(film: &[Vec<Detection>], form: impl Fn(&Detection) -> T) -> Vec<Vec<T>> {
    film.iter().map(|frame| frame.iter().map(&form).collect()).collect()
}

fn norfair_box(detection: &Detection) -> norfair_rs::Result<norfair_rs::Detection> {
    let corners = detection.bounding_box.pixel_corners(PICTURE);
    norfair_rs::Detection::from_slice(&[corners.x1, corners.y1, corners.x2, corners.y2], 1, 4)
}

fn edgefirst_box(detection: &Detection) -> EdgefirstBox {
    let corners = detection.bounding_box.corners();
    EdgefirstBox {
        corners: [corners.x1, corners.y1, corners.x2, corners.y2].map(|value| value as f32),
        score: detection.confidence as f32,
        class: usize::from(detection.class.0),
    }
}

fn measured(detection: &Detection) -> Measured {
    let corners = detection.bounding_box.pixel_corners(PICTURE);
    let x1 = corners.x1 as f32;
    let y1 = corners.y1 as f32;
    let x2 = corners.x2 as f32;
    let y2 = corners.y2 as f32;
    (
        [x1, y1, x2 - x1, y2 - y1],
        detection.confidence as f32,
        i64::from(detection.class.0),
    )
}

/// What it took to play a film once.
struct Played {
    microseconds_per_frame: f64,
    /// The number of boxes at the end.
    boxes: usize,
}

impl Played {
    fn since(begin: f64, boxes: usize) -> Self {
        Self {
            microseconds_per_frame: (processor_seconds() - begin) * 1e6 / FRAMES as f64,
            boxes,
        }
    }
}

/// Plays a film once.
type Contestant<'a> = Box<dyn FnMut() -> Played + 'a>;

fn ours<'a, P: Policy + 'a>(mut policy: P, film: &'a Film) -> Contestant<'a> {
    let mut outcome = Outcome::default();
    let mut index = 0u64;
    Box::new(move || {
        let begin = processor_seconds();
        for detections in &film.ours {
            index += 1;
            let mut need = policy.begin(FrameHead {
                // Never a multiple of the periodic cap.
                index: index % 29 + 1,
                step: 1,
                picture: PICTURE,
            });
            while need != Need::Nothing {
                need = policy.answer(match need {
                    Need::Screen => Evidence::Screen { empty: false },
                    _ => Evidence::Detections(detections),
                });
            }
            policy.finish(&mut outcome);
            black_box(&outcome);
            assert!(!outcome.state.is_skipped());
        }
        Played::since(begin, outcome.boxes.len())
    })
}

/// Wraps a tracker whose `update` takes the boxes of a frame and returns the number of tracked objects.
fn theirs<'a, T: Clone>(
    film: &'a [Vec<T>],
    mut update: impl FnMut(Vec<T>) -> usize + 'a,
) -> Contestant<'a> {
    Box::new(move || {
        // Most trackers take the boxes by value. The copies are not counted.
        let frames = film.to_vec();
        let mut boxes = 0;
        let begin = processor_seconds();
        for frame in frames {
            boxes = black_box(update(frame));
        }
        Played::since(begin, boxes)
    })
}

fn contestants(film: &Film) -> Result<Vec<(&'static str, Contestant<'_>)>, Box<dyn Error>> {
    let albireo = |profile| Albireo::new(AlbireoSettings::of(profile), 1e-9);
    let trigger = Trigger::ExpectedLoss { lambda: 0.0 };
    let expected_loss = ExpectedLoss::new(ExpectedLossSettings::default(), trigger)?;
    let mut sort = Sort::new(1, 3, 0.3);
    let mut byte_track = ByteTrack::new(0.5, 30, 0.8, 0.6);
    let mut oc_sort = OcSort::from_params(OcSortParams::default());
    // A distance of 1 − IoU, equivalent to SORT's 0.3 above.
    let mut config = TrackerConfig::from_distance_name("iou", 0.7);
    config.initialization_delay = 3;
    let mut norfair = norfair_rs::Tracker::new(config)?;
    let mut edgefirst = ByteTrackBuilder::new().track_high_conf(0.5).build::<EdgefirstBox>();
    let mut time_ns = 0;
    Ok(vec![
        (
            "albireo, profile paper",
            ours(albireo(Profile::Paper)?, film),
        ),
        (
            "albireo, profile reference",
            ours(albireo(Profile::Reference)?, film),
        ),
        ("expected-loss", ours(expected_loss, film)),
        (
            "trackforge 0.5.1 SORT",
            theirs(&film.trackforge, move |frame| sort.update(frame).len()),
        ),
        (
            "trackforge 0.5.1 ByteTrack",
            theirs(&film.trackforge, move |frame| {
                byte_track.update(frame).len()
            }),
        ),
        (
            "trackforge 0.5.1 OC-SORT",
            theirs(&film.trackforge, move |frame| oc_sort.update(frame).len()),
        ),
        (
            "norfair-rs 0.5.2",
            theirs(&film.norfair, move |frame| {
                norfair.update(frame, 1, None).len()
            }),
        ),
        (
            "edgefirst-tracker 0.38.2 ByteTrack",
            theirs(&film.edgefirst, move |frame| {
                time_ns += 33_333_333;
                edgefirst.update(&frame, time_ns).iter().flatten().count()
            }),
        ),
    ])
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    // glibc reads the variable once, at process start.
    if std::env::var_os(TUNABLES_VARIABLE).is_none() {
        let mut again = Command::new(std::env::current_exe()?);
        let status = again.env(TUNABLES_VARIABLE, TUNABLES).status()?;
        return Ok(if status.success() {
            ExitCode::SUCCESS
        } else {
            ExitCode::FAILURE
        });
    }
    measure()?;
    Ok(ExitCode::SUCCESS)
}

fn measure() -> Result<(), Box<dyn Error>> {
    let tunables = std::env::var(TUNABLES_VARIABLE).unwrap_or_default();
    println!("{TUNABLES_VARIABLE}={tunables}\n");
    println!(
        "Processor time of a frame on which the detector ran, µs: median of {ROUNDS} rounds of {FRAMES} frames (quartiles)\n"
    );
    let films: Vec<_> = OBJECTS.into_iter().map(Film::new).collect::<Result<_, _>>()?;
    let mut columns = Vec::new();
    for (objects, film) in OBJECTS.iter().zip(&films) {
        let mut contestants = contestants(film)?;
        let mut times = vec![Vec::new(); contestants.len()];
        for round in 0..=ROUNDS {
            for ((name, play), times) in contestants.iter_mut().zip(&mut times) {
                let played = play();
                assert!(
                    played.boxes * 10 >= objects * 8,
                    "{name} follows {} of {objects} objects: its time means nothing",
                    played.boxes
                );
                // The first round warms up caches and filters.
                if round > 0 {
                    times.push(played.microseconds_per_frame);
                }
            }
        }
        columns.push(times.into_iter().map(quartiles).collect::<Vec<_>>());
    }
    let head: Vec<_> = OBJECTS.iter().map(|n| format!("{n} objects")).collect();
    println!(
        "| | {} |\n| --- |{}",
        head.join(" | "),
        " --- |".repeat(OBJECTS.len())
    );
    for (row, (name, _)) in contestants(&films[0])?.iter().enumerate() {
        let cells: Vec<_> = columns
            .iter()
            .map(|column| {
                let [low, median, high] = column[row];
                format!("{median:.1} ({low:.1}-{high:.1})")
            })
            .collect();
        println!("| {name} | {} |", cells.join(" | "));
    }
    Ok(())
}
