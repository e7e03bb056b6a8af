use super::*;
use crate::detection::{ClassId, Detection};
use crate::geometry::BoundingBox;
use crate::policy::{BoxSource, FrameState, OutputBox};
use proptest::prelude::*;

fn found(bounding_box: BoundingBox, class: u16) -> Detection {
    Detection {
        bounding_box,
        class: ClassId(class),
        confidence: 0.9,
    }
}

fn shown(bounding_box: BoundingBox, class: u16) -> OutputBox {
    OutputBox {
        bounding_box,
        class: ClassId(class),
        confidence: 0.7,
        source: BoxSource::Predicted,
        object: None,
        confirmed: true,
    }
}

/// One of 100 places that do not overlap, moved a little.
fn at(place: usize, off: f64) -> BoundingBox {
    let (column, row) = ((place % 10) as f64, (place / 10) as f64);
    BoundingBox::new(0.05 + column / 10.0 + off, 0.05 + row / 10.0, 0.08, 0.08)
}

fn one(shown: &[OutputBox], detected: &[Detection]) -> AuditSums {
    let mut sums = AuditSums::default();
    sums.add(shown, detected, FrameState::P, 1);
    sums
}

#[test]
fn what_was_shown_missed_newly_there_and_gone_is_told_apart() {
    let seen = [
        found(at(0, 0.0), 0),
        found(at(1, 0.0), 1),
        found(at(4, 0.0), 0),
    ];
    let told = [
        // Right; of another class, and so far off that it is another box; gone.
        shown(at(0, 0.004), 7),
        shown(at(1, 0.04), 1),
        shown(at(50, 0.0), 0),
    ];
    let total = one(&told, &seen).total();
    assert_eq!(total.frames, 1);
    assert_eq!(
        total.detected,
        BoxCounts {
            boxes: 3,
            paired: 1,
            alone: 1
        }
    );
    assert_eq!(
        total.shown,
        BoxCounts {
            boxes: 3,
            paired: 1,
            alone: 1
        }
    );
    assert_eq!(total.same_class, 0);
    let overlap = total.mean_overlap().unwrap();
    assert!((overlap - 0.076 / 0.084).abs() < 1e-6, "{overlap}");
}

#[test]
fn pairs_are_the_optimal_ones_and_not_the_first_that_fit() {
    // The first shown box fits both objects, better the second one; the second fits the second only.
    let wide = |center: f64| BoundingBox::new(center, 0.5, 0.2, 0.2);
    let seen = [found(wide(0.40), 0), found(wide(0.46), 0)];
    let told = [shown(wide(0.44), 0), shown(wide(0.52), 0)];
    let sums = one(&told, &seen);
    assert_eq!(sums.total().detected.paired, 2);
    assert_eq!(sums.recall().unwrap().rate, 1.0);
}

#[test]
fn sizes_are_shares_of_the_picture_and_each_side_goes_by_its_own() {
    let square = |side: f64| BoundingBox::new(0.5, 0.5, side, side);
    for (side, name) in [(0.05, "small"), (0.1, "medium"), (0.3, "large")] {
        let sums = one(&[shown(square(side), 0)], &[found(square(side), 0)]);
        for (group, tally) in sums.by_size.groups() {
            assert_eq!(tally.detected.paired, u64::from(group == name), "{side}");
            assert_eq!(tally.shown.paired, u64::from(group == name), "{side}");
        }
    }
    // A large box that hangs out of the picture is as large as what is seen of it.
    let outside = BoundingBox::new(-0.08, 0.5, 0.2, 0.2);
    let sums = one(&[], &[found(outside, 0)]);
    assert_eq!(sums.by_size.small.detected.alone, 0);
    assert_eq!(sums.by_size.medium.detected.alone, 1);
}

#[test]
fn a_box_that_nobody_can_see_counts_on_neither_side() {
    let outside = BoundingBox::new(1.4, 0.5, 0.2, 0.2);
    let broken = BoundingBox::new(f64::NAN, 0.5, 0.2, 0.2);
    let sums = one(
        &[shown(outside, 0), shown(broken, 0)],
        &[found(outside, 0), found(broken, 0)],
    );
    assert_eq!(sums.total().frames, 1);
    assert!(sums.total().detected.is_empty() && sums.total().shown.is_empty());
    assert_eq!((sums.recall(), sums.precision()), (None, None));
}

#[test]
fn a_frame_that_the_detector_had_looked_at_is_not_compared() {
    let mut sums = AuditSums::default();
    for state in [FrameState::I, FrameState::AI, FrameState::EI] {
        sums.add(&[shown(at(0, 0.0), 0)], &[found(at(0, 0.0), 0)], state, 1);
    }
    assert!(sums.is_empty());
}

#[test]
fn pauses_fall_into_their_groups() {
    let mut sums = AuditSums::default();
    for pause in 1..=20 {
        sums.add(&[], &[found(at(0, 0.0), 0)], FrameState::E, pause);
    }
    let frames = sums.by_pause.groups().map(|(_, tally)| tally.frames);
    assert_eq!(frames, [1, 1, 2, 4, 8, 4]);
    assert_eq!(sums.by_state.e.frames, 20);
}

#[test]
fn the_share_that_is_drawn_is_the_one_asked_for_and_the_same_each_time() {
    for (share, least, most) in [(0.02, 1_850, 2_150), (0.5, 49_400, 50_600)] {
        let draw = AuditDraw::new(share, 7);
        let drawn = (0..100_000).filter(|frame| draw.draw(*frame)).count();
        assert!((least..=most).contains(&drawn), "{share}: {drawn}");
        let again = AuditDraw::new(share, 7);
        assert!((0..1000).all(|frame| draw.draw(frame) == again.draw(frame)));
        let other = AuditDraw::new(share, 8);
        assert!((0..1000).any(|frame| draw.draw(frame) != other.draw(frame)));
        // No frame in step with a policy that calls every second one.
        let even = (0..100_000).step_by(2).filter(|frame| draw.draw(*frame));
        let even = even.count() * 2;
        assert!((least * 9 / 10..=most * 11 / 10).contains(&even), "{even}");
    }
    assert!((0..1000).all(|frame| AuditDraw::new(1.0, 1).draw(frame)));
    for share in [0.0, -1.0, f64::NAN] {
        let draw = AuditDraw::new(share, 1);
        assert!(draw.is_off() && !(0..1000).any(|frame| draw.draw(frame)));
    }
}

#[test]
fn the_interval_is_wilsons_where_each_frame_has_one_box() {
    // 8 of 10: R's prop.test(8, 10, correct = FALSE) says 0.4901625 to 0.9433178.
    let counts = BoxCounts {
        boxes: 10,
        paired: 8,
        alone: 0,
    };
    let rate = AuditRate::new(&counts, 1.0).unwrap();
    assert!((rate.low - 0.490_162_5).abs() < 1e-6, "{rate:?}");
    assert!((rate.high - 0.943_317_8).abs() < 1e-6, "{rate:?}");
}

#[test]
fn one_frame_with_twenty_boxes_is_no_certainty() {
    let seen: Vec<_> = (0..20).map(|place| found(at(place, 0.0), 0)).collect();
    let told: Vec<_> = (0..20).map(|place| shown(at(place, 0.0), 0)).collect();
    let rate = one(&told, &seen).recall().unwrap();
    assert_eq!(rate.boxes, 20);
    assert!(rate.independent < 1.5 && rate.low < 0.3, "{rate:?}");
}

/// A stream of frames whose crowds and misses hang together, as they do on roads: the first of `random` is how many
/// boxes, the second how many of them were shown.
fn road(random: &mut impl FnMut() -> f64, frames: usize) -> Vec<(usize, usize)> {
    let mut bad = false;
    (0..frames)
        .map(|_| {
            // Bad stretches, in which much is missed.
            if random() < 0.05 {
                bad = random() < 0.2;
            }
            let boxes = (random() * 9.0) as usize;
            let miss = if bad { 0.6 } else { 0.05 };
            let paired = (0..boxes).filter(|_| random() >= miss).count();
            (boxes, paired)
        })
        .collect()
}

#[test]
fn intervals_hold_the_full_comparison_as_often_as_they_say() {
    let mut state = 1u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let frames = road(&mut random, 5_000);
    let all: (usize, usize) = frames
        .iter()
        .fold((0, 0), |sum, frame| (sum.0 + frame.0, sum.1 + frame.1));
    let truth = all.1 as f64 / all.0 as f64;
    let (mut held, mut naive, mut mean) = (0, 0, 0.0);
    let rounds = 400;
    for seed in 0..rounds {
        let draw = AuditDraw::new(0.02, seed);
        let mut sums = AuditSums::default();
        for (_, (boxes, paired)) in (0..).zip(&frames).filter(|(index, _)| draw.draw(*index)) {
            let seen: Vec<_> = (0..*boxes).map(|place| found(at(place, 0.0), 0)).collect();
            let told: Vec<_> = (0..*paired).map(|place| shown(at(place, 0.0), 0)).collect();
            sums.add(&told, &seen, FrameState::P, 1);
        }
        let rate = sums.recall().unwrap();
        mean += rate.rate / rounds as f64;
        held += usize::from((rate.low..=rate.high).contains(&truth));
        let independent = AuditRate::new(&sums.total().detected, 1.0).unwrap();
        naive += usize::from((independent.low..=independent.high).contains(&truth));
    }
    assert!((mean - truth).abs() < 0.01, "{mean} {truth}");
    let least = rounds as usize * 93 / 100;
    assert!(held >= least, "{held} of {rounds}");
    // Boxes counted as independent would promise too much: that is what the spread is for.
    assert!(naive < least, "{naive} of {rounds}");
}

#[test]
fn a_message_with_what_a_later_version_adds_is_read_and_nothing_is_written_for_nothing() {
    let text = serde_json::to_string(&AuditSums::default()).unwrap();
    assert_eq!(text, "{}");
    let later = r#"{"missed":3,"by_weather":{"rain":{}},"by_state":{"P":{"frames":2,"hue":1}}}"#;
    let sums: AuditSums = serde_json::from_str(later).unwrap();
    assert_eq!((sums.missed, sums.total().frames, sums.drawn()), (3, 2, 5));
}

fn any_box() -> impl Strategy<Value = BoundingBox> {
    (-0.1..1.1, -0.1..1.1, 0.01..0.5, 0.01..0.5)
        .prop_map(|(x, y, width, height)| BoundingBox::new(x, y, width, height))
}

type Frame = (Vec<OutputBox>, Vec<Detection>, FrameState, u32, bool);

fn any_frame() -> impl Strategy<Value = Frame> {
    let told = prop::collection::vec((any_box(), 0..3u16).prop_map(|(b, c)| shown(b, c)), 0..6);
    let seen = prop::collection::vec((any_box(), 0..3u16).prop_map(|(b, c)| found(b, c)), 0..6);
    (
        told,
        seen,
        prop::sample::select(FrameState::ALL.to_vec()),
        0..40u32,
        any::<bool>(),
    )
}

fn add(sums: &mut AuditSums, (told, seen, state, pause, missed): &Frame) {
    if *missed {
        sums.add_missed();
    } else {
        sums.add(told, seen, *state, *pause);
    }
}

proptest! {
    #[test]
    fn pooled_sums_are_those_of_counting_together(
        frames in prop::collection::vec((any_frame(), 0..4usize), 0..24)
    ) {
        let mut together = AuditSums::default();
        let mut parts = [const { None }; 4].map(|_: Option<()>| AuditSums::default());
        for (frame, part) in &frames {
            add(&mut together, frame);
            add(&mut parts[*part], frame);
        }
        let mut pooled = AuditSums::default();
        // In another order, and over the wire.
        for part in parts.iter().rev() {
            let text = serde_json::to_string(part).unwrap();
            pooled.merge(&serde_json::from_str(&text).unwrap());
        }
        prop_assert_eq!(&pooled, &together);
        prop_assert_eq!(pooled.recall(), together.recall());
        // Every group adds up to the total.
        let total = together.total();
        let mut by_pause = AuditTally::default();
        for (_, tally) in together.by_pause.groups() {
            by_pause.merge(tally);
        }
        prop_assert_eq!(by_pause, total);
        let mut by_size = AuditTally { frames: total.frames, ..AuditTally::default() };
        for (_, tally) in together.by_size.groups() {
            by_size.merge(tally);
        }
        prop_assert_eq!(by_size, total);
    }

    #[test]
    fn the_two_sides_are_treated_alike((told, seen, _, pause, _) in any_frame()) {
        let mut there = AuditSums::default();
        there.add(&told, &seen, FrameState::P, pause);
        let turned_told: Vec<_> = seen.iter().map(|d| shown(d.bounding_box, d.class.0)).collect();
        let turned_seen: Vec<_> = told.iter().map(|b| found(b.bounding_box, b.class.0)).collect();
        let mut back = AuditSums::default();
        back.add(&turned_told, &turned_seen, FrameState::P, pause);
        prop_assert_eq!(there.total().detected, back.total().shown);
        prop_assert_eq!(there.total().shown, back.total().detected);
        prop_assert_eq!(there.recall(), back.precision());
    }

    #[test]
    fn no_sums_from_elsewhere_make_a_rate_that_is_none(
        boxes in any::<u64>(), paired in any::<u64>(), squares in any::<[u64; 3]>()
    ) {
        let mut sums = AuditSums::default();
        sums.by_state.p.detected = BoxCounts { boxes, paired, alone: 0 };
        sums.spread.detected = SquareSums {
            boxes: squares[0], paired: squares[1], product: squares[2],
        };
        sums.merge(&sums.clone());
        if let Some(rate) = sums.recall() {
            for value in [rate.rate, rate.low, rate.high] {
                prop_assert!((0.0..=1.0).contains(&value), "{:?}", rate);
            }
            prop_assert!(rate.low <= rate.high, "{:?}", rate);
        }
    }
}
