//! Promises of the division of energy and of what is saved of the detector's time.

use super::*;
use crate::tests::ms;

const FRONT: u64 = 0;
const REAR: u64 = 1;

fn two_cameras() -> Attribution {
    let mut cameras = Attribution::default();
    assert_eq!((cameras.add(), cameras.add()), (FRONT, REAR));
    cameras
}

/// Ten watts for so many samples of 100 ms; `work` comes before each. What each camera has of it, and of saved time.
fn pass(
    cameras: &mut Attribution,
    samples: u64,
    mut work: impl FnMut(&mut Attribution, u64),
) -> ([f64; 2], [f64; 2]) {
    let of = |totals: &[(u64, CameraTotals)], what: fn(&CameraTotals) -> f64| {
        [FRONT, REAR].map(|number| {
            let found = totals.iter().find(|(camera, _)| *camera == number);
            found.map_or(0.0, |(_, totals)| what(totals))
        })
    };
    let before = cameras.divide(0.0, 0.0);
    let mut after = before.clone();
    for sample in 0..samples {
        work(cameras, sample);
        after = cameras.divide(1.0, 0.1);
    }
    let used = |what: fn(&CameraTotals) -> f64| {
        let (before, after) = (of(&before, what), of(&after, what));
        [after[0] - before[0], after[1] - before[1]]
    };
    (used(|totals| totals.joules), used(|totals| totals.saved_s))
}

fn assert_near(found: [f64; 2], expected: [f64; 2], by: f64) {
    let near = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < by);
    assert!(near, "{found:?}, not {expected:?}");
}

#[test]
fn detector_time_divides_the_energy_and_frames_divide_it_without() {
    let mut cameras = two_cameras();
    let (joules, _) = pass(&mut cameras, 1000, |cameras, _| {
        cameras.called(FRONT, ms(30));
        cameras.called(REAR, ms(10));
    });
    assert_near(joules, [750.0, 250.0], 1e-9);
    // Frames alone take over within some time constants.
    pass(&mut cameras, 200, |cameras, sample| {
        cameras.frame(FRONT);
        if sample.is_multiple_of(9) {
            cameras.frame(REAR);
        }
    });
    let (joules, _) = pass(&mut cameras, 900, |cameras, sample| {
        cameras.frame(FRONT);
        if sample.is_multiple_of(9) {
            cameras.frame(REAR);
        }
    });
    assert_near(joules, [810.0, 90.0], 1.0);
    // Nothing at all: as before.
    let (joules, _) = pass(&mut cameras, 1000, |_, _| {});
    assert!(joules[0] > 800.0 && (joules[0] + joules[1] - 1000.0).abs() < 1e-9);
}

#[test]
fn cameras_that_did_nothing_share_equally() {
    let (joules, _) = pass(&mut two_cameras(), 10, |_, _| {});
    assert_near(joules, [5.0, 5.0], 1e-9);
}

#[test]
fn a_camera_that_comes_has_its_part_from_then_on_and_one_that_goes_takes_none() {
    let mut cameras = Attribution::default();
    assert_eq!(cameras.add(), FRONT);
    pass(&mut cameras, 10, |cameras, _| cameras.called(FRONT, ms(10)));
    assert_eq!(cameras.add(), REAR);
    let (joules, _) = pass(&mut cameras, 1000, |cameras, _| {
        cameras.called(FRONT, ms(10));
        cameras.called(REAR, ms(10));
    });
    assert_near(joules, [500.0, 500.0], 6.0);
    assert_eq!(cameras.divide(1.0, 0.1).len(), 2);
    cameras.remove(FRONT);
    let (joules, _) = pass(&mut cameras, 10, |_, _| {});
    assert!((joules[1] - 10.0).abs() < 1e-9, "{joules:?}");
}

#[test]
fn an_avoided_call_saves_the_time_of_a_call() {
    let mut cameras = two_cameras();
    let (_, saved) = pass(&mut cameras, 1000, |cameras, sample| {
        cameras.called(FRONT, ms(20));
        cameras.avoided(FRONT);
        if sample.is_multiple_of(2) {
            cameras.avoided(REAR);
        }
    });
    assert_near(saved, [20.0, 10.0], 0.05);
}

#[test]
fn no_more_is_saved_than_the_time_that_one_detector_had_left() {
    let mut cameras = two_cameras();
    // Of each 100 ms it is busy for 80; the calls avoided would have taken 120 more.
    let (_, saved) = pass(&mut cameras, 1000, |cameras, _| {
        cameras.called(FRONT, ms(40));
        cameras.called(REAR, ms(40));
        (0..3).for_each(|_| cameras.avoided(REAR));
    });
    assert_near(saved, [0.0, 20.0], 0.2);
}

#[test]
fn calls_that_are_avoided_in_a_burst_have_the_time_around_it() {
    let mut cameras = two_cameras();
    cameras.called(FRONT, ms(40));
    // Twice a second four frames come at once: 160 ms of calls that one detector would have spread over two samples.
    let (_, saved) = pass(&mut cameras, 1000, |cameras, sample| {
        if sample.is_multiple_of(5) {
            (0..4).for_each(|_| cameras.avoided(REAR));
        }
    });
    assert_near(saved, [0.0, 200.0 * 0.16], 0.2);
}

#[test]
fn before_the_first_call_nothing_is_known_to_be_saved() {
    let (_, saved) = pass(&mut two_cameras(), 10, |cameras, _| cameras.avoided(FRONT));
    assert_near(saved, [0.0, 0.0], f64::MIN_POSITIVE);
}
