use crate::detection::Detection;
use crate::flow::GreyPicture;
use crate::geometry::PictureSize;
use crate::policy::tests::{Run, built, seen};
use crate::policy::{
    BoxSource, CallCause, FrameEvidence, FrameState, Need, PassCause, PauseFrames, Policy, Profile,
    WithPause,
};

/// Ten frames a second; a look every ten seconds.
const PAUSE: PauseFrames = PauseFrames {
    still: 100,
    second: 10,
    ..PauseFrames::OFF
};

const SIZE: PictureSize = PictureSize::new(160, 90);

/// A surface of this brightness, with the noise of a sensor.
fn surface(brightness: u8, seed: u32) -> Vec<u8> {
    let mut pixels = Vec::new();
    for index in 0..SIZE.width * SIZE.height {
        let noise = (index.wrapping_mul(2_654_435_761).wrapping_add(seed * 97) >> 13) % 7;
        pixels.push((u32::from(brightness) + noise) as u8);
    }
    pixels
}

/// The same with a person far away in it: two columns, five rows.
fn with_person(brightness: u8, seed: u32) -> Vec<u8> {
    let mut pixels = surface(brightness, seed);
    for row in 40..45 {
        for column in 70..72 {
            pixels[row * SIZE.width as usize + column] += 60;
        }
    }
    pixels
}

struct Camera {
    run: Run<WithPause>,
    seed: u32,
}

impl Camera {
    fn under(policy: &str) -> Self {
        let policy = WithPause::new(built(policy, Profile::Paper), PAUSE);
        Self {
            run: Run::with(Box::new(policy)),
            seed: 0,
        }
    }

    /// Shows one more frame; true if the detector was called.
    fn calls(&mut self, pixels: &[u8], found: &[Detection]) -> bool {
        self.seed += 1;
        let known = FrameEvidence {
            grey: Some(GreyPicture { size: SIZE, pixels }),
            ..FrameEvidence::detections(found)
        };
        self.run.frame(1, known);
        self.run.needs.contains(&Need::Detections)
    }

    /// The frames, from 0, in which the detector is called while the surface has this brightness.
    fn looks(&mut self, brightness: u8, frames: u32, found: &[Detection]) -> Vec<u32> {
        let mut looks = Vec::new();
        for frame in 0..frames {
            let pixels = surface(brightness, self.seed);
            if self.calls(&pixels, found) {
                looks.push(frame);
            }
        }
        looks
    }
}

#[test]
fn a_picture_without_change_is_looked_at_once_in_ten_seconds_and_at_once_when_it_changes() {
    for policy in ["albireo", "vanilla", "ctd", "expected-loss:0"] {
        let mut camera = Camera::under(policy);
        let looks = camera.looks(100, 235, &[]);
        let first_second: Vec<u32> = (0..10).collect();
        assert_eq!(looks[..10], first_second, "{policy}");
        assert_eq!(looks[10..], [109, 209], "{policy}");
        assert_eq!(camera.run.outcome.state, FrameState::E, "{policy}");
        assert_eq!(camera.run.outcome.passed, Some(PassCause::Unchanged));
        assert_eq!(camera.run.outcome.cause, None);
        assert_eq!(
            camera.run.policy.no_news(),
            Some((PassCause::Unchanged, 234))
        );
        assert!(camera.calls(&with_person(100, 1), &[]), "{policy}");
        assert_eq!(camera.run.policy.no_news(), None);
        assert_eq!(camera.run.outcome.passed, None);
    }
}

#[test]
fn what_stands_in_an_unchanged_picture_is_reported_as_it_was_found() {
    let car = [seen(0.5, 0.9)];
    let mut camera = Camera::under("vanilla");
    let looks = camera.looks(100, 50, &car);
    assert_eq!(looks.len(), 10);
    let outcome = &camera.run.outcome;
    assert_eq!(
        (outcome.state, outcome.passed),
        (FrameState::P, Some(PassCause::Unchanged))
    );
    assert_eq!(outcome.boxes[0].source, BoxSource::Predicted);
    assert_eq!(outcome.boxes[0].bounding_box, car[0].bounding_box);
    // The policy of the paper predicts by itself, and pays for no comparison then.
    let mut camera = Camera::under("albireo");
    let mut called = 0;
    let mut compared = 0;
    for _ in 0..300 {
        let pixels = surface(100, camera.seed);
        called += u32::from(camera.calls(&pixels, &car));
        assert_eq!(camera.run.outcome.boxes.len(), 1);
        compared += u32::from(!camera.run.needs.is_empty());
    }
    assert!(called < 15 && compared < 200, "{called} {compared}");
}

#[test]
fn a_dark_picture_must_be_still_for_half_a_minute() {
    let mut camera = Camera::under("albireo");
    let looks = camera.looks(5, 650, &[]);
    assert_eq!(looks.len(), 300 + 3, "{looks:?}");
    assert_eq!(camera.run.outcome.passed, Some(PassCause::Dark));
    assert!(camera.calls(&with_person(5, 1), &[]));
    // A light that goes on is news, too.
    let mut camera = Camera::under("albireo");
    camera.looks(5, 400, &[]);
    assert!(camera.calls(&surface(60, 1), &[]));
}

#[test]
fn a_moving_picture_is_compared_once_a_second_and_always_looked_at() {
    let mut camera = Camera::under("albireo");
    let mut compared = 0;
    for frame in 0..100_u32 {
        let pixels = surface((frame * 37 % 200) as u8, frame);
        assert!(camera.calls(&pixels, &[]));
        assert_eq!(camera.run.outcome.cause, Some(CallCause::NoObjects));
        compared += usize::from(camera.run.needs.len() > 2);
    }
    assert_eq!(compared, 10);
}

#[test]
fn lost_frames_are_time_a_failed_look_is_repeated_and_a_reset_forgets() {
    let mut camera = Camera::under("albireo");
    camera.looks(100, 20, &[]);
    let pixels = surface(100, 3);
    let known = FrameEvidence {
        grey: Some(GreyPicture {
            size: SIZE,
            pixels: &pixels,
        }),
        ..FrameEvidence::detections(&[])
    };
    camera.run.frame(90, known);
    assert_eq!(camera.run.outcome.cause, Some(CallCause::EmptyRoad));
    // The detector does not answer.
    let blind = FrameEvidence {
        detections: None,
        ..known
    };
    camera.run.frame(200, blind);
    assert!(camera.run.outcome.degraded);
    assert_eq!(camera.run.frame(1, known), FrameState::I);
    assert_eq!(camera.run.frame(1, known), FrameState::E);
    // Without a picture there is no comparison.
    assert_eq!(
        camera.run.frame(1, FrameEvidence::detections(&[])),
        FrameState::I
    );
    camera.run.policy.reset();
    assert_eq!(camera.run.frame(1, known), FrameState::I);
}
