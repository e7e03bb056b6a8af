use super::*;
use crate::data::Clip;
use crate::data::Pass;
use crate::judge::average_precision::tests::{scored, square};
use crate::replay::StoredEvidence;
use crate::settings::ScreenRule;
use crate::settings::Settings;
use albireo_core::detection::ClassId;
use albireo_core::geometry::BoundingBox;
use albireo_core::policy::{BoxSource, OutputBox, PolicyConfig};
use albireo_vision::picture::Picture;

const PICTURE: PictureSize = PictureSize::new(100, 100);

/// Asks for each kind of evidence in turn and records the answers.
#[derive(Default)]
struct Curious {
    script: Vec<Need>,
    answers: Vec<String>,
    step: usize,
}

impl Curious {
    fn next(&mut self) -> Need {
        let need = self.script.get(self.step).copied().unwrap_or(Need::Nothing);
        self.step += 1;
        need
    }
}

impl Policy for Curious {
    fn name(&self) -> &'static str {
        "curious"
    }
    fn begin(&mut self, _: FrameHead) -> Need {
        self.step = 0;
        self.next()
    }
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        let answer = match evidence {
            Evidence::Screen { empty } => format!("screen {empty}"),
            Evidence::GreyPicture(grey) => format!("grey {}", grey.size),
            Evidence::Detections(found) => format!("detections {}", found.len()),
            Evidence::Unavailable => "unavailable".to_owned(),
        };
        self.answers.push(answer);
        self.next()
    }
    fn finish(&mut self, outcome: &mut Outcome) {
        *outcome = Outcome {
            state: FrameState::I,
            boxes: vec![OutputBox {
                bounding_box: BoundingBox::new(0.5, 0.5, 0.111, 0.111),
                class: ClassId(0),
                confidence: 0.7,
                source: BoxSource::Detected,
                object: None,
                confirmed: true,
            }],
            ..Outcome::default()
        };
    }
    fn reset(&mut self) {}
}

/// A recording of two frames with grey pictures; the second has no screen verdict.
fn recording(found: &[ScoredBox]) -> Clip {
    let grey = Picture {
        size: PictureSize::new(2, 1),
        pixels: vec![0, 0],
        ..Picture::default()
    };
    Clip {
        detections: Some(vec![found.to_vec(); 2]),
        screen: Some(vec![Some(false), None]),
        pass: Some(Pass {
            grey: vec![grey; 2],
            ..Pass::default()
        }),
        ..Clip::new("clip".to_owned(), PICTURE, 2)
    }
}

/// Replays a detector that drops detections below 0.5.
fn replayed(
    policy: &mut dyn Policy,
    recording: &Clip,
    profile: Profile,
) -> Result<Replay, EvalError> {
    let settings = Settings {
        screen: ScreenRule::Recorded,
        ..Settings::default()
    };
    let mut source = StoredEvidence::new(recording, &settings)?;
    let floor = MinConfidence::new(None, 0.5);
    let keep_trace = true;
    replay(policy, &mut source, profile, floor, keep_trace)
}

/// A policy that asks for everything.
fn insatiable() -> Curious {
    Curious {
        script: vec![Need::Screen, Need::GreyPicture, Need::Detections],
        ..Curious::default()
    }
}

#[test]
fn a_policy_gets_its_evidence_and_learns_of_missing_screen_verdicts() {
    let mut policy = insatiable();
    replayed(&mut policy, &recording(&[]), Profile::Paper).expect("it runs");
    let expected = "screen false, grey 2x1, detections 0, unavailable, grey 2x1, detections 0";
    assert_eq!(policy.answers.join(", "), expected);
}

#[test]
fn the_record_of_a_frame_says_what_the_policy_asked_for() {
    let all = replayed(&mut insatiable(), &recording(&[]), Profile::Paper).expect("it runs");
    assert!(all.frames.iter().all(|frame| frame.screen));
    assert!(all.frames.iter().all(|frame| frame.examined));
    assert!(all.frames.iter().all(|frame| frame.detector));
    let mut content = Curious::default();
    let nothing = replayed(&mut content, &recording(&[]), Profile::Paper).expect("it runs");
    let asked = |frame: &FrameRecord| frame.screen || frame.examined || frame.detector;
    assert!(!nothing.frames.iter().any(asked));
}

#[test]
fn the_paper_scores_boxes_as_reported_and_the_reference_cuts_them_to_pixels() {
    let run = |profile| {
        let result = replayed(&mut Curious::default(), &recording(&[]), profile).expect("it runs");
        result.boxes[0][0].corners
    };
    assert!((run(Profile::Paper).x1 - 44.45).abs() < 1e-9);
    assert_eq!(run(Profile::Reference).x1, 44.0);
}

/// Replays detections of confidence 0.7 with a node that publishes from `report_confidence` on, or from 0.8 without
/// one.
fn replayed_with_floor(profile: Profile, report_confidence: Option<f64>) -> Replay {
    let recording = recording(&[]);
    let floor = MinConfidence::new(report_confidence, 0.8);
    let mut source = StoredEvidence::new(&recording, &Settings::default()).unwrap();
    let keep_trace = false;
    let mut policy = Curious::default();
    replay(&mut policy, &mut source, profile, floor, keep_trace).expect("it runs")
}

#[test]
fn published_boxes_are_scored_and_all_boxes_as_well() {
    for (report_confidence, published) in [(None, 0), (Some(0.7), 1)] {
        let result = replayed_with_floor(Profile::Paper, report_confidence);
        assert_eq!(result.boxes[0].len(), published, "{report_confidence:?}");
        let all = result.boxes_all.expect("a node has both");
        assert_eq!(all[0].len(), 1, "{report_confidence:?}");
    }
}

#[test]
fn the_reference_scores_every_box_however_faint() {
    let result = replayed_with_floor(Profile::Reference, None);
    assert_eq!(result.boxes[0].len(), 1);
    assert_eq!(result.boxes_all, None);
}

#[test]
fn a_policy_that_uses_pixels_is_rejected_on_stored_detections_with_a_remedy() {
    let mut policy = Curious {
        script: vec![Need::GreyPicture],
        ..Curious::default()
    };
    let clip = Clip {
        pass: None,
        ..recording(&[])
    };
    let said = replayed(&mut policy, &clip, Profile::Paper).unwrap_err().to_string();
    assert!(said.contains("evaluate it on a video"), "{said}");
}

#[test]
fn two_replays_of_a_policy_differ_only_in_time() {
    let mut policy = PolicyConfig::default().build().expect("a policy");
    let found = scored(square(40.0, 40.0, 20.0), 0.9);
    let mut run =
        || replayed(policy.as_mut(), &recording(&[found]), Profile::Reference).expect("it runs");
    let first = run();
    let second = run();
    assert_eq!(first.trace, second.trace);
    assert_eq!(first.boxes, second.boxes);
    assert_eq!(first.boxes_last_confidence, second.boxes_last_confidence);
}
