//! Time of a detector frame in the decision core, beside the trackers of `trackforge` on the same boxes, in
//! the same run: processor time of the one thread they run on. Prints a table in Markdown.
//!
//! `make bench-peers`, or `cargo run --release --manifest-path benches/standalone/Cargo.toml`

use albireo_bench_scene::{PICTURE, Scene, processor_seconds, quartiles};
use albireo_core::detection::Detection;
use albireo_core::policy::{
    Albireo, AlbireoSettings, Evidence, ExpectedLoss, ExpectedLossSettings, FrameHead, Need,
    Outcome, Policy, Profile, Trigger,
};
use std::error::Error;
use std::hint::black_box;
use trackforge::trackers::byte_track::ByteTrack;
use trackforge::trackers::ocsort::{OcSort, OcSortParams};
use trackforge::trackers::sort::Sort;

const OBJECTS: [usize; 3] = [10, 30, 100];
const FRAMES: usize = 100;
/// Rounds of each contestant; they take turns, so that a slow minute is slow for all of them alike.
const ROUNDS: usize = 101;

/// A box as trackforge takes it: left, top, width, height in pixels; score; class.
type Measured = ([f32; 4], f32, i64);

/// A film in the form of each contestant.
struct Film {
    ours: Vec<Vec<Detection>>,
    theirs: Vec<Vec<Measured>>,
}

impl Film {
    fn new(objects: usize) -> Self {
        let forth = Scene::new(objects).film(FRAMES / 2, objects / 20);
        // Back and forth, so that it can be played again without a cut.
        let ours: Vec<_> = forth.iter().chain(forth.iter().rev()).cloned().collect();
        let theirs = ours
            .iter()
            .map(|frame| frame.iter().map(measured).collect())
            .collect();
        Self { ours, theirs }
    }
}

fn measured(detection: &Detection) -> Measured {
    let corners = detection.bounding_box.pixel_corners(PICTURE);
    let [x1, y1, x2, y2] =
        [corners.x1, corners.y1, corners.x2, corners.y2].map(|value| value as f32);
    (
        [x1, y1, x2 - x1, y2 - y1],
        detection.confidence as f32,
        i64::from(detection.class.0),
    )
}

/// Plays a film once and says how long a frame took, in microseconds, and how many boxes came out in the
/// end.
type Contestant<'a> = Box<dyn FnMut() -> (f64, usize) + 'a>;

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
            loop {
                need = match need {
                    Need::Nothing => break,
                    Need::Screen => policy.answer(Evidence::Screen { empty: false }),
                    _ => policy.answer(Evidence::Detections(detections)),
                };
            }
            policy.finish(&mut outcome);
            black_box(&outcome);
            assert!(!outcome.state.is_skipped());
        }
        (per_frame(begin), outcome.boxes.len())
    })
}

fn theirs<'a, T: 'a>(
    film: &'a Film,
    mut update: impl FnMut(Vec<Measured>) -> Vec<T> + 'a,
) -> Contestant<'a> {
    Box::new(move || {
        // They take the boxes by value: the copies are not counted.
        let frames = film.theirs.clone();
        let mut boxes = 0;
        let begin = processor_seconds();
        for frame in frames {
            boxes = black_box(update(frame)).len();
        }
        (per_frame(begin), boxes)
    })
}

fn per_frame(begin: f64) -> f64 {
    (processor_seconds() - begin) * 1e6 / FRAMES as f64
}

fn contestants(film: &Film) -> Result<Vec<(&'static str, Contestant<'_>)>, Box<dyn Error>> {
    let albireo = |profile| Albireo::new(AlbireoSettings::of(profile), 1e-9);
    let trigger = Trigger::ExpectedLoss { lambda: 0.0 };
    let expected_loss = ExpectedLoss::new(ExpectedLossSettings::default(), trigger)?;
    let mut sort = Sort::new(1, 3, 0.3);
    let mut byte_track = ByteTrack::new(0.5, 30, 0.8, 0.6);
    let mut oc_sort = OcSort::from_params(OcSortParams::default());
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
            theirs(film, move |frame| sort.update(frame)),
        ),
        (
            "trackforge 0.5.1 ByteTrack",
            theirs(film, move |frame| byte_track.update(frame)),
        ),
        (
            "trackforge 0.5.1 OC-SORT",
            theirs(film, move |frame| oc_sort.update(frame)),
        ),
    ])
}

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "Processor time of a frame on which the detector ran, µs: median of {ROUNDS} rounds of {FRAMES} frames (quartiles)\n"
    );
    let films = OBJECTS.map(Film::new);
    let mut columns = Vec::new();
    for (objects, film) in OBJECTS.iter().zip(&films) {
        let mut contestants = contestants(film)?;
        let mut times = vec![Vec::new(); contestants.len()];
        for round in 0..=ROUNDS {
            for ((name, play), times) in contestants.iter_mut().zip(&mut times) {
                let (time, boxes) = play();
                assert!(
                    boxes * 10 >= objects * 8,
                    "{name} follows {boxes} of {objects} objects: its time means nothing"
                );
                // The first round is for the caches and the filters.
                if round > 0 {
                    times.push(time);
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
