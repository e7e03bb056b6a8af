//! With profile `reference`, the policy decides as the published code did, frame by frame.
//!
//! The traces are `golden/albireo-*` of the shared data, over its recorded detections; excerpts are in
//! `fixtures/golden`.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support::shared;
use albireo::detection::{ClassId, Detection};
use albireo::geometry::{BoundingBox, Corners, PictureSize};
use albireo::policy::{
    Albireo, AlbireoSettings, BoxSource, Evidence, FrameHead, Need, ObjectRecord, Outcome, Policy,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// Largest difference of boxes and τ.
const TOLERANCE: f64 = 1e-9;
/// Detections below this were not given to the published code.
const DETECTOR_THRESHOLD: f64 = 0.5;

#[derive(Deserialize)]
struct GoldenFrame {
    frame: u64,
    state: String,
    tau_max: Option<f64>,
    active: usize,
    objects: Vec<GoldenObject>,
}

#[derive(Deserialize)]
struct GoldenObject {
    id: u64,
    class: u16,
    confirmed: bool,
    conf: f64,
    #[serde(rename = "box")]
    bounding_box: [f64; 4],
    tau: f64,
    hits: u32,
    since_update: u32,
    since_infer: u32,
    rescues: u32,
}

/// A line of an excerpt, beside what is golden in it.
#[derive(Deserialize)]
struct ExcerptFrame {
    frame: u64,
    /// cx, cy, w, h, confidence, class.
    detections: Vec<(f64, f64, f64, f64, f64, u16)>,
}

/// What the empty-scene screen of a trace says.
#[derive(Clone, Copy)]
enum Screen {
    NeverEmpty,
    EmptyWithoutDetections,
}

/// Detections by frame, in file order.
type Recorded = BTreeMap<u64, Vec<Detection>>;

fn read_detections(csv: &str, picture: PictureSize) -> Recorded {
    let mut recorded = Recorded::new();
    for line in csv.lines().skip(1) {
        let fields: Vec<f64> = line.split(',').map(|f| f.parse().unwrap()).collect();
        let [frame, x1, y1, x2, y2, confidence, class] = fields[..] else {
            panic!("a detection has seven numbers, not `{line}`");
        };
        if confidence >= DETECTOR_THRESHOLD {
            recorded.entry(frame as u64).or_default().push(Detection {
                bounding_box: Corners { x1, y1, x2, y2 }.normalise(picture),
                class: ClassId(class as u16),
                confidence,
            });
        }
    }
    recorded
}

/// Replays `recorded` and compares every frame of `golden`. Returns the number of frames compared.
fn compare(
    what: &str,
    u: f64,
    screen: Screen,
    picture: PictureSize,
    recorded: &Recorded,
    golden: &str,
) -> usize {
    let mut policy = Albireo::new(AlbireoSettings::reference(), u).unwrap();
    let mut outcome = Outcome::default();
    let mut frames = 0;
    for line in golden.lines() {
        let expected: GoldenFrame = serde_json::from_str(line).unwrap();
        let at = format!("{what}, frame {}", expected.frame);
        let detections = recorded.get(&expected.frame).map_or(&[][..], Vec::as_slice);
        let mut need = policy.begin(FrameHead {
            index: expected.frame,
            step: 1,
            picture,
        });
        loop {
            need = match need {
                Need::Nothing => break,
                Need::Screen => policy.answer(Evidence::Screen {
                    empty: match screen {
                        Screen::NeverEmpty => false,
                        Screen::EmptyWithoutDetections => detections.is_empty(),
                    },
                }),
                Need::Detections => policy.answer(Evidence::Detections(detections)),
                Need::GreyPicture => panic!("{at}: Albireo looks at no pictures"),
            };
        }
        policy.finish(&mut outcome);
        assert_eq!(outcome.state.as_str(), expected.state, "{at}");
        assert_eq!(outcome.active, expected.active, "{at}");
        match (outcome.tau_max, expected.tau_max) {
            (Some(found), Some(expected)) => close(found, expected, &at, "tau_max"),
            (found, expected) => assert_eq!(found, expected, "{at}: tau_max"),
        }
        let mut objects = Vec::new();
        policy.objects(&mut |object| objects.push(*object));
        assert_eq!(objects.len(), expected.objects.len(), "{at}: objects");
        for (found, expected) in objects.iter().zip(&expected.objects) {
            compare_object(&at, found, expected);
        }
        // The evaluation scores every object, on every frame kind.
        let reported: Vec<_> = outcome.boxes.iter().map(|b| b.object.unwrap().0).collect();
        let all: Vec<_> = expected.objects.iter().map(|object| object.id).collect();
        let mut sorted = reported.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, all, "{at}: boxes reported");
        let rescued = outcome.boxes.iter().any(|b| b.source == BoxSource::Rescued);
        assert_eq!(rescued, expected.state == "AI", "{at}: rescued boxes");
        frames += 1;
    }
    frames
}

fn compare_object(at: &str, found: &ObjectRecord, expected: &GoldenObject) {
    let at = &format!("{at}, object {}", expected.id);
    assert_eq!(found.id.0, expected.id, "{at}");
    assert_eq!(found.class.0, expected.class, "{at}: class");
    assert_eq!(found.confirmed, expected.confirmed, "{at}: confirmed");
    assert_eq!(found.confidence, expected.conf, "{at}: confidence");
    let counters = [
        found.hits,
        found.since_update,
        found.since_infer,
        found.rescues,
    ];
    let expected_counters = [
        expected.hits,
        expected.since_update,
        expected.since_infer,
        expected.rescues,
    ];
    assert_eq!(counters, expected_counters, "{at}: counters");
    let b = found.bounding_box;
    for (found, expected) in [b.center_x, b.center_y, b.width, b.height]
        .into_iter()
        .zip(expected.bounding_box)
    {
        close(found, expected, at, "box");
    }
    close(found.tau, expected.tau, at, "tau");
}

fn close(found: f64, expected: f64, at: &str, what: &str) {
    assert!(
        (found - expected).abs() <= TOLERANCE,
        "{at}: {what} is {found}, expected {expected}"
    );
}

#[derive(Deserialize)]
struct Sequences {
    sequences: Vec<Sequence>,
}

#[derive(Deserialize)]
struct Sequence {
    name: String,
    width: u32,
    height: u32,
    frames: usize,
}

fn read_to_string(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn compare_all(folder: &str, u: f64, screen: Screen) {
    let shared = shared("");
    let recorded = shared.join("data/recorded");
    let list = read_to_string(&recorded.join("sequences.json"));
    let sequences = serde_json::from_str::<Sequences>(&list).unwrap().sequences;
    assert_eq!(sequences.len(), 21);
    for sequence in sequences {
        let name = &sequence.name;
        let picture = PictureSize::new(sequence.width, sequence.height);
        let csv = read_to_string(&recorded.join(format!("detections/{name}.csv")));
        let path = shared.join(format!("golden/{folder}/{name}.jsonl.gz"));
        let file = std::fs::File::open(&path)
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut golden = String::new();
        flate2::read::GzDecoder::new(file)
            .read_to_string(&mut golden)
            .unwrap();
        let what = format!("{folder}/{name}");
        let detections = read_detections(&csv, picture);
        let frames = compare(&what, u, screen, picture, &detections, &golden);
        assert_eq!(frames, sequence.frames, "{what}");
    }
}

/// Replays an excerpt, whose lines carry the detections.
fn compare_excerpt(lines: &str, u: f64, screen: Screen, picture: PictureSize) {
    let mut recorded = Recorded::new();
    for line in lines.lines() {
        let frame: ExcerptFrame = serde_json::from_str(line).unwrap();
        let detections = frame.detections.iter().map(|d| Detection {
            bounding_box: BoundingBox::new(d.0, d.1, d.2, d.3),
            confidence: d.4,
            class: ClassId(d.5),
        });
        recorded.insert(frame.frame, detections.collect());
    }
    let frames = compare("excerpt", u, screen, picture, &recorded, lines);
    assert_eq!(frames, recorded.len());
    assert!(frames >= 36, "{frames}");
}

#[test]
fn golden_excerpt_with_all_five_frame_states() {
    compare_excerpt(
        include_str!("fixtures/golden/albireo-u3e-4-erd-detections.kitti-0018.jsonl"),
        3e-4,
        Screen::EmptyWithoutDetections,
        PictureSize::new(1238, 374),
    );
}

#[test]
fn golden_excerpt_with_runs_of_predicted_frames() {
    compare_excerpt(
        include_str!("fixtures/golden/albireo-u1e-3-erd-nonempty.kitti-0008.jsonl"),
        1e-3,
        Screen::NeverEmpty,
        PictureSize::new(1242, 375),
    );
}

#[test]
fn golden_excerpt_with_rescues_and_removals() {
    compare_excerpt(
        include_str!("fixtures/golden/albireo-u3e-4-erd-nonempty.PETS09-S2L1.jsonl"),
        3e-4,
        Screen::NeverEmpty,
        PictureSize::new(768, 576),
    );
}

#[test]
fn shared_golden_traces_at_3e_4_with_a_screen_that_is_never_empty() {
    compare_all("albireo-u3e-4-erd-nonempty", 3e-4, Screen::NeverEmpty);
}

#[test]
fn shared_golden_traces_at_3e_4_with_a_screen_that_is_always_right() {
    compare_all(
        "albireo-u3e-4-erd-detections",
        3e-4,
        Screen::EmptyWithoutDetections,
    );
}

#[test]
fn shared_golden_traces_at_1e_3_with_a_screen_that_is_never_empty() {
    compare_all("albireo-u1e-3-erd-nonempty", 1e-3, Screen::NeverEmpty);
}
