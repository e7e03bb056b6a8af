//! A camera that starts a clip with every frame, so that each frame ends a clip.

use super::{PATIENCE, next, subscribe, until_connected};
use crate::node_frames::attachment;
use albireo::cli::frames::open_session;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_wire::{ClipReport, read};
use std::collections::BTreeSet;
use tokio::sync::mpsc::UnboundedReceiver;
use zenoh::Session;
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;

pub(crate) struct Camera {
    pub(crate) session: Session,
    key: String,
    answers: UnboundedReceiver<()>,
    picture: Vec<u8>,
    /// The number of the next frame and of its clip.
    pub(crate) seq: u64,
    reports: UnboundedReceiver<ClipReport>,
    reported: BTreeSet<String>,
}

impl Camera {
    /// Connects the camera of `node` at `endpoint`, and waits until the node hears it.
    pub(crate) async fn at(endpoint: &str, node: &str) -> Self {
        let session = open_session(&[endpoint.to_owned()], &[], PATIENCE).await.unwrap();
        let of = |what: &str| format!("albireo/{node}/front/{what}");
        let answers = subscribe(&session, &of("detections"), drop).await;
        let report = |sample: Sample| read(&sample.payload().to_bytes()).unwrap();
        let reports = subscribe(&session, &of("clip"), report).await;
        until_connected(&session, node, "front").await;
        let scene = BoxScene::new(5, PictureSize::new(320, 180));
        Self {
            session,
            key: of("frame"),
            answers,
            picture: scene.frame(0).jpeg(80).unwrap(),
            seq: 0,
            reports,
            reported: BTreeSet::new(),
        }
    }

    /// Sends `count` frames, each of its own clip, and waits for each answer: then all clips except the last are closed.
    pub(crate) async fn clips(&mut self, count: u64) {
        for _ in 0..count {
            let attachment = attachment(self.seq, None, Some(&format!("clip-{}", self.seq)));
            self.seq += 1;
            // Like `albireo publish`, it does not wait for subscribers that do not read.
            self.session
                .put(&*self.key, self.picture.clone())
                .congestion_control(CongestionControl::Drop)
                .attachment(attachment)
                .await
                .unwrap();
            next(&mut self.answers).await;
        }
    }

    /// The clips whose reports the node has published, which it does once they are on its disk.
    pub(crate) fn reported(&mut self) -> &mut BTreeSet<String> {
        let new = std::iter::from_fn(|| self.reports.try_recv().ok());
        self.reported.extend(new.map(|report| report.clip));
        &mut self.reported
    }

    pub(crate) async fn close(self) {
        self.session.close().await.unwrap();
    }
}
