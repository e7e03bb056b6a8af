//! The decision core allocates nothing per frame once its buffers have grown. There is one test alone in this process: dhat
//! counts the allocations of the whole process, and another test's would be counted, too.

#![allow(clippy::unwrap_used)]

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{
    EvidenceAtHand, FrameEvidence, FrameHead, FrameState, GreyPicture, LatePolicy, Need, Outcome,
    PauseFrames, Policy, PolicyConfig, Profile, Settler, WithPause, decide,
};
use std::collections::BTreeMap;
use std::time::Duration;

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

const OBJECTS: usize = 40;
const PERIOD: usize = 60;
const GREY: PictureSize = PictureSize::new(160, 90);

/// Frame `frame` of a film that repeats: objects in rows that drift to and fro, every seventh unseen
/// for three frames of a period, so that objects are matched, rescued, removed and created.
fn detections(frame: usize) -> Vec<Detection> {
    let phase = (frame % PERIOD) as f64 / PERIOD as f64 * std::f64::consts::TAU;
    (0..OBJECTS)
        .filter(|object| !(object % 7 == 0 && (frame + object) % PERIOD < 9))
        .map(|object| Detection {
            bounding_box: BoundingBox::new(
                0.1 + 0.1 * (object % 8) as f64 + 0.02 * phase.sin(),
                0.15 + 0.15 * (object / 8) as f64 + 0.02 * phase.cos(),
                0.11,
                0.16,
            ),
            class: ClassId(0),
            confidence: 0.8,
        })
        .collect()
}

/// A grey picture of the same film: stripes that move every three frames.
fn stripes(frame: usize) -> Vec<u8> {
    let moved = frame % PERIOD / 3;
    let pixel = |place: usize| 200 * ((place / 7 + moved) % 2) as u8;
    (0..GREY.pixels() as usize).map(pixel).collect()
}

/// A grey picture of the same film for policies with optical flow: a texture that drifts with the objects.
fn texture(frame: usize) -> Vec<u8> {
    let phase = (frame % PERIOD) as f64 / PERIOD as f64 * std::f64::consts::TAU;
    let (width, height) = (GREY.width as usize, f64::from(GREY.height));
    let pixel = |place: usize| {
        let x = (place % width) as f64 - 0.02 * width as f64 * phase.sin();
        let y = (place / width) as f64 - 0.02 * height * phase.cos();
        (128.0 + 50.0 * (0.7 * x + 0.2 * y).sin() + 50.0 * (0.8 * y - 0.3 * x).sin()) as u8
    };
    (0..GREY.pixels() as usize).map(pixel).collect()
}

struct Frame {
    detections: Vec<Detection>,
    /// Of the grey picture.
    pixels: Vec<u8>,
}

fn evidence(offset: usize, frame: &Frame) -> FrameEvidence<'_> {
    let grey = GreyPicture {
        size: GREY,
        pixels: &frame.pixels,
    };
    FrameEvidence {
        empty: Some(offset.is_multiple_of(7)),
        grey: Some(grey),
        detections: Some(&frame.detections),
    }
}

/// Answers a frame with what is known about it.
type Decide<'f> = dyn FnMut(FrameHead, FrameEvidence<'_>, &mut Outcome) + 'f;

/// Answers at once, gets the evidence of a frame two frames later, and settles all frames.
fn two_frames_late(policy: Box<dyn Policy>, film: &[Frame]) -> Box<Decide<'_>> {
    let mut late = LatePolicy::new(policy).unwrap();
    let mut settler = Settler::new(Duration::from_secs(2));
    let mut waits: Option<(FrameHead, Need)> = None;
    Box::new(
        move |head: FrameHead, _: FrameEvidence<'_>, outcome: &mut Outcome| {
            let need = late.frame(head, outcome);
            let time = Duration::from_millis(100 * head.index);
            let pending = need != Need::Nothing;
            settler.frame(head.index, time, outcome, pending, |_| {});
            if pending {
                waits = Some((head, need));
            }
            let is_due = |(waiting, _): &(FrameHead, Need)| waiting.index + 2 <= head.index;
            if let Some((waiting, need)) = waits.filter(is_due) {
                let offset = waiting.index as usize % PERIOD;
                let mut known = evidence(offset, &film[offset]);
                let Ok(evidence) = known.evidence(need);
                let need = late.deliver(waiting.index, evidence, outcome).unwrap();
                if need == Need::Nothing {
                    waits = None;
                    settler.late(waiting.index, outcome, |_| {});
                } else {
                    waits = Some((waiting, need));
                }
            }
        },
    )
}

#[test]
fn no_frame_allocates_once_the_buffers_have_grown() {
    use FrameState::{AI, E, EI, I, P};
    let _profiler = dhat::Profiler::builder().testing().build();
    let late = "albireo:3e-4 expected-loss:0.5 expected-loss+flow:0.5".split(' ');
    let cases: [(&str, &[FrameState]); 4] = [
        ("vanilla", &[I]),
        ("erd-only", &[E, EI]),
        ("fixed-skip:2 ctd:0.5 statues:75 kill-only:5e-4", &[P, I]),
        ("fixed-skip-in-tracker:2", &[P, I, AI]),
    ];
    for profile in [Profile::Paper, Profile::Reference] {
        for (policies, states) in cases {
            for asked in policies.split(' ') {
                check(asked, profile, states, Answers::AtOnce);
            }
        }
        for asked in late.clone() {
            check(asked, profile, &[P, I, AI], Answers::AtOnce);
        }
    }
    for asked in late {
        check(asked, Profile::Paper, &[P, I, AI], Answers::Late);
    }
}

/// When a policy gets the evidence of a frame.
enum Answers {
    AtOnce,
    Late,
}

fn check(asked: &str, profile: Profile, states: &[FrameState], answers: Answers) {
    let mut config = PolicyConfig::default();
    config.select(asked).unwrap();
    config.profile = profile;
    let pause = PauseFrames {
        every: 3,
        ..PauseFrames::OFF
    };
    let mut policy: Box<dyn Policy> = Box::new(WithPause::new(config.build().unwrap(), pause));
    let mut outcome = Outcome::default();
    let picture = if asked.contains("+flow") {
        texture
    } else {
        stripes
    };
    let frame = |offset: usize| Frame {
        detections: detections(offset),
        pixels: picture(offset),
    };
    let film: Vec<Frame> = (0..PERIOD).map(frame).collect();
    let mut decider: Box<Decide<'_>> = match answers {
        Answers::Late => two_frames_late(policy, &film),
        Answers::AtOnce => Box::new(
            move |head: FrameHead, mut known: FrameEvidence<'_>, outcome: &mut Outcome| {
                let Ok(()) = decide(&mut *policy, head, &mut known, outcome);
            },
        ),
    };
    let mut first = 0;
    // The minimum of several rounds, since the test's main thread may allocate in parallel.
    let mut least: BTreeMap<(usize, FrameState), u64> = BTreeMap::new();
    for index in 0..6 * PERIOD {
        let offset = index % PERIOD;
        let head = FrameHead {
            index: index as u64,
            step: 1,
            picture: PictureSize::new(1280, 720),
        };
        let known = evidence(offset, &film[offset]);
        let before = dhat::HeapStats::get().total_blocks;
        decider(head, known, &mut outcome);
        let allocations = dhat::HeapStats::get().total_blocks - before;
        match index / PERIOD {
            0 => first += allocations,
            1 | 2 => {}
            _ => {
                let entry = least.entry((offset, outcome.state)).or_insert(allocations);
                *entry = allocations.min(*entry);
            }
        }
    }
    assert!(first > 0, "the counter works: the first frames do allocate");
    for &wanted in states {
        let is_seen = least.keys().any(|(_, state)| *state == wanted);
        assert!(is_seen, "{asked}, {profile:?}: no {wanted} frame");
    }
    least.retain(|_, allocations| *allocations > 0);
    assert!(least.is_empty(), "{asked}, {profile:?}: {least:?}");
}
