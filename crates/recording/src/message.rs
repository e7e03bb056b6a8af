//! The messages in JSON, their schemas, and the topics of a camera.

use albireo_wire::BoxMessage;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// A topic of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Topic {
    /// The picture.
    Image,
    /// The published boxes, to draw over it.
    Boxes,
    /// What is plotted.
    Figures,
    /// The published message.
    Detections,
    /// Where the frame was taken.
    Position,
    /// Why there is a recording.
    Event,
    /// A frame on which the audit found a difference.
    Audit,
    /// Its picture.
    AuditImage,
    /// The boxes that the detector found on it.
    AuditBoxes,
}

impl Topic {
    /// All topics.
    pub const ALL: [Self; 9] = [
        Self::Image,
        Self::Boxes,
        Self::Figures,
        Self::Detections,
        Self::Position,
        Self::Event,
        Self::Audit,
        Self::AuditImage,
        Self::AuditBoxes,
    ];

    /// The last part of its name.
    const fn ending(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Boxes => "boxes",
            Self::Figures => "figures",
            Self::Detections => "detections",
            Self::Position => "position",
            Self::Event => "event",
            Self::Audit => "audit",
            Self::AuditImage => "audit/image",
            Self::AuditBoxes => "audit/boxes",
        }
    }

    /// Its name for a camera.
    pub fn of(self, camera: &str) -> String {
        format!("/{camera}/{}", self.ending())
    }

    /// Splits a name into camera and topic.
    pub fn parse(name: &str) -> Option<(&str, Self)> {
        let (camera, ending) = name.strip_prefix('/')?.split_once('/')?;
        let topic = Self::ALL.into_iter().find(|topic| topic.ending() == ending)?;
        Some((camera, topic))
    }

    /// The name of its schema, as which a reader knows the messages.
    pub(crate) const fn schema(self) -> &'static str {
        match self {
            Self::Image | Self::AuditImage => "foxglove.CompressedImage",
            Self::Boxes | Self::AuditBoxes => "foxglove.ImageAnnotations",
            Self::Figures => "albireo.Figures",
            Self::Detections => "albireo.Detections",
            Self::Position => "foxglove.LocationFix",
            Self::Event => "albireo.Event",
            Self::Audit => "albireo.Audit",
        }
    }

    /// The schema of its messages in JSON; `None` if they are in protobuf.
    pub(crate) fn json_schema(self) -> Option<Value> {
        match self {
            Self::Detections => Some(detections()),
            Self::Event => Some(event()),
            Self::Audit => Some(audit()),
            _ => None,
        }
    }
}

/// A recording's cause, on [`Topic::Event`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventMessage {
    /// Version.
    pub v: u32,
    /// Time of the event, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// What happened: `audit`, or the words of the request.
    pub reason: String,
}

/// A frame that was answered without the detector, with what the detector found on it afterwards, on [`Topic::Audit`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditMessage {
    /// Version.
    pub v: u32,
    /// Sequence number of the frame.
    pub seq: u64,
    /// Capture time, nanoseconds since the Unix epoch.
    pub t_ns: u64,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// The boxes that were published.
    pub shown: Vec<BoxMessage>,
    /// The boxes that the detector found.
    pub detected: Vec<BoxMessage>,
}

fn object(title: &str, properties: Value) -> Value {
    json!({"title": title, "type": "object", "properties": properties})
}

fn boxes() -> Value {
    let fields = json!({
        "box": {
            "description": "Left, top, right, bottom, pixels",
            "type": "array", "items": {"type": "number"},
        },
        "class": {"type": "string"},
        "confidence": {"type": "number"},
        "source": {"type": "string", "description": "detected, predicted, followed or rescued"},
        "object": {"type": "integer", "description": "Track id"},
        "confirmed": {"type": "boolean"},
    });
    json!({"type": "array", "items": object("box", fields)})
}

fn whole() -> Value {
    json!({"type": "integer"})
}

fn number() -> Value {
    json!({"type": "number"})
}

fn text() -> Value {
    json!({"type": "string"})
}

fn detections() -> Value {
    let latency = json!({
        "total": number(), "waiting": number(), "decode": number(), "screen": number(),
        "detector": number(), "policy": number(),
    });
    let threshold = json!({"name": text(), "value": number()});
    let fields = json!({
        "v": whole(),
        "seq": whole(),
        "t_ns": whole(),
        "clip": text(),
        "state": {"type": "string", "description": "E, P, E+I, I or AI"},
        "pending": {"type": "boolean"},
        "degraded": {"type": "boolean"},
        "cause": text(),
        "passed": text(),
        "tau_max": number(),
        "threshold": object("threshold", threshold),
        "width": whole(),
        "height": whole(),
        "boxes": boxes(),
        "latency_ms": object("latency_ms", latency),
    });
    object("albireo.Detections", fields)
}

fn event() -> Value {
    let fields = json!({"v": whole(), "t_ns": whole(), "reason": text()});
    object("albireo.Event", fields)
}

fn audit() -> Value {
    let fields = json!({
        "v": whole(), "seq": whole(), "t_ns": whole(), "width": whole(), "height": whole(),
        "shown": boxes(), "detected": boxes(),
    });
    object("albireo.Audit", fields)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_is_found_by_its_name() {
        for topic in Topic::ALL {
            let name = topic.of("front");
            assert_eq!(Topic::parse(&name), Some(("front", topic)));
        }
        for other in ["/image", "front/image", "/front/other", "/a/b/image"] {
            assert_eq!(Topic::parse(other), None, "{other}");
        }
    }
}
