use super::*;
use crate::boxes::ScoredBox;
use crate::judge::average_precision::tests::scored;
use crate::settings::ScreenRule;
use crate::spec::resolve;
use albireo_core::geometry::Corners;
use albireo_core::policy::PolicyConfig;

const PICTURE: PictureSize = PictureSize::new(1280, 720);

/// The stream at arrival with a detector whose measured runs took these times, ms.
fn at_arrival(milliseconds: &str) -> Stream {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), milliseconds.replace(' ', "\n")).unwrap();
    let detector = RunTimes::read(file.path().to_str().unwrap()).unwrap();
    Stream::AtArrival { detector }
}

/// A clip at 10 frames per second of a car that moves by `speed` pixels per frame.
fn drive_by(frames: usize, speed: f64) -> Clip {
    let car = |frame: usize| Corners {
        x1: 100.0 + speed * frame as f64,
        y1: 100.0,
        x2: 180.0 + speed * frame as f64,
        y2: 160.0,
    };
    let detection = |frame| scored(car(frame), 0.9);
    let truth = |frame| ScoredBox {
        confidence: 1.0,
        object: Some(1),
        ..detection(frame)
    };
    Clip {
        frame_rate: Some(10.0),
        detections: Some((0..frames).map(|frame| vec![detection(frame)]).collect()),
        truth: Some((0..frames).map(|frame| vec![truth(frame)]).collect()),
        ..Clip::new("drive-by".to_owned(), PICTURE, frames)
    }
}

fn policies(asked: &[&str]) -> Vec<PolicySpec> {
    let asked: Vec<_> = asked.iter().map(|name| (*name).to_owned()).collect();
    let base = PolicyConfig::default();
    let pixels = false;
    resolve(&asked, &[], &base, ScreenRule::Nonempty, pixels).unwrap()
}

fn published(clip: &Clip, policy: &str, stream: Stream) -> Published {
    let specs = policies(&[policy]);
    let policy = specs.last().unwrap().config.build().unwrap();
    let mut evidence = StoredEvidence::new(clip, &Settings::default()).unwrap();
    let interval = 1.0 / clip.frame_rate.unwrap();
    publish(policy, &mut evidence, &stream, interval).unwrap()
}

/// The left edge of the box of each frame; 0 for a frame without one.
fn left_edges(published: &Published) -> Vec<i64> {
    let x1 = |found: &OutputBox| found.bounding_box.pixel_corners(PICTURE).x1.round() as i64;
    let left = |boxes: &Vec<OutputBox>| boxes.first().map_or(0, x1);
    published.boxes.iter().map(left).collect()
}

#[test]
fn vanilla_as_delivered_shows_the_latest_finished_boxes_on_every_frame() {
    let clip = drive_by(6, 10.0);
    for (milliseconds, edges, calls) in [
        // Runs begin at 0, 113, … 565 ms, each with the newest frame.
        ("113", [0, 0, 100, 110, 120, 130], 6),
        // Runs begin at 0, 250 and 500 ms, each with the newest frame: 0, 2 and 5.
        ("250", [0, 0, 0, 100, 100, 120], 3),
        // Runs begin at 0, 100, 350 and 400 ms with the newest frame, 0, 1, 3 and 4, and the times are used in turn.
        ("50 250", [0, 100, 100, 100, 130, 130], 4),
    ] {
        let late = published(&clip, "vanilla", at_arrival(milliseconds));
        assert_eq!(left_edges(&late), edges, "{milliseconds} ms");
        assert_eq!(late.calls, calls, "{milliseconds} ms");
    }
}

#[test]
fn a_policy_that_answers_at_once_shows_the_car_in_place() {
    let clip = drive_by(40, 6.0);
    let at_once = published(&clip, "expected-loss:0", at_arrival("113"));
    let edges = left_edges(&at_once);
    assert_eq!(edges[..2], [0, 0]);
    for (frame, edge) in edges.iter().enumerate().skip(20) {
        let off = edge - (100 + 6 * frame as i64);
        assert!(off.abs() <= 2, "frame {frame}: {off}");
    }
    // Every second frame finds the detector free.
    assert_eq!(at_once.calls, 20);
}

#[test]
fn a_policy_that_waits_for_the_detector_shows_the_car_where_it_was_two_frames_earlier() {
    let clip = drive_by(40, 6.0);
    let waiting = published(&clip, "vanilla", at_arrival("113"));
    assert_eq!(left_edges(&waiting)[30], 100 + 6 * 28);
}

#[test]
fn settled_boxes_equal_the_detectors_if_it_runs_on_every_frame() {
    let clip = drive_by(30, 6.0);
    let vanilla = published(&clip, "vanilla", Stream::Settled);
    let expected: Vec<_> = (0..30).map(|frame| 100 + 6 * frame).collect();
    assert_eq!(left_edges(&vanilla), expected);
    assert_eq!(vanilla.calls, 30);
    assert_eq!(vanilla.delay, 0);
}

#[test]
fn settled_boxes_between_two_detector_calls_lie_between_theirs() {
    let clip = drive_by(30, 6.0);
    let skipping = published(&clip, "fixed-skip-in-tracker:3", Stream::Settled);
    assert_eq!(skipping.boxes.len(), 30);
    assert_eq!(skipping.calls, 10);
    // From when the car's speed is known to the last detector call.
    for (frame, edge) in left_edges(&skipping).iter().enumerate().take(26).skip(6) {
        let off = edge - (100 + 6 * frame as i64);
        assert!(off.abs() <= 1, "frame {frame}: {off}");
    }
    // Between two calls one frame waits for two others, and one for one.
    let between_calls = 9 * (2 + 1);
    assert!(skipping.delay >= between_calls, "{}", skipping.delay);
}

/// The table of a policy and vanilla over two clips.
fn table_of_two_clips() -> String {
    let specs = policies(&["expected-loss:0"]);
    let clips = [drive_by(40, 6.0), drive_by(40, 7.0)];
    let results = run(&clips, &specs, &Settings::default(), at_arrival("113")).unwrap();
    results.table()
}

#[test]
fn the_table_compares_with_vanilla() {
    let table = table_of_two_clips();
    let is_of_policy = |line: &&str| line.starts_with("expected-loss-0");
    let rows: Vec<&str> = table.lines().filter(is_of_policy).collect();
    // One row in the table of figures, one in that of the differences.
    let [figures, difference] = rows.as_slice() else {
        panic!("{table}");
    };
    assert!(figures.contains(" 50.0 "), "{table}");
    assert!(difference.contains(" +"), "{table}");
}

#[test]
fn the_table_is_at_most_80_columns_wide() {
    let table = table_of_two_clips();
    assert!(table.lines().all(|line| line.len() <= 80), "{table}");
}

#[test]
fn a_clip_without_times_is_rejected() {
    let specs = policies(&["expected-loss:0"]);
    let clip = Clip {
        frame_rate: None,
        ..drive_by(3, 1.0)
    };
    let refused = run(&[clip], &specs, &Settings::default(), at_arrival("113")).unwrap_err();
    assert!(refused.to_string().contains("frame rate"), "{refused}");
}
