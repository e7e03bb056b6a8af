//! Checks a configuration's values beyond their types.

use super::{CameraConfig, NodeConfig};
use crate::camera::AnswerTime;
use crate::input::Delivery;
use crate::input::source::{RtspTransport, SourceAddress, SourceKind};
use albireo_core::policy::{Albireo, ExpectedLoss, LatePolicy, Policy, ThresholdSpec};
use albireo_core::target::{Target, ThresholdRange};
use albireo_service::config::{Configuration, DAY_S, Finding, Findings};
use std::collections::{HashMap, HashSet};
use zenoh::key_expr::KeyExpr;

const WRITTEN: &str = "is what this node writes or answers itself; frames need a key of their own";
const NO_SOURCE: &str = "applies only to a camera with a source, and this one has none";
const FOR_FFMPEG: &str =
    "is for ffmpeg; in a GStreamer pipeline name the decoder as one of its elements";
const BESIDE_SOURCE: &str = "is set together with source: frames come from one or the other";
const NEVER_WAITS: &str =
    "`every` needs a sender that waits, which a source does not: use `albireo replay --every`";

impl Configuration for NodeConfig {
    const SECTIONS: &'static [&'static str] = &[
        "NODE", "ZENOH", "UPLINK", "OUTBOX", "HTTP", "DETECTOR", "SCREEN", "POLICY", "TARGET",
        "REPORT", "SETTLE", "AUDIT", "CLIP", "FRAME", "POWER", "LOG", "TOKEN",
    ];

    /// Does not check that files exist: a missing file is reported when it is opened.
    fn findings(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        self.check_names(&mut findings);
        self.zenoh.check(&mut findings);
        self.uplink.check(&mut findings);
        findings.count("outbox.gather_s", self.outbox.gather_s, 0, 86_400);
        self.http.check(&self.tokens, &mut findings);
        self.check_models(&mut findings);
        self.check_figures(&mut findings);
        self.log.check(&mut findings);
        let policy = self.check_policy(&mut findings);
        let spec = policy.as_ref().map(|policy| policy.threshold_spec());
        self.check_answers(policy, &mut findings);
        self.check_target(spec, &mut findings);
        self.check_cameras(spec, &mut findings);
        findings.0
    }
}

impl NodeConfig {
    fn check_names(&self, findings: &mut Findings) {
        let name = albireo_wire::check_segment("node name", &self.node.name);
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
        let library = self.detector.onnxruntime.as_deref();
        findings.path("detector.onnxruntime", library);
    }

    fn check_figures(&self, findings: &mut Findings) {
        let shares = [
            ("report.confidence", self.report.confidence.unwrap_or(0.0)),
            ("audit.share", self.audit.share),
        ];
        for (key, share) in shares {
            if !(0.0..=1.0).contains(&share) {
                findings.add(key, format!("must be from 0 to 1, not {share}"));
            }
        }
        findings.above_zero("clip.window_s", self.clip.window_s, DAY_S);
        findings.above_zero("clip.longest_s", self.clip.longest_s, 3600.0);
        findings.above_zero("clip.silence_s", self.clip.silence_s, DAY_S);
        if self.clip.window_s > self.clip.longest_s && self.clip.window_s <= DAY_S {
            findings.add("clip.window_s", "is above clip.longest_s: raise that too");
        }
        let largest = self.frame.max_payload_bytes as u64;
        findings.count("frame.max_payload_bytes", largest, 1, 1 << 30);
        for (key, reason) in self.power.problems() {
            findings.add(format!("power.{key}"), reason);
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

    /// Checks that the policy can answer at once, and that settled frames wait long enough for the detector.
    fn check_answers(&self, policy: Option<Box<dyn Policy>>, findings: &mut Findings) {
        let mut cameras = self.cameras.iter();
        let at_once = cameras.any(|camera| self.answer_time(camera) == AnswerTime::AtOnce);
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

    fn check_target(&self, spec: Option<Option<ThresholdSpec>>, findings: &mut Findings) {
        let target = self.target.hold;
        findings.check("target.hold", target.map(Target::check).transpose());
        if matches!(target, Some(Target::Recall(_))) && self.audit.share == 0.0 {
            findings.add("target.hold", "`recall` needs an audit: audit.share is 0");
        }
        let (least, most) = (self.target.least, self.target.most);
        if let Some(spec) = spec
            && (target.is_some() || least.is_some() || most.is_some())
        {
            let range = ThresholdRange::of(&self.policy.name, spec.as_ref(), least, most);
            findings.check("target", range);
        }
    }

    fn check_cameras(&self, spec: Option<Option<ThresholdSpec>>, findings: &mut Findings) {
        if self.cameras.is_empty() {
            findings.add("camera", "is empty: a node needs at least one [[camera]]");
        }
        let mut names = HashSet::new();
        for (index, camera) in self.cameras.iter().enumerate() {
            let key = |name: &str| format!("camera[{index}].{name}");
            check_camera(camera, &key, findings);
            if let (Some(threshold), Some(spec)) = (camera.threshold, spec) {
                let none = || format!("policy `{}` has no threshold", self.policy.name);
                if let Some(spec) = findings.check(key("threshold"), spec.ok_or_else(none)) {
                    findings.check(key("threshold"), spec.check(threshold));
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
        let mut written = vec![node.target()];
        for keys in (self.cameras.iter()).filter_map(|camera| node.camera(&camera.name).ok()) {
            written.extend([
                keys.detections(),
                keys.late(),
                keys.settled(),
                keys.clip(),
                keys.counters(),
                keys.threshold(),
            ]);
        }
        let mut owners: HashMap<String, &str> = HashMap::new();
        for (index, camera) in self.cameras.iter().enumerate() {
            let at = format!("camera[{index}].key");
            let Ok(key) = self.frame_key(camera) else {
                continue;
            };
            if written.contains(&key) {
                findings.add(at.clone(), format!("`{key}` {WRITTEN}"));
            }
            // Cameras with the same name are already reported.
            if let Some(other) = owners.insert(key.clone(), &camera.name)
                && other != camera.name
            {
                findings.add(
                    at,
                    format!(
                        "`{key}` is the key of camera `{other}` too; each camera needs its own"
                    ),
                );
            }
        }
    }
}

fn check_camera(camera: &CameraConfig, key: &dyn Fn(&str) -> String, findings: &mut Findings) {
    let name = albireo_wire::check_segment("camera name", &camera.name);
    let is_right = findings.check(key("name"), name).is_some();
    if is_right && camera.name.bytes().all(|byte| byte == b'.') {
        findings.add(
            key("name"),
            "must not be only dots, which mean something else in an HTTP path",
        );
    }
    if let Some(frames) = &camera.key {
        match KeyExpr::try_from(frames.as_str()) {
            Ok(expression) if expression.is_wild() => findings.add(
                key("key"),
                format!(
                    "`{frames}` has a wildcard; a camera is one key, so that frames stay in order"
                ),
            ),
            Ok(_) => {}
            Err(error) => findings.add(
                key("key"),
                format!("`{frames}` is not a valid Zenoh key: {error}"),
            ),
        }
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
    let source = camera
        .source
        .as_ref()
        .map(SourceAddress::resolved)
        .transpose();
    findings.check(key("source"), source);
    findings.check(key("source_options"), camera.source_options.check());
    let source = camera.source.as_ref().map(SourceAddress::kind);
    let (none, is_pipeline) = (source.is_none(), source == Some(SourceKind::Pipeline));
    let rate = camera.max_rate.is_some();
    let transport = camera.rtsp_transport != RtspTransport::default();
    let hardware = camera.hardware.is_some();
    let options = !camera.source_options.0.is_empty();
    let every = camera.delivery == Delivery::Every;
    for (name, is_wrong, reason) in [
        ("max_rate", none && rate, NO_SOURCE),
        ("rtsp_transport", none && transport, NO_SOURCE),
        ("hardware", none && hardware, NO_SOURCE),
        ("source_options", none && options, NO_SOURCE),
        ("hardware", is_pipeline && hardware, FOR_FFMPEG),
        ("source_options", is_pipeline && options, FOR_FFMPEG),
        ("key", !none && camera.key.is_some(), BESIDE_SOURCE),
        ("delivery", !none && every, NEVER_WAITS),
    ] {
        if is_wrong {
            findings.add(key(name), reason);
        }
    }
}
