use super::*;
use crate::detection::{ClassId, ObjectId};
use proptest::prelude::*;
use std::collections::BTreeMap;

const MOMENT: Duration = Duration::from_millis(100);
const LONG: Duration = Duration::from_secs(3600);

fn reported(object: u64, x: f64, confidence: f64, source: BoxSource) -> OutputBox {
    OutputBox {
        bounding_box: BoundingBox::new(x, 0.5, 0.1, 0.1),
        class: ClassId(0),
        confidence,
        source,
        object: Some(ObjectId(object)),
        confirmed: true,
    }
}

fn answer(state: FrameState, boxes: &[OutputBox]) -> Outcome {
    Outcome {
        state,
        boxes: boxes.to_vec(),
        ..Outcome::default()
    }
}

/// With one box there, predicted or detected.
fn at(state: FrameState, x: f64) -> Outcome {
    let source = match state {
        FrameState::P => BoxSource::Predicted,
        _ => BoxSource::Detected,
    };
    answer(state, &[reported(0, x, 0.8, source)])
}

#[derive(Debug, PartialEq)]
struct Given {
    index: u64,
    settled: bool,
    boxes: Vec<OutputBox>,
}

/// Frames, one every 100 ms, and what came out.
struct Stream {
    settler: Settler,
    given: Vec<Given>,
}

impl Stream {
    fn new(longest_delay: Duration) -> Self {
        Self {
            settler: Settler::new(longest_delay),
            given: Vec::new(),
        }
    }

    fn frame(&mut self, index: u64, outcome: &Outcome, pending: bool) {
        let time = MOMENT * u32::try_from(index).unwrap();
        self.settler.frame(index, time, outcome, pending, note_in(&mut self.given));
    }

    fn late(&mut self, index: u64, outcome: &Outcome) {
        self.settler.late(index, outcome, note_in(&mut self.given));
    }

    fn indices(&self) -> Vec<u64> {
        self.given.iter().map(|given| given.index).collect()
    }
}

fn note_in(given: &mut Vec<Given>) -> impl FnMut(SettledFrame<'_>) {
    move |frame| {
        given.push(Given {
            index: frame.index,
            settled: frame.settled,
            boxes: frame.boxes.to_vec(),
        });
    }
}

#[test]
fn nothing_is_interpolated_from_a_stream_that_has_ended() {
    let mut stream = Stream::new(LONG);
    stream.frame(0, &at(FrameState::I, 0.1), false);
    stream.settler.end_stream(note_in(&mut stream.given));
    // Another object with the same number.
    stream.frame(1, &answer(FrameState::P, &[]), false);
    stream.frame(2, &at(FrameState::I, 0.9), false);
    assert_eq!(stream.indices(), [0, 1, 2]);
    assert_eq!(stream.given[1].boxes, []);
}

#[test]
fn boxes_between_two_calls_are_interpolated_with_the_confidence_of_the_second() {
    use BoxSource::{Detected, Predicted, Rescued};
    let mut stream = Stream::new(LONG);
    let seen = [
        reported(0, 0.1, 0.8, Detected),
        reported(1, 0.5, 0.8, Detected),
        reported(2, 0.7, 0.8, Detected),
    ];
    stream.frame(0, &answer(FrameState::I, &seen), false);
    for index in 1..4 {
        let predicted = seen.map(|known| OutputBox {
            source: Predicted,
            ..known
        });
        stream.frame(index, &answer(FrameState::P, &predicted), false);
        assert_eq!(stream.indices(), [0]);
    }
    let second = [
        reported(0, 0.5, 0.6, Detected),
        reported(1, 0.5, 0.6, Rescued),
        reported(3, 0.9, 0.6, Detected),
    ];
    stream.frame(4, &answer(FrameState::AI, &second), false);
    assert_eq!(stream.indices(), [0, 1, 2, 3, 4]);
    for given in &stream.given[1..4] {
        assert!(given.settled);
        let mut drawn = given.boxes.clone();
        drawn.sort_by_key(|drawn| drawn.object.unwrap().0);
        let x = 0.1 + 0.1 * given.index as f64;
        let new = 0.3 * given.index as f64 / 4.0;
        let expected = [(0, x, 0.7), (1, 0.5, 0.6), (2, 0.7, 0.4), (3, 0.9, new)];
        for (drawn, (object, x, confidence)) in drawn.iter().zip(expected) {
            assert_eq!(drawn.object, Some(ObjectId(object)));
            assert!((drawn.bounding_box.center_x - x).abs() < 1e-12, "{drawn:?}");
            assert!((drawn.confidence - confidence).abs() < 1e-12, "{drawn:?}");
            assert_eq!(drawn.source, Predicted);
        }
        assert_eq!(drawn.len(), 4);
    }
    assert_eq!(stream.given[4].boxes, second);
}

#[test]
fn a_frame_that_waited_too_long_is_sent_as_it_was_answered() {
    let own = at(FrameState::P, 0.5);
    let mut stream = Stream::new(MOMENT * 3);
    stream.frame(0, &at(FrameState::I, 0.5), false);
    for index in 1..=5 {
        stream.frame(index, &own, false);
    }
    assert_eq!(stream.indices(), [0, 1]);
    assert!(!stream.given[1].settled);
    assert_eq!(stream.given[1].boxes, own.boxes);
    stream.frame(6, &answer(FrameState::E, &[]), false);
    assert_eq!(stream.indices(), [0, 1, 2, 3, 4, 5, 6]);
    assert!(stream.given[2..].iter().all(|given| given.settled));
    // The screen saw nothing: what was predicted before is half believed.
    assert_eq!(stream.given[5].boxes[0].confidence, 0.4);
}

#[test]
fn a_stream_without_calls_delays_a_bounded_number_of_frames() {
    let own = at(FrameState::P, 0.5);
    let mut settler = Settler::new(LONG);
    let mut given = 0;
    for index in 0..10_000 {
        settler.frame(index, Duration::ZERO, &own, index == 0, |_| given += 1);
        assert!(settler.buffer.len() <= MOST_FRAMES && settler.spare.len() <= MOST_FRAMES);
    }
    assert_eq!(given, 10_000 - MOST_FRAMES);
}

#[test]
fn late_detections_settle_the_frames_before_them_and_after_them() {
    let predicted = at(FrameState::P, 0.9);
    let detected = |x| at(FrameState::I, x);
    let mut stream = Stream::new(LONG);
    stream.frame(0, &detected(0.1), false);
    stream.frame(1, &predicted, false);
    stream.frame(2, &predicted, true);
    stream.frame(3, &predicted, false);
    assert_eq!(stream.indices(), [0]);
    stream.late(7, &detected(0.3));
    stream.late(3, &detected(0.3));
    assert_eq!(stream.indices(), [0]);
    stream.late(2, &detected(0.3));
    assert_eq!(stream.indices(), [0, 1, 2]);
    stream.late(2, &detected(0.7));
    stream.frame(4, &detected(0.5), false);
    for (given, expected) in stream.given.iter().zip([0.1, 0.2, 0.3, 0.4, 0.5]) {
        let place = given.boxes[0].bounding_box.center_x;
        assert!((place - expected).abs() < 1e-12, "{place} {expected}");
    }
    // The detector looked, but nothing came of it: no call.
    stream.frame(5, &predicted, true);
    stream.late(5, &predicted);
    assert_eq!(stream.indices(), [0, 1, 2, 3, 4]);
}

#[test]
fn a_late_answer_still_settles_later_frames() {
    let predicted = at(FrameState::P, 0.9);
    let detected = |x| at(FrameState::I, x);
    let mut stream = Stream::new(MOMENT);
    stream.frame(0, &predicted, true);
    stream.frame(1, &predicted, false);
    stream.frame(2, &predicted, false);
    let first = Given {
        index: 0,
        settled: false,
        boxes: predicted.boxes.clone(),
    };
    assert_eq!(stream.given, [first]);
    stream.late(0, &detected(0.1));
    stream.frame(3, &detected(0.4), false);
    let settled: Vec<_> = stream.given.iter().map(|given| given.settled).collect();
    assert_eq!(settled, [false, true, true, true]);
    assert!((stream.given[2].boxes[0].bounding_box.center_x - 0.3).abs() < 1e-12);
}

#[test]
fn a_restarted_stream_sends_the_old_frames_first() {
    let mut stream = Stream::new(LONG);
    stream.frame(5, &at(FrameState::I, 0.5), false);
    stream.frame(6, &at(FrameState::P, 0.5), false);
    stream.frame(0, &at(FrameState::P, 0.5), false);
    stream.frame(1, &at(FrameState::I, 0.5), false);
    assert_eq!(stream.indices(), [5, 6, 0, 1]);
    assert!(stream.given[1..3].iter().all(|given| !given.settled));
}

#[derive(Clone, Debug)]
struct Event {
    state: FrameState,
    /// The detector's answer arrives later.
    pending: bool,
    /// Number of frames lost before this one.
    lost: u64,
    /// Places of boxes by object.
    boxes: BTreeMap<u64, f64>,
}

prop_compose! {
    fn event()(
        state in prop::sample::select(FrameState::ALL.to_vec()),
        pending in prop::bool::weighted(0.3),
        lost in prop_oneof![4 => Just(0u64), 1 => 1..9u64],
        boxes in prop::collection::btree_map(0..4u64, 0.0..1.0, 0..4),
    ) -> Event {
        Event { state, pending, lost, boxes }
    }
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    prop::collection::vec(event(), 1..80)
}

fn outcome(event: &Event) -> Outcome {
    let mut boxes = Vec::new();
    for (object, x) in &event.boxes {
        boxes.push(OutputBox {
            object: Some(ObjectId(*object)),
            ..at(event.state, *x).boxes[0]
        });
    }
    answer(event.state, &boxes)
}

/// The answer of the detector that a frame waits for.
struct Late {
    frame: u64,
    /// Number of the frame after which it arrives.
    arrives: u64,
    outcome: Outcome,
}

proptest! {
    #[test]
    fn every_frame_is_sent_once_and_in_order(script in events(), longest in 0..12u32, late in 1..5u64) {
        let mut stream = Stream::new(MOMENT * longest);
        let mut pushed = Vec::new();
        let mut awaited: Option<Late> = None;
        let mut index = 0;
        for event in &script {
            index += 1 + event.lost;
            let outcome = outcome(event);
            if event.pending && awaited.is_none() {
                stream.frame(index, &answer(FrameState::P, &[]), true);
                awaited = Some(Late { frame: index, arrives: index + late, outcome });
            } else {
                stream.frame(index, &outcome, false);
            }
            pushed.push(index);
            if let Some(late) = awaited.take_if(|late| late.arrives <= index) {
                stream.late(late.frame, &late.outcome);
            }
            prop_assert!(pushed.starts_with(&stream.indices()));
            let oldest = pushed.get(stream.given.len()).copied().unwrap_or(index);
            prop_assert!(index - oldest <= u64::from(longest), "held back for too long");
        }
        stream.settler.flush(note_in(&mut stream.given));
        prop_assert_eq!(stream.indices(), pushed);
    }

    #[test]
    fn with_a_call_on_every_frame_each_is_sent_at_once_and_unchanged(script in events()) {
        let mut stream = Stream::new(LONG);
        for (index, event) in (0u64..).zip(&script) {
            let mut own = outcome(event);
            if own.state == FrameState::P {
                own.state = FrameState::I;
            }
            stream.frame(index, &own, false);
            let expected = Given { index, settled: true, boxes: own.boxes };
            prop_assert_eq!(stream.given.last(), Some(&expected));
        }
    }
}
