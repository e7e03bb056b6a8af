//! Recordings are opened by other programs, survive a power cut, and become training data; recordings of others are played.

use crate::node_frames::{CAMERA, ask_frame, pictures};
use crate::support::detectors::model;
use crate::support::{
    Node, albireo_on_a_disk_that_fills, ask_script, assert_contains, grey_jpeg, json_at, limit,
    metric, project, python, run, text_at, until, until_connected, zenoh_client,
};
use crate::wheel;
use albireo_eval::data::mot_challenge;
use albireo_eval::footage::{SourceName, VideoEncoding};
use albireo_vision::picture::PictureFormat;
use rstest::rstest;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use zenoh::Session;

fn script(request: &Value) -> Value {
    let file = project("tests/python/recordings.py");
    ask_script(Command::new(python()).arg(file), request)
}

/// A node of one camera that records into `recordings` in its folder.
async fn node(folder: tempfile::TempDir, settings: &str) -> Node {
    let settings = self::settings(&folder, settings);
    Node::start_in(folder, &settings).await
}

/// The settings of such a node.
fn settings(folder: &tempfile::TempDir, more: &str) -> String {
    let model = model("boxes.onnx");
    let recordings = folder.path().join("recordings");
    let camera = format!("[[camera]]\nname = {CAMERA:?}\ndelivery = \"every\"\n");
    format!(
        "detector.model = {model:?}\npower.source = \"none\"\nrecord.folder = {recordings:?}\n{more}{camera}"
    )
}

async fn connected(node: &Node) -> Session {
    let session = zenoh_client(&node.zenoh).await;
    until_connected(&session, "node", CAMERA).await;
    session
}

/// Sends frames from number `first` on, and waits until each is accepted.
async fn send(session: &Session, first: u64, pictures: &[Vec<u8>]) {
    for (seq, picture) in (first..).zip(pictures) {
        let attachment = json!({"v": 1, "seq": seq, "t_ns": seq * 100_000_000, "position": {"latitude": 48.1, "longitude": 11.6}});
        let attachment = attachment.to_string().into_bytes();
        ask_frame(session, CAMERA, picture.clone(), "image/jpeg", attachment).await;
    }
}

async fn answered(node: &Node) -> Value {
    json_at(&format!("{}/api/v1/cameras/{CAMERA}", node.http)).await["frames"].clone()
}

async fn status(node: &Node) -> Value {
    json_at(&format!("{}/api/v1/recordings", node.http)).await
}

fn recordings(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = std::fs::read_dir(folder.join("recordings"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    paths
}

/// After `kill -9`, Python reads what was on the disk; when the node starts again, the file has its index.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn a_recording_is_opened_by_others_after_a_power_cut_and_mended_by_the_next_start() {
    let always = "policy.name = \"vanilla\"\nrecord.when = [\"always\"]\n";
    let node_ = node(tempfile::tempdir().unwrap(), always).await;
    let session = connected(&node_).await;
    let pictures = pictures(20);
    send(&session, 0, &pictures).await;
    let bytes: usize = pictures.iter().map(Vec::len).sum();
    until("the pictures are on the disk", async || {
        recordings(node_.folder.path())
            .iter()
            .any(|path| path.metadata().unwrap().len() >= bytes as u64)
    })
    .await;
    assert_eq!(status(&node_).await["written_frames"], 20);
    let series = "albireo_recording_frames_total{outcome=\"written\"}";
    assert!((metric(&node_.http, series).await - 20.0).abs() < 0.5);
    let folder = node_.kill().await;
    let path = recordings(folder.path()).remove(0);
    let recovered = script(&json!({"recover": path}));
    assert_eq!(recovered["counts"]["/front/image"], 20, "{recovered}");
    assert!(
        recovered["end"].is_string(),
        "it has no end yet: {recovered}"
    );

    let node_ = node(folder, always).await;
    let path = recordings(node_.folder.path()).remove(0);
    until("it is mended", async || {
        std::fs::read(&path).unwrap().ends_with(b"\x89MCAP0\r\n")
    })
    .await;
    let read = script(&json!({"read": path}));
    assert_eq!(read["jpeg"], 20, "{read}");
    for topic in ["image", "boxes", "figures", "detections", "position"] {
        assert_eq!(read["counts"][format!("/front/{topic}")], 20, "{topic}");
    }
    // What is drawn and plotted is what was published.
    for (frame, message) in read["detections"].as_array().unwrap().iter().enumerate() {
        let boxes = message["boxes"].as_array().unwrap();
        let lines = read["lines"][frame].as_array().unwrap();
        assert_eq!(lines.len(), boxes.len());
        assert_eq!(message["state"], "I");
        assert_eq!(read["states"][frame], 3);
        for (line, found) in lines.iter().zip(boxes) {
            for side in 0..2 {
                let published = found["box"][side].as_f64().unwrap();
                let drawn = line[0][side].as_f64().unwrap();
                assert!((drawn - published).abs() < 0.01, "{drawn} {published}");
            }
        }
    }
    let lines = read["lines"].as_array().unwrap().iter();
    let counts: Vec<_> = lines.map(|lines| lines.as_array().unwrap().len()).collect();
    assert!(
        counts.iter().any(|count| *count > 1),
        "there are boxes: {read}"
    );
    let rerun = script(&json!({"rerun": path}));
    assert_eq!(rerun["pictures"], 20, "{rerun}");
    assert_eq!(rerun["places"], 20, "{rerun}");
    assert_eq!(rerun["states"], read["states"]);
    assert_eq!(rerun["lines"], json!(counts));

    // A recording of a node is footage for it.
    let path = path.to_str().unwrap();
    run(
        &["replay", path, "--node", "node", "--connect", &node_.zenoh],
        &[],
    )
    .succeeds();
    until("what was replayed is recorded", async || {
        status(&node_).await["written_frames"] == 20
    })
    .await;
    node_.stop_well().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn a_request_keeps_what_was_before_and_after_it() {
    let around = "policy.name = \"vanilla\"\nrecord.before_s = 600\nrecord.after_s = 600\n";
    let node = node(tempfile::tempdir().unwrap(), around).await;
    let session = connected(&node).await;
    assert_contains(
        &status(&node).await["missing"].to_string(),
        &["no frames come from front", "albireo replay"],
    );
    let pictures = pictures(6);
    send(&session, 0, &pictures[..3]).await;
    until("three frames are answered", async || {
        answered(&node).await == 3
    })
    .await;
    let client = reqwest::Client::new();
    let url = format!("{}/api/v1/recordings", node.http);
    let wrong = client.put(&url).json(&json!({"camera": "rear"})).send().await.unwrap();
    assert_eq!(wrong.status(), 404);
    let asked = client.put(&url).json(&json!({"reason": "braking"})).send().await.unwrap();
    assert_eq!(asked.status(), 202);
    send(&session, 3, &pictures[3..]).await;
    until("six frames are written", async || {
        status(&node).await["written_frames"] == 6
    })
    .await;
    assert_contains(&text_at(&format!("{}/readyz", node.http)).await, &["ready"]);
    let folder = node.stop().await.folder;
    let path = recordings(folder.path()).remove(0);
    let read = script(&json!({"read": path}));
    assert_eq!(read["counts"]["/front/image"], 6, "{read}");
    assert_eq!(read["reasons"], json!(["braking"]));
}

/// A hook without an address only records, and one that is told of nothing does nothing.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn a_hook_records_what_it_is_told_of() {
    let settings = "policy.name = \"vanilla\"\nrecord.before_s = 600\nrecord.after_s = 600\n\
                    sightings = { appear_s = 0.0, leave_s = 0.0 }\n\
                    [[hook]]\nclasses = [\"nothing\"]\nrecord = true\n[[hook]]\nrecord = true\n";
    let node = node(tempfile::tempdir().unwrap(), settings).await;
    let session = connected(&node).await;
    send(&session, 0, &[grey_jpeg(90, [640, 360])]).await;
    send(&session, 1, &pictures(3)).await;
    until("what was before it is written, too", async || {
        status(&node).await["written_frames"] == 4
    })
    .await;
    let folder = node.stop().await.folder;
    let path = recordings(folder.path()).remove(0);
    let read = script(&json!({"read": path}));
    let reasons = read["reasons"].as_array().unwrap();
    assert!(!reasons.is_empty(), "{read}");
    for reason in reasons {
        let told = reason.as_str().unwrap();
        assert!(
            told.ends_with(" appeared") || told.ends_with(" left"),
            "{told}"
        );
    }
}

/// What the disk refuses is counted and told where a person looks, and every frame is answered meanwhile.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_full_disk_costs_recordings_and_no_answers() {
    let always = "policy.name = \"vanilla\"\nrecord.when = [\"always\"]\n";
    let folder = tempfile::tempdir().unwrap();
    let settings = settings(&folder, always);
    let node = Node::start_as(albireo_on_a_disk_that_fills(), folder, &settings).await;
    let session = connected(&node).await;
    limit(node.id(), "--fsize=0:unlimited");
    let pictures = pictures(20);
    send(&session, 0, &pictures).await;
    let series = "albireo_recording_frames_total{outcome=\"failed\"}";
    until("a frame could not be written", async || {
        metric(&node.http, series).await > 0.5
    })
    .await;
    let fault = "recordings cannot be written (record.folder): ";
    assert_contains(&text_at(&format!("{}/readyz", node.http)).await, &[fault]);
    assert_contains(&status(&node).await, &[fault]);
    until("all are answered", async || answered(&node).await == 20).await;

    limit(node.id(), "--fsize=unlimited:unlimited");
    let mut seq = 20;
    until("recordings are written again", async || {
        send(&session, seq, &pictures[..1]).await;
        seq += 1;
        status(&node).await["written_frames"].as_u64() > Some(0)
    })
    .await;
    assert_eq!(status(&node).await["fault"], Value::Null);
    let log = node.stop_well().await.log;
    assert_contains(
        &log,
        &[
            "recordings cannot be written",
            "recordings are written again",
        ],
    );
}

/// Boxes that stay where they were while the objects move are a difference, and the detector's boxes become labels.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn frames_on_which_the_audit_found_a_difference_become_training_data() {
    let settings = "policy.name = \"fixed-skip\"\npolicy.fixed_skip.n = 1000\naudit.share = 1\n\
                    record.when = [\"audit\"]\nrecord.before_s = 0\nrecord.after_s = 0\n";
    let node = node(tempfile::tempdir().unwrap(), settings).await;
    let session = connected(&node).await;
    let far: Vec<_> = pictures(120).into_iter().step_by(20).collect();
    let series = "albireo_recording_frames_total{outcome=\"audited\"}";
    for (seq, picture) in (0..).zip(&far) {
        send(&session, seq, std::slice::from_ref(picture)).await;
    }
    until("the audit has looked", async || {
        metric(&node.http, series).await > 0.5
    })
    .await;
    let folder = node.stop().await.folder;
    let from = folder.path().join("recordings").display().to_string();
    let out = folder.path().join("hard");
    let said = run(
        &[
            "export",
            &from,
            "--to",
            "coco",
            "--out",
            out.to_str().unwrap(),
        ],
        &[],
    );
    assert_contains(&said.succeeds(), &[" with ", "of 1 recording in"]);
    let read = script(&json!({"coco": out.join("annotations.json")}));
    assert!(read["images"].as_u64().unwrap() >= 1, "{read}");
    assert!(!read["boxes"].as_array().unwrap().is_empty(), "{read}");

    // Nothing around these frames was kept.
    let shown = folder.path().join("shown");
    let shown = shown.to_str().unwrap();
    let said = run(
        &[
            "export", &from, "--to", "mot", "--frames", "shown", "--out", shown,
        ],
        &[],
    );
    assert_contains(&said.fails(), &["no frame with its boxes"]);
}

/// The dataset is opened as its users open it, and the tracks by our own reader of MOTChallenge.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and the wheel"]
async fn an_export_is_opened_by_supervision_and_its_tracks_are_those_that_were_shown() {
    let always = "policy.u = 1e-3\nrecord.when = [\"always\"]\n";
    let node = node(tempfile::tempdir().unwrap(), always).await;
    let session = connected(&node).await;
    send(&session, 0, &pictures(12)).await;
    until("all frames are written", async || {
        status(&node).await["written_frames"] == 12
    })
    .await;
    let folder = node.stop().await.folder;
    let from = folder.path().join("recordings").display().to_string();
    let export = |to: &str| {
        let out = folder.path().join(to);
        let arguments = ["export", &from, "--frames", "shown", "--to", to, "--out"];
        let arguments: Vec<_> = arguments.into_iter().chain([out.to_str().unwrap()]).collect();
        assert_contains(&run(&arguments, &[]).succeeds(), &["12 pictures with"]);
        out
    };
    let coco = export("coco");
    let code = "import json, sys, supervision as sv\n\
                data = sv.DetectionDataset.from_coco(sys.argv[1] + '/images', sys.argv[1] + '/annotations.json')\n\
                boxes = sum(len(found) for _, image, found in data if image.shape == (360, 640, 3))\n\
                print(json.dumps([len(data), boxes, data.classes]))";
    let mut supervision = Command::new(wheel::python());
    supervision.args(["-c", code]).arg(&coco);
    let read: Value =
        serde_json::from_str(&crate::support::run_command(&mut supervision).succeeds()).unwrap();
    assert_eq!(read[0], 12, "{read}");
    assert!(read[1].as_u64().unwrap() > 12, "{read}");
    let tracks = mot_challenge::read(&export("mot")).unwrap();
    assert_eq!(tracks.clips.len(), 1);
    let rows = recordings(&folder.path().join("mot/.."));
    let name = rows[0].file_stem().unwrap().to_str().unwrap().to_owned() + "/gt/gt.txt";
    let rows = std::fs::read_to_string(folder.path().join("mot").join(name)).unwrap();
    assert_eq!(rows.lines().count() as u64, read[1].as_u64().unwrap());
}

/// Pictures of Foxglove in JSON and of ROS 2 in CDR, in files of each compression, are footage like any other.
#[test]
#[ignore = "needs Python"]
fn recordings_of_other_programs_are_played_picture_by_picture() {
    use base64::Engine as _;
    use base64::prelude::BASE64_STANDARD;
    let folder = tempfile::tempdir().unwrap();
    let jpeg = grey_jpeg(90, [32, 16]);
    let rgb = vec![7; 3 * 32 * 16];
    let request = json!({
        "write": folder.path(), "size": [32, 16],
        "jpeg": BASE64_STANDARD.encode(&jpeg), "rgb": BASE64_STANDARD.encode(&rgb),
    });
    for compression in script(&request).as_array().unwrap() {
        let file = folder.path().join(format!("{}.mcap", compression.as_str().unwrap()));
        let file = file.to_str().unwrap();
        for (topic, format, bytes) in [
            ("/foxglove", PictureFormat::Jpeg, &jpeg),
            ("/ros/compressed", PictureFormat::Jpeg, &jpeg),
            ("/ros/image", PictureFormat::Rgb8, &rgb),
        ] {
            let name: SourceName = format!("{file}:{topic}").parse().unwrap();
            let mut source = name.open(None, VideoEncoding::Jpeg).unwrap();
            assert_eq!(source.frames(), Some(5), "{file}:{topic}");
            assert_eq!(source.rate(), 20.0, "{file}:{topic}");
            for pass in 0..2 {
                for _ in 0..5 {
                    let picture = source.next().unwrap().unwrap();
                    assert_eq!((picture.format, &*picture.bytes), (format, &**bytes));
                }
                assert!(source.next().unwrap().is_none(), "pass {pass}");
                source.rewind().unwrap();
            }
        }
        let name: SourceName = format!("{file}:/ros/cut").parse().unwrap();
        let error = name.open(None, VideoEncoding::Jpeg).unwrap().next().unwrap_err();
        assert_contains(
            &error.to_string(),
            &["/ros/cut, picture 1", "ends inside data"],
        );
        let all: SourceName = file.parse().unwrap();
        assert_eq!(all.clip_names().unwrap().len(), 4);
        let error = all.open(None, VideoEncoding::Jpeg).err().unwrap().to_string();
        assert_contains(&error, &["several topics", ".mcap:/foxglove", "/ros/image"]);
        let other: SourceName = format!("{file}:/imu").parse().unwrap();
        let error = other.open(None, VideoEncoding::Jpeg).err().unwrap().to_string();
        assert_contains(&error, &["/imu (sensor_msgs/msg/Imu in cdr, 3 messages)"]);
    }
}
