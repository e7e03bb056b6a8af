//! Replays recorded detections through a policy and compares every frame with a golden trace.

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{
    BoxSource, FrameEvidence, FrameHead, ObjectRecord, Outcome, Policy, PolicyConfig, Profile,
    decide,
};
use albireo_eval::replay::trace::TraceFrame;
use serde::Deserialize;

/// The largest allowed difference of boxes and τ.
const TOLERANCE: f64 = 1e-9;

/// A line of an excerpt.
#[derive(Deserialize)]
struct ExcerptFrame {
    #[serde(flatten)]
    golden: TraceFrame,
    /// cx, cy, w, h, confidence, class.
    detections: Vec<(f64, f64, f64, f64, f64, u16)>,
}

/// The verdicts of the empty-scene screen of a trace.
#[derive(Clone, Copy)]
pub(crate) enum Screen {
    NeverEmpty,
    EmptyWithoutDetections,
}

/// The policy `asked`, `NAME[:ARGUMENT]`.
pub(crate) fn policy(asked: &str, profile: Profile) -> Box<dyn Policy> {
    let mut config = PolicyConfig::default();
    config.select(asked).unwrap();
    config.profile = profile;
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
    let empty = matches!(screen, Screen::EmptyWithoutDetections) && detections.is_empty();
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
    golden: &[TraceFrame],
) {
    let mut policy = policy(asked, Profile::Reference);
    let mut outcome = Outcome::default();
    assert_eq!(recorded.len(), golden.len(), "{what}: frames");
    for (expected, given) in golden.iter().zip(recorded) {
        let index = expected.frame;
        let place = format!("{what}, frame {index}");
        decide_frame(&mut *policy, index, screen, picture, given, &mut outcome);
        assert_eq!(outcome.state, expected.state, "{place}");
        assert_eq!(outcome.active, expected.active, "{place}");
        match (outcome.tau_max, expected.tau_max) {
            (Some(found), Some(expected)) => assert_close(found, expected, &place, "tau_max"),
            (found, expected) => assert_eq!(found, expected, "{place}: tau_max"),
        }
        let mut objects = Vec::new();
        policy.objects(&mut |object| objects.push(*object));
        assert_eq!(objects.len(), expected.objects.len(), "{place}: objects");
        for (found, expected) in objects.iter().zip(&expected.objects) {
            compare_object(&place, found, expected);
        }
        // The evaluation scores every object, on every frame kind.
        let mut reported: Vec<_> =
            outcome.boxes.iter().map(|shown| shown.object.unwrap()).collect();
        reported.sort_unstable();
        let all: Vec<_> = expected.objects.iter().map(|object| object.id).collect();
        assert_eq!(reported, all, "{place}: boxes reported");
        let is_rescued = outcome.boxes.iter().any(|shown| shown.source == BoxSource::Rescued);
        // Objects that CTD keeps after a miss do not make a frame AI.
        let is_missed = |object: &ObjectRecord| object.since_update > 0;
        let is_skipped = outcome.state.is_skipped();
        let should_be = !is_skipped && expected.objects.iter().any(is_missed);
        assert_eq!(is_rescued, should_be, "{place}: rescued boxes");
    }
}

fn compare_object(frame: &str, found: &ObjectRecord, expected: &ObjectRecord) {
    let place = format!("{frame}, object {}", expected.id.0);
    let sides = |object: &ObjectRecord| <[f64; 4]>::from(object.bounding_box);
    for (found, expected) in sides(found).into_iter().zip(sides(expected)) {
        assert_close(found, expected, &place, "box");
    }
    assert_close(found.tau, expected.tau, &place, "tau");
    let exact = ObjectRecord {
        bounding_box: found.bounding_box,
        tau: found.tau,
        ..*expected
    };
    assert_eq!(*found, exact, "{place}");
}

fn assert_close(found: f64, expected: f64, place: &str, what: &str) {
    let difference = (found - expected).abs();
    assert!(
        difference <= TOLERANCE,
        "{place}: {what} {found}, not {expected}"
    );
}

/// Replays an excerpt, whose lines include the detections.
pub(crate) fn compare_excerpt(lines: &str, asked: &str, screen: Screen, picture: PictureSize) {
    let mut recorded = Vec::new();
    let mut golden = Vec::new();
    for line in lines.lines() {
        let frame: ExcerptFrame = serde_json::from_str(line).unwrap();
        let mut detections = Vec::new();
        for (cx, cy, w, h, confidence, class) in frame.detections {
            detections.push(Detection {
                bounding_box: BoundingBox::new(cx, cy, w, h),
                confidence,
                class: ClassId(class),
            });
        }
        recorded.push(detections);
        golden.push(frame.golden);
    }
    compare("excerpt", asked, screen, picture, &recorded, &golden);
    assert!(golden.len() >= 36, "{}", golden.len());
}
