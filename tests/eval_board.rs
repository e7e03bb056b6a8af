//! `albireo eval board` and `join` on a split in BDD100K's layout: measured through the real node, killed, and gone on with.

use crate::eval_command::eval;
use crate::support::{assert_contains, project, run, text, until};
use albireo_eval::footage::{SourceName, VideoEncoding};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

const CLIPS: usize = 3;
const FRAMES: usize = 6;

/// Writes pictures and labels of the demonstration's road as BDD100K lays them out: a folder and a label file for each
/// clip, eleven categories, crowds.
fn split(folder: &Path) {
    let truth: Value = serde_json::from_str(&text("demo/truth.json")).unwrap();
    let labels = |clip: &str, frame: usize| -> Vec<Value> {
        let mut frames = truth.as_array().unwrap().iter();
        let found = frames.find(|one| one["videoName"] == clip && one["frameIndex"] == frame);
        found.unwrap()["labels"].as_array().cloned().unwrap_or_default()
    };
    let categories = [
        "other person",
        "trailer",
        "other vehicle",
        "train",
        "rider",
        "bicycle",
        "motorcycle",
        "bus",
        "truck",
        "pedestrian",
        "car",
    ];
    let road = SourceName::Archive(project("demo/road.tar"));
    let mut busy = road.open_clips(None, VideoEncoding::Jpeg).unwrap().swap_remove(0);
    let mut frames: Vec<Vec<Value>> = vec![Vec::new(); CLIPS];
    for number in 0..CLIPS * FRAMES {
        let clip = number / FRAMES;
        let frame = number % FRAMES;
        let name = format!("b1c{clip:05x}-{clip:08x}");
        let picture = format!("{name}-{:07}.jpg", frame + 1);
        let place = folder.join("images/track/val").join(&name);
        fs::create_dir_all(&place).unwrap();
        fs::write(place.join(&picture), busy.next().unwrap().unwrap().bytes).unwrap();
        let mut labels = labels("busy", number);
        labels.push(json!({
            "id": "900", "category": categories[number % categories.len()],
            "attributes": {"crowd": number % 3 == 0}, "box2d": {"x1": 5, "y1": 5, "x2": 60, "y2": 60}
        }));
        frames[clip].push(
            json!({"name": picture, "videoName": name, "frameIndex": frame, "labels": labels}),
        );
    }
    fs::create_dir_all(folder.join("labels/val")).unwrap();
    for (clip, frames) in frames.iter().enumerate() {
        let path = folder.join(format!("labels/val/{clip}.json"));
        fs::write(path, json!(frames).to_string()).unwrap();
    }
}

/// The clips and policies of all whole runs in the file, in order.
fn runs(file: &Path) -> Vec<(String, String)> {
    let text = fs::read_to_string(file).unwrap_or_default();
    let word = |value: &Value| value.as_str().unwrap().to_owned();
    let mut runs = Vec::new();
    for line in text.split_inclusive('\n').filter(|line| line.ends_with('\n')) {
        let line: Value = serde_json::from_str(line).unwrap();
        let run = &line["run"];
        if run.is_object() {
            runs.push((word(&run["clip"]), word(&run["policy"])));
        }
    }
    runs
}

fn arguments(folder: &Path) -> Vec<String> {
    let folder = folder.display();
    let text = format!(
        "eval board {folder}/images/track/val --ground-truth {folder}/labels/val --truth-format bdd100k \
         --policy albireo --policy fixed-skip:2 --machine board --power-mode 15W --out {folder}/out"
    );
    text.split_whitespace().map(str::to_owned).collect()
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_killed_measurement_goes_on_and_its_files_join_into_tables() {
    let folder = tempfile::tempdir().unwrap();
    split(folder.path());
    let file = folder.path().join("out/yolox_nano.as-exported.15W.board.jsonl");
    let mut first = Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(arguments(folder.path()))
        .current_dir(project(""))
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    until("two runs are kept", async || runs(&file).len() >= 2).await;
    first.kill().unwrap();
    first.wait().unwrap();
    let kept = runs(&file);
    assert!(kept.len() < CLIPS * 3, "it was done before it was killed");

    let words = arguments(folder.path());
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let ended = run(&words, &[]);
    assert_contains(
        &ended.err,
        &[&format!("{} of 9 runs done", kept.len()), "Every run is in"],
    );
    ended.succeeds();
    let all = runs(&file);
    assert_eq!(all[..kept.len()], kept);
    assert_eq!(all.len(), 9);
    assert_eq!(all.iter().collect::<BTreeSet<_>>().len(), 9);

    // The power of the first two clips is kept, estimated here.
    let mut traced = 0;
    for line in fs::read_to_string(&file).unwrap().lines() {
        let line: Value = serde_json::from_str(line).unwrap();
        let run = &line["run"];
        if !run.is_object() {
            continue;
        }
        assert!(run["memory_mb"].as_f64().unwrap() > 10.0, "{run}");
        if run["traces"]["total"].is_array() {
            assert_ne!(run["clip"], "b1c00002-00000002");
            traced += 1;
        }
    }
    assert!(traced > 0, "no run has its power");

    let out = folder.path().join("tables");
    let joined = eval(&format!("join {} --out {}", file.display(), out.display()));
    let table = joined.succeeds();
    assert_contains(
        &table,
        &[
            "yolox_nano, as exported, 15W, board: 3 clips",
            "fixed-skip-2",
            "albireo-u3e-4",
            "cores",
            "memory",
        ],
    );
    assert!(out.join("join.html").metadata().unwrap().len() > 10_000);
    let rows = fs::read_to_string(out.join("clips.csv")).unwrap();
    assert_eq!(rows.lines().count(), 10);
    // Every second frame of the six was skipped.
    assert_contains(&rows, &["fixed-skip-2,6,0,0,0,3,"]);
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_measurement_goes_on_only_under_the_settings_that_it_began_with() {
    let folder = tempfile::tempdir().unwrap();
    split(folder.path());
    let place = folder.path().display();
    let clip = format!("{place}/images/track/val/b1c00000-00000000");
    let words = format!(
        "eval board {clip} --ground-truth {place}/labels/val --truth-format bdd100k --machine board \
         --power-mode 15W --out {place}/out"
    );
    let board = |more: &str, environment: &[(&str, &str)]| {
        let words: Vec<&str> = words.split(' ').chain(more.split_whitespace()).collect();
        run(&words, environment)
    };
    board("", &[]).succeeds();
    let pictures = format!("{place}/screen.onnx");
    fs::write(&pictures, "another screen").unwrap();
    for (variable, value, said) in [
        (
            "ALBIREO_DETECTOR__CONFIDENCE",
            "0.6",
            "detector.confidence was 0.5, and now is 0.6",
        ),
        (
            "ALBIREO_SCREEN__MODEL",
            &pictures,
            "screen.model was not set, and now is",
        ),
        (
            "ALBIREO_POLICY__PROFILE",
            "reference",
            "policy.profile was paper, and now is reference",
        ),
    ] {
        let refused = board("", &[(variable, value)]).fails();
        assert_contains(&refused, &[said, "--out", "--restart"]);
    }
    // What changes no run, and another policy, does not matter.
    let same = [
        ("ALBIREO_LOG__LEVEL", "warn"),
        ("ALBIREO_NODE__NAME", "car-7"),
    ];
    assert_contains(&board("", &same).err, &["2 of 2 runs done"]);
    assert_contains(
        &board("--sweep u=3e-4,1e-3", &[]).err,
        &["2 of 3 runs done"],
    );
    let other = [("ALBIREO_DETECTOR__CONFIDENCE", "0.6")];
    assert_contains(
        &board("--restart", &other).err,
        &["0 of 2 runs done", "Every run is in"],
    );

    // The labels of the clip's last frame are lost.
    let labels = format!("{place}/labels/val/0.json");
    let mut frames: Value = serde_json::from_str(&fs::read_to_string(&labels).unwrap()).unwrap();
    frames[FRAMES - 1]["labels"] = json!([]);
    fs::write(&labels, frames.to_string()).unwrap();
    let refused = board("", &other).fails();
    assert_contains(
        &refused,
        &["runs of the clip b1c00000-00000000 were of 6 pictures"],
    );
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_clip_that_is_not_what_its_truth_is_for_is_found_before_the_first_run() {
    let folder = tempfile::tempdir().unwrap();
    split(folder.path());
    let last = folder
        .path()
        .join("images/track/val/b1c00002-00000002/b1c00002-00000002-0000006.jpg");
    fs::remove_file(last).unwrap();
    let words = arguments(folder.path());
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let refused = run(&words, &[]).fails();
    let missing = "for other pictures, too: the clip has no b1c00002-00000002-0000006.jpg";
    assert_contains(&refused, &[missing]);
    assert!(!folder.path().join("out").exists());

    let place = folder.path().display();
    let video = eval(&format!(
        "video {place}/images/track/val --ground-truth {place}/labels/val --truth-format bdd100k"
    ));
    let refused = video.fails();
    assert_contains(&refused, &[missing]);
    assert!(!refused.contains("processing"), "{refused}");
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_clip_of_hours_is_played_whole_or_refused_before_the_first_run() {
    let folder = tempfile::tempdir().unwrap();
    split(folder.path());
    let place = folder.path().display();
    let slow = format!(
        "board {place}/images/track/val/b1c00000-00000000 --ground-truth {place}/labels/val --truth-format bdd100k \
         --rate 0.001"
    );
    let refused = eval(&format!("{slow} --paced --out {place}/paced")).fails();
    let why = "b1c00000-00000000: 6 frames at 0.001 frames/s take 6000 s";
    assert_contains(&refused, &[why, "without --paced", "--rate"]);
    assert!(!folder.path().join("paced").exists());

    let unpaced = format!("{slow} --machine board --power-mode 15W --out {place}/out");
    eval(&unpaced).succeeds();
    let file = folder.path().join("out/yolox_nano.as-exported.15W.board.jsonl");
    assert_contains(&fs::read_to_string(file).unwrap(), &["6 pictures of"]);
    assert_contains(&eval(&unpaced).err, &["2 of 2 runs done"]);
}

/// A label of a car.
fn a_car() -> Value {
    json!({"category": "car", "box2d": {"x1": 10, "y1": 20, "x2": 60, "y2": 80}})
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_clip_that_is_too_large_for_the_memory_is_refused_before_the_first_run() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("large");
    fs::create_dir(&clip).unwrap();
    let road = SourceName::Archive(project("demo/road.tar"));
    let mut busy = road.open_clips(None, VideoEncoding::Jpeg).unwrap().swap_remove(0);
    let picture = busy.next().unwrap().unwrap().bytes;
    let mut labels = Vec::new();
    for frame in 0..80 {
        let file = clip.join(format!("{frame}.jpg"));
        fs::write(&file, &picture).unwrap();
        // The rest of its 15 MiB takes no room on the disk.
        fs::File::options().write(true).open(&file).unwrap().set_len(15 << 20).unwrap();
        labels.push(json!({
            "name": "", "videoName": "large", "frameIndex": frame, "labels": [a_car()],
        }));
    }
    fs::write(folder.path().join("large.json"), json!(labels).to_string()).unwrap();
    let place = folder.path().display();
    let refused = eval(&format!(
        "board {place}/large --ground-truth {place}/large.json --truth-format bdd100k --out {place}/out"
    ));
    let why = "large: its pictures have 1200 MiB, and a clip may take 1024 MiB of memory: split it";
    assert_contains(&refused.fails(), &[why]);
    assert!(!folder.path().join("out").exists());
}

/// Writes a video that begins between two key frames: its file counts the frames from the first of them, and fewer are played.
/// Returns their number.
fn cut_video(folder: &Path) -> usize {
    let whole = folder.join("whole.mp4");
    let cut = folder.join("cut.mp4");
    let ffmpeg = |arguments: &[&str]| {
        let status = Command::new("ffmpeg").args(["-v", "error"]).args(arguments).status();
        assert!(status.unwrap().success(), "{arguments:?}");
    };
    let scene = "testsrc=size=320x240:rate=25:duration=2";
    let [from, to] = [&whole, &cut].map(|path| path.to_str().unwrap());
    ffmpeg(&["-f", "lavfi", "-i", scene, "-g", "25", from]);
    ffmpeg(&["-ss", "1.3", "-i", from, "-c", "copy", to]);
    let mut video = SourceName::Video(cut.clone()).open(None, VideoEncoding::Jpeg).unwrap();
    let mut played = 0;
    while video.next().unwrap().is_some() {
        played += 1;
    }
    assert!(video.frames() > Some(played), "the file counts no more");
    played as usize
}

#[test]
#[ignore = "needs ONNX Runtime and ffmpeg"]
fn a_video_is_held_against_the_labels_of_the_frames_that_are_played() {
    let folder = tempfile::tempdir().unwrap();
    let labels: Vec<Value> = (0..cut_video(folder.path()))
        .map(|frame| {
            json!({
                "name": format!("{frame}.jpg"), "videoName": "cut", "frameIndex": frame, "labels": [a_car()],
            })
        })
        .collect();
    let truth = folder.path().join("cut.json");
    fs::write(&truth, json!(labels).to_string()).unwrap();
    let place = folder.path().display();
    let words = format!(
        "board {place}/cut.mp4 --ground-truth {place}/cut.json --truth-format bdd100k --out {place}/out"
    );
    eval(&words).succeeds();
    assert_contains(&eval(&words).err, &["2 of 2 runs done"]);
}
