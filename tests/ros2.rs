//! A camera of ROS 2 is read by its topic, in the encodings of the usual drivers, and its boxes go back into ROS 2: another
//! implementation of the messages, without ROS 2 itself, writes the pictures and reads the boxes.

use crate::node_frames::{CAMERA, configuration};
use crate::support::{client, next, python, subscribe, until_read, zenoh_client};
use albireo_core::geometry::PictureSize;
use albireo_node::PreparedNode;
use albireo_node::config::CameraConfig;
use albireo_scene::BoxScene;
use albireo_vision::picture::{FrameLimits, Picture, PixelLayout, decode, picture_of_file};
use albireo_wire::{DetectionsMessage, read};
use rstest::rstest;
use serde_json::Value;
use std::path::Path;
use tokio::io::AsyncWriteExt;
use tokio_util::sync::CancellationToken;
use zenoh::sample::Sample;

/// Writes a picture with boxes in it as a PPM file.
fn write_picture(path: &Path) {
    let file = BoxScene::new(5, PictureSize::new(320, 180)).frame(0).jpeg(90).unwrap();
    let limits = FrameLimits::default();
    let file = picture_of_file(file.into(), &limits).unwrap();
    let mut picture = Picture::default();
    decode(&file, &limits, PixelLayout::Rgb8, None, &mut picture).unwrap();
    let head = format!("P6\n{} {}\n255\n", picture.size.width, picture.size.height);
    std::fs::write(path, [head.as_bytes(), &picture.pixels].concat()).unwrap();
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|number| number.as_f64().unwrap())
        .collect()
}

/// Checks the boxes that the other implementation has read against the node's own message.
fn check(answer: &Value, message: &DetectionsMessage) {
    assert_eq!(answer["t_ns"], message.t_ns);
    assert!(answer["sent_ns"].as_u64().unwrap() > message.t_ns);
    assert_eq!(answer["frame_id"], CAMERA);
    let boxes = answer["boxes"].as_array().unwrap();
    assert_eq!(boxes.len(), message.boxes.len());
    for (read, sent) in boxes.iter().zip(&message.boxes) {
        let [left, top, right, bottom] = sent.corners.map(f64::from);
        let [x, y, width, height] = numbers(&read["box"])[..] else {
            panic!("{read}");
        };
        let read_corners = [
            x - width / 2.0,
            y - height / 2.0,
            x + width / 2.0,
            y + height / 2.0,
        ];
        for (read, sent) in read_corners.into_iter().zip([left, top, right, bottom]) {
            assert!((read - sent).abs() < 1e-3, "{read} {sent}");
        }
        assert_eq!(read["class"], *sent.class);
        assert!((read["score"].as_f64().unwrap() - f64::from(sent.confidence)).abs() < 1e-6);
        let object = sent.object.map(|object| object.0.to_string()).unwrap_or_default();
        assert_eq!(read["id"], object);
        assert_eq!(read["same_header"], true);
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn a_ros_2_topic_of_any_distribution_and_encoding_is_read_and_its_boxes_are_published_for_ros_2()
 {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("picture.ppm");
    write_picture(&picture);
    let mut config = configuration();
    config.publish.ros2 = true;
    config.cameras = vec![CameraConfig {
        topic: Some("/camera/image_raw".to_owned()),
        ..CameraConfig::named(CAMERA)
    }];
    let shutdown = CancellationToken::new();
    let node = PreparedNode::new(&config)
        .unwrap()
        .start(&config, shutdown.clone())
        .await
        .unwrap();
    let endpoint = node.endpoints().await.remove(0);
    let stopped = tokio::spawn(node.stopped());
    let session = zenoh_client(&endpoint).await;
    let message = |sample: Sample| read::<DetectionsMessage>(&sample.payload().to_bytes()).unwrap();
    let mut messages = subscribe(&session, "albireo/node/front/detections", message).await;
    until_read(&session, "node", CAMERA).await;

    let arguments = [
        &*endpoint,
        "/camera/image_raw",
        "/albireo/node/front/detections_2d",
        picture.to_str().unwrap(),
    ];
    let (mut camera, mut lines) = client(&python(), "ros2.py", &arguments).await;
    camera.stdin.as_mut().unwrap().write_all(b"begin\n").await.unwrap();
    let mut first = None;
    for index in 0..18 {
        let line = lines.next_line().await.unwrap().unwrap();
        let line: Value = serde_json::from_str(&line).unwrap();
        let message = next(&mut messages).await;
        assert_eq!(
            message.t_ns,
            1_700_000_000_000_000_000 + index * 1_000_000_001
        );
        let answers = line["answers"].as_array().unwrap();
        assert_eq!(answers.len(), 3, "{line}");
        for answer in answers {
            check(answer, &message);
            assert_eq!(answer["number"], index + 1);
            let gid = answer["gid"].as_str().unwrap();
            assert!(gid.len() == 34 && gid.starts_with("10"), "{gid}");
        }
        // The picture is the same in every encoding.
        let known: &DetectionsMessage = first.get_or_insert_with(|| message.clone());
        assert!(!known.boxes.is_empty());
        assert_eq!(
            known.boxes.len(),
            message.boxes.len(),
            "{}",
            line["encoding"]
        );
        for (known, found) in known.boxes.iter().zip(&message.boxes) {
            let is_there =
                known.corners.iter().zip(found.corners).all(|(a, b)| (a - b).abs() <= 3.0);
            assert!(
                is_there && known.class == found.class,
                "{}: {known:?} {found:?}",
                line["encoding"]
            );
        }
    }
    let tokens = lines.next_line().await.unwrap().unwrap();
    let tokens: Vec<String> = serde_json::from_str(&tokens).unwrap();
    assert_eq!(tokens.len(), 2, "{tokens:?}");
    assert!(
        tokens[0].ends_with("/0/0/NN/%/%albireo%node/front"),
        "{tokens:?}"
    );
    let publisher = "/0/1/MP/%/%albireo%node/front/%albireo%node%front%detections_2d/";
    let kind = "vision_msgs::msg::dds_::Detection2DArray_/RIHS01_";
    assert!(
        tokens[1].contains(&format!("{publisher}{kind}")),
        "{tokens:?}"
    );
    camera.wait().await.unwrap();
    shutdown.cancel();
    stopped.await.unwrap().unwrap();
}
