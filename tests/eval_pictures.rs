//! Evaluation on pictures: stored results replay to the same decisions as a policy that calls the models per frame.

mod bad_input;
mod live;

use crate::eval_command::eval;
use crate::support::detectors::model;
use crate::support::{assert_contains, jpeg, scored, shared};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::PolicyConfig;
use albireo_eval::boxes::ScoredBox;
use albireo_eval::data::{Clip, LoadReport, recorded};
use albireo_eval::data::{Pass, StepTimes, vanilla_as_truth};
use albireo_eval::footage::{Downsampled, Ffmpeg, FrameSource, Pictures, Video, VideoEncoding};
use albireo_eval::pictures::{LOWEST_CONFIDENCE, ModelRunner, PassSettings, run_pass};
use albireo_eval::result::{ClipResult, Provenance};
use albireo_eval::run::run as evaluate;
use albireo_eval::settings::ScreenRule;
use albireo_eval::settings::Settings;
use albireo_eval::spec::{PolicySpec, resolve};
use albireo_scene::BoxScene;
use albireo_vision::detector::{DetectorConfig, HeadName};
use albireo_vision::picture::ColorOrder;
use albireo_vision::screen::ScreenConfig;
use std::path::Path;

fn detector(name: &str) -> String {
    model(name).display().to_string()
}

/// Writes JPEG pictures. The fixture detector's confidences are the means of the three colours, and the fixture screen calls a
/// picture empty while red is below one half: with these colours objects and verdicts come and go, in different rhythms.
fn write_pictures(folder: &Path, frames: u32) {
    for frame in 0..frames {
        let red = if frame % 17 < 9 { 150 + frame % 50 } else { 30 };
        let green = if frame % 11 < 6 { 135 + frame % 7 } else { 60 };
        let colour = [red as u8, green as u8, (frame % 80) as u8];
        let pixels = colour.repeat(1280 * 720);
        let file = folder.join(format!("{frame}.jpg"));
        std::fs::write(file, jpeg(&pixels, [1280, 720])).unwrap();
    }
}

fn fixture_detector() -> DetectorConfig {
    DetectorConfig {
        model: model("colours.onnx"),
        confidence: LOWEST_CONFIDENCE,
        ..DetectorConfig::default()
    }
}

fn fixture_screen() -> ScreenConfig {
    ScreenConfig {
        model: Some(model("screen.onnx")),
        ..ScreenConfig::default()
    }
}

fn pass_over(
    source: &mut dyn FrameSource,
    detector: &DetectorConfig,
    screen: &ScreenConfig,
) -> Clip {
    let mut models = ModelRunner::start(detector, screen).unwrap();
    let keep = PassSettings {
        keep_grey: true,
        ..PassSettings::default()
    };
    let mut report = LoadReport::default();
    run_pass(source, &mut models, &keep, &mut report, &mut || ()).unwrap()
}

fn specs(asked: &str, screen: ScreenRule) -> Vec<PolicySpec> {
    let asked: Vec<String> = asked.split(' ').map(str::to_owned).collect();
    resolve(&asked, &[], &PolicyConfig::default(), screen, true).unwrap()
}

fn settings(confidence: f64, screen: ScreenRule) -> Settings {
    Settings {
        confidence,
        screen,
        threads: 2,
        ..Settings::default()
    }
}

const NO_PIXELS: &str =
    "albireo albireo:1e-3 fixed-skip:2 ctd:0.5 erd-only kill-only kill+erd kill+erd-10d";

/// Asserts that every policy decides on the stored clip as on the pictures.
fn assert_replays_alike(pictured: &Clip, confidence: f64) -> Vec<ClipResult> {
    let folder = tempfile::tempdir().unwrap();
    recorded::write(folder.path(), std::slice::from_ref(pictured)).unwrap();
    let stored = recorded::read(folder.path()).unwrap();
    assert_eq!(stored.report.left_out.len(), 0, "{:?}", stored.report);
    let without_pass = Clip {
        file_names: Vec::new(),
        pass: None,
        ..pictured.clone()
    };
    assert_eq!(stored.clips[0], without_pass);
    let policies = specs(NO_PIXELS, ScreenRule::Recorded);
    let settings = settings(confidence, ScreenRule::Recorded);
    let live = evaluate([pictured], &policies, &settings, &|| ()).unwrap();
    let replayed = evaluate(&stored.clips, &policies, &settings, &|| ()).unwrap();
    assert_eq!(live.len(), replayed.len());
    for (live, replayed) in live.iter().zip(&replayed) {
        let policy = &live.policy;
        assert_eq!(*policy, replayed.policy);
        let found = &replayed.states_by_frame;
        let expected = &live.states_by_frame;
        assert_eq!(found, expected, "{policy}");
        assert_eq!(live.boxes, replayed.boxes, "{policy}");
    }
    live
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn pictures_stored_detections_and_the_node_give_the_same_frame_states() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 60);
    let mut source = Pictures::of_folder(folder.path(), 10.0).unwrap();
    let detector = fixture_detector();
    let pictured = pass_over(&mut source, &detector, &fixture_screen());
    assert_eq!(pictured.frames, 60);
    assert_eq!(pictured.pass.as_ref().unwrap().grey.len(), 60);
    let verdicts = pictured.screen.as_ref().unwrap();
    let empty = verdicts.iter().filter(|&&said| said == Some(true)).count();
    assert!(empty > 10 && empty < 50, "{empty} of 60 frames are empty");
    for confidence in [0.1, 0.5, 0.6] {
        let results = assert_replays_alike(&pictured, confidence);
        // At a low confidence frames are skipped by prediction, at a high one by the screen.
        let states = results[1].states;
        match confidence {
            0.1 => assert!(states.p > 0, "{states:?}"),
            0.6 => assert!(states.e > 0, "{states:?}"),
            _ => {}
        }
    }
    let policies = format!("{NO_PIXELS} statues:25");
    // At a high confidence there are few objects, so most frames ask the screen.
    for (confidence, longest_empty_run, is_reached) in [(0.5, 100, false), (0.6, 3, true)] {
        let screen = ScreenConfig {
            longest_empty_run,
            ..fixture_screen()
        };
        source.rewind().unwrap();
        let node = live::NodeSettings {
            detector: &detector,
            screen: &screen,
            confidence,
        };
        let forced = live::assert_live_alike(&mut source, node, &pictured, &policies);
        assert_eq!(forced > 0, is_reached, "{forced} at {confidence}");
    }
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn pictures_without_ground_truth_are_judged_against_vanilla_and_timed() {
    let folder = tempfile::tempdir().unwrap();
    let drive = folder.path().display();
    write_pictures(folder.path(), 30);
    let [colours, screen] = ["colours.onnx", "screen.onnx"].map(detector);
    let said = eval(&format!(
        "pictures {drive} --detector {colours} --screen-model {screen} --policy albireo --policy erd-only \
         --policy statues:25 --energy-model config/energy/agx-thor.toml"
    ));
    let said = said.succeeds();
    assert_contains(&said, &["Judged against vanilla", "statues-25"]);
    assert_contains(&said, &["Time of the detector"]);
    assert_contains(&said, &["projected from an energy model"]);
}

/// Writes a sequence in the MOTChallenge layout: pictures of boxes and their exact places.
fn write_sequence(folder: &Path, frames: u64) {
    use std::fmt::Write;
    let size = PictureSize::new(640, 360);
    let scene = BoxScene::new(5, size);
    for part in ["img1", "gt"] {
        std::fs::create_dir_all(folder.join(part)).unwrap();
    }
    let mut truth = String::new();
    for number in 1..=frames {
        let frame = scene.frame(number - 1);
        let picture = folder.join(format!("img1/{number:06}.jpg"));
        std::fs::write(picture, frame.jpeg(90).unwrap()).unwrap();
        for (class, place) in &frame.boxes {
            let (width, height) = (place.x2 - place.x1, place.y2 - place.y1);
            let (x, y) = (place.x1 + 1.0, place.y1 + 1.0);
            writeln!(truth, "{number},{class},{x},{y},{width},{height},1,1,1").unwrap();
        }
    }
    std::fs::write(folder.join("gt/gt.txt"), truth).unwrap();
    let info = format!(
        "[Sequence]\nname=boxes\nimDir=img1\nframeRate=10\nseqLength={frames}\nimWidth={}\nimHeight={}\nimExt=.jpg\n",
        size.width, size.height
    );
    std::fs::write(folder.join("seqinfo.ini"), info).unwrap();
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn pictures_are_judged_by_their_ground_truth_and_their_streams_as_those_of_stored_detections() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["boxes", "saved", "first", "second"];
    let [sequence, saved, first, second] =
        names.map(|name| folder.path().join(name).display().to_string());
    write_sequence(sequence.as_ref(), 40);
    let boxes = detector("boxes.onnx");
    let streams = "--policy expected-loss --detector-ms 113 --settled --out";
    let said = eval(&format!(
        "video {sequence}/img1 --detector {boxes} --truth-format motchallenge --ground-truth {sequence} \
         --policy fixed-skip:2 --policy expected-loss+flow --save-detections {saved} {streams} {first}"
    ));
    assert_contains(&said.succeeds(), &["Judged by the ground truth of"]);
    let report = std::fs::read(format!("{first}/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let ap50 = |policy: usize| report["policies"][policy]["ap50"].as_f64().unwrap();
    assert!(ap50(0) > 0.99, "the detector finds every box: {}", ap50(0));
    assert!(ap50(1) < ap50(0), "every second frame is predicted");

    eval(&format!("recorded {saved} {streams} {second}")).succeeds();
    let line = |folder: &str, file: &str, policy: &str| {
        let text = std::fs::read_to_string(Path::new(folder).join(file)).unwrap();
        let line = text
            .lines()
            .find(|line| line.starts_with(policy))
            .unwrap_or_else(|| panic!("no {policy} in\n{text}"));
        // The columns of the two tables differ in width.
        line.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    for file in ["at-arrival.txt", "settled.txt"] {
        let with_pictures = |policy| line(&first, file, policy);
        let stored = line(&second, file, "expected-loss-");
        assert_eq!(with_pictures("expected-loss-"), stored);
        assert!(with_pictures("expected-loss+flow").contains("0."), "{file}");
    }
}

/// An artificial clip: one confident car on every frame, and round times.
fn by_hand(frames: usize) -> Clip {
    let car = scored([100.0, 100.0, 200.0, 200.0], 2, 0.9);
    let times = StepTimes {
        decode: 1e4,
        detector: 1e5,
        screen: 1e3,
        ..StepTimes::default()
    };
    Clip {
        frame_rate: Some(10.0),
        detections: Some(vec![vec![car]; frames]),
        screen: Some(vec![Some(false); frames]),
        pass: Some(Pass {
            times: vec![times; frames],
            ..Pass::default()
        }),
        ..Clip::new("by-hand".to_owned(), PictureSize::new(1280, 720), frames)
    }
}

#[test]
fn the_time_of_a_frame_is_composed_of_the_steps_it_needed() {
    let pictured = by_hand(30);
    let policies = specs("fixed-skip:2 erd-only", ScreenRule::Recorded);
    let settings = settings(0.5, ScreenRule::Recorded);
    let results = evaluate([&pictured], &policies, &settings, &|| ()).unwrap();
    for result in &results {
        let time = result.frame_time.unwrap();
        assert_eq!(time.provenance, Provenance::Composed);
        let detector = result.detector_frames as f64;
        let screen = result.screen_frames as f64;
        let expected = (detector * 1.1e5 + screen * 1e3) / 30.0;
        // The time of the decisions is measured; even on a busy machine it is far below that of the steps.
        let is_right = (expected..expected + 500.0).contains(&time.milliseconds.mean);
        assert!(is_right, "{}: {time:?}, not {expected}", result.policy);
    }
    assert_eq!(results[0].detector_frames, 30);
    assert_eq!(results[1].detector_frames, 15);
    assert_eq!(results[2].screen_frames, 30);
}

#[test]
fn vanilla_is_perfect_against_itself_and_unsure_detections_are_not_ground_truth() {
    let mut pictured = by_hand(5);
    let unsure = ScoredBox {
        confidence: 0.3,
        ..pictured.detections.as_ref().unwrap()[0][0]
    };
    pictured.detections.as_mut().unwrap()[0].push(unsure);
    let truth = vanilla_as_truth(&pictured, 0.5);
    assert!(truth.iter().all(|frame| frame.len() == 1));
    pictured.truth = Some(truth);
    let policies = specs("vanilla", ScreenRule::Nonempty);
    let settings = settings(0.5, ScreenRule::Nonempty);
    let results = evaluate([&pictured], &policies, &settings, &|| ()).unwrap();
    assert_eq!(results[0].accuracy.unwrap().ap50, 1.0);
}

#[test]
fn only_a_policy_that_uses_pixels_makes_the_pass_keep_them() {
    let nonempty = ScreenRule::Nonempty;
    let asked = |policies: &str| PassSettings::for_policies(&specs(policies, nonempty)).unwrap();
    assert_eq!(asked(NO_PIXELS), PassSettings::default());
    assert!(asked("albireo statues:75").keep_grey);
    let flow = asked("expected-loss expected-loss+flow");
    assert_eq!((flow.keep_grey, flow.keep_small), (false, Some(320)));
}

#[test]
#[ignore = "needs ../shared and ONNX Runtime and ffmpeg"]
fn shared_a_real_clip_is_decided_alike_live_replayed_and_from_stored_detections() {
    let detector = DetectorConfig {
        model: shared("models/yolox_nano_416.onnx"),
        head: HeadName::Yolox.into(),
        confidence: LOWEST_CONFIDENCE,
        timeout_ms: 60_000,
        ..DetectorConfig::default()
    };
    let screen = ScreenConfig {
        model: Some(shared("models/erd_upstream.onnx")),
        color_order: ColorOrder::Bgr,
        timeout_ms: 60_000,
        ..ScreenConfig::default()
    };
    let clip = shared("media/highway_empty_then_car.mp4");
    let clip = clip.to_str().unwrap();
    let jpeg = VideoEncoding::Jpeg;
    let mut clip = Video::open(clip, None, jpeg, Ffmpeg::default()).unwrap();
    // Every second frame: detector runs are slow.
    let rate = clip.rate() / 2.0;
    let mut video = Downsampled::new(&mut clip, rate);
    let pictured = pass_over(&mut video, &detector, &screen);
    assert_eq!(pictured.frames, 38);
    let results = assert_replays_alike(&pictured, 0.5);
    assert!(results[1].states.p > 0, "{:?}", results[1].states);
    video.rewind().unwrap();
    // One policy each that uses the detector, the screen and pixels; the fixtures test all policies.
    let policies = "albireo erd-only statues:25";
    let node = live::NodeSettings {
        detector: &detector,
        screen: &screen,
        confidence: 0.5,
    };
    live::assert_live_alike(&mut video, node, &pictured, policies);
}
