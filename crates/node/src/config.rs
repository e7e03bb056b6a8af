//! The configuration of a node: one TOML file, overridden by environment variables, checked as a whole
//! before anything starts. `config/node.toml` lists every key with its default.

mod machine;
mod validate;

use crate::camera::audit::AuditConfig;
use crate::camera::clip::ClipConfig;
use crate::camera::{AnswerTime, LoopSettings, PublishConfig, ReportConfig, SettleConfig};
use crate::forwarding::{HookConfig, MqttConfig};
use crate::input::receiver::ReceiverSettings;
use crate::input::source::{RtspTransport, SourceAddress, SourceOptions, SourceSettings};
use crate::input::{Delivery, PayloadFormat, keys_of_topic};
use crate::outbox::OutboxConfig;
use crate::position::PositionConfig;
use crate::recorder::RecordConfig;
use crate::state::board::SightingsConfig;
use crate::state::target::TargetConfig;
use albireo_core::policy::PolicyConfig;
use albireo_power::PowerConfig;
use albireo_service::config::{HttpConfig, LogConfig, NamedToken, UplinkConfig, ZenohConfig};
use albireo_vision::detector::{ClassNames, DetectorConfig};
use albireo_vision::picture::{Flip, FrameLimits, Mask, Mount};
use albireo_vision::screen::ScreenConfig;
use albireo_wire::{KeyError, NodeKeys};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// A source without a picture for this long is reopened. Not a setting: a camera that records only motion needs a
/// program that publishes it.
const SOURCE_SILENCE: Duration = Duration::from_secs(15);

/// All settings of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NodeConfig {
    /// The node's identity.
    pub node: NodeSection,
    /// The connection to Zenoh.
    pub zenoh: ZenohConfig,
    /// A separate session to the hub.
    pub uplink: UplinkConfig,
    /// The reports that wait for the hub.
    pub outbox: OutboxConfig,
    /// The HTTP interface.
    pub http: HttpConfig,
    /// The detector.
    pub detector: DetectorConfig,
    /// The empty-scene screen.
    pub screen: ScreenConfig,
    /// The policy that decides frames.
    pub policy: PolicyConfig,
    /// The target that the node holds by moving its threshold.
    pub target: TargetConfig,
    /// The boxes to publish.
    pub report: ReportConfig,
    /// Further forms in which boxes are published.
    pub publish: PublishConfig,
    /// Publishes frames again, for consumers that store boxes.
    pub settle: SettleConfig,
    /// The share of skipped frames that is examined afterwards.
    pub audit: AuditConfig,
    /// When a class counts as there, and as away.
    pub sightings: SightingsConfig,
    /// The MQTT broker.
    pub mqtt: MqttConfig,
    /// Recordings with pictures.
    pub record: RecordConfig,
    /// The end of clips.
    pub clip: ClipConfig,
    /// Limits of incoming frames.
    pub frame: FrameLimits,
    /// The source of power figures.
    pub power: PowerConfig,
    /// The source of positions.
    pub position: PositionConfig,
    /// The log.
    pub log: LogConfig,
    /// Addresses that are told when a class appears or leaves, one `[[hook]]` each.
    #[serde(rename = "hook")]
    pub hooks: Vec<HookConfig>,
    /// Further tokens of the HTTP interface besides `http.token`, one `[[token]]` each.
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
            publish: PublishConfig::default(),
            settle: SettleConfig::default(),
            audit: AuditConfig::default(),
            sightings: SightingsConfig::default(),
            mqtt: MqttConfig::default(),
            record: RecordConfig::default(),
            clip: ClipConfig::default(),
            frame: FrameLimits::default(),
            power: PowerConfig::default(),
            position: PositionConfig::default(),
            log: LogConfig::default(),
            hooks: Vec::new(),
            tokens: Vec::new(),
            cameras: vec![CameraConfig::named("front")],
        }
    }
}

impl NodeConfig {
    /// The node's Zenoh keys.
    ///
    /// # Errors
    /// [`KeyError`] if a name is invalid; never for a checked configuration.
    pub fn keys(&self) -> Result<NodeKeys, KeyError> {
        NodeKeys::new(&self.node.prefix, &self.node.name)
    }

    /// The files of the models, by key.
    fn model_files(&self) -> [(&'static str, Option<&Path>); 3] {
        let names = self.detector.class_names.as_ref();
        [
            ("detector.model", Some(&self.detector.model)),
            ("detector.class_names", names.and_then(ClassNames::file)),
            ("screen.model", self.screen.model.as_deref()),
        ]
    }

    /// The settings of the cameras' loops.
    pub(crate) fn loop_settings(&self) -> LoopSettings {
        LoopSettings {
            clip: self.clip,
            audit: self.audit,
            longest_hold: Duration::from_millis(self.settle.longest_ms),
        }
    }

    /// The time at which a camera's frames are answered.
    pub(crate) fn answer_time(&self, camera: &CameraConfig) -> AnswerTime {
        camera.answer.unwrap_or(self.node.answer)
    }

    /// The keys of a camera's frames: its `key`, those of its ROS 2 `topic`, else `{prefix}/{node}/{camera}/frame`.
    ///
    /// # Errors
    /// [`KeyError`] if a name is invalid; never for a checked configuration.
    pub(crate) fn frame_keys(&self, camera: &CameraConfig) -> Result<Vec<String>, KeyError> {
        match (&camera.key, &camera.topic) {
            (Some(key), _) => Ok(vec![key.clone()]),
            (None, Some(topic)) => {
                Ok(keys_of_topic(ros_domain().unwrap_or_default(), topic).to_vec())
            }
            (None, None) => Ok(vec![self.keys()?.camera(&camera.name)?.frame()]),
        }
    }
}

/// The ROS 2 domain, from the environment variable that all of ROS 2 takes it from.
///
/// # Errors
/// The reason, if it is no number.
pub(crate) fn ros_domain() -> Result<u32, String> {
    let Ok(domain) = std::env::var("ROS_DOMAIN_ID") else {
        return Ok(0);
    };
    let wrong =
        |_| format!("the environment variable ROS_DOMAIN_ID must be a number, not `{domain}`");
    match domain.trim() {
        "" => Ok(0),
        number => number.parse().map_err(wrong),
    }
}

/// The node's identity: the `[node]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NodeSection {
    /// Its name, one segment of every key: letters, digits, `-`, `_`, `.`.
    pub name: String,
    /// First segment (or segments) of every key.
    pub prefix: String,
    /// Folder for data that must survive a restart: changed thresholds, undelivered clip reports. Without it
    /// both are lost.
    pub state_dir: Option<PathBuf>,
    /// The time at which frames are answered.
    pub answer: AnswerTime,
    /// Labels by which a hub selects nodes; `page` and `hub` are addresses that the pages link to.
    pub labels: BTreeMap<String, String>,
    /// Maximum time for stopping, even if something hangs. Not a setting: service managers wait for 10 s and more.
    #[serde(skip)]
    pub stop_timeout: Duration,
    /// With a service manager: seconds for which the detector, the screen or a camera loop may be broken before the
    /// node stops feeding the watchdog.
    pub stuck_after_s: f64,
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
    /// Its name, one segment of its keys: letters, digits, `-`, `_`, `.`. Empty by default, which is invalid.
    pub name: String,
    /// Zenoh key of its frames; by default `{prefix}/{node}/{camera}/frame`.
    pub key: Option<String>,
    /// ROS 2 topic of its frames, instead of the key.
    pub topic: Option<String>,
    /// A source that the node opens itself, instead of the key.
    pub source: Option<SourceAddress>,
    /// Maximum frames per second of the source.
    pub max_rate: Option<f64>,
    /// Packet transport of an RTSP source.
    pub rtsp_transport: RtspTransport,
    /// Decoder of the source other than the processor: an acceleration or a decoder of ffmpeg.
    pub hardware: Option<String>,
    /// Options of ffmpeg for the source.
    pub source_options: SourceOptions,
    /// Payload format.
    pub format: PayloadFormat,
    /// The frames to process when they arrive faster than the node works.
    pub delivery: Delivery,
    /// Maximum number of waiting frames. Not a setting: a third one would only delay answers.
    #[serde(skip)]
    pub ring: usize,
    /// The time at which its frames are answered, if different from `node.answer`.
    pub answer: Option<AnswerTime>,
    /// Threshold of this camera, instead of the policy's.
    pub threshold: Option<f64>,
    /// True if the policy forgets its objects at a new clip id of the camera.
    pub reset_at_clip: bool,
    /// Degrees clockwise by which its pictures are turned: 0, 90, 180 or 270.
    pub rotate: i64,
    /// How its turned pictures are mirrored.
    pub flip: Option<Flip>,
    /// Left, top, right and bottom of the part that is kept, shares of the turned picture.
    pub crop: Option<[f64; 4]>,
    /// What is painted grey in the part that is kept, and in which nothing is reported.
    pub mask: Mask,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            name: String::new(),
            key: None,
            topic: None,
            source: None,
            max_rate: None,
            rtsp_transport: RtspTransport::default(),
            hardware: None,
            source_options: SourceOptions::default(),
            format: PayloadFormat::default(),
            delivery: Delivery::default(),
            ring: 2,
            answer: None,
            threshold: None,
            reset_at_clip: true,
            rotate: 0,
            flip: None,
            crop: None,
            mask: Mask::default(),
        }
    }
}

impl CameraConfig {
    /// Creates a camera named `name`, with all other settings at their defaults.
    pub fn named(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// The settings for receiving its frames.
    pub(crate) fn receiver_settings(&self, limits: FrameLimits) -> ReceiverSettings {
        ReceiverSettings {
            camera: self.name.clone(),
            format: match self.topic {
                Some(_) => PayloadFormat::Ros2,
                None => self.format,
            },
            delivery: self.delivery,
            ring: self.ring,
            limits,
            mount: self.mount(),
        }
    }

    /// How it is mounted; `None` if its pictures stay as they are sent.
    pub(crate) fn mount(&self) -> Option<Arc<Mount>> {
        let mount = Mount {
            rotate: self.rotate,
            flip: self.flip,
            crop: self.crop,
            mask: self.mask.clone(),
        };
        (!mount.is_plain()).then(|| Arc::new(mount))
    }

    /// The settings for opening its source, if it has one.
    pub(crate) fn source_settings(&self, limits: FrameLimits) -> Option<SourceSettings> {
        Some(SourceSettings {
            address: self.source.clone()?,
            max_rate: self.max_rate,
            transport: self.rtsp_transport,
            hardware: self.hardware.clone(),
            options: self.source_options.clone(),
            silence: SOURCE_SILENCE,
            // Not encoded again: most frames are never examined.
            as_jpeg: false,
            limits,
        })
    }
}

#[cfg(test)]
mod tests;
