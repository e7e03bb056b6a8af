use super::*;
use proptest::prelude::*;
use std::collections::BTreeSet;

const PERIOD: Duration = Duration::from_millis(100);

struct Camera {
    tracker: SequenceTracker,
    now: Instant,
}

impl Camera {
    fn new() -> Self {
        Self {
            tracker: SequenceTracker::default(),
            now: Instant::now(),
        }
    }

    fn arrive(&mut self, seq: impl Into<Option<u64>>, stream: impl Into<Option<u64>>) -> Arrival {
        let seq = seq.into();
        let stream = stream.into();
        self.tracker.arrive(&FrameNumber { seq, stream }, self.now)
    }

    fn pass(&mut self, time: Duration) -> &mut Self {
        self.now += time;
        self
    }

    /// Frames of one stream, a period apart.
    fn send(
        &mut self,
        numbers: impl IntoIterator<Item = u64>,
        stream: Option<u64>,
    ) -> Vec<Arrival> {
        let arrive = |number| self.pass(PERIOD).arrive(number, stream);
        numbers.into_iter().map(arrive).collect()
    }
}

fn new(index: u64, lost: u64) -> Arrival {
    Arrival::New {
        index,
        lost,
        restarted: false,
    }
}

fn restarted(index: u64) -> Arrival {
    Arrival::New {
        index,
        lost: 0,
        restarted: true,
    }
}

/// Frames that are not new, and numbers counted as lost.
fn losses(arrivals: &[Arrival]) -> (usize, u64) {
    let mut dropped = 0;
    let mut lost = 0;
    for arrival in arrivals {
        match arrival {
            Arrival::New { lost: missing, .. } => lost += *missing,
            _ => dropped += 1,
        }
    }
    (dropped, lost)
}

#[test]
fn a_long_gap_costs_one_more_frame_unless_a_silence_explains_it() {
    let mut camera = Camera::new();
    camera.send(0..12, None);
    let expected = [Arrival::Stray, new(1002, 989), new(1003, 0)];
    assert_eq!(camera.send([1000, 1002, 1003], None), expected);
    camera.pass(SILENCE);
    assert_eq!(camera.arrive(1043, None), new(1043, 39));
}

#[test]
fn a_number_that_never_came_is_late_also_after_the_numbering_has_changed() {
    let mut camera = Camera::new();
    // By forties, once not, and by forties again.
    camera.send([0, 40, 80, 121, 200, 240, 280, 320], None);
    assert_eq!(
        camera.send([160, 320], None),
        [Arrival::Late, Arrival::Duplicate]
    );
}

#[test]
fn a_sample_with_an_unreadable_number_does_not_also_count_as_lost() {
    let mut camera = Camera::new();
    for (unreadable, seq, lost) in [(0, 0, 0), (0, 1, 0), (2, 6, 2), (0, 9, 2), (1, 10, 0)] {
        for _ in 0..unreadable {
            camera.tracker.arrive_unreadable();
        }
        assert_eq!(camera.send([seq], None), [new(seq, lost)]);
    }
}

#[test]
fn one_stray_frame_costs_a_camera_no_frame_and_no_count() {
    for own in [None, Some(9)] {
        for (seq, stream) in [
            (Some(5), Some(77)),
            (Some(0), own),
            (Some(900), own),
            (Some(1500), own),
            (Some(5_000_000), own),
            (Some(u64::MAX), own),
            (Some(1002), Some(77)),
            (None, own),
            (None, Some(77)),
        ] {
            let mut camera = Camera::new();
            assert_eq!(losses(&camera.send(1000..1050, own)), (0, 0));
            let case = format!("{seq:?} of {stream:?} among {own:?}");
            assert_eq!(camera.arrive(seq, stream), Arrival::Stray, "{case}");
            let after = camera.send(1050..1450, own);
            assert_eq!(losses(&after), (0, 0), "{case}");
            assert!(!after.contains(&restarted(50)));
        }
    }
}

#[test]
fn another_stream_takes_over_after_a_second_and_five_periods_of_silence() {
    for (period_ms, silence_ms) in [(20, 1000), (200, 1000), (2000, 10_000)] {
        let period = Duration::from_millis(period_ms);
        let silence = Duration::from_millis(silence_ms);
        let mut camera = Camera::new();
        for number in 0..10 {
            camera.pass(period).arrive(number, 1);
        }
        camera.pass(silence - Duration::from_millis(1));
        assert_eq!(camera.arrive(0, 2), Arrival::Stray, "{period:?}");
        camera.pass(Duration::from_millis(1));
        assert_eq!(camera.arrive(1, 2), restarted(10), "{period:?}");
        let after = camera.send(2..9, Some(2));
        assert_eq!(after, Vec::from_iter((11..18).map(|place| new(place, 0))));
        assert_eq!(camera.arrive(10, 1), Arrival::Stray, "left of the first");
    }
}

#[test]
fn a_restart_after_a_visible_departure_costs_no_frame() {
    let mut camera = Camera::new();
    camera.send(0..50, Some(1));
    let mut place = 50;
    for (stream, numbers) in [(2, 0..50), (3, 20..60), (4, 500..520), (5, 0..5)] {
        camera.tracker.publisher_left(stream - 1);
        // What was still on its way is processed.
        let arrivals = camera.send(numbers, Some(stream));
        assert_eq!(arrivals[0], restarted(place));
        for arrival in &arrivals[1..] {
            place += 1;
            assert_eq!(*arrival, new(place, 0));
        }
        place += 1;
    }
    camera.tracker.publisher_left(4);
    assert_eq!(camera.arrive(0, 6), Arrival::Stray, "an old one is gone");
    camera.tracker.publisher_left(5);
    assert_eq!(losses(&camera.send([5], Some(5))), (0, 0), "its last frame");
    camera.tracker.publisher_came(5);
    assert_eq!(camera.arrive(0, 6), Arrival::Stray, "it is back");
}

#[test]
fn a_silent_restart_costs_only_the_frames_of_one_second() {
    for sent in [20, 1000] {
        let mut camera = Camera::new();
        camera.send(0..sent, None);
        let arrivals = camera.send(0..30, None);
        let (dropped, lost) = losses(&arrivals);
        assert_eq!(lost, 0, "{sent}");
        assert!((9..=10).contains(&dropped), "{sent}: {dropped}");
        assert_eq!(losses(&arrivals[dropped..]), (0, 0));
        assert_eq!(arrivals[dropped], restarted(sent));
        camera.pass(SILENCE);
        let after_a_silence = camera.send(0..30, None);
        assert_eq!(losses(&after_a_silence), (0, 0));
        assert_eq!(camera.arrive(7, None), Arrival::Duplicate);
    }
}

#[test]
fn frames_without_numbers_are_never_lost() {
    let mut camera = Camera::new();
    camera.send(0..100, None);
    camera.pass(SILENCE);
    assert_eq!(camera.arrive(None, None), restarted(100));
    for place in 101..453 {
        assert_eq!(camera.pass(PERIOD).arrive(None, None), new(place, 0));
    }
    camera.pass(SILENCE);
    assert_eq!(camera.arrive(0, None), restarted(453));
    assert_eq!(camera.arrive(1, None), new(454, 0));
}

#[test]
fn of_two_cameras_on_one_key_the_first_wins_and_loses_no_frame() {
    for (first_number, first_stream, second_stream) in [
        (0, Some(1), Some(2)),
        (0, None, Some(2)),
        (1000, None, None),
    ] {
        let mut camera = Camera::new();
        for number in 0..200 {
            let seq = first_number + number;
            let heard = camera.pass(PERIOD / 2).arrive(seq, first_stream);
            assert_eq!(heard, new(number, 0));
            // The second one numbers from 0, and sends more often.
            for half in [0, 1] {
                let seq = 2 * number + half;
                let other = camera.pass(PERIOD / 4).arrive(seq, second_stream);
                assert_eq!(other, Arrival::Stray);
            }
        }
    }
}

proptest! {
    /// Frames are lost, repeated and delayed by less than the window: every one is counted as what it is.
    #[test]
    fn all_frames_are_accounted_for(
        sent in prop::collection::vec((0_u8..10, 0_u64..20), 1..400),
        start in 0_u64..1_000_000,
    ) {
        // Fate 0: lost; 1: sent twice; else once. The second number delays the arrival.
        let mut arriving = Vec::new();
        for (number, (fate, delay)) in sent.iter().enumerate() {
            let number = number as u64;
            let delay = if *delay < 15 { 0 } else { *delay - 14 };
            let copies = match fate { 0 => 0, 1 => 2, _ => 1 };
            arriving.extend(std::iter::repeat_n((number + delay, start + number), copies));
        }
        // Stable, so two frames on the same place keep their order.
        arriving.sort_by_key(|(place, _)| *place);
        // It begins with a step of one: what the first steps mean is tried below.
        let first = arriving.first().map_or(start, |(_, number)| *number) + 2;
        for (place, number) in &mut arriving {
            *place += 2;
            *number += 2;
        }
        arriving.splice(0..0, [(0, first - 2), (1, first - 1)]);
        let mut camera = Camera::new();
        let mut fresh = BTreeSet::new();
        let mut late = BTreeSet::new();
        let mut duplicate = 0_usize;
        let mut lost = 0;
        let mut last_index = None;
        let begin = arriving.first().map_or(0, |(_, number)| *number);
        let mut stray = BTreeSet::new();
        for (_, number) in &arriving {
            match camera.pass(PERIOD / 50).arrive(*number, None) {
                Arrival::New { index, lost: missing, restarted } => {
                    prop_assert!(!restarted);
                    prop_assert_eq!(index, *number - begin);
                    prop_assert!(last_index < Some(index));
                    last_index = Some(index);
                    lost += missing;
                    prop_assert!(fresh.insert(*number));
                }
                Arrival::Duplicate => duplicate += 1,
                Arrival::Late => prop_assert!(late.insert(*number)),
                // Behind a long gap.
                Arrival::Stray => prop_assert!(stray.insert(*number)),
            }
        }
        prop_assume!(stray.is_empty());
        let distinct: BTreeSet<u64> = arriving.iter().map(|(_, number)| *number).collect();
        prop_assert!(fresh.is_disjoint(&late));
        prop_assert_eq!(fresh.len() + late.len(), distinct.len());
        prop_assert_eq!(duplicate, arriving.len() - distinct.len());
        if let (Some(first), Some(last)) = (fresh.first(), fresh.last()) {
            let found = late.iter().filter(|number| *number > first).count() as u64;
            let missing = (*first..=*last).filter(|number| !distinct.contains(number)).count();
            prop_assert_eq!(lost - found, missing as u64);
        }
    }

    #[test]
    fn no_history_silences_a_camera(
        history in prop::collection::vec((prop_oneof![0_u64..200, any::<u64>()], 0_u64..3), 0..50),
        start in prop_oneof![0_u64..200, 0..u64::MAX - 200],
        stream in 0_u64..3,
    ) {
        let mut camera = Camera::new();
        let mut last_index = None;
        for (number, stream) in history {
            if let Arrival::New { index, .. } = camera.pass(PERIOD).arrive(number, stream) {
                prop_assert!(last_index.is_none_or(|last| last < index || index == u64::MAX));
                last_index = Some(index);
            }
        }
        let arrivals = camera.send(start..start + 200, Some(stream));
        let is_new = |arrival: &Arrival| matches!(arrival, Arrival::New { .. });
        let from = arrivals.iter().position(is_new).unwrap();
        prop_assert!(from < 100, "{from}");
        prop_assert!(arrivals[from..].iter().all(is_new));
    }
}

/// What a camera at 30 frames/s may send as numbers: one by one, every tenth, milliseconds, nanoseconds.
fn numberings() -> impl Strategy<Value = Vec<u64>> {
    let steps = prop_oneof![
        (1_u64..20, Just(0_u64)),
        (Just(10_u64), Just(0_u64)),
        (33_u64..200, 0_u64..12),
        (33_333_333_u64..40_000_000, 0_u64..5_000_000),
    ];
    let start = 0..1_u64 << 40;
    let noise = prop::collection::vec(any::<u64>(), 60..200);
    (steps, start, noise).prop_map(|((step, jitter), start, noise)| {
        let mut number = start;
        let mut numbers = Vec::with_capacity(noise.len());
        for noise in noise {
            number += step + noise % (jitter + 1);
            numbers.push(number);
        }
        numbers
    })
}

proptest! {
    #[test]
    fn whatever_a_camera_counts_its_frames_are_answered_and_no_loss_is_invented(
        numbers in numberings(),
        period_ms in prop_oneof![Just(33_u64), Just(100), Just(1000), Just(5000)],
    ) {
        let mut camera = Camera::new();
        let period = Duration::from_millis(period_ms);
        let arrivals: Vec<Arrival> = numbers
            .iter()
            .map(|number| camera.pass(period).arrive(*number, None))
            .collect();
        let (dropped, lost) = losses(&arrivals);
        prop_assert!(dropped <= 2, "{dropped} of {}", arrivals.len());
        prop_assert_eq!(lost, 0);
        let restarts = |arrival: &&Arrival| matches!(arrival, Arrival::New { restarted: true, .. });
        prop_assert!(arrivals.iter().filter(restarts).count() <= 1);
    }

    #[test]
    fn a_constant_step_still_tells_what_is_lost(
        step in 2_u64..1000,
        // Up to seven frames in a row are lost: one more, and the next frame has to confirm the jump.
        ahead in prop::collection::vec(prop_oneof![8 => Just(1_u64), 2 => 2_u64..=8], 20..200),
    ) {
        let steps = [1; 4].into_iter().chain(ahead);
        let places: Vec<u64> = steps
            .scan(0, |place, ahead| {
                *place += ahead;
                Some(*place)
            })
            .collect();
        let arrivals = Camera::new().send(places.iter().map(|place| place * step), None);
        let (dropped, lost) = losses(&arrivals);
        prop_assert!(dropped <= 1, "{dropped}");
        prop_assert_eq!(lost, places[places.len() - 1] - places.len() as u64);
    }
}

#[test]
fn a_camera_that_changes_its_step_loses_one_frame_at_most() {
    let mut camera = Camera::new();
    camera.send((0..50).map(|number| number * 10), None);
    let every = camera.send(491..600, None);
    assert_eq!(losses(&every), (0, 0), "from tens to ones");
    let tens = camera.send((61..100).map(|number| number * 10), None);
    let (dropped, lost) = losses(&tens);
    assert!(dropped <= 1, "back to tens: {dropped}");
    assert!(lost <= 10, "back to tens: {lost}");
}

#[test]
fn times_tell_late_frames_and_duplicates() {
    let mut camera = Camera::new();
    camera.send([0, 33, 67, 100, 134], None);
    assert_eq!(camera.arrive(134, None), Arrival::Duplicate);
    assert_eq!(camera.arrive(110, None), Arrival::Late);
    assert_eq!(losses(&camera.send([167, 201], None)), (0, 0));
}
