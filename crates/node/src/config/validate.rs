//! Checks a configuration's values beyond their types.

use super::{CameraConfig, NodeConfig, ros_domain};
use crate::camera::AnswerTime;
use crate::camera::clip::LONGEST_REPORT_S;
use crate::input::source::{RtspTransport, SourceAddress, SourceKind};
use crate::input::{Delivery, check_topic};
use crate::recorder::Occasion;
use crate::state::board::SightingsConfig;
use albireo_core::policy::{Albireo, ExpectedLoss, LatePolicy, Policy, ThresholdSpec, no_pause};
use albireo_core::target::{Target, ThresholdRange};
use albireo_service::config::{Configuration, DAY_S, Finding, Findings};
use albireo_wire::{MOST_CAMERAS, check_camera_name, check_node_name};
use std::collections::{HashMap, HashSet};
use zenoh::key_expr::KeyExpr;

const WRITTEN: &str = "is what this node writes or answers itself; frames need a key of their own";
const NO_SOURCE: &str = "applies only to a camera with a source, and this one has none";
const FOR_FFMPEG: &str =
    "is for ffmpeg; in a GStreamer pipeline name the decoder as one of its elements";
const BESIDE_SOURCE: &str = "is set together with source: frames come from one or the other";
const BESIDE_KEY: &str = "is set together with key: leave the key out, the topic says it";
const NEVER_WAITS: &str =
    "`every` needs a sender that waits, which a source does not: use `albireo replay --every`";

impl Configuration for NodeConfig {
    const SECTIONS: &'static [&'static str] = &[
        "NODE",
        "ZENOH",
        "UPLINK",
        "OUTBOX",
        "HTTP",
        "DETECTOR",
        "SCREEN",
        "POLICY",
        "TARGET",
        "REPORT",
        "PUBLISH",
        "SETTLE",
        "AUDIT",
        "RECORD",
        "SIGHTINGS",
        "MQTT",
        "CLIP",
        "FRAME",
        "POWER",
        "POSITION",
        "LOG",
        "HOOK",
        "TOKEN",
    ];

    const REMOVED: &'static str = "\
node.hub_wins: a value set at the node stays until the hub desires a new one
node.stop_timeout_s: stopping takes at most 5 s
node.camera_silence_s: a camera counts as silent after 30 s without a frame
outbox.max_bytes: the file of reports takes at most 256 MiB
outbox.gather_reports: 12 reports go together; outbox.gather_s = 0 sends each at once
outbox.answer_timeout_ms: a hub may take 10 s to answer a batch
outbox.retry_min_ms: a batch is sent again after 1 s, then after pauses that double up to 60 s
outbox.retry_max_ms: a batch is sent again after 1 s, then after pauses that double up to 60 s
outbox.status_s: the hub sets the time between heartbeats
uplink.retry_max_ms: the connection to the router is retried after at most 30 s
uplink.verify_name: the router's certificate is always compared with its name: `albireo cert` takes \
    several names and addresses
uplink.user: a node identifies itself by uplink.certificate, which `albireo cert` creates
uplink.password_file: a node identifies itself by uplink.certificate, which `albireo cert` creates
http.timeout_ms: a request may take 10 s
http.idle_timeout_ms: a connection that is silent for 30 s is closed
http.max_connections: 256 connections may be open at a time
detector.suppression_per_class: boxes of one class suppress each other
detector.most_detections: a frame has at most 300 detections
detector.batch_wait_ms: a frame waits for those that are likely to come within the time of a run
detector.may_fall_back: each provider in detector.providers replaces those before it if they fail: list a single \
    one to allow no other
detector.gpu.device: the environment variable CUDA_VISIBLE_DEVICES chooses the GPU
detector.gpu.memory_limit_mib: there is no limit but the card's memory
screen.empty_class: the first of the network's two outputs means \"empty\"
screen.timeout_ms: a verdict that takes longer than 1 s counts as \"not empty\"
screen.longest_empty_run: the detector runs after 100 empty frames in a row
power.sysfs: sysfs is read at /sys
power.procfs: procfs is read at /proc
power.nvpmodel: nvpmodel is looked for in PATH
power.nvml_cards: all cards of the machine count
power.sudo: power.tegrastats may name a script that runs `exec sudo -n tegrastats \"$@\"`
camera.ring: two frames may wait
camera.source_timeout_s: a source without a picture for 15 s is opened again
policy.albireo: its numbers are those of the paper or of its published code: choose by policy.profile
policy.expected_loss: its numbers are fitted to recordings and fixed; `expected-loss+flow` in policy.name follows \
    boxes in pictures
audit.wait_s: a drawn frame waits 5 s for the detector
uplink.lease_ms: the lease of the uplink is 120 s
uplink.reopen_s: after 300 s without an answer the uplink is opened again
frame.max_width: frame.max_pixels limits columns times rows
frame.max_height: frame.max_pixels limits columns times rows
frame.max_decoded_bytes: frame.max_pixels limits columns times rows
power.source = battery: a battery updates its figures too rarely to measure clips; `estimate` works on every \
    machine
power.source = sum: name one meter in power.source: `rapl` for the processor or `nvml` for the cards
power.sum: name one meter in power.source: `rapl` for the processor or `nvml` for the cards
power.gpu_idle_watts: the estimate is of the processor alone; a GPU needs a meter (`ina`, `tegrastats`, `nvml`)
power.gpu_busy_watts: the estimate is of the processor alone; a GPU needs a meter (`ina`, `tegrastats`, `nvml`)";

    /// Does not check that files exist: a missing file is reported when it is opened.
    fn findings(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        self.check_names(&mut findings);
        self.zenoh.check(&mut findings);
        self.uplink.check(&mut findings);
        findings.count("outbox.gather_s", self.outbox.gather_s, 0, 86_400);
        findings.within("outbox.offline_h", self.outbox.offline_h, 0.0, 8760.0);
        self.http.check(&self.tokens, &mut findings);
        self.check_models(&mut findings);
        if self.publish.ros2 {
            findings.check("publish.ros2", ros_domain());
        }
        self.check_figures(&mut findings);
        self.check_forwarding(&mut findings);
        self.log.check(&mut findings);
        let policy = self.check_policy(&mut findings);
        self.check_pause(policy.as_deref(), &mut findings);
        let valid = policy.as_ref().map(|policy| ValidPolicy {
            threshold: policy.threshold_spec(),
        });
        self.check_answers(policy, &mut findings);
        self.check_target(valid.as_ref(), &mut findings);
        self.check_cameras(valid.as_ref(), &mut findings);
        findings.0
    }
}

/// A policy that can be built.
struct ValidPolicy {
    /// Its threshold, if it has one.
    threshold: Option<ThresholdSpec>,
}

/// Who puts messages on a key.
enum KeyOwner<'a> {
    Node,
    /// The camera of this name.
    Camera(&'a str),
}

impl NodeConfig {
    fn check_names(&self, findings: &mut Findings) {
        let name = check_node_name(&self.node.name);
        if findings.check("node.name", name).is_some() {
            findings.check("node.prefix", self.keys());
        }
        findings.path("node.state_dir", self.node.state_dir.as_deref());
        findings.above_zero("node.stuck_after_s", self.node.stuck_after_s, DAY_S);
    }

    fn check_models(&self, findings: &mut Findings) {
        for (key, path) in self.model_files() {
            findings.path(key, path);
        }
        for (key, reason) in self.detector.problems() {
            findings.add(format!("detector.{key}"), reason);
        }
        if let Some((key, reason)) = self.screen.empty_road().problem() {
            findings.add(format!("screen.{key}"), reason);
        }
        let library = self.detector.onnxruntime.as_deref();
        findings.path("detector.onnxruntime", library);
    }

    fn check_figures(&self, findings: &mut Findings) {
        let confidence = self.report.confidence.unwrap_or(0.0);
        findings.within("report.confidence", confidence, 0.0, 1.0);
        findings.within("audit.share", self.audit.share, 0.0, 1.0);
        findings.above_zero("clip.window_s", self.clip.window_s, DAY_S);
        findings.above_zero("clip.longest_s", self.clip.longest_s, LONGEST_REPORT_S);
        findings.above_zero("clip.silence_s", self.clip.silence_s, DAY_S);
        // More than a day is reported already.
        if self.clip.window_s > self.clip.longest_s && self.clip.window_s <= DAY_S {
            findings.add("clip.window_s", "is above clip.longest_s: raise that too");
        }
        let largest = self.frame.max_payload_bytes as u64;
        findings.count("frame.max_payload_bytes", largest, 1, 1 << 30);
        self.record.check(findings);
        if self.record.when.contains(&Occasion::Audit) && self.audit.share == 0.0 {
            findings.add("record.when", "`audit` needs an audit: audit.share is 0");
        }
        for (key, reason) in self.power.problems() {
            findings.add(format!("power.{key}"), reason);
        }
    }

    fn check_forwarding(&self, findings: &mut Findings) {
        let SightingsConfig { appear_s, leave_s } = self.sightings;
        findings.within("sightings.appear_s", appear_s, 0.0, 3600.0);
        findings.within("sightings.leave_s", leave_s, 0.0, 3600.0);
        self.mqtt.check(findings);
        let cameras: Vec<_> = self.cameras.iter().map(|camera| camera.name.as_str()).collect();
        for (index, hook) in self.hooks.iter().enumerate() {
            hook.check(index, &cameras, findings);
            if hook.record && self.record.folder.is_none() {
                let reason = "is set, but nothing is recorded without record.folder";
                findings.add(format!("hook[{index}].record"), reason);
            }
        }
    }

    fn check_policy(&self, findings: &mut Findings) -> Option<Box<dyn Policy>> {
        let error = match self.policy.build() {
            Ok(policy) => return Some(policy),
            Err(error) => error.to_string(),
        };
        // The message starts with the key, which other users of the error need.
        let (key, reason) = error.split_once(": ").unwrap_or(("policy", &error));
        findings.add(key, reason);
        // An invalid name must not hide an invalid number.
        if key == "policy.name" {
            findings.check("policy.u", Albireo::THRESHOLD.check(self.policy.u));
            let lambda = ExpectedLoss::THRESHOLD.check(self.policy.lambda);
            findings.check("policy.lambda", lambda);
        }
        None
    }

    /// Checks that a pause on an empty road is not set in vain.
    fn check_pause(&self, policy: Option<&dyn Policy>, findings: &mut Findings) {
        if let Some(policy) = policy
            && self.screen.pause_s > 0.0
            && !policy.takes_pause()
        {
            let reason = format!("is set, but {}", no_pause(&self.policy.name));
            findings.add("screen.pause_s", reason);
        }
    }

    /// Checks that the policy can answer at once, and that settled frames wait long enough for the detector.
    fn check_answers(&self, policy: Option<Box<dyn Policy>>, findings: &mut Findings) {
        let at_once =
            self.cameras.iter().any(|camera| self.answer_time(camera) == AnswerTime::AtOnce);
        let longest = self.settle.longest_ms;
        findings.count("settle.longest_ms", longest, 1, 60_000);
        if !at_once {
            return;
        }
        findings.check("node.answer", policy.map(LatePolicy::new).transpose());
        let deadline = self.detector.timeout_ms;
        if self.settle.enabled && longest < deadline {
            findings.add(
                "settle.longest_ms",
                format!(
                    "is {longest}, but with answers at once the detector may take {deadline} ms \
                     (detector.timeout_ms): raise one or lower the other"
                ),
            );
        }
    }

    /// Checks the target; without a policy, only what does not depend on it.
    fn check_target(&self, policy: Option<&ValidPolicy>, findings: &mut Findings) {
        let target = self.target.hold;
        findings.check("target.hold", target.map(Target::check).transpose());
        if matches!(target, Some(Target::Recall(_))) && self.audit.share == 0.0 {
            findings.add("target.hold", "`recall` needs an audit: audit.share is 0");
        }
        let least = self.target.least;
        let most = self.target.most;
        let is_set = target.is_some() || least.is_some() || most.is_some();
        if let Some(policy) = policy
            && is_set
        {
            let threshold = policy.threshold.as_ref();
            let range = ThresholdRange::of(&self.policy.name, threshold, least, most);
            findings.check("target", range);
        }
    }

    /// Checks the cameras; without a policy, only what does not depend on it.
    fn check_cameras(&self, policy: Option<&ValidPolicy>, findings: &mut Findings) {
        if self.cameras.is_empty() {
            findings.add("camera", "is empty: a node needs at least one [[camera]]");
        }
        let number = self.cameras.len();
        if self.uplink.is_set() && number > MOST_CAMERAS {
            let reason =
                format!("names {number} cameras; a hub takes at most {MOST_CAMERAS} of a node");
            findings.add("camera", reason);
        }
        let mut names = HashSet::new();
        for (index, camera) in self.cameras.iter().enumerate() {
            let key = |name: &str| format!("camera[{index}].{name}");
            check_camera(camera, &key, findings);
            if let (Some(threshold), Some(policy)) = (camera.threshold, policy) {
                match policy.threshold {
                    Some(spec) => {
                        findings.check(key("threshold"), spec.check(threshold));
                    }
                    None => {
                        let reason = format!("policy `{}` has no threshold", self.policy.name);
                        findings.add(key("threshold"), reason);
                    }
                }
            }
            if !names.insert(camera.name.as_str()) {
                findings.add(
                    key("name"),
                    format!("two cameras are named `{}`", camera.name),
                );
            }
        }
        self.check_keys(findings);
    }

    /// Checks keys: cameras must not share one, and none may be a key that the node itself writes.
    fn check_keys(&self, findings: &mut Findings) {
        let Ok(node) = self.keys() else { return };
        let mut written = vec![node.target(), node.screen()];
        for camera in &self.cameras {
            let Ok(keys) = node.camera(&camera.name) else {
                continue;
            };
            written.extend([
                keys.detections(),
                keys.late(),
                keys.settled(),
                keys.clip(),
                keys.counters(),
                keys.threshold(),
            ]);
        }
        let mut owners: HashMap<String, KeyOwner<'_>> =
            written.into_iter().map(|key| (key, KeyOwner::Node)).collect();
        for (index, camera) in self.cameras.iter().enumerate() {
            for key in self.frame_keys(camera).unwrap_or_default() {
                let owner = KeyOwner::Camera(&camera.name);
                let reason = match owners.insert(key.clone(), owner) {
                    Some(KeyOwner::Node) => format!("`{key}` {WRITTEN}"),
                    Some(KeyOwner::Camera(other)) if other != camera.name => format!(
                        "`{key}` is the key of camera `{other}` too; each camera needs its own"
                    ),
                    // Cameras with the same name are already reported.
                    Some(KeyOwner::Camera(_)) | None => continue,
                };
                let name = if camera.topic.is_some() {
                    "topic"
                } else {
                    "key"
                };
                findings.add(format!("camera[{index}].{name}"), reason);
            }
        }
    }
}

fn check_camera(camera: &CameraConfig, key: &dyn Fn(&str) -> String, findings: &mut Findings) {
    findings.check(key("name"), check_camera_name(&camera.name));
    if let Some(frames) = &camera.key {
        match KeyExpr::try_from(frames.as_str()) {
            Ok(expression) if expression.is_wild() => findings.add(
                key("key"),
                format!(
                    "`{frames}` has a wildcard; a camera is one key, so that frames stay in order. For a camera of ROS 2 \
                     write its topic: topic = \"/camera/image_raw\""
                ),
            ),
            Ok(_) => {}
            Err(error) => findings.add(
                key("key"),
                format!("`{frames}` is not a valid Zenoh key: {error}"),
            ),
        }
    }
    if let Some(mount) = camera.mount() {
        for (name, reason) in mount.problems() {
            findings.add(key(name), reason);
        }
    }
    if let Some(topic) = &camera.topic {
        findings.check(key("topic"), check_topic(topic));
        findings.check(key("topic"), ros_domain());
    }
    check_source(camera, key, findings);
}

fn check_source(camera: &CameraConfig, key: &dyn Fn(&str) -> String, findings: &mut Findings) {
    if let Some(rate) = camera.max_rate {
        findings.above_zero(&key("max_rate"), rate, 1000.0);
    }
    if camera.hardware.as_ref().is_some_and(String::is_empty) {
        findings.add(key("hardware"), "is empty; leave the key out instead");
    }
    let source = camera.source.as_ref().map(SourceAddress::resolved);
    findings.check(key("source"), source.transpose());
    findings.check(key("source_options"), camera.source_options.check());
    let kind = camera.source.as_ref().map(SourceAddress::kind);
    let has_source = kind.is_some();
    let is_pipeline = kind == Some(SourceKind::Pipeline);
    let has_rate = camera.max_rate.is_some();
    let has_transport = camera.rtsp_transport != RtspTransport::default();
    let has_hardware = camera.hardware.is_some();
    let has_options = !camera.source_options.0.is_empty();
    let takes_every_frame = camera.delivery == Delivery::Every;
    for (name, is_wrong, reason) in [
        ("max_rate", !has_source && has_rate, NO_SOURCE),
        ("rtsp_transport", !has_source && has_transport, NO_SOURCE),
        ("hardware", !has_source && has_hardware, NO_SOURCE),
        ("source_options", !has_source && has_options, NO_SOURCE),
        ("hardware", is_pipeline && has_hardware, FOR_FFMPEG),
        ("source_options", is_pipeline && has_options, FOR_FFMPEG),
        ("key", has_source && camera.key.is_some(), BESIDE_SOURCE),
        ("topic", has_source && camera.topic.is_some(), BESIDE_SOURCE),
        (
            "topic",
            camera.key.is_some() && camera.topic.is_some(),
            BESIDE_KEY,
        ),
        ("delivery", has_source && takes_every_frame, NEVER_WAITS),
    ] {
        if is_wrong {
            findings.add(key(name), reason);
        }
    }
}
