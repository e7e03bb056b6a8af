//! What a configuration's values must keep to beyond their types.

use super::{CameraConfig, HttpConfig, NodeConfig, Problem};
use crate::detector::ClassNames;
use crate::policy::Knob;
use crate::wire;
use std::collections::HashSet;
use std::path::Path;
use zenoh::config::EndPoint;
use zenoh::key_expr::KeyExpr;

/// A day: longer timeouts and windows are slips of the pen.
const DAY_S: f64 = 86_400.0;
const DAY_MS: u64 = 86_400_000;

/// Collects what is wrong.
#[derive(Default)]
struct Findings(Vec<Problem>);

impl Findings {
    fn add(&mut self, key: impl Into<String>, reason: impl Into<String>) {
        self.0.push(Problem::new(key, reason));
    }

    fn above_zero(&mut self, key: &str, value: f64, high: f64) {
        // Written so that NaN is refused.
        if !(value > 0.0 && value <= high) {
            self.add(
                key,
                format!("must be above 0 and at most {high}, not {value}"),
            );
        }
    }

    fn count(&mut self, key: &str, value: u64, low: u64, high: u64) {
        if !(low..=high).contains(&value) {
            self.add(key, format!("must be from {low} to {high}, not {value}"));
        }
    }

    fn path(&mut self, key: &str, path: Option<&Path>) {
        if path.is_some_and(|path| path.as_os_str().is_empty()) {
            self.add(key, "is empty; leave the key out instead");
        }
    }
}

impl NodeConfig {
    /// Everything that is wrong with the values; empty when they can be used. Whether files are there is
    /// not looked at: that is seen when they are opened.
    pub fn problems(&self) -> Vec<Problem> {
        let mut findings = Findings::default();
        self.check_names(&mut findings);
        self.check_zenoh(&mut findings);
        check_http(&self.http, &mut findings);
        self.check_models(&mut findings);
        self.check_figures(&mut findings);
        if let Err(reason) = check_level(&self.log.level) {
            findings.add("log.level", reason);
        }
        let knob = self.check_policy(&mut findings);
        self.check_cameras(knob, &mut findings);
        findings.0
    }

    fn check_names(&self, findings: &mut Findings) {
        if let Err(error) = wire::check_segment("node name", &self.node.name) {
            findings.add("node.name", error.to_string());
        } else if let Err(error) = self.keys() {
            findings.add("node.prefix", error.to_string());
        }
        findings.path("node.state_dir", self.node.state_dir.as_deref());
    }

    fn check_zenoh(&self, findings: &mut Findings) {
        let zenoh = &self.zenoh;
        let before = findings.0.len();
        for (key, endpoints) in [
            ("zenoh.connect", &zenoh.connect),
            ("zenoh.listen", &zenoh.listen),
        ] {
            for endpoint in endpoints {
                if let Err(error) = endpoint.parse::<EndPoint>() {
                    findings.add(
                        key,
                        format!(
                            "`{endpoint}` is no endpoint such as `tcp/127.0.0.1:7447`: {error}"
                        ),
                    );
                }
            }
        }
        findings.path("zenoh.config_file", zenoh.config_file.as_deref());
        if findings.0.len() == before
            && zenoh.config_file.is_none()
            && let Err(error) = zenoh.to_zenoh(self.frame.max_payload_bytes)
        {
            findings.add("zenoh", error);
        }
        if zenoh.mode == super::ZenohMode::Client
            && zenoh.connect.is_empty()
            && zenoh.config_file.is_none()
            && !zenoh.multicast_scouting
        {
            findings.add(
                "zenoh.connect",
                "is empty: a client needs a router to connect to (or multicast_scouting = true)",
            );
        }
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
    if let Err(error) = wire::check_segment("camera name", &camera.name) {
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

fn check_level(level: &str) -> Result<(), String> {
    let fault = |error: &dyn std::fmt::Display| {
        format!("`{level}` is neither error, warn, info, debug, trace nor a filter: {error}")
    };
    // The filter takes a lone word that is no level for the name of a module, and then logs nothing else.
    for word in level.split(',').filter(|part| !part.contains(['=', '['])) {
        word.trim()
            .parse::<tracing::level_filters::LevelFilter>()
            .map_err(|_| fault(&format!("`{word}` is no level")))?;
    }
    tracing_subscriber::EnvFilter::builder()
        .parse(level)
        .map(drop)
        .map_err(|error| fault(&error))
}

fn check_http(http: &HttpConfig, findings: &mut Findings) {
    if let Some(fault) = http.token.as_ref().and_then(super::Token::fault) {
        findings.add("http.token", fault);
    }
    findings.path("http.token_file", http.token_file.as_deref());
    if http.token.is_some() && http.token_file.is_some() {
        findings.add("http.token_file", "and http.token are both set; keep one");
    }
    if !http.listen.ip().is_loopback()
        && http.token.is_none()
        && http.token_file.is_none()
        && !http.allow_unauthenticated
    {
        findings.add(
            "http.listen",
            format!(
                "{} can be reached from other machines, and no token is set; set http.token_file (or \
                 http.token), or http.allow_unauthenticated = true if anybody may use it",
                http.listen
            ),
        );
    }
    findings.count("http.timeout_ms", http.timeout_ms, 1, DAY_MS);
    for origin in &http.cors_origins {
        let host = origin
            .strip_prefix("https://")
            .or_else(|| origin.strip_prefix("http://"));
        if host.is_none_or(|host| host.is_empty() || host.contains('/')) {
            findings.add(
                "http.cors_origins",
                format!("`{origin}` is no origin such as `https://fleet.example`"),
            );
        }
    }
}
