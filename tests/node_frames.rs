//! A node with a real Zenoh session and ONNX Runtime handles good and bad frames, thresholds and its own shutdown.

use crate::support::{PATIENCE, next, project, subscribe, until_connected, zenoh_client};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::FrameState;
use albireo_node::config::{CameraConfig, NodeConfig};
use albireo_node::input::PayloadFormat;
use albireo_node::state::board::{Board, CameraSnapshot};
use albireo_node::{Node, NodeError, PreparedNode};
use albireo_scene::BoxScene;
use albireo_vision::picture::{
    FrameLimits, Picture, PictureFormat, PixelLayout, decode, picture_of_file,
};
use albireo_wire::{ClipReport, DetectionsMessage, FrameAnswer, FrameAttachment, VERSION, read};
use rstest::rstest;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::sync::Arc;
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Reply;
use zenoh::sample::Sample;

pub(crate) const CAMERA: &str = "front";

/// A node on a free port, with one camera that loses nothing.
pub(crate) fn configuration() -> NodeConfig {
    let mut config = NodeConfig::default();
    config.zenoh.listen = vec!["tcp/127.0.0.1:0".to_owned()];
    config.detector.model = project("tests/fixtures/models/boxes.onnx");
    config.detector.timeout_ms = 60_000;
    config.policy.name = "vanilla".to_owned();
    config.cameras = vec![CameraConfig {
        delivery: albireo_node::input::Delivery::Every,
        ..CameraConfig::named(CAMERA)
    }];
    config
}

pub(crate) struct Bench {
    pub(crate) board: Arc<Board>,
    pub(crate) shutdown: CancellationToken,
    pub(crate) stopped: JoinHandle<Result<(), NodeError>>,
    pub(crate) session: Session,
    detections: UnboundedReceiver<DetectionsMessage>,
    pub(crate) endpoints: Vec<String>,
}

impl Bench {
    pub(crate) async fn start(config: &NodeConfig) -> Self {
        Self::start_prepared(config, PreparedNode::new(config).unwrap()).await
    }

    pub(crate) async fn start_prepared(config: &NodeConfig, prepared: PreparedNode) -> Self {
        let shutdown = CancellationToken::new();
        let board = Arc::clone(prepared.board());
        let node: Node = prepared.start(config, shutdown.clone()).await.unwrap();
        let endpoints = node.endpoints().await;
        let session = zenoh_client(&endpoints[0]).await;
        let stopped = tokio::spawn(node.stopped());
        let detections = published(&session, "albireo/node/*/detections").await;
        until_connected(&session, "node", CAMERA).await;
        Self {
            board,
            shutdown,
            stopped,
            detections,
            session,
            endpoints,
        }
    }

    /// Sends a JPEG picture, and waits until the node has accepted or refused it.
    pub(crate) async fn send(&self, picture: impl Into<ZBytes>, seq: u64) -> Reply {
        let attachment = attachment(seq, None, None);
        ask_frame(&self.session, CAMERA, picture, "image/jpeg", attachment).await
    }

    pub(crate) async fn send_of_clip(&self, picture: impl Into<ZBytes>, seq: u64, clip: &str) {
        let attachment = attachment(seq, None, Some(clip));
        ask_frame(&self.session, CAMERA, picture, "image/jpeg", attachment).await;
    }

    pub(crate) async fn published<T: DeserializeOwned + Send + 'static>(
        &self,
        key: &str,
    ) -> UnboundedReceiver<T> {
        published(&self.session, &format!("albireo/node/{CAMERA}/{key}")).await
    }

    pub(crate) fn snapshot(&self) -> CameraSnapshot {
        self.board.camera(CAMERA).unwrap().snapshot()
    }

    async fn answered_threshold(&mut self, seq: u64) -> Option<f64> {
        self.send(pictures(1).remove(0), seq).await;
        let threshold = self.answer().await.threshold;
        threshold.map(|threshold| threshold.value)
    }

    pub(crate) async fn answer(&mut self) -> DetectionsMessage {
        next(&mut self.detections).await
    }

    pub(crate) async fn stop(self) {
        self.shutdown.cancel();
        self.stopped.await.unwrap().unwrap();
        self.session.close().await.unwrap();
    }
}

/// Sends a frame as a query, and returns the reply once the node has accepted or refused it.
pub(crate) async fn ask_frame(
    session: &Session,
    camera: &str,
    payload: impl Into<ZBytes>,
    encoding: &str,
    attachment: Vec<u8>,
) -> Reply {
    let replies = session
        .get(format!("albireo/node/{camera}/frame"))
        .payload(payload)
        .encoding(Encoding::from(encoding))
        .attachment(attachment)
        .timeout(PATIENCE)
        .await
        .unwrap();
    replies.recv_async().await.expect("the node answers")
}

/// The reason for which a node refused a frame, if it did.
pub(crate) fn refused(reply: Reply) -> Option<String> {
    let answer: FrameAnswer = read(&reply.into_result().unwrap().payload().to_bytes()).unwrap();
    answer.refused
}

/// Puts a frame to a camera, and waits where Zenoh would drop it.
pub(crate) async fn put(session: &Session, camera: &str, payload: &[u8], attachment: Vec<u8>) {
    session
        .put(format!("albireo/node/{camera}/frame"), payload)
        .attachment(attachment)
        .congestion_control(zenoh::qos::CongestionControl::Block)
        .await
        .unwrap();
}

async fn published<T: DeserializeOwned + Send + 'static>(
    session: &Session,
    key: &str,
) -> UnboundedReceiver<T> {
    let read = |sample: Sample| serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
    subscribe(session, key, read).await
}

pub(crate) fn attachment(seq: u64, stream: Option<u64>, clip: Option<&str>) -> Vec<u8> {
    let attachment = FrameAttachment {
        v: VERSION,
        seq: Some(seq),
        stream,
        t_ns: Some(seq * 100_000_000),
        clip: clip.map(str::to_owned),
        ..FrameAttachment::default()
    };
    serde_json::to_vec(&attachment).unwrap()
}

/// Pictures of boxes, small for speed.
pub(crate) fn pictures(count: u64) -> Vec<Vec<u8>> {
    let scene = BoxScene::new(5, PictureSize::new(640, 360));
    (0..count).map(|index| scene.frame(index).jpeg(85).unwrap()).collect()
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn every_kind_of_dropped_frame_is_counted_under_its_own_name_and_the_next_one_is_answered() {
    let mut config = configuration();
    config.frame.max_payload_bytes = 400_000;
    let mut bench = Bench::start(&config).await;
    let picture = pictures(1).remove(0);
    for seq in [10, 10, 9] {
        bench.send(picture.clone(), seq).await;
    }
    bench.send(vec![0; 400_001], 11).await;
    let text = attachment(12, None, None);
    ask_frame(&bench.session, CAMERA, "hello", "text/plain", text).await;
    assert!(refused(bench.send("not a picture", 13).await).is_some());
    // Half a picture has a valid header: only decoding shows that it is broken.
    let half = picture[..picture.len() / 2].to_vec();
    bench.send(half, 14).await;
    bench.send(picture.clone(), 18).await;
    // Of a second publisher on the camera's key.
    let stray = attachment(19, Some(77), None);
    ask_frame(&bench.session, CAMERA, picture, "image/jpeg", stray).await;
    assert_eq!(bench.answer().await.seq, 10);
    assert_eq!(bench.answer().await.seq, 18);
    let dropped = bench.snapshot().dropped;
    let mut kinds = Vec::new();
    for (kind, count) in dropped.by_kind() {
        if count > 0 {
            kinds.push(format!("{kind} {count}"));
        }
    }
    let expected =
        "lost 3, late 1, stray 1, duplicate 1, undecodable 2, oversized 1, unknown_format 1";
    assert_eq!(kinds.join(", "), expected);
    bench.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn positions_of_frames_are_the_way_of_their_clip_and_a_wrong_one_costs_no_frame() {
    let mut bench = Bench::start(&configuration()).await;
    let mut clips = bench.published::<ClipReport>("clip").await;
    let picture = pictures(1).remove(0);
    let of_clip = |seq: u64, clip: &str, position: Value| {
        let attachment = json!({
            "v": VERSION, "seq": seq, "t_ns": seq * 1_000_000_000, "clip": clip, "position": position,
        });
        serde_json::to_vec(&attachment).unwrap()
    };
    for seq in 0..11 {
        // 22.24 m to the north each second.
        let latitude = 48.0 + seq as f64 * 0.0002;
        let position = match seq {
            5 => json!({"latitude": 95.0, "longitude": 11.0}),
            6 => json!("N48.0012 E11"),
            _ => json!({"latitude": latitude, "longitude": 11.0, "speed_m_s": 20 + seq}),
        };
        let attachment = of_clip(seq, "drive", position);
        let reply = ask_frame(
            &bench.session,
            CAMERA,
            picture.clone(),
            "image/jpeg",
            attachment,
        );
        assert_eq!(refused(reply.await), None);
        assert_eq!(bench.answer().await.seq, seq);
    }
    let health = bench.board.readiness.health().status();
    let reason = health.reasons.get("position").map(String::as_str).unwrap_or_default();
    assert!(
        reason.contains("a frame of front: ") && reason.contains("(2 since"),
        "{reason}"
    );

    let attachment = of_clip(11, "home", Value::Null);
    ask_frame(&bench.session, CAMERA, picture, "image/jpeg", attachment).await;
    let drive = next(&mut clips).await;
    let travel = drive.travel.expect("a way");
    assert_eq!((drive.frames, travel.check()), (11, Ok(())));
    assert!((travel.distance_m - 222.4).abs() < 0.1, "{travel:?}");
    assert_eq!(travel.fastest_m_s, Some(30.0));
    assert_eq!(travel.bounds, [11.0, 48.0, 11.0, 48.002]);
    assert_eq!(travel.track.first(), Some(&[11.0, 48.0]));
    assert_eq!(travel.track.last(), Some(&[11.0, 48.002]));
    bench.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_predicted_frame_is_never_decoded() {
    let mut config = configuration();
    config.policy.name = "fixed-skip".to_owned();
    config.policy.fixed_skip.n = 1000.0;
    let mut bench = Bench::start(&config).await;
    let mut picture = pictures(1).remove(0);
    bench.send(picture.clone(), 0).await;
    assert_eq!(bench.answer().await.state, FrameState::I);
    // From here on only the headers are valid, and noise follows that no decoder accepts.
    let from = picture.len() / 3;
    picture[from..].fill(0xFF);
    for seq in 1..5 {
        bench.send(picture.clone(), seq).await;
        let message = bench.answer().await;
        assert_eq!(message.state, FrameState::P);
        assert_eq!(message.latency_ms.decode, None);
    }
    bench.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_threshold_over_zenoh_applies_from_the_next_frame_and_is_validated() {
    let mut config = configuration();
    config.policy.name = "albireo".to_owned();
    let mut bench = Bench::start(&config).await;
    assert_eq!(bench.answered_threshold(0).await, Some(3e-4));

    assert_eq!(ask(&bench.session, None).await, Ok(3e-4));
    let change = r#"{"threshold":{"name":"u","value":5e-4}}"#;
    assert_eq!(ask(&bench.session, Some(change)).await, Ok(5e-4));
    assert_eq!(bench.answered_threshold(1).await, Some(5e-4));

    for bad in [
        r#"{"threshold":{"name":"u","value":0}}"#,
        r#"{"threshold":{"name":"lambda","value":0.3}}"#,
        r#"{"u":5e-4}"#,
        r#"{"v":9,"threshold":{"name":"u","value":1}}"#,
    ] {
        let reason = ask(&bench.session, Some(bad)).await.expect_err(bad);
        assert!(!reason.is_empty());
    }
    assert_eq!(ask(&bench.session, None).await, Ok(5e-4));

    let change = r#"{"threshold":{"name":"u","value":7e-4}}"#;
    let put = bench.session.put("albireo/node/front/threshold", change);
    put.await.unwrap();
    // On one link a query arrives after an earlier put.
    assert_eq!(ask(&bench.session, None).await, Ok(7e-4));
    assert_eq!(bench.answered_threshold(2).await, Some(7e-4));
    bench.stop().await;
}

async fn ask(session: &Session, payload: Option<&str>) -> Result<f64, String> {
    let mut query = session.get("albireo/node/front/threshold");
    if let Some(payload) = payload {
        query = query.payload(payload);
    }
    let reply = query.await.unwrap().recv_async().await.unwrap();
    let sample = reply
        .into_result()
        .map_err(|error| error.payload().try_to_string().unwrap().into_owned())?;
    let message: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
    Ok(message["threshold"]["value"].as_f64().unwrap())
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_ros_2_camera_beside_another_is_answered_under_its_own_key() {
    let mut config = configuration();
    config.cameras.push(CameraConfig {
        key: Some("camera/image_raw/compressed".to_owned()),
        format: PayloadFormat::Ros2,
        ..CameraConfig::named("ros")
    });
    let mut bench = Bench::start(&config).await;
    let message = std::fs::read(project("tests/fixtures/ros2/compressed_image_0_be.cdr")).unwrap();
    bench.session.put("camera/image_raw/compressed", message).await.unwrap();
    let answer = bench.answer().await;
    assert_eq!((answer.width, answer.height), (320, 180));
    assert_eq!(answer.t_ns, 1_700_000_000_123_456_789);
    bench.send(pictures(1).remove(0), 0).await;
    assert_eq!(bench.answer().await.width, 640);
    bench.stop().await;
}

/// A colour as BT.601 with limited range writes it: luma, Cb, Cr.
fn yuv(pixel: &[u8]) -> [u8; 3] {
    let r = f64::from(pixel[0]) / 255.0;
    let g = f64::from(pixel[1]) / 255.0;
    let b = f64::from(pixel[2]) / 255.0;
    let luma = 0.299 * r + 0.587 * g + 0.114 * b;
    let [cb, cr] = [(b - luma) / 1.772, (r - luma) / 1.402];
    [16.0 + 219.0 * luma, 128.0 + 224.0 * cb, 128.0 + 224.0 * cr].map(|value| value.round() as u8)
}

/// A row of pixels: luma, Cb, Cr.
type YuvRow = Vec<[u8; 3]>;

/// The bytes of each row, of which `bytes` gives those of two pixels.
fn by_pairs<'a>(
    rows: impl Iterator<Item = &'a YuvRow>,
    bytes: impl Fn(&[[u8; 3]]) -> Vec<u8>,
) -> Vec<Vec<u8>> {
    rows.map(|row| row.chunks(2).flat_map(&bytes).collect()).collect()
}

/// The rows of each plane of `picture` in `format`.
fn planes_of(picture: &Picture, format: PictureFormat) -> Vec<Vec<Vec<u8>>> {
    let rows_of_bytes = picture.pixels.chunks(3 * picture.size.width as usize);
    let yuv_row = |row: &[u8]| -> YuvRow { row.chunks(3).map(yuv).collect() };
    let rows: Vec<YuvRow> = rows_of_bytes.clone().map(yuv_row).collect();
    let every_second = || rows.iter().step_by(2);
    let luma = || {
        by_pairs(rows.iter(), |pair| {
            pair.iter().map(|pixel| pixel[0]).collect()
        })
    };
    let chroma = |channel: usize| by_pairs(every_second(), |pair| vec![pair[0][channel]]);
    match format {
        PictureFormat::Yuyv => {
            let bytes = |p: &[[u8; 3]]| vec![p[0][0], p[0][1], p[1][0], p[0][2]];
            vec![by_pairs(rows.iter(), bytes)]
        }
        PictureFormat::Uyvy => {
            let bytes = |p: &[[u8; 3]]| vec![p[0][1], p[0][0], p[0][2], p[1][0]];
            vec![by_pairs(rows.iter(), bytes)]
        }
        PictureFormat::I420 => vec![luma(), chroma(1), chroma(2)],
        PictureFormat::Nv12 => {
            let bytes = |p: &[[u8; 3]]| vec![p[0][1], p[0][2]];
            vec![luma(), by_pairs(every_second(), bytes)]
        }
        _ => vec![rows_of_bytes.map(<[u8]>::to_vec).collect()],
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn raw_frames_of_every_layout_with_and_without_padded_rows_give_the_boxes_of_the_picture() {
    let mut bench = Bench::start(&configuration()).await;
    let file = picture_of_file(pictures(1).remove(0).into(), &FrameLimits::default()).unwrap();
    let mut picture = Picture::default();
    decode(
        &file,
        &FrameLimits::default(),
        PixelLayout::Rgb8,
        None,
        &mut picture,
    )
    .unwrap();
    let mut seq = 0;
    let mut expected: Option<DetectionsMessage> = None;
    for (format, name) in [
        (PictureFormat::Rgb8, "rgb8"),
        (PictureFormat::Yuyv, "yuyv"),
        (PictureFormat::Uyvy, "uyvy"),
        (PictureFormat::I420, "i420"),
        (PictureFormat::Nv12, "nv12"),
    ] {
        let planes = planes_of(&picture, format);
        // The rows of all planes are padded in proportion to the first's.
        for padding in [0, 64] {
            let first = planes[0][0].len() + padding;
            let mut bytes = Vec::new();
            for plane in &planes {
                let is_chroma = planes.len() > 1 && plane[0].len() < planes[0][0].len();
                let step = if is_chroma { first / 2 } else { first };
                for row in plane {
                    bytes.extend_from_slice(row);
                    bytes.resize(bytes.len() + step - row.len(), 0xAA);
                }
            }
            let attachment = FrameAttachment {
                v: VERSION,
                seq: Some(seq),
                width: Some(picture.size.width),
                height: Some(picture.size.height),
                ..FrameAttachment::default()
            };
            let attachment = serde_json::to_vec(&attachment).unwrap();
            let encoding = format!("image/raw;{name}");
            let reply = ask_frame(&bench.session, CAMERA, bytes, &encoding, attachment).await;
            assert_eq!(refused(reply), None, "{name}, {padding} bytes of padding");
            let answer = bench.answer().await;
            assert_eq!(answer.seq, seq);
            let expected = expected.get_or_insert_with(|| answer.clone());
            assert!(!expected.boxes.is_empty());
            assert_eq!(answer.boxes.len(), expected.boxes.len(), "{name} {padding}");
            for (found, known) in answer.boxes.iter().zip(&expected.boxes) {
                let is_there =
                    found.corners.iter().zip(&known.corners).all(|(a, b)| (a - b).abs() <= 2.0);
                assert!(
                    is_there && found.class == known.class,
                    "{name} {padding}: {found:?}, {known:?}"
                );
            }
            seq += 1;
        }
    }
    bench.stop().await;
}
