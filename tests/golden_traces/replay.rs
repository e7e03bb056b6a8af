//! Replays recorded detections through a policy and compares every frame with a golden trace.

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{
    Albireo, BoxSource, FrameEvidence, FrameHead, ObjectRecord, Outcome, Policy, PolicyConfig,
    Profile, decide,
};
use serde::Deserialize;

/// The largest allowed difference of boxes and τ.
const TOLERANCE: f64 = 1e-9;

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

/// The detections in a line of an excerpt.
#[derive(Deserialize)]
struct ExcerptFrame {
    /// cx, cy, w, h, confidence, class.
    detections: Vec<(f64, f64, f64, f64, f64, u16)>,
}

/// The verdicts of the empty-scene screen of a trace.
#[derive(Clone, Copy)]
pub(crate) enum Screen {
    NeverEmpty,
    EmptyWithoutDetections,
}

/// The policy `asked`, `NAME[:ARGUMENT]`, with the profile of the published code.
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

/// Replays `recorded` and compares every frame of it with `golden`.
pub(crate) fn compare(
    what: &str,
    asked: &str,
    screen: Screen,
    picture: PictureSize,
    recorded: &[Vec<Detection>],
    golden: &str,
) {
    let mut policy = reference(asked);
    let mut outcome = Outcome::default();
    assert_eq!(recorded.len(), golden.lines().count(), "{what}: frames");
    for (line, detections) in golden.lines().zip(recorded) {
        let expected: GoldenFrame = serde_json::from_str(line).unwrap();
        let at = format!("{what}, frame {}", expected.frame);
        let index = expected.frame;
        decide_frame(
            &mut *policy,
            index,
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
        // Objects that CTD keeps after a miss do not make a frame AI.
        let missed = |object: &GoldenObject| object.since_update > 0;
        let skipped = outcome.state.is_skipped();
        let expected_rescued = !skipped && expected.objects.iter().any(missed);
        assert_eq!(rescued, expected_rescued, "{at}: rescued boxes");
        if policy.name() == Albireo::NAME {
            assert_eq!(rescued, expected.state == "AI", "{at}: rescued boxes");
        }
    }
}

fn compare_object(at: &str, found: &ObjectRecord, expected: &GoldenObject) {
    let at = &format!("{at}, object {}", expected.id);
    assert_eq!(found.id.0, expected.id, "{at}");
    assert_eq!(found.class.0, expected.class, "{at}: class");
    assert_eq!(found.confirmed, expected.confirmed, "{at}: confirmed");
    assert_eq!(found.confidence, expected.conf, "{at}: confidence");
    assert_eq!(found.hits, expected.hits, "{at}: hits");
    assert_eq!(found.since_update, expected.since_update, "{at}: update");
    assert_eq!(found.since_infer, expected.since_infer, "{at}: infer");
    assert_eq!(found.misses, expected.rescues, "{at}: rescues");
    let sides: [f64; 4] = found.bounding_box.into();
    for (found, expected) in sides.into_iter().zip(expected.bounding_box) {
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

/// Replays an excerpt, whose lines include the detections.
pub(crate) fn compare_excerpt(lines: &str, asked: &str, screen: Screen, picture: PictureSize) {
    let detections = |line: &str| -> Vec<Detection> {
        let frame: ExcerptFrame = serde_json::from_str(line).unwrap();
        let detections = frame.detections.iter().map(|d| Detection {
            bounding_box: BoundingBox::new(d.0, d.1, d.2, d.3),
            confidence: d.4,
            class: ClassId(d.5),
        });
        detections.collect()
    };
    let recorded: Vec<_> = lines.lines().map(detections).collect();
    compare("excerpt", asked, screen, picture, &recorded, lines);
    let frames = recorded.len();
    assert!(frames >= 36, "{frames}");
}
