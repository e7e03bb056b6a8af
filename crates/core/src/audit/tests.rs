use super::rate::{SideSums, design_effect, wilson};
use super::*;
use crate::detection::{ClassId, Detection};
use crate::geometry::BoundingBox;
use crate::policy::tests::random;
use crate::policy::{BoxSource, OutputBox};
use proptest::prelude::*;

type Place = (BoundingBox, u16);

fn add(sums: &mut AuditSums, shown: &[Place], detected: &[Place]) {
    let shown = shown.iter().map(|&(bounding_box, class)| OutputBox {
        bounding_box,
        class: ClassId(class),
        confidence: 0.7,
        source: BoxSource::Predicted,
        object: None,
        confirmed: true,
    });
    let detected = detected.iter().map(|&(bounding_box, class)| Detection {
        bounding_box,
        class: ClassId(class),
        confidence: 0.9,
    });
    sums.add(&Vec::from_iter(shown), &Vec::from_iter(detected));
}

/// One of 100 places that do not overlap, moved a little.
fn at(place: usize, off: f64) -> BoundingBox {
    let (column, row) = ((place % 10) as f64, (place / 10) as f64);
    BoundingBox::new(0.05 + column / 10.0 + off, 0.05 + row / 10.0, 0.08, 0.08)
}

fn one(shown: &[Place], detected: &[Place]) -> AuditSums {
    let mut sums = AuditSums::default();
    add(&mut sums, shown, detected);
    sums
}

/// Adds a frame with `detected` boxes, of which `paired` were shown.
pub(crate) fn add_crowd(sums: &mut AuditSums, detected: usize, paired: usize) {
    let boxes: Vec<_> = (0..detected).map(|place| (at(place, 0.0), 0)).collect();
    add(sums, &boxes[..paired], &boxes);
}

#[test]
fn boxes_of_the_same_object_are_paired() {
    let seen = [(at(0, 0.0), 0), (at(1, 0.0), 1), (at(4, 0.0), 0)];
    // Correct with another class; too far off to be the same box; a box that is gone.
    let reported = [(at(0, 0.004), 7), (at(1, 0.04), 1), (at(50, 0.0), 0)];
    let sums = one(&reported, &seen);
    assert_eq!(sums.frames, 1);
    assert_eq!((sums.detected, sums.shown, sums.paired), (3, 3, 1));
}

#[test]
fn pairs_are_the_optimal_ones_and_not_the_first_that_fit() {
    // The first shown box fits both objects, the second one better; the second fits only the second object.
    let wide = |center: f64| (BoundingBox::new(center, 0.5, 0.2, 0.2), 0);
    let seen = [wide(0.40), wide(0.46)];
    let reported = [wide(0.44), wide(0.52)];
    let sums = one(&reported, &seen);
    assert_eq!(sums.paired, 2);
    assert_eq!(sums.recall().unwrap().rate, 1.0);
}

#[test]
fn an_invisible_box_counts_on_neither_side() {
    let invisible = [1.4, f64::NAN].map(|x| (BoundingBox::new(x, 0.5, 0.2, 0.2), 0));
    let sums = one(&invisible, &invisible);
    assert_eq!(sums.frames, 1);
    assert_eq!((sums.detected, sums.shown), (0, 0));
    assert_eq!((sums.recall(), sums.precision()), (None, None));
}

#[test]
fn the_drawn_share_is_as_configured_and_reproducible() {
    for (share, least, most) in [(0.02, 1_850, 2_150), (0.5, 49_400, 50_600)] {
        let draw = AuditDraw::new(share, 7);
        let drawn = (0..100_000).filter(|frame| draw.draw(*frame)).count();
        assert!((least..=most).contains(&drawn), "{share}: {drawn}");
        let again = AuditDraw::new(share, 7);
        assert!((0..1000).all(|frame| draw.draw(frame) == again.draw(frame)));
        let other = AuditDraw::new(share, 8);
        assert!((0..1000).any(|frame| draw.draw(frame) != other.draw(frame)));
        // The draw does not align with a policy that calls on every second frame.
        let even = (0..100_000).step_by(2).filter(|frame| draw.draw(*frame)).count() * 2;
        assert!((least * 9 / 10..=most * 11 / 10).contains(&even), "{even}");
    }
    assert!((0..1000).all(|frame| AuditDraw::new(1.0, 1).draw(frame)));
    for share in [0.0, -1.0, f64::NAN] {
        let draw = AuditDraw::new(share, 1);
        assert!(draw.is_off() && !(0..1000).any(|frame| draw.draw(frame)));
    }
}

#[test]
fn the_interval_is_wilsons_with_one_box_per_frame() {
    // 8 of 10: R's prop.test(8, 10, correct = FALSE) says 0.4901625 to 0.9433178.
    let interval = wilson(0.8, 10.0);
    assert!((interval.low - 0.490_162_5).abs() < 1e-6, "{interval:?}");
    assert!((interval.high - 0.943_317_8).abs() < 1e-6, "{interval:?}");
}

#[test]
fn one_frame_with_twenty_boxes_is_no_certainty() {
    let mut sums = AuditSums::default();
    add_crowd(&mut sums, 20, 20);
    let rate = sums.recall().unwrap();
    assert_eq!(rate.boxes, 20);
    assert!(rate.independent < 1.5 && rate.low < 0.3, "{rate:?}");
}

/// The numbers of detected boxes and of shown ones among them.
struct Counts {
    boxes: usize,
    paired: usize,
}

/// The counts of each frame. Crowds and misses are correlated over time, as on roads.
fn road(frames: usize) -> Vec<Counts> {
    let mut random = random(1);
    let mut bad = false;
    let mut counts = Vec::new();
    for _ in 0..frames {
        // Bad stretches with many misses.
        if random() < 0.05 {
            bad = random() < 0.2;
        }
        let boxes = (random() * 9.0) as usize;
        let miss = if bad { 0.6 } else { 0.05 };
        let paired = (0..boxes).filter(|_| random() >= miss).count();
        counts.push(Counts { boxes, paired });
    }
    counts
}

#[test]
fn intervals_cover_the_full_comparison_at_their_rate() {
    let frames = road(5_000);
    let boxes: usize = frames.iter().map(|frame| frame.boxes).sum();
    let paired: usize = frames.iter().map(|frame| frame.paired).sum();
    let truth = paired as f64 / boxes as f64;
    let mut held = 0;
    let mut naive = 0;
    let mut mean = 0.0;
    let rounds = 400;
    for seed in 0..rounds {
        let draw = AuditDraw::new(0.02, seed);
        let mut sums = AuditSums::default();
        for (index, frame) in (0..).zip(&frames) {
            if draw.draw(index) {
                add_crowd(&mut sums, frame.boxes, frame.paired);
            }
        }
        let rate = sums.recall().unwrap();
        mean += rate.rate / rounds as f64;
        held += usize::from((rate.low..=rate.high).contains(&truth));
        let independent = wilson(rate.rate, rate.boxes as f64);
        naive += usize::from((independent.low..=independent.high).contains(&truth));
    }
    assert!((mean - truth).abs() < 0.01, "{mean} {truth}");
    let least = rounds as usize * 93 / 100;
    assert!(held >= least, "{held} of {rounds}");
    // Treating boxes as independent would promise too much, hence the design effect.
    assert!(naive < least, "{naive} of {rounds}");
}

#[test]
fn fields_of_later_versions_are_ignored_and_zeros_are_not_written() {
    assert_eq!(serde_json::to_string(&AuditSums::default()).unwrap(), "{}");
    let later = r#"{"missed":3,"by_weather":{"rain":{}},"frames":2,"squares":{"hue":1}}"#;
    let sums: AuditSums = serde_json::from_str(later).unwrap();
    assert_eq!((sums.missed, sums.frames, sums.drawn()), (3, 2, 5));
}

fn boxes() -> impl Strategy<Value = Vec<Place>> {
    let place = (-0.1..1.1, -0.1..1.1, 0.01..0.5, 0.01..0.5)
        .prop_map(|(x, y, width, height)| BoundingBox::new(x, y, width, height));
    prop::collection::vec((place, 0..3u16), 0..6)
}

type Frame = (Vec<Place>, Vec<Place>, bool);

fn add_frame(sums: &mut AuditSums, (reported, seen, missed): &Frame) {
    if *missed {
        sums.add_missed(reported.len());
    } else {
        add(sums, reported, seen);
    }
}

proptest! {
    #[test]
    fn pooled_sums_equal_counting_together(
        frames in prop::collection::vec(((boxes(), boxes(), any::<bool>()), 0..4usize), 0..24)
    ) {
        let mut together = AuditSums::default();
        let mut parts = [AuditSums::default(); 4];
        for (frame, part) in &frames {
            add_frame(&mut together, frame);
            add_frame(&mut parts[*part], frame);
        }
        let mut pooled = AuditSums::default();
        // In another order, and through JSON.
        for part in parts.iter().rev() {
            let text = serde_json::to_string(part).unwrap();
            pooled.merge(&serde_json::from_str(&text).unwrap());
        }
        prop_assert_eq!(&pooled, &together);
        prop_assert_eq!(pooled.recall(), together.recall());
    }

    #[test]
    fn the_two_sides_are_treated_alike(reported in boxes(), seen in boxes()) {
        let there = one(&reported, &seen);
        let back = one(&seen, &reported);
        prop_assert_eq!(there.detected, back.shown);
        prop_assert_eq!(there.shown, back.detected);
        prop_assert_eq!(there.recall(), back.precision());
    }

    #[test]
    fn no_foreign_sums_give_an_impossible_rate(
        missed_boxes in any::<u64>(), detected in any::<u64>(), paired in any::<u64>(), squares in any::<[u64; 3]>()
    ) {
        let mut sums = AuditSums {
            missed_boxes,
            detected,
            paired,
            squares: AuditSquares {
                detected: squares[0],
                paired: squares[1],
                detected_paired: squares[2],
                ..AuditSquares::default()
            },
            ..AuditSums::default()
        };
        sums.merge(&sums.clone());
        if let Some(rate) = sums.recall() {
            for value in [rate.rate, rate.low, rate.high] {
                prop_assert!((0.0..=1.0).contains(&value), "{:?}", rate);
            }
            prop_assert!(rate.low <= rate.high, "{:?}", rate);
        }
    }

    /// Computed per frame instead of from sums of squares.
    #[test]
    fn the_design_effect_is_the_variance_of_frames_over_that_of_boxes(
        frames in prop::collection::vec((1u32..12, 0.0f64..=1.0), 1..40),
    ) {
        let frames: Vec<(f64, f64)> = frames.iter()
            .map(|&(boxes, share)| (f64::from(boxes), (f64::from(boxes) * share).round()))
            .collect();
        // Of each frame with m boxes, k of them paired.
        let sum = |value: &dyn Fn(f64, f64) -> f64| frames.iter().map(|&(m, k)| value(m, k)).sum::<f64>();
        let boxes = sum(&|m, _| m);
        let paired = sum(&|_, k| k);
        let crowd = sum(&|m, _| m * m) / boxes;
        let rate = (paired + crowd / 2.0) / (boxes + crowd);
        let more = |shown: f64| (shown - rate * crowd).powi(2);
        let residuals = sum(&|m, k| (k - rate * m).powi(2)) + (more(0.0) + more(crowd)) / 2.0;
        let expected = residuals / (boxes + crowd) / (rate * (1.0 - rate));
        let found = design_effect(SideSums {
            paired: paired as u64,
            boxes: boxes as u64,
            paired_squared: sum(&|_, k| k * k) as u64,
            boxes_paired: sum(&|m, k| m * k) as u64,
            boxes_squared: sum(&|m, _| m * m) as u64,
        });
        prop_assert!((found - expected.max(1.0)).abs() < 1e-9 * expected, "{found} {expected}");
    }
}

/// The sums of a camera and its true recall: all boxes but one were shown, and only half of them on missed frames.
fn camera(frames: u64, boxes: u64, missed: u64) -> (AuditSums, f64) {
    let mut sums = AuditSums::default();
    for _ in 0..missed {
        sums.add_missed(boxes as usize);
    }
    for _ in missed..frames {
        add_crowd(&mut sums, boxes as usize, boxes as usize - 1);
    }
    let right = missed * (boxes / 2) + (frames - missed) * (boxes - 1);
    (sums, right as f64 / (frames * boxes) as f64)
}

#[test]
fn the_interval_covers_missed_frames_too() {
    let (sums, truth) = camera(1_000, 10, 300);
    let compared = sums.compared_recall().unwrap();
    assert!(compared.low > truth, "{compared:?} {truth}");
    let reported = sums.recall().unwrap();
    assert_eq!(reported.rate, compared.rate);
    let interval = reported.low..=reported.high;
    assert!(interval.contains(&truth), "{reported:?} {truth}");
    assert!((reported.low - 0.7 * compared.low).abs() < 1e-12);
    assert!((reported.high - (0.3 + 0.7 * compared.high)).abs() < 1e-12);
    let (whole, truth) = camera(1_000, 10, 0);
    assert_eq!(whole.recall(), whole.compared_recall());
    assert!((whole.recall().unwrap().rate - truth).abs() < 1e-12);
}

#[test]
fn a_crowded_camera_with_many_misses_is_not_outvoted_by_a_quiet_one() {
    let (crowded, right) = camera(100, 20, 50);
    let (quiet, also) = camera(300, 2, 0);
    let truth = (right * 2_000.0 + also * 600.0) / 2_600.0;
    let mut pooled = crowded;
    pooled.merge(&quiet);
    let reported = pooled.recall().unwrap();
    let interval = reported.low..=reported.high;
    assert!(interval.contains(&truth), "{reported:?} {truth}");
    // An eighth of the frames was missed, but more than a third of the boxes.
    assert!(reported.high - reported.low > 0.38, "{reported:?}");
}

#[test]
fn missed_frames_alone_give_no_rate() {
    let mut sums = AuditSums::default();
    sums.add_missed(3);
    sums.add_missed(0);
    assert_eq!((sums.missed, sums.missed_boxes, sums.drawn()), (2, 4, 2));
    assert_eq!((sums.recall(), sums.precision()), (None, None));
    assert_eq!(sums.missed_share(), 1.0);
    assert!(!sums.is_empty() && AuditSums::default().is_empty());
}
