//! Plays one run to the real node: starts a node with one policy, sends it the clip as a camera does, and collects its
//! answers.

pub(super) mod clip;

use self::clip::Extent;
use super::frames::{FrameSender, Pacing, close, open_session};
use super::replay::{PublishOptions, Sent, UNPACED, publish};
use super::values::counted;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::ThresholdSpec;
use albireo_eval::boxes::ScoredBox;
use albireo_eval::compare::{Boxes, ClassNumbers, Suggestion};
use albireo_eval::data::classes::Evaluated;
use albireo_eval::data::{Clip, GroundTruth, LoadReport};
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_eval::spec::PolicySpec;
use albireo_eval::statistics::mean;
use albireo_node::PreparedNode;
use albireo_node::camera::AnswerTime;
use albireo_node::camera::clip::LONGEST_REPORT_S;
use albireo_node::config::{CameraConfig, NodeConfig};
use albireo_node::input::Delivery;
use albireo_node::state::advice::SkipWatch;
use albireo_node::state::board::{Board, CameraBoard, Event, News};
use albireo_power::{PowerConfig, PowerHandle};
use albireo_service::config::{Configuration, LogConfig};
use albireo_service::process;
use albireo_wire::{ClipReport, DetectionsMessage, EnergyQuality};
use anyhow::{Context, anyhow, bail, ensure};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast::Receiver;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// The longest time for the node to load its model, and for the camera to find the node.
const PATIENCE: Duration = Duration::from_secs(120);

/// The time between two entries of a power trace, as in the paper.
const TRACE_PERIOD: Duration = Duration::from_millis(100);

/// The names of the node, its camera, and the clips of warm-up and measurement.
const NODE: &str = "compare";
const CAMERA: &str = "camera";
const WARM_UP: &str = "warm-up";
const MEASURED: &str = "measured";

/// Plays runs.
pub(super) struct Player {
    /// The node's configuration, which each run adapts.
    pub config: NodeConfig,
    /// The clip to play.
    pub clip: Pictures,
    /// How much of the clip that is.
    pub extent: Extent,
    /// Size of its pictures.
    pub size: PictureSize,
    /// Frames per second; `None` to send each frame once the node has accepted the previous one.
    pub rate: Option<f64>,
    /// Warm-up, seconds of the clip.
    pub warm_up_s: f64,
    /// Rest before each run.
    pub cool_down: Duration,
}

/// The results of a run.
pub(super) struct Played {
    /// The clip's report.
    pub report: ClipReport,
    /// CPU time of this process while the clip was played.
    pub cpu: Duration,
    /// CPU time of reading the power meter, as a share of one core.
    pub meter_share_of_core: f64,
    /// The most memory that this process held while the clip was played, MB; `None` if the system does not tell.
    pub memory_mb: Option<f64>,
    /// The machine's power while the clip was played, by domain.
    pub traces: Traces,
    /// The answers to the clip's frames.
    answers: Vec<Arc<DetectionsMessage>>,
}

/// The node that a run is played to.
struct RunningNode<'a> {
    board: &'a Board,
    power: PowerHandle,
    endpoints: Vec<String>,
}

/// What is measured while the clip is played.
struct Measured {
    cpu: Duration,
    memory_mb: Option<f64>,
    traces: Traces,
}

/// Power by domain: seconds since a clip's first frame, and watts.
type Traces = BTreeMap<String, Vec<[f64; 2]>>;

impl Played {
    /// Suggests a threshold, if no frame was skipped although objects were tracked.
    pub(super) fn advice(&self, spec: Option<ThresholdSpec>) -> Option<Suggestion> {
        let spec = spec?;
        let mut watch = SkipWatch::default();
        for answer in &self.answers {
            watch.count(answer);
        }
        let advice = watch.advice_so_far(&spec)?;
        Some(Suggestion {
            threshold: advice.threshold,
            value: advice.attempt,
        })
    }

    /// The mean time of a frame until its answer, milliseconds. Without a rate the next frame is sent while the node
    /// works on the one before: its wait there says nothing about the node, and is left out. `None` if no frame was
    /// answered.
    pub(super) fn frame_ms(&self, rate: Option<f64>) -> Option<f64> {
        let times = self.answers.iter().map(|answer| match rate {
            Some(_) => answer.latency_ms.total,
            None => answer.latency_ms.total - answer.latency_ms.waiting,
        });
        mean(times)
    }

    /// The answers to the clip's frames.
    pub(super) fn answers(&self) -> impl Iterator<Item = &DetectionsMessage> {
        self.answers.iter().map(AsRef::as_ref)
    }

    /// Returns the boxes of each frame that ground truth can judge, of a clip of `frames` frames of which the first has
    /// the sequence number `first`; a frame without an answer has none. Boxes of classes that are not `evaluated` are
    /// counted in `left_out`.
    pub(super) fn judged_boxes(
        &self,
        first: u64,
        frames: usize,
        evaluated: &Evaluated,
        left_out: &mut BTreeMap<String, u64>,
    ) -> Vec<Vec<ScoredBox>> {
        let mut boxes = vec![Vec::new(); frames];
        for answer in self.answers() {
            // What is below is a frame of the warm-up.
            let Some(frame) = answer.seq.checked_sub(first) else {
                continue;
            };
            let Some(place) = boxes.get_mut(frame as usize) else {
                continue;
            };
            for found in &answer.boxes {
                let Ok(class) = evaluated.find(&found.class) else {
                    *left_out.entry(found.class.clone()).or_default() += 1;
                    continue;
                };
                let [x1, y1, x2, y2] = found.corners.map(f64::from);
                place.push(ScoredBox {
                    corners: Corners { x1, y1, x2, y2 },
                    class,
                    confidence: f64::from(found.confidence),
                    object: None,
                });
            }
        }
        boxes
    }

    /// Returns the boxes of the clip's frames, of which the first has the sequence number `first`.
    pub(super) fn boxes(&self, first: u64, classes: &mut ClassNumbers) -> Boxes {
        let mut boxes = Boxes::default();
        for answer in &self.answers {
            // What is below is a frame of the warm-up.
            if let Some(frame) = answer.seq.checked_sub(first) {
                boxes.insert(frame, classes.boxes(answer));
            }
        }
        boxes
    }
}

impl Player {
    /// The number of frames that a run sends, including the warm-up.
    pub(super) fn frames_of_a_run(&self) -> u64 {
        self.warm_up_frames() + self.clip.frames().unwrap_or_default()
    }

    /// The number of frames of the warm-up, after which the clip begins.
    pub(super) fn warm_up_frames(&self) -> u64 {
        let rate = self.rate.unwrap_or_else(|| self.clip.rate());
        (self.warm_up_s * rate).round() as u64
    }

    /// Rests, then plays the clip to a new node under `policy`. `progress` gets the number of frames sent and the
    /// current step.
    ///
    /// # Errors
    /// When the node cannot start or does not answer, or on `shutdown`.
    pub(super) async fn play(
        &self,
        policy: &PolicySpec,
        progress: impl Fn(u64, &str),
        shutdown: &CancellationToken,
    ) -> anyhow::Result<Played> {
        let delivery = match self.rate {
            Some(_) => Delivery::Newest,
            None => Delivery::Every,
        };
        let config = configuration(&self.config, policy, delivery)?;
        progress(0, "rest");
        tokio::select! {
            () = tokio::time::sleep(self.cool_down) => {}
            () = shutdown.cancelled() => bail!("stopped"),
        }
        progress(0, "loading the model");
        let prepared = PreparedNode::new(&config)?;
        let board = Arc::clone(prepared.board());
        let ended = CancellationToken::new();
        let collecting = tokio::spawn(collect(board.subscribe(), ended.clone()));
        let stop = shutdown.child_token();
        let starting = prepared.start(&config, stop.clone());
        let started = shutdown.run_until_cancelled(starting).await;
        let node = started.context("stopped")??;
        let running = RunningNode {
            board: &board,
            power: node.power(),
            endpoints: node.endpoints().await,
        };
        let stopped = tokio::spawn(node.stopped());
        let played = tokio::select! {
            played = self.play_to(running, &config, &progress, shutdown) => played,
            () = shutdown.cancelled() => Err(anyhow!("stopped")),
        };
        // The clip ends with the node; its report is on the board once the node has stopped.
        stop.cancel();
        stopped.await.context("the node")??;
        ended.cancel();
        let measured = played?;
        let answers = collecting.await.context("the node's answers")??;
        let at_any_time = None;
        let reports = board.recent_clips(Some(CAMERA), at_any_time, at_any_time, usize::MAX);
        let report = reports
            .iter()
            .find(|report| report.clip == MEASURED)
            .context("the node reported no clip")?;
        ensure!(
            report.part == 0,
            "the clip took more than {LONGEST_REPORT_S} s, which one report cannot cover: {}",
            self.extent.way_out()
        );
        Ok(Played {
            report: ClipReport::clone(report),
            cpu: measured.cpu,
            memory_mb: measured.memory_mb,
            traces: measured.traces,
            meter_share_of_core: board.power().meter_share_of_core(),
            answers,
        })
    }

    /// Plays warm-up and clip to a running node.
    async fn play_to(
        &self,
        node: RunningNode<'_>,
        config: &NodeConfig,
        progress: &impl Fn(u64, &str),
        shutdown: &CancellationToken,
    ) -> anyhow::Result<Measured> {
        let key = config.keys()?.camera(CAMERA)?.frame();
        let camera = node.board.camera(CAMERA).context("the camera is not on the board")?;
        let session = open_session(&node.endpoints, &[], PATIENCE).await?;
        let pacing = match self.rate {
            Some(_) => Pacing::WaitForNetwork,
            None => Pacing::WaitForNode,
        };
        let sender = FrameSender::declare(&session, &key, pacing).await?;
        sender.wait_for_receiver(PATIENCE).await?;

        let warm_up = self.warm_up_frames();
        if warm_up > 0 {
            let options = PublishOptions {
                repeat: true,
                frames: Some(warm_up),
                clip: Some(WARM_UP.to_owned()),
                ..PublishOptions::default()
            };
            let report = |sent| progress(sent, "warm-up");
            self.send(&sender, options, report, shutdown).await?;
            self.answered(camera, warm_up).await?;
        }
        let options = PublishOptions {
            clip: Some(MEASURED.to_owned()),
            first_sequence: warm_up,
            ..PublishOptions::default()
        };
        let before = process_cpu();
        // Where the peak cannot be forgotten, it would be that of an earlier run.
        let is_peak_own = process::forget_peak_memory();
        let ended = CancellationToken::new();
        let tracing = tokio::spawn(trace(node.power, ended.clone()));
        // The trace ends with this function, whatever its end.
        let _ended = ended.clone().drop_guard();
        let report = |sent| progress(warm_up + sent, "playing");
        self.send(&sender, options, report, shutdown).await?;
        if let Some(rate) = self.rate {
            // The last frame's time is part of the clip.
            tokio::time::sleep(Duration::from_secs_f64(1.0 / rate)).await;
        }
        self.answered(camera, self.frames_of_a_run()).await?;
        let cpu = process_cpu().saturating_sub(before);
        ended.cancel();
        let peak_bytes = if is_peak_own {
            process::peak_memory_bytes()
        } else {
            None
        };
        let measured = Measured {
            cpu,
            memory_mb: peak_bytes.map(|bytes| bytes as f64 / 1e6),
            traces: tracing.await.context("the power trace")?,
        };
        close(session).await?;
        Ok(measured)
    }

    /// Sends the clip at the comparison's rate.
    async fn send(
        &self,
        sender: &FrameSender,
        options: PublishOptions,
        report: impl Fn(u64),
        shutdown: &CancellationToken,
    ) -> anyhow::Result<()> {
        let options = PublishOptions {
            rate: Some(self.rate.unwrap_or(UNPACED)),
            ..options
        };
        let clip = Box::new(self.clip.clone());
        let send = |frame| sender.send(frame);
        let progress = |sent: &Sent| report(sent.frames);
        publish(clip, send, &options, progress, shutdown).await?;
        Ok(())
    }

    /// Waits until the node has answered or dropped `frames` frames.
    async fn answered(&self, camera: &CameraBoard, frames: u64) -> anyhow::Result<()> {
        let patience = PATIENCE + Duration::from_millis(self.config.detector.timeout_ms);
        let start = Instant::now();
        loop {
            let snapshot = camera.snapshot();
            let settled = snapshot.states.frames() + snapshot.dropped.total();
            if settled >= frames {
                return Ok(());
            }
            if start.elapsed() > patience {
                bail!(
                    "the node answered {settled} of {frames} frames within {} s",
                    patience.as_secs()
                );
            }
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }
}

/// Returns the configuration of a run under `policy`: of `base`, what decides, detects and measures, with one camera, a
/// local endpoint and no stored state. Whatever else a node does, such as reports to a hub, recordings, hooks and MQTT,
/// is left out: it would tell others of pictures that no camera has seen.
fn configuration(
    base: &NodeConfig,
    policy: &PolicySpec,
    delivery: Delivery,
) -> anyhow::Result<NodeConfig> {
    let mut config = played_of(base);
    config.policy.clone_from(&policy.config);
    config.screen.pause_s = policy.empty_road.pause_s;
    config.screen.after_s = policy.empty_road.after_s;
    config.cameras[0].delivery = delivery;
    match config.findings().into_iter().next() {
        Some(problem) => bail!("{problem}"),
        None => Ok(config),
    }
}

/// What all runs take of the configuration `base`. Only what is taken here can change a run.
pub(super) fn played_of(base: &NodeConfig) -> NodeConfig {
    let mut config = NodeConfig {
        detector: base.detector.clone(),
        screen: base.screen.clone(),
        policy: base.policy.clone(),
        report: base.report,
        publish: base.publish,
        audit: base.audit,
        frame: base.frame,
        power: base.power.clone(),
        log: base.log.clone(),
        cameras: vec![CameraConfig::named(CAMERA)],
        ..NodeConfig::default()
    };
    config.node.name = NODE.to_owned();
    // `vanilla` cannot answer at once, so all policies wait for the detector.
    config.node.answer = AnswerTime::WhenKnown;
    config.zenoh.listen = vec!["tcp/127.0.0.1:0".to_owned()];
    // Neither a pause of the machine nor its slowness may cut the clip.
    config.clip.silence_s = LONGEST_REPORT_S;
    config.clip.longest_s = LONGEST_REPORT_S;
    config
}

/// The configuration of the nodes that runs are played to: that of `file`, with another `detector` if one is named.
/// `log_level` takes the place of the default level, at which the node of each run would write its start and its end.
///
/// # Errors
/// When the file is invalid, or there is no detector.
pub(super) fn node_configuration(
    file: Option<&Path>,
    detector: Option<&Path>,
    log_level: &str,
) -> anyhow::Result<NodeConfig> {
    let mut config = super::node::configuration(file)?;
    if let Some(model) = detector {
        config.detector.model = model.to_path_buf();
    }
    let model = &config.detector.model;
    ensure!(
        model.is_file(),
        "{}: no such file; run this in the project's folder, or name an ONNX file with --detector or --config",
        model.display()
    );
    if config.log.level == LogConfig::default().level {
        log_level.clone_into(&mut config.log.level);
    }
    Ok(config)
}

/// Refuses a paced clip of `frames` frames at `rate` frames per second if one report cannot cover it.
///
/// # Errors
/// When it cannot: the error says how long the clip takes, and the `way_out`.
pub(super) fn check_pace(frames: u64, rate: f64, way_out: &str) -> anyhow::Result<()> {
    let seconds = frames as f64 / rate;
    ensure!(
        seconds <= LONGEST_REPORT_S,
        "{} at {rate} frames/s take {seconds:.0} s, and one report covers {LONGEST_REPORT_S} s at most: {way_out}",
        counted(frames, "frame", "frames")
    );
    Ok(())
}

/// The clip of `source`, without detections and with its whole ground truth; `is_alone` and `report` as for
/// [`GroundTruth::attach_to`].
///
/// # Errors
/// When the ground truth is for other pictures.
pub(super) fn with_truth(
    truth: &mut GroundTruth,
    source: &dyn FrameSource,
    size: PictureSize,
    is_alone: bool,
    report: &mut LoadReport,
) -> anyhow::Result<Clip> {
    let frames = usize::try_from(source.frames().unwrap_or_default())?;
    let mut clip = Clip::new(source.name().to_owned(), size, frames);
    clip.file_names = source.file_names();
    truth.attach_to(&mut clip, is_alone, Some(frames), report)?;
    Ok(clip)
}

/// Sets the power meter in `config` to the one that can be used, so that every run uses the same one and unusable
/// meters are reported once. Returns its name.
pub(super) async fn choose_meter(config: &mut PowerConfig) -> anyhow::Result<String> {
    let wanted = config.clone();
    let opened = tokio::task::spawn_blocking(move || {
        let (source, meter) = albireo_power::open(&wanted)?;
        anyhow::Ok((source, meter.quality()))
    });
    let (source, quality) = opened.await.context("the power meter")??;
    config.source = source;
    let name = match quality {
        EnergyQuality::Measured => format!("{} (measured)", source.as_str()),
        EnergyQuality::Estimated => "no meter, estimated".to_owned(),
        _ => "no meter".to_owned(),
    };
    Ok(name)
}

/// Collects the answers to the clip's frames until the node has `ended`.
async fn collect(
    mut events: Receiver<Arc<Event>>,
    ended: CancellationToken,
) -> anyhow::Result<Vec<Arc<DetectionsMessage>>> {
    let mut answers = Vec::new();
    loop {
        let event = tokio::select! {
            biased;
            event = events.recv() => event.context("the node's answers")?,
            () = ended.cancelled() => return Ok(answers),
        };
        if let News::Frame(frame) = &event.news
            && frame.detections.clip == MEASURED
        {
            answers.push(Arc::clone(&frame.detections));
        }
    }
}

/// Collects the machine's power by domain until `ended`: seconds since the start, and the mean watts since the entry
/// before.
async fn trace(power: PowerHandle, ended: CancellationToken) -> Traces {
    let start = Instant::now();
    let mut traces = Traces::new();
    let mut before = power.snapshot();
    let mut ticks = tokio::time::interval(TRACE_PERIOD);
    while ended.run_until_cancelled(ticks.tick()).await.is_some() {
        let now = power.snapshot();
        // Without a new sample there is nothing to tell.
        if now.sampled_s <= before.sampled_s {
            continue;
        }
        let newest = now.clone().since(&before);
        for domain in now.joules.keys() {
            if let Some((joules, seconds)) = newest.energy(domain) {
                let entry = [start.elapsed().as_secs_f64(), joules / seconds];
                traces.entry(domain.clone()).or_default().push(entry);
            }
        }
        before = now;
    }
    traces
}

/// The CPU time of all threads of this process so far.
fn process_cpu() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    Duration::new(seconds, u32::try_from(time.tv_nsec).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::policy::EmptyRoad;
    use albireo_eval::compare::variants;
    use albireo_eval::spec::Base;
    use albireo_wire::Target;

    fn played(answers: Vec<Arc<DetectionsMessage>>) -> Played {
        Played {
            report: ClipReport::default(),
            cpu: Duration::ZERO,
            memory_mb: None,
            traces: Traces::new(),
            meter_share_of_core: 0.0,
            answers,
        }
    }

    #[test]
    fn a_run_without_an_answer_has_no_mean_time_of_a_frame() {
        let unanswered = played(Vec::new());
        assert_eq!(unanswered.frame_ms(None), None);
        assert_eq!(unanswered.frame_ms(Some(30.0)), None);
    }

    #[test]
    fn an_unpaced_frame_takes_no_longer_for_waiting_behind_the_one_before() {
        let answer = |total: f64, waiting: f64| {
            let text = format!(
                r#"{{"v":1,"seq":0,"t_ns":0,"clip":"","state":"E","width":1,"height":1,"boxes":[],
                "latency_ms":{{"total":{total},"waiting":{waiting},"policy":0}}}}"#
            );
            Arc::new(serde_json::from_str(&text).unwrap())
        };
        let played = played(vec![answer(31.0, 16.0), answer(30.0, 15.0)]);
        assert_eq!(played.frame_ms(None), Some(15.0));
        assert_eq!(played.frame_ms(Some(30.0)), Some(30.5));
    }

    #[test]
    fn a_paced_clip_of_more_than_an_hour_is_refused_with_its_time_and_the_way_out() {
        assert!(check_pace(3600, 1.0, "split it").is_ok());
        let refused = check_pace(5000, 1.0, "split it").unwrap_err().to_string();
        let said =
            "5000 frames at 1 frames/s take 5000 s, and one report covers 3600 s at most: split it";
        assert_eq!(refused, said);
    }

    /// The configuration of a run under `policy`, written as on the command line.
    fn configuration_of(base: &NodeConfig, policy: &str) -> NodeConfig {
        let settings = Base {
            config: &base.policy,
            empty_road: EmptyRoad::default(),
        };
        // A comparison has two policies or more.
        let asked = [policy, "fixed-skip"].map(str::to_owned);
        let policies = variants(&asked, &[], settings).unwrap();
        configuration(base, &policies[0], Delivery::Newest).unwrap()
    }

    const POLICIES: [&str; 2] = ["albireo", "vanilla"];

    /// A node that does all that a run must not do.
    fn busy_node() -> NodeConfig {
        let mut base = NodeConfig::default();
        base.node.state_dir = Some("/var/lib/albireo".into());
        base.zenoh.connect = vec!["tcp/hub.example:7447".to_owned()];
        base.uplink.connect = vec!["tls/hub.example:7447".to_owned()];
        base.target.hold = Some(Target::SkipRate(0.5));
        base.node.answer = AnswerTime::AtOnce;
        base.settle.enabled = true;
        base.clip.longest_s = 60.0;
        base.mqtt.broker = Some("mqtt://house.example".to_owned());
        base.record.folder = Some("/var/lib/albireo/recordings".into());
        base
    }

    #[test]
    fn a_run_reports_to_no_hub_and_no_broker_and_is_not_recorded() {
        let NodeConfig { mqtt, record, .. } = NodeConfig::default();
        for policy in POLICIES {
            let config = configuration_of(&busy_node(), policy);
            assert!(!config.uplink.is_set());
            assert_eq!(config.zenoh.connect, [""; 0]);
            assert_eq!(config.mqtt, mqtt);
            assert_eq!(config.record, record);
        }
    }

    #[test]
    fn a_run_holds_no_target_and_keeps_no_state() {
        for policy in POLICIES {
            let config = configuration_of(&busy_node(), policy);
            assert_eq!(config.target.hold, None);
            assert_eq!(config.node.state_dir, None);
        }
    }

    #[test]
    fn a_run_answers_each_frame_once_when_the_detector_has() {
        for policy in POLICIES {
            let config = configuration_of(&busy_node(), policy);
            assert_eq!(config.node.answer, AnswerTime::WhenKnown);
            assert!(!config.settle.enabled);
        }
    }

    #[test]
    fn a_slow_run_of_a_long_clip_is_one_report() {
        for policy in POLICIES {
            let config = configuration_of(&busy_node(), policy);
            assert_eq!(config.clip.longest_s, 3600.0);
        }
    }

    #[test]
    fn a_run_pauses_on_an_empty_road_only_if_its_policy_says_so() {
        let base = NodeConfig::default();
        assert_eq!(configuration_of(&base, "albireo").screen.pause_s, 0.0);
        let pausing = configuration_of(&base, "albireo:1e-3,pause_s=0.2");
        assert_eq!(pausing.screen.pause_s, 0.2);
    }
}
