use super::*;
use crate::camera::answer;
use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{
    Albireo, AlbireoSettings, FrameEvidence, FrameHead, Outcome, Policy, decide,
};
use albireo_wire::Threshold;

fn message(seq: u64, outcome: &Outcome, u: f64) -> DetectionsMessage {
    let mut message = DetectionsMessage {
        degraded: outcome.degraded,
        threshold: Some(Threshold::new("u", u)),
        cause: outcome.cause,
        tau_max: outcome.tau_max,
        ..answer(seq, outcome.state)
    };
    if !outcome.state.is_skipped() {
        message.latency_ms.detector = Some((seq % 100) as f64);
    }
    message
}

/// Three objects of different speeds and sizes that cross the picture, with pauses in between.
fn scene(index: u64) -> Vec<Detection> {
    let object = |pace: f64, size: f64, y: f64| {
        let x = (index as f64 * pace) % 1.4 - 0.2;
        let wobble = ((index * 7919) % 13) as f64 * 3e-4;
        (0.05..0.95).contains(&x).then(|| Detection {
            bounding_box: BoundingBox::new(x + wobble, y, size, size),
            class: ClassId(0),
            confidence: 0.8,
        })
    };
    let objects = [
        object(0.004, 0.08, 0.3),
        object(0.007, 0.12, 0.6),
        object(0.002, 0.05, 0.8),
    ];
    objects.into_iter().flatten().collect()
}

/// A scene that was played under a threshold.
struct Played {
    history: History,
    /// The share of frames that were skipped.
    skip_rate: f64,
}

/// Plays the first `frames` frames of the scene under `u`.
fn played(u: f64, frames: u64) -> Played {
    let mut policy = Albireo::new(AlbireoSettings::paper(), u).unwrap();
    let mut history = History::default();
    let mut outcome = Outcome::default();
    let mut skipped = 0;
    for index in 0..frames {
        let found = scene(index);
        let mut known = FrameEvidence {
            empty: Some(found.is_empty()),
            ..FrameEvidence::detections(&found)
        };
        let head = FrameHead {
            index,
            step: 1,
            picture: PictureSize::new(1280, 720),
        };
        let Ok(()) = decide(&mut policy, head, &mut known, &mut outcome);
        skipped += u64::from(outcome.state.is_skipped());
        let age = Duration::from_millis(33 * index);
        history.add(&message(index, &outcome, u), age);
    }
    Played {
        history,
        skip_rate: skipped as f64 / frames as f64,
    }
}

/// The age of a node that started at the Unix epoch.
fn at(seconds: u64) -> Clock {
    Clock {
        now_ms: 1000 * seconds as i64,
        age: Duration::from_secs(seconds),
    }
}

#[test]
fn memory_is_allocated_once_and_the_oldest_entry_is_overwritten() {
    let mut history = History::default();
    let capacities = |history: &History| {
        [
            history.frames.capacity(),
            history.hour.ended.capacity(),
            history.times.capacity(),
        ]
    };
    let before = capacities(&history);
    let outcome = Outcome {
        state: FrameState::I,
        cause: Some(CallCause::Start),
        ..Outcome::default()
    };
    // Two hours at two frames per second, and a burst with more latencies than a piece can hold.
    let times = (0..14_400).map(|half_second| 500 * half_second);
    let burst = std::iter::repeat_n(7_200_000, 4000);
    for (seq, at) in (0..).zip(times.chain(burst)) {
        history.add(&message(seq, &outcome, 1.0), Duration::from_millis(at));
    }
    assert_eq!(capacities(&history), before);
    assert_eq!(history.frames(usize::MAX).len(), FRAMES);
    assert_eq!(history.frames(3).first().unwrap().seq, 18_397);
    let shown = history.slots(&at(7200));
    assert_eq!(shown.len(), SLOTS);
    let first = &shown[0];
    let last = shown.last().unwrap();
    assert_eq!(first.at_ms, 3_600_000);
    assert_eq!(first.frames, 20);
    assert_eq!(first.calls, 20);
    assert_eq!(first.skipped, 0);
    assert_eq!(last.frames, 4000);
    // The percentiles of a piece cover that piece alone.
    assert!(first.detector_p50_ms < first.detector_p99_ms);
    assert!(last.detector_p99_ms >= Some(97.0), "{last:?}");
    // After an hour without frames nothing is left to show.
    assert_eq!(history.slots(&at(10_900)), []);
}

#[test]
fn a_slot_without_frames_is_absent() {
    let mut history = History::default();
    let outcome = Outcome::default();
    for at in [0, 5, 25, 26, 65] {
        history.add(&message(at, &outcome, 1.0), Duration::from_secs(at));
    }
    let shown = history.slots(&at(66));
    let frames: Vec<_> = shown.iter().map(|slot| (slot.at_ms, slot.frames)).collect();
    assert_eq!(frames, [(0, 2), (20_000, 2), (60_000, 1)]);
}

#[test]
fn the_estimated_skip_rate_of_another_threshold_is_close_to_its_actual_one() {
    let policy = Albireo::new(AlbireoSettings::paper(), 3e-4).unwrap();
    let longest = policy.longest_pause();
    let values = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2];
    let truths = values.map(|u| played(u, 6000).skip_rate);
    // The shares must differ, or there is nothing to estimate.
    assert!(truths[4] - truths[0] > 0.2, "{truths:?}");
    let mut worst = 0.0_f64;
    let mut naive_worst = 0.0_f64;
    let mut near = 0.0_f64;
    for (place, recorded) in values.into_iter().enumerate() {
        let past = played(recorded, 6000).history.frames(usize::MAX);
        let estimate = SkipEstimate::of(&past, longest, &values).unwrap();
        for (other, (value, truth)) in estimate.values.iter().zip(&truths).enumerate() {
            let apart = (value.skip_rate - truth).abs();
            worst = worst.max(apart);
            if other.abs_diff(place) <= 1 {
                near = near.max(apart);
            }
            // Compares the recorded uncertainty with the value, frame by frame.
            let naive = past.iter().filter(|frame| match (frame.cause, frame.tau_max) {
                (Some(CallCause::Screen), _) => false,
                (_, tau) => tau.is_none_or(|tau| f64::from(tau) < values[other]),
            });
            let naive_rate = naive.count() as f64 / past.len() as f64;
            naive_worst = naive_worst.max((naive_rate - truth).abs());
        }
        let really = estimate.skipped;
        let same = estimate.values[place].skipped;
        let apart = really.abs_diff(same) as f64 / past.len() as f64;
        assert!(apart < 0.01, "at the value itself: {really} and {same}");
    }
    assert!(near < 0.15, "{near}");
    assert!(worst < 0.2, "{worst}");
    assert!(worst < naive_worst / 2.0, "{worst} and {naive_worst}");
    assert!(SkipEstimate::of(&[], longest, &values).is_none());
}

#[test]
fn the_power_of_a_slot_is_its_joules_over_the_sampled_time() {
    let mut past = PowerPast::default();
    for second in 0..100 {
        past.add(PowerSnapshot::default(), Duration::from_secs(second));
    }
    assert_eq!(past.slots(&at(100)), [], "no source, no power");
    past = PowerPast::default();
    let mut joules = 0.0;
    for second in 0..=7200_u64 {
        let snapshot = PowerSnapshot {
            quality: EnergyQuality::Estimated,
            joules: [("total".to_owned(), joules)].into(),
            covered_s: [("total".to_owned(), second as f64 / 2.0)].into(),
            ..PowerSnapshot::default()
        };
        past.add(snapshot, Duration::from_secs(second));
        // 5 W in even pieces and 9 W in odd ones, sampled half the time.
        let is_even = (second / SLOT_S).is_multiple_of(2);
        joules += if is_even { 2.5 } else { 4.5 };
    }
    let slots = past.slots(&at(7200));
    assert!((SLOTS - 1..=SLOTS).contains(&slots.len()));
    for slot in slots.iter().skip(1) {
        // The first second of a piece belongs to the sample that began it.
        assert!((5.0..=9.0).contains(&slot.watts["total"]), "{slot:?}");
        assert_eq!(slot.quality, EnergyQuality::Estimated);
    }
    let mean = slots.iter().map(|slot| slot.watts["total"]).sum::<f32>() / slots.len() as f32;
    assert!((6.9..7.1).contains(&mean), "{mean}");
}
