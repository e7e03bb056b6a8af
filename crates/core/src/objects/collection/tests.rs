use super::*;
use crate::policy::AlbireoSettings;
use crate::policy::tests::PICTURE;

fn seen(x: f64) -> Detection {
    crate::policy::tests::seen(x, 0.9)
}

fn frame(objects: &mut ObjectStates, detections: &[Detection]) {
    objects.predict(PICTURE, 1);
    let life_cycle = objects.settings.life_cycle;
    objects.observe(detections, |state| life_cycle.missed(state));
}

fn objects() -> ObjectStates {
    ObjectStates::new(AlbireoSettings::paper().objects)
}

fn confirmed(mut objects: ObjectStates) -> ObjectStates {
    for _ in 0..3 {
        frame(&mut objects, &[seen(0.5)]);
    }
    assert!(objects.states()[0].confirmed);
    objects
}

/// Number, confirmation and misses of an object after frames: `d` detected, `u` unsure, `m` missed, `p` only predicted.
fn after(frames: &str) -> Option<(u64, bool, u32)> {
    let mut objects = objects();
    let mut unsure = seen(0.5);
    unsure.confidence = 0.49;
    for kind in frames.chars() {
        match kind {
            'd' => frame(&mut objects, &[seen(0.5)]),
            'u' => frame(&mut objects, &[unsure]),
            'm' => frame(&mut objects, &[]),
            _ => objects.predict(PICTURE, 1),
        }
    }
    let state = objects.states().first()?;
    Some((state.id.0, state.confirmed, state.misses))
}

#[test]
fn three_detections_confirm_an_object_which_is_then_rescued_twice() {
    for (frames, expected) in [
        ("d", Some((0, false, 0))),
        ("dd", Some((0, false, 0))),
        ("ddd", Some((0, true, 0))),
        // A tentative object is removed at its first miss, and its number is not used again.
        ("dm", None),
        ("dmd", Some((1, false, 0))),
        // Frames without the detector neither count nor reset the count.
        ("dddm", Some((0, true, 1))),
        ("dddmp", Some((0, true, 1))),
        ("dddmpm", Some((0, true, 2))),
        ("dddmpmp", Some((0, true, 2))),
        ("dddmpmpm", None),
        // A detection resets the count.
        ("dddmmd", Some((0, true, 0))),
        ("dddmmdmmdmm", Some((0, true, 2))),
        // An unsure object is not rescued.
        ("dddu", Some((0, true, 0))),
        ("dddum", None),
    ] {
        assert_eq!(after(frames), expected, "{frames}");
    }
}

#[test]
fn a_rescue_resets_the_age_only_if_configured() {
    for resets in [false, true] {
        let mut settings = AlbireoSettings::paper().objects;
        settings.life_cycle.rescue_resets_age = resets;
        let mut objects = confirmed(ObjectStates::new(settings));
        frame(&mut objects, &[]);
        let state = &objects.states()[0];
        assert_eq!(state.since_infer, if resets { 0 } else { 1 });
        assert_eq!(state.since_update, 1);
    }
}

#[test]
fn an_object_that_leaves_the_picture_is_removed() {
    let mut objects = objects();
    for step in 0..5 {
        frame(&mut objects, &[seen(0.90 + 0.02 * f64::from(step))]);
    }
    assert_eq!(objects.states().len(), 1);
    objects.predict(PICTURE, 1);
    objects.predict(PICTURE, 1);
    assert!(objects.states().is_empty());
}

#[test]
fn sides_stay_at_least_one_pixel_long() {
    let mut objects = objects();
    for step in (1..10).rev() {
        let mut shrinking = seen(0.5);
        shrinking.bounding_box.width = 0.01 * f64::from(step);
        frame(&mut objects, &[shrinking]);
    }
    for _ in 0..20 {
        objects.predict(PICTURE, 1);
        for state in objects.states() {
            assert!(state.filter.bounding_box().width >= 1.0 / 1280.0);
        }
    }
    assert_eq!(objects.states().len(), 1);
}

#[test]
fn too_long_a_gap_forgets_all_objects() {
    let mut objects = confirmed(objects());
    objects.predict(PICTURE, 301);
    assert_eq!(objects.states().len(), 1);
    objects.predict(PICTURE, u32::MAX);
    assert!(objects.states().is_empty());
}

#[test]
fn hostile_detections_are_counted_and_have_no_effect() {
    let mut objects = confirmed(objects());
    let mut clean = objects.clone();
    let mut found = vec![seen(0.5)];
    for number in [f64::NAN, f64::INFINITY, -1e300, 1e300] {
        let [mut off, mut long] = [seen(0.5); 2];
        off.bounding_box.center_x = number;
        long.bounding_box.height = number;
        found.push(off);
        found.insert(0, long);
    }
    frame(&mut objects, &found);
    frame(&mut clean, &[seen(0.5)]);
    assert_eq!(objects.states(), clean.states());
    assert_eq!(objects.rejected_detections(), 8);
    let usable: Vec<_> = objects.sightings().iter().map(|sighting| sighting.usable).collect();
    assert_eq!(usable.iter().filter(|usable| **usable).count(), 1);
    // Four boxes were put before it.
    assert!(usable[4]);
}

#[test]
fn a_picture_without_pixels_is_harmless() {
    let mut objects = confirmed(objects());
    objects.predict(PictureSize::new(0, 0), 1);
    for state in objects.states() {
        assert!(state.filter.bounding_box().is_finite() && state.filter.tau().is_finite());
    }
}
