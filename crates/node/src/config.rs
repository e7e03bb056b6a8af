//! The configuration of a node: one TOML file, overridden by environment variables, checked as a whole
//! before anything starts. Every key with its default is in `config/node.toml`.

mod machine;
mod validate;

use crate::camera::audit::AuditConfig;
use crate::camera::clip::ClipConfig;
use crate::camera::{AnswerTime, ReportConfig, SettleConfig};
use crate::delivery::outbox::OutboxConfig;
use crate::input::source::{Handover, RtspTransport, SourceAddress, SourceOptions, SourceSettings};
use crate::input::{Delivery, PayloadFormat};
use crate::state::target::TargetConfig;
use albireo_core::policy::PolicyConfig;
use albireo_power::PowerConfig;
use albireo_service::config::{HttpConfig, LogConfig, NamedToken, UplinkConfig, ZenohConfig};
use albireo_vision::detector::{ClassNames, DetectorConfig};
use albireo_vision::picture::FrameLimits;
use albireo_vision::screen::ScreenConfig;
use albireo_wire::{KeyError, NodeKeys};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// All settings of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NodeConfig {
    /// Who the node is.
    pub node: NodeSection,
    /// How it reaches Zenoh.
    pub zenoh: ZenohConfig,
    /// A separate session to the hub.
    pub uplink: UplinkConfig,
    /// What waits for the hub.
    pub outbox: OutboxConfig,
    /// The HTTP interface.
    pub http: HttpConfig,
    /// The detector.
    pub detector: DetectorConfig,
    /// The empty-scene screen.
    pub screen: ScreenConfig,
    /// What decides a frame.
    pub policy: PolicyConfig,
    /// The target that the node holds by moving its threshold.
    pub target: TargetConfig,
    /// Which boxes are published.
    pub report: ReportConfig,
    /// Whether frames are published once more, for consumers that store boxes.
    pub settle: SettleConfig,
    /// How many skipped frames are looked at afterwards.
    pub audit: AuditConfig,
    /// When a clip ends.
    pub clip: ClipConfig,
    /// Limits of incoming frames.
    pub frame: FrameLimits,
    /// Where power figures come from.
    pub power: PowerConfig,
    /// The log.
    pub log: LogConfig,
    /// Tokens of the HTTP interface beside `http.token`, one `[[token]]` each.
    #[serde(rename = "token")]
    pub tokens: Vec<NamedToken>,
    /// The cameras, one `[[camera]]` each.
    #[serde(rename = "camera")]
    pub cameras: Vec<CameraConfig>,
}

impl Default for NodeConfig {
    fn default() -> Self {
        Self {
            node: NodeSection::default(),
            zenoh: ZenohConfig::default(),
            uplink: UplinkConfig::default(),
            outbox: OutboxConfig::default(),
            http: HttpConfig::default(),
            detector: DetectorConfig::default(),
            screen: ScreenConfig::default(),
            policy: PolicyConfig::default(),
            target: TargetConfig::default(),
            report: ReportConfig::default(),
            settle: SettleConfig::default(),
            audit: AuditConfig::default(),
            clip: ClipConfig::default(),
            frame: FrameLimits::default(),
            power: PowerConfig::default(),
            log: LogConfig::default(),
            tokens: Vec::new(),
            cameras: vec![CameraConfig::named("front")],
        }
    }
}

impl NodeConfig {
    /// The node's Zenoh keys.
    ///
    /// # Errors
    /// [`KeyError`] when a name cannot be used; a configuration that passed its check has none.
    pub fn keys(&self) -> Result<NodeKeys, KeyError> {
        NodeKeys::new(&self.node.prefix, &self.node.name)
    }

    /// The files of its models, by key.
    fn model_files(&self) -> [(&'static str, Option<&Path>); 3] {
        let names = match &self.detector.class_names {
            Some(ClassNames::File(names)) => Some(names.as_path()),
            _ => None,
        };
        [
            ("detector.model", Some(&self.detector.model)),
            ("detector.class_names", names),
            ("screen.model", self.screen.model.as_deref()),
        ]
    }

    /// When a camera's frames are answered.
    pub(crate) fn answer_time(&self, camera: &CameraConfig) -> AnswerTime {
        camera.answer.unwrap_or(self.node.answer)
    }

    /// The key a camera's frames come on: its own `key`, else `{prefix}/{node}/{camera}/frame`.
    ///
    /// # Errors
    /// [`KeyError`] when a name cannot be used; a configuration that passed its check has none.
    pub(crate) fn frame_key(&self, camera: &CameraConfig) -> Result<String, KeyError> {
        match &camera.key {
            Some(key) => Ok(key.clone()),
            None => Ok(self.keys()?.camera(&camera.name)?.frame()),
        }
    }
}

/// Who the node is: the `[node]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NodeSection {
    /// Its name, one part of every key: letters, digits, `-`, `_`, `.`.
    pub name: String,
    /// First part (or parts) of every key.
    pub prefix: String,
    /// Folder for what must survive a restart: changed thresholds, undelivered clip reports. Without it
    /// both are forgotten.
    pub state_dir: Option<PathBuf>,
    /// When frames are answered.
    pub answer: AnswerTime,
    /// Labels by which a hub selects nodes.
    pub labels: BTreeMap<String, String>,
    /// Longest time stopping may take, whatever hangs. No setting: service managers wait for 10 s and more.
    #[serde(skip)]
    pub stop_timeout: Duration,
    /// Under a service manager: a detector, screen or camera loop that has been broken for that long ends the feeding of
    /// the watchdog, seconds.
    pub stuck_after_s: f64,
}

impl NodeSection {
    /// [`stuck_after_s`](Self::stuck_after_s) as a time.
    pub(crate) fn stuck_after(&self) -> Duration {
        Duration::try_from_secs_f64(self.stuck_after_s).unwrap_or(Duration::MAX)
    }
}

impl Default for NodeSection {
    fn default() -> Self {
        Self {
            name: "node".to_owned(),
            prefix: "albireo".to_owned(),
            state_dir: None,
            answer: AnswerTime::default(),
            labels: BTreeMap::new(),
            stop_timeout: Duration::from_secs(5),
            stuck_after_s: 900.0,
        }
    }
}

/// One camera: a `[[camera]]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// Its name, one part of its keys: letters, digits, `-`, `_`, `.`. Empty by default, which no camera may be.
    pub name: String,
    /// Zenoh key its frames come on; by default `{prefix}/{node}/{camera}/frame`.
    pub key: Option<String>,
    /// A source that the node itself opens, in place of the key.
    pub source: Option<SourceAddress>,
    /// The source's frames per second, at most.
    pub max_rate: Option<f64>,
    /// How an RTSP source sends its packets.
    pub rtsp_transport: RtspTransport,
    /// What decodes the source instead of the processor: an acceleration or a decoder of ffmpeg.
    pub hardware: Option<String>,
    /// Options of ffmpeg for the source.
    pub source_options: SourceOptions,
    /// A source without a picture for this long is opened again, seconds. No setting: a camera that records only motion
    /// needs a program that publishes it.
    #[serde(skip)]
    pub source_timeout_s: f64,
    /// How its payload is to be read.
    pub format: PayloadFormat,
    /// Which frames are processed when they come faster than the node works.
    pub delivery: Delivery,
    /// Frames that may wait. No setting: a third one would only make answers later.
    #[serde(skip)]
    pub ring: usize,
    /// When its frames are answered, if not as `node.answer` says.
    pub answer: Option<AnswerTime>,
    /// Threshold of this camera in place of the policy's.
    pub threshold: Option<f64>,
    /// Whether a new clip id from the camera makes the policy forget its objects.
    pub reset_at_clip: bool,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            name: String::new(),
            key: None,
            source: None,
            max_rate: None,
            rtsp_transport: RtspTransport::default(),
            hardware: None,
            source_options: SourceOptions::default(),
            source_timeout_s: 15.0,
            format: PayloadFormat::default(),
            delivery: Delivery::default(),
            ring: 2,
            answer: None,
            threshold: None,
            reset_at_clip: true,
        }
    }
}

impl CameraConfig {
    /// A camera of that name with every other setting at its default.
    pub fn named(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// How its source is opened, if it has one.
    pub(crate) fn source_settings(&self, limits: FrameLimits) -> Option<SourceSettings> {
        Some(SourceSettings {
            address: self.source.clone()?,
            max_rate: self.max_rate,
            transport: self.rtsp_transport,
            hardware: self.hardware.clone(),
            options: self.source_options.clone(),
            silence: Duration::try_from_secs_f64(self.source_timeout_s).unwrap_or(Duration::MAX),
            // Not coded again: most frames are never looked at.
            decoded: Handover::Pixels,
            limits,
        })
    }
}

#[cfg(test)]
mod tests;
