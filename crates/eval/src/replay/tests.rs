use super::*;
use crate::run::Settings;
use crate::source::StoredEvidence;
use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::BoundingBox;
use albireo_core::policy::{
    BoxSource, GreyPicture, Knob, KnobError, OutputBox, PolicyConfig, PolicyConfigError,
};

const PICTURE: PictureSize = PictureSize::new(100, 100);

/// Asks for each kind of evidence in turn and notes what it was told.
#[derive(Default)]
struct Curious {
    script: Vec<Need>,
    told: Vec<String>,
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
    fn knob(&self) -> Option<Knob> {
        None
    }
    fn knob_value(&self) -> Option<f64> {
        None
    }
    fn set_knob(&mut self, _: f64) -> Result<(), KnobError> {
        Err(KnobError::Absent { policy: "curious" })
    }
    fn begin(&mut self, _: FrameHead) -> Need {
        self.step = 0;
        self.next()
    }
    fn answer(&mut self, evidence: Evidence<'_>) -> Need {
        self.told.push(match evidence {
            Evidence::Screen { empty } => format!("screen {empty}"),
            Evidence::GreyPicture(grey) => format!("grey {}", grey.size),
            Evidence::Detections(found) => format!("detections {}", found.len()),
            Evidence::Unavailable => "unavailable".to_owned(),
        });
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

/// A source whose evidence is missing on odd frames.
struct Patchy {
    found: Vec<Detection>,
    grey: Vec<u8>,
}

impl ClipEvidence for Patchy {
    fn picture(&self) -> PictureSize {
        PICTURE
    }
    fn frames(&self) -> usize {
        2
    }
    fn detections(&mut self, frame: usize) -> Result<Option<&[Detection]>, EvalError> {
        Ok((frame == 0).then_some(&self.found[..]))
    }
    fn screen_says_empty(&mut self, frame: usize) -> Result<Option<bool>, EvalError> {
        Ok((frame == 0).then_some(false))
    }
    fn grey_picture(
        &mut self,
        frame: usize,
        _: Need,
    ) -> Result<Option<GreyPicture<'_>>, EvalError> {
        let size = PictureSize::new(2, 1);
        Ok((frame == 0).then_some(GreyPicture {
            size,
            pixels: &self.grey,
        }))
    }
}

/// Of a detector that drops what is below 0.5.
fn replayed(
    policy: &mut dyn Policy,
    source: &mut dyn ClipEvidence,
    profile: Profile,
) -> Result<Replay, EvalError> {
    let floor = MinConfidence::new(None, 0.5);
    replay(policy, source, profile, floor, true)
}

fn patchy() -> Patchy {
    Patchy {
        found: Vec::new(),
        grey: vec![0, 0],
    }
}

#[test]
fn a_policy_is_told_what_it_asks_for_and_what_cannot_be_had() {
    let mut policy = Curious {
        script: vec![Need::Screen, Need::GreyPicture, Need::Detections],
        ..Curious::default()
    };
    let mut source = patchy();
    let result = replayed(&mut policy, &mut source, Profile::Paper).expect("it runs");
    assert_eq!(
        policy.told,
        [
            "screen false",
            "grey 2x1",
            "detections 0",
            "unavailable",
            "unavailable",
            "unavailable"
        ]
    );
    let calls: Vec<_> = result
        .frames
        .iter()
        .map(|f| (f.screen, f.detector))
        .collect();
    assert_eq!(calls, [(true, true), (true, false)]);
}

#[test]
fn the_paper_scores_boxes_as_reported_and_the_reference_cuts_them_to_pixels() {
    let run = |scoring| {
        let mut source = patchy();
        let result = replayed(&mut Curious::default(), &mut source, scoring);
        result.expect("it runs").boxes[0][0].corners
    };
    assert!((run(Profile::Paper).x1 - 44.45).abs() < 1e-9);
    assert_eq!(run(Profile::Reference).x1, 44.0);
}

#[test]
fn the_boxes_a_node_publishes_are_judged_and_all_boxes_beside_them() {
    let mut source = patchy();
    let mut counts = |profile, least| {
        let floor = MinConfidence::new(least, 0.8);
        let result = replay(
            &mut Curious::default(),
            &mut source,
            profile,
            floor,
            false,
        );
        let result = result.expect("it runs");
        (
            result.boxes[0].len(),
            result.boxes_all.map(|all| all[0].len()),
        )
    };
    // The detector found it with a confidence of 0.7.
    assert_eq!(counts(Profile::Paper, None), (0, Some(1)));
    assert_eq!(counts(Profile::Paper, Some(0.7)), (1, Some(1)));
    // The published evaluator judges every box.
    assert_eq!(counts(Profile::Reference, None), (1, None));
}

#[test]
fn a_policy_that_looks_at_pixels_is_refused_on_stored_detections_with_the_way_out() {
    let mut policy = Curious {
        script: vec![Need::GreyPicture],
        ..Curious::default()
    };
    let clip = crate::data::Clip {
        detections: Some(vec![Vec::new()]),
        ..crate::data::Clip::new("clip".to_owned(), PICTURE, 1)
    };
    let mut source = StoredEvidence::new(&clip, &Settings::default()).expect("it has detections");
    let error = replayed(&mut policy, &mut source, Profile::Paper);
    let said = error.unwrap_err().to_string();
    assert!(said.contains("evaluate it on a video"), "{said}");
}

#[test]
fn two_replays_of_one_policy_are_equal_in_all_but_time() -> Result<(), PolicyConfigError> {
    let mut policy = PolicyConfig::default().build()?;
    let found = vec![Detection {
        bounding_box: BoundingBox::new(0.5, 0.5, 0.2, 0.2),
        class: ClassId(2),
        confidence: 0.9,
    }];
    let mut run = || {
        let mut source = Patchy {
            found: found.clone(),
            grey: Vec::new(),
        };
        let result = replayed(policy.as_mut(), &mut source, Profile::Reference);
        let result = result.expect("it runs");
        (result.trace, result.boxes, result.boxes_last_confidence)
    };
    assert_eq!(run(), run());
    Ok(())
}
