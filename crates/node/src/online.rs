//! Tries what a configuration names, as a node would use it: the models on their execution provider, cameras that the
//! node opens, the router, the hub. For `albireo check --online`.

use crate::config::{CameraConfig, NodeConfig};
use crate::input::source::{LiveSource, SourceSink};
use albireo_service::clock::milliseconds;
use albireo_service::config::{ZenohConfig, ZenohMode};
use albireo_service::session;
use albireo_vision::detector::{DetectorConfig, DetectorNetwork};
use albireo_vision::picture::{EncodedPicture, FrameFault, Picture};
use albireo_vision::screen::ScreenHandle;
use albireo_wire::NodeKeys;
use std::fmt::Display;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::{Sender, channel};
use tokio_util::sync::CancellationToken;
use zenoh::{Session, Wait};

/// Pictures the detector is timed on, after its warm-up.
const PICTURES: usize = 9;

/// How long a router and a hub are waited for.
const ANSWER: Duration = Duration::from_secs(10);

/// What was seen of one thing that a configuration names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tried {
    /// The key of the configuration.
    pub key: String,
    /// What was seen, or why it does not work.
    pub outcome: Result<String, String>,
}

/// Tries everything the configuration names, and reports each result as it comes. Nothing is published, and a node that runs
/// beside is not disturbed, but that a camera which serves one client at a time refuses the second.
pub async fn try_all(config: &NodeConfig, mut each: impl FnMut(Tried)) {
    let mut report = |key: &str, outcome| {
        each(Tried {
            key: key.to_owned(),
            outcome,
        });
    };
    let detector = config.detector.clone();
    let found = tokio::task::spawn_blocking(move || try_detector(&detector)).await;
    report(
        "detector",
        found.unwrap_or_else(|error| Err(error.to_string())),
    );
    match ScreenHandle::start(&config.screen, config.detector.onnxruntime.as_deref()).await {
        Ok(None) => {}
        Ok(Some(screen)) => {
            let [_, _, rows, columns] = screen.input_format().shape();
            report("screen", Ok(format!("input shape {rows} x {columns}")));
        }
        Err(error) => report("screen", Err(error.to_string())),
    }
    for camera in &config.cameras {
        if camera.source.is_some() {
            let key = format!("camera.{}.source", camera.name);
            report(&key, try_source(config, camera).await);
        }
    }
    let fleet = config.keys();
    if config.uplink.is_set() {
        let uplink = config.uplink.clone();
        let opening = tokio::task::spawn_blocking(move || session::open_uplink(&uplink));
        let opened = in_time(&config.uplink.connect, opening).await;
        let opened = opened.and_then(|opened| opened.map_err(|error| format!("{error:#}")));
        report("uplink.connect", hub_answer(opened, fleet).await);
    } else if !config.zenoh.connect.is_empty() && config.zenoh.config_file.is_none() {
        // As a client that listens nowhere: the ports are the running node's.
        let client = ZenohConfig {
            mode: ZenohMode::Client,
            listen: Vec::new(),
            ..config.zenoh.clone()
        };
        let opening = session::open(&client, config.frame.max_payload_bytes, |_| {});
        let reached = match in_time(&config.zenoh.connect, opening).await {
            Err(reason) => Err(reason),
            Ok(session) => {
                close(session).await;
                Ok(format!("{} answers", config.zenoh.connect.join(", ")))
            }
        };
        report("zenoh.connect", reached);
    }
}

/// What `opening` gives if that comes in time, or why it does not.
async fn in_time<T, E: Display>(
    endpoints: &[String],
    opening: impl Future<Output = Result<T, E>>,
) -> Result<T, String> {
    match tokio::time::timeout(ANSWER, opening).await {
        Ok(opened) => opened.map_err(|error| format!("{error:#}")),
        Err(_) => Err(format!(
            "{} did not answer in {} s",
            endpoints.join(", "),
            ANSWER.as_secs()
        )),
    }
}

/// Which provider runs the model, and how long a run takes.
fn try_detector(config: &DetectorConfig) -> Result<String, String> {
    let begun = Instant::now();
    let mut network = DetectorNetwork::open(config).map_err(|error| error.to_string())?;
    let loaded = begun.elapsed();
    let prepared = network
        .preparation()
        .prepare(&Picture::black(network.input_format().size))
        .map_err(|error| error.to_string())?;
    let mut took = Vec::with_capacity(PICTURES);
    for _ in 0..PICTURES {
        let begun = Instant::now();
        let found = network.detect(&prepared);
        found.map_err(|error| error.to_string())?;
        took.push(begun.elapsed());
    }
    took.sort();
    let median = took.get(PICTURES / 2).copied().unwrap_or_default();
    let provider = network.provider();
    let mut text = format!(
        "runs on {}, {:.1} ms a picture (median of {PICTURES}), loaded in {:.1} s",
        provider.as_str(),
        milliseconds(median),
        loaded.as_secs_f64(),
    );
    if let Some(first) = config.providers.first()
        && *first != provider
    {
        text.push_str(&format!(
            "; `{}` does not work here, and detector.providers lists another after it",
            first.as_str()
        ));
    }
    Ok(text)
}

/// Hands on whether the first picture came, or why not.
struct FirstPicture(Sender<Result<String, String>>);

impl SourceSink for FirstPicture {
    fn picture(&mut self, picture: Result<EncodedPicture, FrameFault>, _reopened: bool) {
        let found = match picture {
            Ok(picture) => Ok(format!(
                "a picture came, {} kB as {}",
                picture.bytes.len().div_ceil(1000),
                picture.format.as_str()
            )),
            Err(fault) => Err(format!("a picture came that cannot be used: {fault}")),
        };
        // Only the first is waited for.
        let _ = self.0.try_send(found);
    }

    fn fails(&mut self, reason: &str, _pause: Duration) {
        let _ = self.0.try_send(Err(reason.to_owned()));
    }
}

async fn try_source(config: &NodeConfig, camera: &CameraConfig) -> Result<String, String> {
    let Some(settings) = camera.source_settings(config.frame) else {
        return Err("it has no source".to_owned());
    };
    let patience = settings.silence.min(Duration::from_secs(600)) + ANSWER;
    let found = tokio::task::spawn_blocking(move || LiveSource::find(settings)).await;
    let source = found
        .map_err(|error| error.to_string())?
        .map_err(|error| error.to_string())?;
    let (sender, mut found) = channel(1);
    let stop = CancellationToken::new();
    let source = Arc::new(source);
    let running = source.run(FirstPicture(sender), stop.clone());
    let waiting = async {
        let first = tokio::time::timeout(patience, found.recv()).await;
        stop.cancel();
        match first {
            Ok(Some(found)) => found,
            Ok(None) => Err("its reader ended".to_owned()),
            Err(_) => Err(format!("no picture in {} s", patience.as_secs())),
        }
    };
    let (ended, found) = tokio::join!(running, waiting);
    ended?;
    found
}

/// Whether somebody takes reports behind the session.
async fn hub_answer(
    opened: Result<Session, String>,
    keys: Result<NodeKeys, albireo_wire::KeyError>,
) -> Result<String, String> {
    let session = opened?;
    let keys = keys.map_err(|error| error.to_string())?;
    let found = hub_behind(&session, keys.report()).await;
    close(session).await;
    match found {
        Ok(true) => Ok("the router answers, and a hub takes reports".to_owned()),
        Ok(false) => Err(format!(
            "the router answers, but no hub takes reports: is the hub running, with hub.prefix as node.prefix, and does \
             the router's access control let this node's certificate use `{}`?",
            keys.report()
        )),
        Err(error) => Err(session::plain(&error)),
    }
}

async fn hub_behind(session: &Session, key: String) -> zenoh::Result<bool> {
    let querier = session.declare_querier(key).await?;
    let (sender, mut matches) = channel(1);
    let _listener = querier
        .matching_listener()
        .callback(move |status| {
            if status.matching() {
                let _ = sender.try_send(());
            }
        })
        .await?;
    if querier.matching_status().await?.matching() {
        return Ok(true);
    }
    Ok(matches!(
        tokio::time::timeout(ANSWER, matches.recv()).await,
        Ok(Some(()))
    ))
}

async fn close(session: Session) {
    let closed = tokio::task::spawn_blocking(move || session.close().wait()).await;
    if let Ok(Err(error)) = closed {
        tracing::debug!(%error, "session not closed cleanly");
    }
}
