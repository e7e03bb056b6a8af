//! What a configuration's values must keep to beyond their types.

use super::{CameraConfig, NodeConfig};
use crate::detector::ClassNames;
use albireo_core::policy::Knob;
use albireo_service::config::{Configuration, DAY_S, Finding, Findings, NamedToken};
use std::collections::HashSet;
use zenoh::key_expr::KeyExpr;

impl Configuration for NodeConfig {
    const SECTIONS: &'static [&'static str] = &[
        "NODE", "ZENOH", "UPLINK", "OUTBOX", "HTTP", "DETECTOR", "SCREEN", "POLICY", "CLIP",
        "FRAME", "POWER", "LOG", "TOKEN",
    ];

    /// Whether files are there is not looked at: that is seen when they are opened.
    fn findings(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        self.check_names(&mut findings);
        self.zenoh
            .check("zenoh", self.frame.max_payload_bytes, &mut findings);
        self.uplink.check("uplink", &mut findings);
        self.check_outbox(&mut findings);
        self.http.check_beside(&self.tokens, &mut findings);
        NamedToken::check(&self.tokens, &mut findings);
        self.check_models(&mut findings);
        self.check_figures(&mut findings);
        self.log.check(&mut findings);
        let knob = self.check_policy(&mut findings);
        self.check_cameras(knob, &mut findings);
        findings.into_vec()
    }
}

impl NodeConfig {
    fn check_names(&self, findings: &mut Findings) {
        if let Err(error) = albireo_wire::check_segment("node name", &self.node.name) {
            findings.add("node.name", error.to_string());
        } else if let Err(error) = self.keys() {
            findings.add("node.prefix", error.to_string());
        }
        findings.path("node.state_dir", self.node.state_dir.as_deref());
        findings.above_zero("node.stop_timeout_s", self.node.stop_timeout_s, 3600.0);
        findings.above_zero("node.camera_silence_s", self.node.camera_silence_s, DAY_S);
        findings.above_zero("node.stuck_after_s", self.node.stuck_after_s, DAY_S);
    }

    fn check_outbox(&self, findings: &mut Findings) {
        let outbox = &self.outbox;
        findings.count("outbox.max_bytes", outbox.max_bytes, 1 << 16, 1 << 40);
        findings.count("outbox.max_age_days", outbox.max_age_days.into(), 1, 36_500);
        let figure = outbox.memory_reports as u64;
        findings.count("outbox.memory_reports", figure, 1, 1_000_000);
        let figure = outbox.batch_reports as u64;
        findings.count("outbox.batch_reports", figure, 1, 1000);
        findings.count(
            "outbox.answer_timeout_ms",
            outbox.answer_timeout_ms,
            100,
            600_000,
        );
        findings.count("outbox.retry_min_ms", outbox.retry_min_ms, 1, 3_600_000);
        let most = outbox.retry_max_ms;
        findings.count(
            "outbox.retry_max_ms",
            most,
            outbox.retry_min_ms.max(1),
            3_600_000,
        );
        findings.count("outbox.status_s", outbox.status_s, 1, 86_400);
        findings.path("outbox.machine_id", Some(&outbox.machine_id));
    }

    fn check_models(&self, findings: &mut Findings) {
        let detector = &self.detector;
        findings.path("detector.model", Some(&detector.model));
        if let Some(ClassNames::File(names)) = &detector.class_names {
            findings.path("detector.class_names", Some(names));
        }
        findings.path("detector.onnxruntime", detector.onnxruntime.as_deref());
        for (key, reason) in detector.problems() {
            findings.add(format!("detector.{key}"), reason);
        }
        findings.path("screen.model", self.screen.model.as_deref());
        for (key, reason) in self.screen.problems() {
            findings.add(format!("screen.{key}"), reason);
        }
    }

    fn check_figures(&self, findings: &mut Findings) {
        findings.above_zero("clip.window_s", self.clip.window_s, DAY_S);
        findings.above_zero("clip.silence_s", self.clip.silence_s, DAY_S);
        let frame = &self.frame;
        findings.count(
            "frame.max_payload_bytes",
            frame.max_payload_bytes as u64,
            1,
            1 << 30,
        );
        findings.count("frame.max_width", frame.max_width.into(), 1, 65_535);
        findings.count("frame.max_height", frame.max_height.into(), 1, 65_535);
        findings.count(
            "frame.max_decoded_bytes",
            frame.max_decoded_bytes as u64,
            1,
            1 << 34,
        );
        for (key, reason) in self.power.problems() {
            findings.add(format!("power.{key}"), reason);
        }
    }

    /// The policy's knob; `None` when there is no policy to ask.
    fn check_policy(&self, findings: &mut Findings) -> Option<Option<Knob>> {
        match self.policy.build() {
            Ok(policy) => Some(policy.knob()),
            Err(error) => {
                // The message begins with the key, as other users of the error want it.
                let message = error.to_string();
                let (key, reason) = message.split_once(": ").unwrap_or(("policy", &message));
                findings.add(key, reason);
                None
            }
        }
    }

    fn check_cameras(&self, knob: Option<Option<Knob>>, findings: &mut Findings) {
        if self.cameras.is_empty() {
            findings.add("camera", "is empty: a node needs at least one [[camera]]");
        }
        let mut names = HashSet::new();
        for (index, camera) in self.cameras.iter().enumerate() {
            let key = |name: &str| format!("camera[{index}].{name}");
            check_camera(camera, &key, findings);
            self.check_threshold(camera, knob, &key, findings);
            if !names.insert(camera.name.as_str()) {
                findings.add(
                    key("name"),
                    format!("two cameras are named `{}`", camera.name),
                );
            }
        }
    }

    fn check_threshold(
        &self,
        camera: &CameraConfig,
        knob: Option<Option<Knob>>,
        key: &dyn Fn(&str) -> String,
        findings: &mut Findings,
    ) {
        let (Some(threshold), Some(knob)) = (camera.threshold, knob) else {
            return;
        };
        match knob.map(|knob| knob.check(threshold)) {
            Some(Ok(_)) => {}
            Some(Err(error)) => findings.add(key("threshold"), error.to_string()),
            None => findings.add(
                key("threshold"),
                format!("policy `{}` has no threshold", self.policy.name),
            ),
        }
    }
}

fn check_camera(camera: &CameraConfig, key: &dyn Fn(&str) -> String, findings: &mut Findings) {
    if let Err(error) = albireo_wire::check_segment("camera name", &camera.name) {
        findings.add(key("name"), error.to_string());
    } else if camera.name.bytes().all(|byte| byte == b'.') {
        findings.add(
            key("name"),
            "dots alone mean something else in an HTTP path",
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
            Err(error) => findings.add(key("key"), format!("`{frames}` is no Zenoh key: {error}")),
        }
    }
    findings.count(&key("ring"), camera.ring as u64, 1, 1024);
}
