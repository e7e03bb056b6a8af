use super::*;
use crate::energy::totals::Totals;
use crate::tests::ms;

const FRONT: u64 = 0;
const REAR: u64 = 1;

fn two_cameras() -> Attribution {
    let mut cameras = Attribution::default();
    assert_eq!(cameras.add(), FRONT);
    assert_eq!(cameras.add(), REAR);
    cameras
}

/// What the two cameras were given.
struct Given {
    joules: [f64; 2],
    /// Detector seconds that their avoided calls saved.
    saved_s: [f64; 2],
}

/// Divides 10 W over `samples` of 100 ms with `work` before each.
fn pass(
    cameras: &mut Attribution,
    samples: u64,
    mut work: impl FnMut(&mut Attribution, u64),
) -> Given {
    let mut totals = Totals {
        cameras: cameras.divide(0.0, 0.0),
        ..Totals::default()
    };
    let before = totals.clone();
    for sample in 0..samples {
        work(cameras, sample);
        totals.cameras = cameras.divide(1.0, 0.1);
    }
    let rise = |figure: fn(Sum) -> f64| {
        [FRONT, REAR].map(|number| figure(totals.camera(number)) - figure(before.camera(number)))
    };
    Given {
        joules: rise(|sum| sum.joules),
        saved_s: rise(|sum| sum.seconds),
    }
}

fn assert_near(found: [f64; 2], expected: [f64; 2], by: f64) {
    let near = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < by);
    assert!(near, "{found:?}, not {expected:?}");
}

#[test]
fn energy_is_divided_by_detector_time_or_else_by_frames_or_else_equally() {
    let mut cameras = two_cameras();
    let idle = pass(&mut cameras, 10, |_, _| {});
    assert_near(idle.joules, [5.0, 5.0], 1e-9);
    let calling = pass(&mut cameras, 1000, |cameras, _| {
        cameras.called(FRONT, ms(30));
        cameras.called(REAR, ms(10));
    });
    assert_near(calling.joules, [750.0, 250.0], 1e-9);
    // Without calls, frames decide after some time constants.
    let frames = |cameras: &mut Attribution, sample: u64| {
        cameras.frame(FRONT);
        if sample.is_multiple_of(9) {
            cameras.frame(REAR);
        }
    };
    pass(&mut cameras, 200, frames);
    let sending = pass(&mut cameras, 900, frames);
    assert_near(sending.joules, [810.0, 90.0], 1.0);
    let [front, rear] = pass(&mut cameras, 1000, |_, _| {}).joules;
    assert!(front > 800.0, "as of the last frames: {front}");
    assert!((front + rear - 1000.0).abs() < 1e-9);
}

#[test]
fn a_new_camera_shares_from_then_on_and_a_removed_one_gets_nothing() {
    let mut cameras = Attribution::default();
    assert_eq!(cameras.add(), FRONT);
    pass(&mut cameras, 10, |cameras, _| cameras.called(FRONT, ms(10)));
    assert_eq!(cameras.add(), REAR);
    let both = pass(&mut cameras, 1000, |cameras, _| {
        cameras.called(FRONT, ms(10));
        cameras.called(REAR, ms(10));
    });
    assert_near(both.joules, [500.0, 500.0], 6.0);
    assert_eq!(cameras.divide(1.0, 0.1).len(), 2);
    cameras.remove(FRONT);
    let [_, rear] = pass(&mut cameras, 10, |_, _| {}).joules;
    assert!((rear - 10.0).abs() < 1e-9, "{rear}");
}

#[test]
fn an_avoided_call_saves_the_duration_of_a_call_and_nothing_before_the_first_call() {
    let mut cameras = two_cameras();
    let before = pass(&mut cameras, 10, |cameras, _| cameras.avoided(FRONT));
    assert_near(before.saved_s, [0.0, 0.0], f64::MIN_POSITIVE);
    let after = pass(&mut cameras, 1000, |cameras, sample| {
        cameras.called(FRONT, ms(20));
        cameras.avoided(FRONT);
        if sample.is_multiple_of(2) {
            cameras.avoided(REAR);
        }
    });
    assert_near(after.saved_s, [20.0, 10.0], 0.05);
}

#[test]
fn savings_are_limited_to_the_idle_time_of_one_detector() {
    let mut cameras = two_cameras();
    // It is busy for 80 of each 100 ms; the avoided calls would have taken another 120 ms.
    let given = pass(&mut cameras, 1000, |cameras, _| {
        cameras.called(FRONT, ms(40));
        cameras.called(REAR, ms(40));
        for _ in 0..3 {
            cameras.avoided(REAR);
        }
    });
    assert_near(given.saved_s, [0.0, 20.0], 0.2);
}

#[test]
fn calls_avoided_in_a_burst_use_the_idle_time_around_it() {
    let mut cameras = two_cameras();
    cameras.called(FRONT, ms(40));
    // Four frames arrive at once twice per second: 160 ms of calls, which one detector would spread over two samples.
    let given = pass(&mut cameras, 1000, |cameras, sample| {
        if sample.is_multiple_of(5) {
            for _ in 0..4 {
                cameras.avoided(REAR);
            }
        }
    });
    assert_near(given.saved_s, [0.0, 200.0 * 0.16], 0.2);
}
