//! Tries what a configuration names, as a node would use it: the models on their execution provider, cameras that the
//! node opens, the router, the hub. For `albireo check --online`.

use crate::config::NodeConfig;
use crate::forwarding::{Hook, Mqtt};
use crate::input::source::{FIRST_PICTURE, LiveSource, SourceEvent, SourceSettings};
use albireo_core::geometry::PictureSize;
use albireo_service::ServiceError;
use albireo_service::clock::milliseconds;
use albireo_service::config::{ZenohConfig, ZenohMode, shown_endpoints};
use albireo_service::session;
use albireo_vision::detector::{
    DetectorConfig, DetectorNetwork, ExecutionProvider, USUAL_PICTURE, compare_with_cpu,
    named_classes,
};
use albireo_vision::picture::{EncodedPicture, FrameLimits, Picture, PixelLayout, decode};
use albireo_vision::screen::ScreenHandle;
use parking_lot::Mutex;
use std::error::Error;
use std::fmt::Display;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::channel;
use tokio_util::sync::CancellationToken;
use zenoh::Session;

/// The number of pictures on which the detector is timed after its warm-up.
const PICTURES: usize = 9;

/// The time limit for a router or a hub to answer.
const ANSWER: Duration = Duration::from_secs(10);

/// The reason why something does not work, for a person.
type TrialFailure = Box<dyn Error + Send + Sync>;

/// Tries everything that the configuration names, and calls `each` with the key and the result or failure. Publishes
/// nothing and does not disturb a running node, but a camera that serves one client at a time refuses the second.
pub async fn try_all(config: &NodeConfig, mut each: impl FnMut(&str, Result<String, String>)) {
    let mut report = |key: &str, outcome: Result<String, TrialFailure>| {
        each(key, outcome.map_err(|error| error.to_string()));
    };
    let detector = Arc::new(config.detector_here());
    let opened = Arc::clone(&detector);
    let found = tokio::task::spawn_blocking(move || try_detector(&opened)).await;
    let network = match found.unwrap_or_else(|error| Err(error.into())) {
        Ok((network, text)) => {
            report("detector", Ok(text));
            Some(Arc::new(Mutex::new(network)))
        }
        Err(error) => {
            report("detector", Err(error));
            None
        }
    };
    let onnxruntime = config.detector.onnxruntime.as_deref();
    match ScreenHandle::start(&config.screen, onnxruntime).await {
        Ok(Some(screen)) => {
            let size = screen.input_format().size;
            report("screen", Ok(format!("input {size}")));
        }
        Ok(None) => {}
        Err(error) => report("screen", Err(error.into())),
    }
    for camera in &config.cameras {
        if let Some(settings) = camera.source_settings(config.frame) {
            let key = format!("camera.{}.source", camera.name);
            let arrived = try_source(settings).await;
            let limits = config.frame;
            let mount = camera.mount();
            let network = network.clone();
            let detector = Arc::clone(&detector);
            let tried = tokio::task::spawn_blocking(move || {
                let picture = arrived?.mounted(mount.as_ref());
                let detector = network.as_deref().map(|network| OpenDetector {
                    network,
                    config: &detector,
                });
                try_picture(&picture, &limits, detector)
            });
            report(&key, tried.await.unwrap_or_else(|error| Err(error.into())));
        }
    }
    if config.mqtt.broker.is_some() {
        report(
            "mqtt.broker",
            Mqtt::try_to_connect(&config.mqtt).await.map_err(Into::into),
        );
    }
    for (index, hook) in config.hooks.iter().enumerate() {
        if hook.posts() {
            let tried = Hook::connects(hook).await;
            report(&format!("hook[{index}]"), tried.map_err(Into::into));
        }
    }
    if config.uplink.is_set() {
        report("uplink.connect", try_hub(config).await);
    } else if !config.zenoh.connect.is_empty() && config.zenoh.config_file.is_none() {
        report("zenoh.connect", try_router(config).await);
    }
}

/// Awaits `opening`, with a time limit.
async fn in_time(
    endpoints: &[String],
    opening: impl Future<Output = Result<Session, ServiceError>>,
) -> Result<Session, TrialFailure> {
    let silent = |_| {
        let endpoints = shown_endpoints(endpoints);
        let seconds = ANSWER.as_secs();
        format!("{endpoints} did not answer in {seconds} s")
    };
    Ok(tokio::time::timeout(ANSWER, opening).await.map_err(silent)??)
}

/// A detector that works.
struct OpenDetector<'a> {
    network: &'a Mutex<DetectorNetwork>,
    config: &'a DetectorConfig,
}

/// Decodes the picture of a camera and, if there is a detector, runs it on the picture; if a GPU runs it, on the CPU, too.
fn try_picture(
    picture: &EncodedPicture,
    limits: &FrameLimits,
    detector: Option<OpenDetector<'_>>,
) -> Result<String, TrialFailure> {
    let unusable = |reason: &dyn Display| -> TrialFailure {
        format!("a picture arrived that cannot be used: {reason}").into()
    };
    let mut decoded = Picture::default();
    decode(picture, limits, PixelLayout::Rgb8, None, &mut decoded)
        .map_err(|fault| unusable(&fault))?;
    let kilobytes = picture.bytes.len().div_ceil(1000);
    let mut text = format!(
        "a picture of {} arrived and was decoded, {kilobytes} kB as {}",
        picture.size,
        picture.format.as_str()
    );
    let Some(OpenDetector { network, config }) = detector else {
        return Ok(text);
    };
    let mut network = network.lock();
    let before = network.counts();
    let prepared = network.preparation().prepare(&decoded).map_err(|fault| unusable(&fault))?;
    let found = network.detect(&prepared)?;
    if let Some(doubt) = network.doubt() {
        return Err(format!("the detector finds only what is impossible: {doubt}").into());
    }
    let mut classes: Vec<&str> = found
        .detections
        .iter()
        .filter_map(|detection| network.class_names().get(usize::from(detection.class.0)))
        .map(String::as_str)
        .collect();
    classes.sort_unstable();
    classes.dedup();
    text.push_str(&format!("; the detector finds {}", found.detections.len()));
    if !classes.is_empty() {
        text.push_str(&format!(" ({})", classes.join(", ")));
    }
    let left_out = network.counts().other_class - before.other_class;
    if left_out > 0 {
        text.push_str(&format!(" and {left_out} of classes that are not reported"));
    }
    let smallest = network.input().smallest_for(decoded.source_size);
    let inputs = network.preparation().inputs();
    if let Some(input) = inputs.iter().find(|input| input.smallest.size == smallest) {
        text.push_str(&format!("; {input}"));
    }
    let provider = network.provider();
    if provider != ExecutionProvider::Cpu {
        let agreement = compare_with_cpu(config, provider, &prepared, &found.detections)?;
        if !agreement.agrees() {
            return Err(format!("{text}; {agreement}").into());
        }
        text.push_str(&format!("; {agreement}"));
    }
    Ok(text)
}

/// Returns the detector, and in words how it is read, the provider that runs it, and the time of a run.
fn try_detector(config: &DetectorConfig) -> Result<(DetectorNetwork, String), TrialFailure> {
    let begun = Instant::now();
    let mut network = DetectorNetwork::open(config)?;
    let loaded = begun.elapsed();
    let largest = network.input_format().size;
    let mut times = format!("{:.1} ms per picture", median(&mut network, largest)?);
    let usual = network.input().first_use(USUAL_PICTURE).smallest.size;
    if network.input().open.is_some() && usual != largest {
        let usual_ms = median(&mut network, usual)?;
        times = format!("{times} at {largest}, {usual_ms:.1} ms for 16:9");
    }
    let provider = network.provider();
    let mut text = format!(
        "runs on {}, {times} (median of {PICTURES}), loaded in {:.1} s; {}; reports {}",
        provider.as_str(),
        loaded.as_secs_f64(),
        network.description(),
        named_classes(network.class_names()).join(", "),
    );
    if !network.left_out().is_empty() {
        let others = network.left_out().len();
        text.push_str(&format!(" and not {others} other classes of the model"));
    }
    if let Some(first) = config.providers.first()
        && *first != provider
    {
        text.push_str(&format!(
            "; `{}` does not work here, and detector.providers lists another after it",
            first.as_str()
        ));
    }
    Ok((network, text))
}

/// The median time of a run on a black picture at an input of `size`, in milliseconds.
fn median(network: &mut DetectorNetwork, size: PictureSize) -> Result<f64, TrialFailure> {
    let mut took = Vec::with_capacity(PICTURES);
    for _ in 0..PICTURES {
        took.push(network.time_at(size)?);
    }
    took.sort();
    Ok(took.get(PICTURES / 2).copied().map_or(0.0, milliseconds))
}

/// Waits for the first picture.
async fn try_source(settings: SourceSettings) -> Result<EncodedPicture, TrialFailure> {
    let patience = settings.silence.clamp(FIRST_PICTURE, Duration::from_secs(600)) + ANSWER;
    let source = tokio::task::spawn_blocking(move || LiveSource::find(settings)).await??;
    let (sender, mut found) = channel(1);
    let stop = CancellationToken::new();
    let each = move |event| {
        // Only the first event is awaited; after a file that is passed over, another may be played.
        if !matches!(event, SourceEvent::PassedOver(_)) {
            let _ = sender.try_send(event);
        }
    };
    let running = tokio::spawn(source.run(each, stop.clone()));
    let first = tokio::time::timeout(patience, found.recv()).await;
    stop.cancel();
    running.await??;
    match first {
        Ok(Some(SourceEvent::Picture(taken))) => {
            let unusable = |fault| format!("a picture arrived that cannot be used: {fault}");
            Ok(taken.picture.map_err(unusable)?)
        }
        Ok(Some(SourceEvent::Failed { reason, .. })) => Err(reason.into()),
        Ok(Some(SourceEvent::PassedOver(file))) => Err(file.to_string().into()),
        Ok(None) => Err("the reader of the source ended".into()),
        Err(_) => Err(format!("no picture in {} s", patience.as_secs()).into()),
    }
}

/// Tries to reach the router, as a client that does not listen: the ports belong to the running node.
async fn try_router(config: &NodeConfig) -> Result<String, TrialFailure> {
    let client = ZenohConfig {
        mode: ZenohMode::Client,
        listen: Vec::new(),
        ..config.zenoh.clone()
    };
    let endpoints = &client.connect;
    let limit = config.frame.max_payload_bytes;
    let is_patient = false;
    let opening = session::open(&client, limit, &[], is_patient, |_| {});
    close(in_time(endpoints, opening).await?).await;
    Ok(format!("{} answers", shown_endpoints(endpoints)))
}

/// Tries to find a hub that accepts reports behind its router.
async fn try_hub(config: &NodeConfig) -> Result<String, TrialFailure> {
    let uplink = &config.uplink;
    let session = in_time(&uplink.connect, session::open_uplink(uplink)).await?;
    let key = config.keys()?.report();
    let found = hub_behind(&session, key.clone()).await;
    close(session).await;
    if found.map_err(|error| session::plain(&error))? {
        return Ok("the router answers, and a hub accepts reports".to_owned());
    }
    let reason = format!(
        "the router answers, but no hub accepts reports: is the hub running, with hub.prefix as node.prefix, and does \
         the router's access control let this node's certificate use `{key}`?"
    );
    Err(reason.into())
}

/// True if somebody answers queries on `key`. Zenoh learns that a moment after the session is open.
async fn hub_behind(session: &Session, key: String) -> zenoh::Result<bool> {
    let querier = session.declare_querier(key).await?;
    let until = Instant::now() + ANSWER;
    loop {
        let is_there = querier.matching_status().await?.matching();
        if is_there || Instant::now() > until {
            return Ok(is_there);
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn close(session: Session) {
    if let Err(error) = session.close().await {
        tracing::debug!(%error, "session not closed cleanly");
    }
}
