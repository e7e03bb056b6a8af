//! A camera that names a clip a frame, so that each frame ends a clip.

use super::{PATIENCE, both_ways, heard, next};
use crate::node_frames::attachment;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_wire::{ClipReport, read};
use std::collections::BTreeSet;
use tokio::sync::mpsc::UnboundedReceiver;
use zenoh::Session;
use zenoh::pubsub::Publisher;
use zenoh::sample::Sample;

/// The camera `front` of a node.
pub(crate) struct Camera {
    pub(crate) session: Session,
    frames: Publisher<'static>,
    answers: UnboundedReceiver<()>,
    picture: Vec<u8>,
    /// Number of the next frame, and of its clip.
    pub(crate) seq: u64,
    reports: UnboundedReceiver<ClipReport>,
    reported: BTreeSet<String>,
}

impl Camera {
    /// The camera of `node`, connected at `endpoint`, once the node hears it.
    pub(crate) async fn at(endpoint: &str, node: &str) -> Self {
        let session = albireo::cli::replay::open_session(&[endpoint.to_owned()], &[], PATIENCE)
            .await
            .unwrap();
        let of = |what: &str| format!("albireo/{node}/front/{what}");
        let answers = heard(&session, &of("detections"), drop).await;
        let report = |sample: Sample| read(&sample.payload().to_bytes()).unwrap();
        let reports = heard(&session, &of("clip"), report).await;
        let frames = session
            // As `albireo publish` does, it does not wait for others who listen to its frames and do not read.
            .declare_publisher(of("frame"))
            .congestion_control(zenoh::qos::CongestionControl::Drop)
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
            reports,
            reported: BTreeSet::new(),
        }
    }

    /// Sends `count` frames of a clip each, and waits for each answer: then all clips but the last are closed.
    pub(crate) async fn clips(&mut self, count: u64) {
        for _ in 0..count {
            let attachment = attachment(self.seq, None, Some(&format!("clip-{}", self.seq)));
            self.seq += 1;
            self.frames
                .put(self.picture.clone())
                .encoding("image/jpeg")
                .attachment(attachment)
                .await
                .unwrap();
            next(&mut self.answers).await;
        }
    }

    /// The clips whose reports the node has published: it keeps a report on its disk before.
    pub(crate) fn reported(&mut self) -> &mut BTreeSet<String> {
        let new = std::iter::from_fn(|| self.reports.try_recv().ok());
        self.reported.extend(new.map(|report| report.clip));
        &mut self.reported
    }

    pub(crate) async fn close(self) {
        self.session.close().await.unwrap();
    }
}
