//! Runs a node in a separate process, and cameras that send to it.

use super::arguments::Policy;
use albireo_vision::detector::DetectorConfig;
use albireo_vision::picture::EncodedPicture;
use albireo_wire::{DetectionsMessage, FrameAttachment, VERSION, read};
use anyhow::{Context, anyhow, bail};
use parking_lot::Mutex;
use std::net::TcpListener;
use std::ops::Range;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::time::MissedTickBehavior;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;

/// The frames per second of every camera.
pub(crate) const RATE: f64 = 30.0;

const NODE: &str = "gpu";

/// The time limit of a start. TensorRT takes minutes to build an engine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(1200);

/// A received answer.
pub(crate) struct Answer {
    pub camera: usize,
    pub message: DetectionsMessage,
    pub at: Instant,
}

/// A running node and a session to it.
pub(crate) struct Node {
    process: Child,
    session: Session,
    http: u16,
    answers: Arc<Mutex<Vec<Answer>>>,
    /// The start time of its process.
    pub started: Instant,
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What a node has done since its start.
#[derive(Clone, Copy)]
pub(crate) struct Work {
    /// Pictures that the detector answered.
    pub pictures: f64,
    /// Runs of the model.
    pub runs: f64,
    /// Processor time of all its threads.
    pub processor_seconds: f64,
}

/// The settings of a node.
pub(crate) struct Settings<'a> {
    pub detector: DetectorConfig,
    pub policy: &'a Policy,
    pub cameras: usize,
    /// The folder of the caches of CUDA and TensorRT.
    pub caches: &'a Path,
    pub folder: &'a Path,
}

impl Node {
    /// Starts a node. It connects to this process, so that the start includes no wait but the node's own.
    pub(crate) async fn start(settings: &Settings<'_>) -> anyhow::Result<Self> {
        let (port, http) = (free_port()?, free_port()?);
        let session = listening(port).await?;
        let answers: Arc<Mutex<Vec<Answer>>> = Arc::default();
        let kept = Arc::clone(&answers);
        session
            .declare_subscriber(format!("albireo/{NODE}/*/detections"))
            .callback(move |sample| {
                let at = Instant::now();
                let camera = sample.key_expr().split('/').nth(2);
                let camera = camera.and_then(|name| name.strip_prefix('c')?.parse().ok());
                let message = read(&sample.payload().to_bytes()).ok();
                if let (Some(camera), Some(message)) = (camera, message) {
                    kept.lock().push(Answer {
                        camera,
                        message,
                        at,
                    });
                }
            })
            .background()
            .await
            .map_err(zenoh_failed)?;
        let file = settings.folder.join("node.toml");
        std::fs::write(&file, configuration(settings, port, http)?)?;
        let program =
            std::env::var_os("ALBIREO_BIN").unwrap_or(env!("CARGO_BIN_EXE_albireo").into());
        let log = std::fs::File::create(settings.folder.join("node.log"))?;
        let started = Instant::now();
        let process = Command::new(program)
            .args(["node", "--config"])
            .arg(&file)
            .env("CUDA_CACHE_PATH", settings.caches)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .context("the program")?;
        Ok(Self {
            process,
            session,
            http,
            answers,
            started,
        })
    }

    /// Waits until the node is ready. Returns the provider that its detector really uses.
    pub(crate) async fn ready(&mut self, folder: &Path) -> anyhow::Result<String> {
        let url = format!("http://127.0.0.1:{}/readyz", self.http);
        let begun = Instant::now();
        loop {
            if let Some(status) = self.process.try_wait()? {
                let log = std::fs::read_to_string(folder.join("node.log")).unwrap_or_default();
                let last = log.lines().last().unwrap_or_default();
                bail!("the node ended ({status}): {last}");
            }
            if let Ok(answer) = reqwest::get(&url).await
                && answer.status().is_success()
            {
                let answer_json: serde_json::Value = answer.json().await?;
                let provider = answer_json["provider"].as_str();
                return Ok(provider.context("/readyz names no provider")?.to_owned());
            }
            if begun.elapsed() > PATIENCE {
                bail!("the node was not ready within {} s", PATIENCE.as_secs());
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Sends the frames of one camera with the numbers `frames`, or fewer if `until` returns `true`. Returns the time of
    /// each put.
    pub(crate) async fn send(
        &self,
        camera: usize,
        pictures: Arc<Vec<EncodedPicture>>,
        frames: Range<u64>,
        until: impl Fn() -> bool,
    ) -> anyhow::Result<Vec<Instant>> {
        let publisher = self
            .session
            .declare_publisher(format!("albireo/{NODE}/c{camera}/frame"))
            .congestion_control(CongestionControl::Drop)
            .await
            .map_err(zenoh_failed)?;
        let mut clock = tokio::time::interval(Duration::from_secs_f64(1.0 / RATE));
        clock.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut put = Vec::new();
        // Forwards and backwards, so that the objects never jump. Each camera starts at a different picture.
        let there_and_back = 2 * (pictures.len() - 1).max(1);
        for number in frames {
            if until() {
                break;
            }
            clock.tick().await;
            let place = (number as usize + camera * 7) % there_and_back;
            let picture = &pictures[place.min(there_and_back - place).min(pictures.len() - 1)];
            let attachment = FrameAttachment {
                v: VERSION,
                seq: Some(number),
                ..FrameAttachment::default()
            };
            put.push(Instant::now());
            publisher
                .put(picture.bytes.clone())
                .encoding(Encoding::IMAGE_JPEG)
                .attachment(serde_json::to_vec(&attachment)?)
                .await
                .map_err(zenoh_failed)?;
        }
        Ok(put)
    }

    /// The node's work since its start.
    pub(crate) async fn work(&self) -> anyhow::Result<Work> {
        let url = format!("http://127.0.0.1:{}/metrics", self.http);
        let metrics = reqwest::get(&url).await?.text().await?;
        let counter = |name: &str| {
            metrics
                .lines()
                .find_map(|line| line.strip_prefix(name))
                .and_then(|value| value.trim().parse::<f64>().ok())
                .with_context(|| format!("/metrics has no {name}"))
        };
        Ok(Work {
            pictures: counter("albireo_detector_runs_total{outcome=\"completed\"}")?,
            runs: counter("albireo_detector_batches_total")?,
            processor_seconds: processor_seconds_of(self.process.id())?,
        })
    }

    /// Removes and returns the answers so far.
    pub(crate) fn answers(&self) -> Vec<Answer> {
        std::mem::take(&mut *self.answers.lock())
    }

    /// The arrival time of the first answer that contains a detector result.
    pub(crate) fn first_detection(&self) -> Option<Instant> {
        let answers = self.answers.lock();
        let detected =
            |answer: &&Answer| !answer.message.degraded && !answer.message.state.is_skipped();
        answers.iter().find(detected).map(|answer| answer.at)
    }
}

/// The processor time that all threads of a process have used.
pub(crate) fn processor_seconds_of(process: u32) -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat"))?;
    // The fields after the name, which may have spaces; user and system time are the 14th and 15th of the line.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    let ticks = fields.split_whitespace().skip(11).take(2);
    let ticks: f64 = ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum();
    // Linux counts a hundred ticks a second for every program.
    Ok(ticks / 100.0)
}

fn configuration(settings: &Settings<'_>, port: u16, http: u16) -> anyhow::Result<String> {
    let mut detector = settings.detector.clone();
    detector.model = std::path::absolute(&detector.model)?;
    let mut text = format!(
        "node.name = \"{NODE}\"\nhttp.listen = \"127.0.0.1:{http}\"\nzenoh.listen = []\n\
         zenoh.connect = [\"tcp/127.0.0.1:{port}\"]\nlog.level = \"error\"\npower.source = \"none\"\n\
         policy.name = \"{}\"\n",
        settings.policy.name
    );
    if let Some(threshold) = settings.policy.threshold {
        let key = match settings.policy.name.as_str() {
            "expected-loss" => "lambda",
            _ => "u",
        };
        text += &format!("policy.{key} = {threshold:?}\n");
    }
    let sections =
        toml::Table::from_iter([("detector".to_owned(), toml::Value::try_from(detector)?)]);
    text += &toml::to_string(&sections)?;
    for camera in 0..settings.cameras {
        text += &format!("[[camera]]\nname = \"c{camera}\"\n");
    }
    Ok(text)
}

fn free_port() -> anyhow::Result<u16> {
    Ok(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port())
}

async fn listening(port: u16) -> anyhow::Result<Session> {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("scouting/multicast/enabled", "false".to_owned()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
    ] {
        config.insert_json5(key, &value).map_err(zenoh_failed)?;
    }
    zenoh::open(config).await.map_err(zenoh_failed)
}

fn zenoh_failed(error: zenoh::Error) -> anyhow::Error {
    anyhow!("Zenoh: {error}")
}
