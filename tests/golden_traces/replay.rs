//! Replays recorded detections through a policy and compares every frame with a golden trace.

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, Corners, PictureSize};
use albireo_core::policy::{
    Albireo, BoxSource, FrameEvidence, FrameHead, ObjectRecord, Outcome, Policy, PolicyConfig,
    Profile, decide,
};
use serde::Deserialize;
use std::collections::BTreeMap;

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
pub(crate) enum Screen {
    NeverEmpty,
    EmptyWithoutDetections,
}

/// Detections by frame, in file order.
pub(crate) type Recorded = BTreeMap<u64, Vec<Detection>>;

/// By frame what a recording has: corners in pixels, confidence, class.
pub(crate) fn read_corners(csv: &str) -> BTreeMap<u64, Vec<[f64; 6]>> {
    let mut recorded = BTreeMap::<_, Vec<_>>::new();
    for line in csv.lines().skip(1) {
        let fields: Vec<f64> = line.split(',').map(|f| f.parse().unwrap()).collect();
        let [frame, x1, y1, x2, y2, confidence, class] = fields[..] else {
            panic!("a detection has seven numbers, not `{line}`");
        };
        if confidence >= DETECTOR_THRESHOLD {
            let found = recorded.entry(frame as u64).or_default();
            found.push([x1, y1, x2, y2, confidence, class]);
        }
    }
    recorded
}

pub(crate) fn read_detections(csv: &str, picture: PictureSize) -> Recorded {
    let detection = |[x1, y1, x2, y2, confidence, class]: [f64; 6]| Detection {
        bounding_box: Corners { x1, y1, x2, y2 }.normalise(picture),
        class: ClassId(class as u16),
        confidence,
    };
    read_corners(csv)
        .into_iter()
        .map(|(frame, found)| (frame, found.into_iter().map(detection).collect()))
        .collect()
}

/// The policy `asked` for, `NAME[:ARGUMENT]`, in the profile of the published code.
pub(crate) fn reference(asked: &str) -> Box<dyn Policy> {
    let mut config = PolicyConfig {
        profile: Profile::Reference,
        ..PolicyConfig::default()
    };
    config.select(asked).unwrap();
    config.build().unwrap()
}

/// Decides on one frame of a sequence without gaps.
pub(crate) fn decide_frame(
    policy: &mut dyn Policy,
    index: u64,
    screen: Screen,
    picture: PictureSize,
    detections: &[Detection],
    outcome: &mut Outcome,
) {
    let head = FrameHead {
        index,
        step: 1,
        picture,
    };
    let empty = match screen {
        Screen::NeverEmpty => false,
        Screen::EmptyWithoutDetections => detections.is_empty(),
    };
    let mut known = FrameEvidence {
        empty: Some(empty),
        grey: None,
        detections: Some(detections),
    };
    let Ok(()) = decide(policy, head, &mut known, outcome);
}

/// Replays `recorded` and compares every frame of `golden`. Returns the number of frames compared.
pub(crate) fn compare(
    what: &str,
    asked: &str,
    screen: Screen,
    picture: PictureSize,
    recorded: &Recorded,
    golden: &str,
) -> u64 {
    let mut policy = reference(asked);
    let mut outcome = Outcome::default();
    let mut frames = 0;
    for line in golden.lines() {
        let expected: GoldenFrame = serde_json::from_str(line).unwrap();
        let at = format!("{what}, frame {}", expected.frame);
        let detections = recorded.get(&expected.frame).map_or(&[][..], Vec::as_slice);
        decide_frame(
            &mut *policy,
            expected.frame,
            screen,
            picture,
            detections,
            &mut outcome,
        );
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
        // The objects that CTD keeps after a miss make no frame AI.
        let missed = |object: &GoldenObject| object.since_update > 0;
        let skipped = outcome.state.is_skipped();
        let expected_rescued = !skipped && expected.objects.iter().any(missed);
        assert_eq!(rescued, expected_rescued, "{at}: rescued boxes");
        if policy.name() == Albireo::NAME {
            assert_eq!(rescued, expected.state == "AI", "{at}: rescued boxes");
        }
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
        found.misses,
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

/// Replays an excerpt, whose lines carry the detections.
pub(crate) fn compare_excerpt(lines: &str, asked: &str, screen: Screen, picture: PictureSize) {
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
    let frames = compare("excerpt", asked, screen, picture, &recorded, lines);
    assert_eq!(frames, recorded.len() as u64);
    assert!(frames >= 36, "{frames}");
}
