//! Runs the node's path of a frame on one thread: decoding, letterbox, model, head, policy, message, Zenoh.

use super::decode_for;
use super::samples::{Samples, Stage};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Albireo, AlbireoSettings, FrameEvidence, FrameHead, Outcome, decide};
use albireo_node::camera::answer::detections_message;
use albireo_node::input::Frame;
use albireo_service::config::ZenohConfig;
use albireo_service::session;
use albireo_vision::detector::{DetectorConfig, DetectorNetwork};
use albireo_vision::picture::{EncodedPicture, FrameLimits, Picture};
use anyhow::{Context, anyhow, bail};
use std::net::TcpListener;
use std::time::{Duration, Instant};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;

const KEY: &str = "albireo/bench/front/detections";

/// A publisher, and a subscriber in a separate session over TCP.
pub(crate) struct Line {
    publisher: Publisher<'static>,
    /// Keeps the sessions open while the publisher is in use.
    _sessions: [Session; 2],
}

impl Line {
    pub(crate) async fn open() -> anyhow::Result<Self> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let listening = ZenohConfig {
            listen: vec![endpoint.clone()],
            ..ZenohConfig::default()
        };
        let connecting = ZenohConfig {
            listen: Vec::new(),
            connect: vec![endpoint],
            ..ZenohConfig::default()
        };
        let limit = FrameLimits::default().max_payload_bytes;
        let node = session::open(&listening, limit, &[], false, |_| {}).await?;
        let client = session::open(&connecting, limit, &[], false, |_| {}).await?;
        let failed = |error: zenoh::Error| anyhow!("Zenoh: {error}");
        client
            .declare_subscriber(KEY)
            .callback(|_| {})
            .background()
            .await
            .map_err(failed)?;
        let publisher = node.declare_publisher(KEY).await.map_err(failed)?;
        let start = Instant::now();
        while !publisher.matching_status().await.map_err(failed)?.matching() {
            if start.elapsed() > Duration::from_secs(10) {
                bail!("no connection over Zenoh on this machine within 10 s");
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        Ok(Self {
            publisher,
            _sessions: [node, client],
        })
    }
}

/// All stages that the frames of a camera pass.
pub(crate) struct OurPath<'a> {
    pub network: DetectorNetwork,
    line: &'a Line,
    class_names: Vec<String>,
    policy: Albireo,
    outcome: Outcome,
    picture: Picture,
    frames: u64,
}

impl<'a> OurPath<'a> {
    pub(crate) fn open(config: &DetectorConfig, line: &'a Line) -> anyhow::Result<Self> {
        let network = DetectorNetwork::open(config)?;
        Ok(Self {
            class_names: network.class_names().to_vec(),
            network,
            line,
            // The threshold is so low that every frame has a detector run and matching.
            policy: Albireo::new(AlbireoSettings::paper(), 1e-9)?,
            outcome: Outcome::default(),
            picture: Picture::default(),
            frames: 0,
        })
    }

    /// The size to which pictures are decoded.
    pub(crate) fn decoded_size(&self) -> PictureSize {
        self.picture.size
    }

    /// Passes one picture through all stages.
    pub(crate) async fn frame(
        &mut self,
        encoded: &EncodedPicture,
        samples: &mut Samples,
    ) -> anyhow::Result<()> {
        let frame = Frame {
            sequence: self.frames,
            time_ns: self.frames * 100_000_000,
            clip: None,
            position: None,
            picture: encoded.clone(),
            received: tokio::time::Instant::now(),
        };
        let start = Instant::now();
        decode_for(self.network.input_format(), encoded, &mut self.picture)?;
        let decoding = start.elapsed();

        let prepared = self.network.preparation().prepare(&self.picture)?;
        let found = self.network.detect(&prepared)?;

        let start = Instant::now();
        let head = FrameHead {
            index: self.frames,
            step: 1,
            picture: encoded.size,
        };
        let mut known = FrameEvidence::in_view(&found.detections);
        let Ok(()) = decide(&mut self.policy, head, &mut known, &mut self.outcome);
        let policy = start.elapsed();
        if self.outcome.state.is_skipped() {
            bail!("the policy skipped a frame that was to be matched");
        }

        let start = Instant::now();
        let message = detections_message(&self.outcome, &frame, "bench", &self.class_names);
        let json = serde_json::to_vec(&message).context("the message")?;
        let written = start.elapsed();

        let start = Instant::now();
        self.line
            .publisher
            .put(json)
            .encoding(Encoding::APPLICATION_JSON)
            .await
            .map_err(|error| anyhow!("Zenoh: {error}"))?;
        let publication = start.elapsed();

        self.frames += 1;
        let times = [
            (Stage::Decode, decoding),
            (Stage::Letterbox, found.letterbox),
            (Stage::Model, found.model),
            (Stage::Head, found.head),
            (Stage::Policy, policy),
            (Stage::Message, written),
            (Stage::Publish, publication),
        ];
        samples.add(&times, found.detections.len());
        Ok(())
    }
}
