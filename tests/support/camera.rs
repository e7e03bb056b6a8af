//! A camera that names a clip a frame, so that each frame ends a clip.

use super::{PATIENCE, both_ways};
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_wire::{ClipReport, FrameAttachment, VERSION, read};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::time::timeout;
use zenoh::Session;
use zenoh::pubsub::Publisher;

/// The camera `front` of a node.
pub(crate) struct Camera {
    pub(crate) session: Session,
    frames: Publisher<'static>,
    answers: UnboundedReceiver<()>,
    picture: Vec<u8>,
    /// Number of the next frame, and of its clip.
    pub(crate) seq: u64,
    reported: Arc<Mutex<BTreeSet<String>>>,
}

impl Camera {
    /// The camera of `node`, connected at `endpoint`, once the node hears it.
    pub(crate) async fn at(endpoint: &str, node: &str) -> Self {
        let session = albireo::cli::replay::open_session(&[endpoint.to_owned()], &[], PATIENCE)
            .await
            .unwrap();
        let (sender, answers) = unbounded_channel();
        session
            .declare_subscriber(format!("albireo/{node}/front/detections"))
            .callback(move |_| {
                let _ = sender.send(());
            })
            .background()
            .await
            .unwrap();
        let reported: Arc<Mutex<BTreeSet<String>>> = Arc::default();
        let of_callback = Arc::clone(&reported);
        session
            .declare_subscriber(format!("albireo/{node}/front/clip"))
            .callback(move |sample| {
                let report: ClipReport = read(&sample.payload().to_bytes()).unwrap();
                of_callback.lock().unwrap().insert(report.clip);
            })
            .background()
            .await
            .unwrap();
        let frames = session
            .declare_publisher(format!("albireo/{node}/front/frame"))
            .congestion_control(zenoh::qos::CongestionControl::Block)
            .await
            .unwrap();
        both_ways(&session, node, "front").await;
        let scene = BoxScene::new(5, PictureSize::new(320, 180));
        Self {
            session,
            frames,
            answers,
            picture: scene.frame(0).jpeg(80).unwrap(),
            seq: 0,
            reported,
        }
    }

    /// Sends `count` frames of a clip each, and waits for each answer: then all clips but the last are closed.
    pub(crate) async fn clips(&mut self, count: u64) {
        for _ in 0..count {
            let attachment = FrameAttachment {
                v: VERSION,
                seq: Some(self.seq),
                t_ns: Some(self.seq),
                clip: Some(format!("clip-{}", self.seq)),
                ..FrameAttachment::default()
            };
            self.seq += 1;
            self.frames
                .put(self.picture.clone())
                .encoding("image/jpeg")
                .attachment(serde_json::to_vec(&attachment).unwrap())
                .await
                .unwrap();
            let answer = timeout(PATIENCE, self.answers.recv()).await;
            answer.unwrap().unwrap();
        }
    }

    /// The clips whose reports the node has published: it keeps a report on its disk before.
    pub(crate) fn reported(&self) -> BTreeSet<String> {
        self.reported.lock().unwrap().clone()
    }

    pub(crate) async fn close(self) {
        self.session.close().await.unwrap();
    }
}
