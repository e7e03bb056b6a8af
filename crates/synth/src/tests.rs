//! What the synthetic dashcam promises.

use super::*;
use albireo_core::detection::BDD100K_CLASSES;
use albireo_core::geometry::Corners;
use std::collections::{HashMap, HashSet};

const SMALL: PictureSize = PictureSize::new(320, 180);

fn dashcam(seed: u64, size: PictureSize) -> Dashcam {
    Dashcam::new(DashcamSettings {
        seed,
        size,
        ..DashcamSettings::default()
    })
    .unwrap()
}

#[test]
fn the_same_settings_give_the_same_bytes_in_any_order() {
    let (mut one, mut other) = (dashcam(7, SMALL), dashcam(7, SMALL));
    let indices = [0, 1, 150, 199, 200, 455];
    let forward: Vec<_> = indices.map(|index| one.frame(index)).into();
    for (index, expected) in indices.into_iter().zip(&forward).rev() {
        let frame = other.frame(index);
        assert_eq!(frame.rgb, expected.rgb, "frame {index}");
        assert_eq!(frame.ground_truth, expected.ground_truth, "frame {index}");
        assert_eq!(
            frame.encode_jpeg(80).unwrap(),
            expected.encode_jpeg(80).unwrap()
        );
    }
    assert_ne!(
        dashcam(8, SMALL).frame(0).rgb,
        forward[0].rgb,
        "another seed"
    );
}

#[test]
fn next_frame_follows_the_frame_asked_for() {
    let mut dashcam = dashcam(1, SMALL);
    assert_eq!(dashcam.next_frame().index, 0);
    assert_eq!(dashcam.frame(198).index, 198);
    assert_eq!(dashcam.next_frame().clip, "seed-1-clip-0");
    assert_eq!(dashcam.next_frame().clip, "seed-1-clip-1");
}

#[test]
fn the_frame_rate_changes_when_pictures_are_taken_and_not_what_happens() {
    let mut slow = dashcam(5, SMALL);
    let mut fast = Dashcam::new(DashcamSettings {
        frame_rate: 20.0,
        ..slow.settings().clone()
    })
    .unwrap();
    let mut objects = 0;
    for second in 0..12 {
        let (a, b) = (slow.frame(second * 10), fast.frame(second * 20));
        assert_eq!(a.ground_truth, b.ground_truth, "second {second}");
        assert_eq!(a.clip, b.clip);
        objects += a.ground_truth.len();
    }
    assert!(objects > 0);
}

/// Mean grey level of each ninth of a picture.
fn ninths(frame: &SyntheticFrame) -> [u64; 9] {
    let (width, height) = (frame.size.width as usize, frame.size.height as usize);
    let (mut sums, mut counts) = ([0; 9], [0; 9]);
    for (index, pixel) in frame.rgb.chunks_exact(3).enumerate() {
        let cell = index / width * 3 / height * 3 + index % width * 3 / width;
        sums[cell] += pixel.iter().map(|&value| u64::from(value)).sum::<u64>();
        counts[cell] += 3;
    }
    std::array::from_fn(|cell| sums[cell] / counts[cell])
}

#[test]
fn the_world_of_a_seed_keeps_its_look() {
    let mut dashcam = dashcam(1, SMALL);
    // Whoever changes the drawing on purpose writes the new levels here. The tolerance is for
    // mathematics libraries whose sines differ in the last place.
    let expected = [
        (20, [183, 185, 180, 121, 123, 120, 88, 80, 88]),
        (300, [92, 111, 92, 92, 101, 83, 78, 73, 83]),
        (520, [95, 112, 113, 76, 91, 89, 69, 65, 68]),
    ];
    for (index, levels) in expected {
        let seen = ninths(&dashcam.frame(index));
        let near = seen.iter().zip(levels).all(|(a, b)| a.abs_diff(b) <= 3);
        assert!(near, "frame {index}: {seen:?} instead of {levels:?}");
    }
}

#[test]
fn a_box_lies_tightly_on_what_its_object_changes_in_the_picture() {
    let size = PictureSize::new(640, 360);
    let mut checked = 0;
    for seed in 1..=10 {
        let mut dashcam = dashcam(seed, size);
        for clip in 0..3 {
            let described = dashcam.describe_clip(clip);
            // Lamps and haze blur what is an object's own pixel.
            if described.light != Light::Day || described.weather == Weather::Fog {
                continue;
            }
            let index = clip * dashcam.frames_per_clip() + 60;
            let with = dashcam.frame(index);
            for found in with.expected() {
                // A two-wheeler's rider goes with it; hiding both says nothing of one.
                let two_wheeler = matches!(found.class.0, 1 | 5 | 6);
                if two_wheeler || found.occlusion > 0.02 || found.truncation > 0.0 {
                    continue;
                }
                let without = dashcam.draw(index, Some(found.object % OBJECTS_PER_CLIP));
                check_difference(&with, &without, found.corners);
                checked += 1;
            }
        }
    }
    assert!(checked >= 15, "only {checked} boxes could be checked");
}

fn check_difference(with: &SyntheticFrame, without: &SyntheticFrame, corners: Corners) {
    let width = with.size.width as usize;
    let changed = |x: usize, y: usize| {
        let at = (y * width + x) * 3;
        (0..3).any(|c| with.rgb[at + c].abs_diff(without.rgb[at + c]) > 3)
    };
    let inside = |low: f64, high: f64| (low.round() as usize)..(high.round() as usize);
    let (columns, rows) = (
        inside(corners.x1, corners.x2),
        inside(corners.y1, corners.y2),
    );
    let count = rows
        .clone()
        .map(|y| columns.clone().filter(|&x| changed(x, y)).count())
        .sum::<usize>();
    let share = count as f64 / (columns.len() * rows.len()) as f64;
    assert!(share > 0.3, "only {share} of {corners:?} changes");
    // Within two pixels of the upper edge and of both sides the object begins …
    let near =
        |range: std::ops::Range<usize>, test: &dyn Fn(usize) -> bool| range.clone().any(test);
    let top = rows.start..rows.start + 2;
    assert!(
        near(top, &|y| columns.clone().any(|x| changed(x, y))),
        "top of {corners:?}"
    );
    for side in [
        columns.start..columns.start + 2,
        columns.end - 2..columns.end,
    ] {
        assert!(
            near(side, &|x| rows.clone().any(|y| changed(x, y))),
            "side of {corners:?}"
        );
    }
    // … and above it nothing changes (a shadow may fall beside and below).
    for y in 0..rows.start.saturating_sub(3) {
        for x in columns.clone() {
            assert!(!changed(x, y), "({x}, {y}) above {corners:?} changes");
        }
    }
}

#[test]
fn boxes_lie_within_the_picture_and_shares_between_0_and_1() {
    let (mut objects, mut hidden, mut outside) = (0, 0, 0);
    for seed in 1..=4 {
        let mut dashcam = dashcam(seed, SMALL);
        for index in (0..600).step_by(13) {
            for found in dashcam.frame(index).ground_truth {
                let c = found.corners;
                assert!(0.0 <= c.x1 && c.x1 < c.x2 && c.x2 <= 320.0, "{found:?}");
                assert!(0.0 <= c.y1 && c.y1 < c.y2 && c.y2 <= 180.0, "{found:?}");
                assert!((0.0..=1.0).contains(&found.occlusion), "{found:?}");
                assert!((0.0..=1.0).contains(&found.truncation), "{found:?}");
                let must_ignore = c.y2 - c.y1 < 3.0 || found.occlusion > 0.8;
                assert!(found.ignore || !must_ignore, "{found:?}");
                let normalised = found.bounding_box(SMALL).pixel_corners(SMALL);
                assert!(normalised.intersection_over_union(c) > 0.9999);
                objects += 1;
                hidden += usize::from(found.occlusion > 0.3);
                outside += usize::from(found.truncation > 0.1);
            }
        }
    }
    assert!(
        objects > 150 && hidden > 10 && outside > 5,
        "{objects} {hidden} {outside}"
    );
}

#[test]
fn an_object_keeps_its_identity_and_no_other_clip_uses_it() {
    // Forty frames a second, so that even what passes close by overlaps itself from frame to frame.
    let mut dashcam = Dashcam::new(DashcamSettings {
        seed: 3,
        size: SMALL,
        frame_rate: 40.0,
        clip_seconds: 8.0,
    })
    .unwrap();
    let mut clip_of: HashMap<u64, (String, u16)> = HashMap::new();
    let mut before: HashMap<u64, Corners> = HashMap::new();
    let mut followed = 0;
    for index in (0..90).chain(320..410) {
        let frame = dashcam.frame(index);
        let unique: HashSet<u64> = frame
            .ground_truth
            .iter()
            .map(|found| found.object)
            .collect();
        assert_eq!(unique.len(), frame.ground_truth.len(), "frame {index}");
        for found in &frame.ground_truth {
            let known = (frame.clip.clone(), found.class.0);
            assert_eq!(
                *clip_of.entry(found.object).or_insert_with(|| known.clone()),
                known
            );
            // From one frame to the next a fully visible object overlaps itself.
            if let Some(last) = before.get(&found.object)
                && found.occlusion < 0.05
                && found.truncation == 0.0
                && !found.ignore
                && last.area() > 60.0
                && found.class.0 != 0
            {
                let overlap = found.corners.intersection_over_union(*last);
                assert!(overlap > 0.3, "frame {index}: {found:?} was at {last:?}");
                followed += 1;
            }
        }
        before = frame
            .ground_truth
            .iter()
            .filter(|found| found.occlusion < 0.05)
            .map(|found| (found.object, found.corners))
            .collect();
    }
    assert!(followed > 100, "{followed}");
}

#[test]
fn all_seven_classes_settings_lights_and_weathers_appear() {
    let mut counts = [0; BDD100K_CLASSES.len()];
    let mut scenes = HashSet::new();
    for seed in 1..=12 {
        let mut dashcam = dashcam(seed, SMALL);
        for clip in 0..3 {
            let described = dashcam.describe_clip(clip);
            scenes.insert(format!("{:?}", described.setting));
            scenes.insert(format!("{:?}", described.light));
            scenes.insert(format!("{:?}", described.weather));
            for second in (0..20).step_by(5) {
                for found in dashcam.frame(clip * 200 + second * 10).expected() {
                    counts[found.class.0 as usize] += 1;
                }
            }
        }
    }
    assert!(counts.iter().all(|&count| count >= 10), "{counts:?}");
    assert_eq!(scenes.len(), 10, "{scenes:?}");
}

#[test]
fn nobody_is_on_the_road_in_a_quiet_stretch_of_several_seconds() {
    let mut quiet = 0;
    for seed in 1..=8 {
        let mut dashcam = dashcam(seed, SMALL);
        for clip in 0..3 {
            let Some((from, to)) = dashcam.describe_clip(clip).quiet else {
                continue;
            };
            assert!(
                to - from >= 3.0 && from >= 0.0 && to <= 20.0,
                "{from} to {to}"
            );
            quiet += 1;
            let first = (from * 10.0).ceil() as u64;
            for index in (first..=(to * 10.0) as u64).step_by(5) {
                let frame = dashcam.frame(clip * 200 + index);
                let seen = frame.ground_truth.first();
                assert_eq!(seen, None, "seed {seed} clip {clip} frame {index}");
            }
        }
    }
    assert!(quiet >= 8, "{quiet} of 24 clips have a quiet stretch");
}

#[test]
fn a_jpeg_shows_the_picture_it_was_made_from() {
    let frame = dashcam(2, SMALL).frame(30);
    let bytes = frame.encode_jpeg(90).unwrap();
    let mut decoder = zune_jpeg::JpegDecoder::new(zune_core::bytestream::ZCursor::new(&bytes));
    let decoded = decoder.decode().unwrap();
    assert_eq!(decoder.dimensions(), Some((320, 180)));
    let pairs = decoded.iter().zip(&frame.rgb);
    let error = pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>() / decoded.len() as u64;
    assert!(error <= 6, "mean error {error}");
}

#[test]
fn settings_that_cannot_be_filmed_are_refused_with_a_reason() {
    let with = |change: fn(&mut DashcamSettings)| {
        let mut settings = DashcamSettings::default();
        change(&mut settings);
        Dashcam::new(settings).err().map(|error| error.to_string())
    };
    assert_eq!(with(|_| {}), None);
    let refused = [
        with(|s| s.size = PictureSize::new(0, 720)),
        with(|s| s.size = PictureSize::new(1280, 100_000)),
        with(|s| s.frame_rate = 0.0),
        with(|s| s.frame_rate = f64::NAN),
        with(|s| s.clip_seconds = -1.0),
        with(|s| s.clip_seconds = f64::INFINITY),
    ];
    for reason in refused {
        let reason = reason.expect("must be refused");
        assert!(reason.contains("must be between"), "{reason}");
    }
}

#[test]
fn half_a_hidden_object_leaves_half_a_box() {
    let mut canvas = Canvas::new(PictureSize::new(200, 120)).unwrap();
    canvas.begin();
    let square = |x: f32, y: f32, w: f32, h: f32| [(x, y), (x + w, y), (x + w, y + h), (x, y + h)];
    let number = canvas.begin_object();
    canvas.solid([square(40.0, 30.0, 60.0, 40.0).as_slice()], [1.0, 0.0, 0.0]);
    canvas.end_object();
    canvas.solid([square(70.0, 0.0, 90.0, 120.0).as_slice()], [0.0, 1.0, 0.0]);
    let drawn = [render::Drawn {
        object: 5,
        class: albireo_core::detection::ClassId(2),
        number,
    }];
    let found = ground_truth::boxes(&canvas, &drawn, 10_000);
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].object, 10_005);
    assert!((found[0].occlusion - 0.5).abs() < 1e-9, "{found:?}");
    let expected = Corners {
        x1: 40.0,
        y1: 30.0,
        x2: 70.0,
        y2: 70.0,
    };
    assert_eq!(found[0].corners, expected);
}
