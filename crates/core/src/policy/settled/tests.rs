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

type Given = (u64, bool, Vec<OutputBox>);

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

    fn of_each<T>(&self, what: impl Fn(&Given) -> T) -> Vec<T> {
        self.given.iter().map(what).collect()
    }

    fn indices(&self) -> Vec<u64> {
        self.of_each(|given| given.0)
    }
}

fn note_in(given: &mut Vec<Given>) -> impl FnMut(SettledFrame<'_>) {
    move |frame| given.push((frame.index, frame.settled, frame.boxes.to_vec()))
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
    for (index, settled, boxes) in &stream.given[1..4] {
        assert!(settled);
        let mut drawn = boxes.clone();
        drawn.sort_by_key(|b| b.object.unwrap().0);
        let x = 0.1 + 0.1 * *index as f64;
        let new = 0.3 * *index as f64 / 4.0;
        let expected = [(0, x, 0.7), (1, 0.5, 0.6), (2, 0.7, 0.4), (3, 0.9, new)];
        for (drawn, (object, x, confidence)) in drawn.iter().zip(expected) {
            assert_eq!(drawn.object, Some(ObjectId(object)));
            assert!((drawn.bounding_box.center_x - x).abs() < 1e-12, "{drawn:?}");
            assert!((drawn.confidence - confidence).abs() < 1e-12, "{drawn:?}");
            assert_eq!(drawn.source, Predicted);
        }
        assert_eq!(drawn.len(), 4);
    }
    assert_eq!(stream.given[4].2, second);
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
    assert_eq!(stream.given[1], (1, false, own.boxes));
    stream.frame(6, &answer(FrameState::E, &[]), false);
    assert_eq!(stream.indices(), [0, 1, 2, 3, 4, 5, 6]);
    assert!(stream.given[2..].iter().all(|(_, settled, _)| *settled));
    // The screen saw nothing: what was predicted before is half believed.
    assert_eq!(stream.given[5].2[0].confidence, 0.4);
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
    let places = stream.of_each(|(.., boxes)| boxes[0].bounding_box.center_x);
    for (place, expected) in places.iter().zip([0.1, 0.2, 0.3, 0.4, 0.5]) {
        assert!((place - expected).abs() < 1e-12, "{places:?}");
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
    assert_eq!(stream.given, [(0, false, predicted.boxes.clone())]);
    stream.late(0, &detected(0.1));
    stream.frame(3, &detected(0.4), false);
    assert_eq!(stream.of_each(|given| given.1), [false, true, true, true]);
    assert!((stream.given[2].2[0].bounding_box.center_x - 0.3).abs() < 1e-12);
}

#[test]
fn a_restarted_stream_sends_the_old_frames_first() {
    let mut stream = Stream::new(LONG);
    stream.frame(5, &at(FrameState::I, 0.5), false);
    stream.frame(6, &at(FrameState::P, 0.5), false);
    stream.frame(0, &at(FrameState::P, 0.5), false);
    stream.frame(1, &at(FrameState::I, 0.5), false);
    assert_eq!(stream.indices(), [5, 6, 0, 1]);
    assert!(stream.given[1..3].iter().all(|(_, settled, _)| !settled));
}

/// State, pending, lost frames before it, and places of boxes by object.
type Event = (usize, bool, u64, BTreeMap<u64, f64>);

fn events() -> impl Strategy<Value = Vec<Event>> {
    let boxes = prop::collection::btree_map(0..4u64, 0.0..1.0, 0..4);
    let pending = prop::bool::weighted(0.3);
    let lost = prop_oneof![4 => Just(0u64), 1 => 1..9u64];
    prop::collection::vec((0..5usize, pending, lost, boxes), 1..80)
}

fn outcome((state, _, _, boxes): &Event) -> Outcome {
    let state = FrameState::ALL[*state];
    let boxes = boxes.iter().map(|(object, x)| OutputBox {
        object: Some(ObjectId(*object)),
        ..at(state, *x).boxes[0]
    });
    answer(state, &boxes.collect::<Vec<_>>())
}

proptest! {
    #[test]
    fn every_frame_is_sent_once_and_in_order(script in events(), longest in 0..12u32, late in 1..5u64) {
        let mut stream = Stream::new(MOMENT * longest);
        let mut pushed = Vec::new();
        let mut waits: Option<(u64, u64, Outcome)> = None;
        let mut index = 0;
        for event in &script {
            index += 1 + event.2;
            let last = outcome(event);
            if event.1 && waits.is_none() {
                stream.frame(index, &answer(FrameState::P, &[]), true);
                waits = Some((index, index + late, last));
            } else {
                stream.frame(index, &last, false);
            }
            pushed.push(index);
            if let Some((frame, _, last)) = waits.take_if(|(_, at, _)| *at <= index) {
                stream.late(frame, &last);
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
            prop_assert_eq!(stream.given.last(), Some(&(index, true, own.boxes)));
        }
    }
}
