//! A camera that hangs upside down, sees its own bonnet or a neighbour's garden: its pictures are turned, cropped and masked
//! before anything looks at them.

use crate::node_frames::{attachment, put};
use crate::support::live_camera::MotionJpegCamera;
use crate::support::{Node, jpeg, json_at, until, until_connected, zenoh_client};
use albireo_recording::{Messages, Topic, picture_in_protobuf};
use albireo_vision::picture::{FrameLimits, Picture, PixelLayout, decode, picture_of_file};
use bytes::Bytes;
use rstest::rstest;
use serde_json::Value;
use std::path::Path;

const SENT: [f64; 2] = [320.0, 180.0];
/// Left, top, right, bottom in the picture as it is sent: the red thing, and the blue one that is masked.
const RED: [f64; 4] = [48.0, 32.0, 96.0, 64.0];
const BLUE: [f64; 4] = [208.0, 96.0, 272.0, 144.0];

/// The blue thing lies in the mask, from (0.53, 0.69) to (0.8, 0.94) of the turned and cropped picture.
const MOUNT: &str = "rotate = 90
flip = \"horizontal\"
crop = [0.0, 0.1, 1.0, 0.9]
mask = [[[0.5, 0.6], [0.85, 0.6], [0.85, 1.0], [0.5, 1.0]]]
";

fn picture() -> Vec<u8> {
    let [width, height] = SENT.map(|side| side as u16);
    let mut pixels = vec![0; 3 * usize::from(width) * usize::from(height)];
    for (at, pixel) in pixels.chunks_exact_mut(3).enumerate() {
        let (x, y) = (at % usize::from(width), at / usize::from(width));
        let is_in = |[left, top, right, bottom]: [f64; 4]| {
            (left..right).contains(&(x as f64)) && (top..bottom).contains(&(y as f64))
        };
        if is_in(RED) {
            pixel[0] = 255;
        } else if is_in(BLUE) {
            pixel[2] = 255;
        }
    }
    jpeg(&pixels, [width, height])
}

/// A published point in the picture as it was sent, by the arithmetic of docs/messages.md.
fn back([x, y]: [f64; 2], [width, height]: [f64; 2]) -> [f64; 2] {
    let uncropped = 0.1 + y / height * (0.9 - 0.1);
    let unflipped = 1.0 - x / width;
    [uncropped * SENT[0], (1.0 - unflipped) * SENT[1]]
}

async fn shown(node: &Node, path: &str) -> Picture {
    let bytes = reqwest::get(format!("{}{path}", node.http))
        .await
        .unwrap()
        .bytes()
        .await
        .unwrap();
    decoded(Bytes::from(bytes.to_vec()))
}

/// The pictures in the recordings of a camera.
fn recorded(folder: &Path, camera: &str) -> Vec<Picture> {
    std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .flat_map(|path| Messages::open(&path).unwrap())
        .filter(|one| one.channel.topic == Topic::Image.of(camera))
        .map(|one| decoded(picture_in_protobuf(&one.data).unwrap()))
        .collect()
}

fn assert_masked(picture: &Picture, name: &str) {
    assert_eq!([picture.size.width, picture.size.height], [180, 256]);
    let is_blue = |pixel: &[u8]| pixel[2] > 150 && pixel[0] < 80;
    let is_grey = |pixel: &[u8]| pixel.iter().all(|value| value.abs_diff(114) < 6);
    assert_eq!(count(picture, is_blue), 0, "{name}");
    let share = count(picture, is_grey) as f64 / (180.0 * 256.0);
    assert!((share - 0.35 * 0.4).abs() < 0.01, "{name}: {share} is grey");
}

fn decoded(file: Bytes) -> Picture {
    let limits = FrameLimits::default();
    let file = picture_of_file(file, &limits).unwrap();
    let mut picture = Picture::default();
    decode(&file, &limits, PixelLayout::Rgb8, None, &mut picture).unwrap();
    picture
}

/// The number of pixels of one colour.
fn count(picture: &Picture, is_colour: fn(&[u8]) -> bool) -> usize {
    picture.pixels.chunks_exact(3).filter(|pixel| is_colour(pixel)).count()
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime and ffmpeg"]
async fn a_camera_is_turned_cropped_and_masked_for_detector_messages_page_and_recordings_alike() {
    let camera = MotionJpegCamera::start(vec![picture()]).await;
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("recordings");
    let settings = format!(
        "detector.model = {:?}\npolicy.name = \"vanilla\"\nrecord = {{ folder = {recordings:?}, when = [\"always\"] }}\n[[camera]]\nname = \"front\"\nsource = \"{}\"\nmax_rate = 5\n\
         {MOUNT}[[camera]]\nname = \"rear\"\n{MOUNT}[[camera]]\nname = \"plain\"\n",
        crate::support::detectors::model("boxes.onnx"),
        camera.address
    );
    let node = Node::start_in(folder, &settings).await;
    let session = zenoh_client(&node.zenoh).await;
    for name in ["rear", "plain"] {
        until_connected(&session, "node", name).await;
        put(&session, name, &picture(), attachment(0, None, None)).await;
    }
    let boxes = async |name: &str| -> Value {
        json_at(&format!("{}/api/v1/cameras/{name}/detections", node.http)).await
    };
    for name in ["plain", "front", "rear"] {
        let url = format!("{}/api/v1/cameras/{name}/detections", node.http);
        let arrived = async || reqwest::get(&url).await.unwrap().status().is_success();
        until("a frame is answered", arrived).await;
    }
    let plain = boxes("plain").await;
    assert_eq!(plain["boxes"].as_array().unwrap().len(), 2, "{plain}");
    for name in ["front", "rear"] {
        let found = boxes(name).await;
        let size = ["width", "height"].map(|side| found[side].as_f64().unwrap());
        assert_eq!(size, [180.0, 256.0], "{name}");
        let [only] = &found["boxes"].as_array().unwrap()[..] else {
            panic!("{name}: not one box: {found}");
        };
        let side = |index: usize| only["box"][index].as_f64().unwrap();
        let [x1, y1] = back([side(0), side(1)], size);
        let [x2, y2] = back([side(2), side(3)], size);
        let sent = [x1.min(x2), y1.min(y2), x1.max(x2), y1.max(y2)];
        for (found, expected) in sent.iter().zip(RED) {
            assert!((found - expected).abs() < 4.0, "{name}: {sent:?}");
        }

        let picture = shown(&node, &format!("/api/v1/cameras/{name}/frame.jpg")).await;
        assert_masked(&picture, name);
        let with_boxes = format!("/api/v1/cameras/{name}/frame.jpg?boxes=true");
        let drawn = shown(&node, &with_boxes).await;
        assert_eq!(drawn.size, picture.size);
    }
    session.close().await.unwrap();
    let folder = node.stop().await.folder;
    for name in ["front", "rear"] {
        let pictures = recorded(&folder.path().join("recordings"), name);
        assert!(!pictures.is_empty());
        for picture in &pictures {
            assert_masked(picture, name);
        }
    }
}
