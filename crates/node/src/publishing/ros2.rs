//! Publishes a camera's boxes for ROS 2: `vision_msgs/msg/Detection2DArray` in CDR, as rmw_zenoh and
//! zenoh-bridge-ros2dds expect it.

use super::{LIVE, Unpublished};
use crate::error::NodeError;
use albireo_service::clock::unix_nanoseconds;
use albireo_wire::{BoxMessage, DetectionsMessage};
use std::sync::atomic::{AtomicI64, Ordering};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// The type's name in keys.
const TYPE: &str = "vision_msgs::msg::dds_::Detection2DArray_";

/// The hash of the type by REP 2016 (RIHS01), of vision_msgs 4.0 and later, which every distribution from Humble on has.
/// tests/clients/ros2.py computes it from the message's definition.
const HASH: &str = "RIHS01_214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968";

/// What Humble, which knows no hashes, has in its keys instead (rmw_zenoh, branch humble).
const NO_HASH: &str = "TypeHashNotSupported";

/// Best effort, the last 10 (rmw_zenoh_cpp/src/detail/liveliness_utils.cpp).
const QOS: &str = "2::,10:,:,:,,";

/// The length of a ROS 2 pose's covariance.
const COVARIANCE: usize = 36;

/// The place of a camera in the graph of ROS 2.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Ros2Place {
    domain: u32,
    /// The parts of the namespace.
    namespace: Vec<String>,
    /// The name of the node, and the frame id of its messages.
    camera: String,
}

impl Ros2Place {
    /// The place of `camera` of `node`: `/{prefix}/{node}/{camera}`, with `_` for what ROS 2 does not allow in names.
    pub(crate) fn new(domain: u32, prefix: &str, node: &str, camera: &str) -> Self {
        Self {
            domain,
            namespace: prefix.split('/').chain([node]).map(word).collect(),
            camera: word(camera),
        }
    }

    /// The topic, without the slash at its beginning.
    fn topic(&self) -> String {
        let parts = self.namespace.iter().chain([&self.camera]);
        parts.map(|part| format!("{part}/")).collect::<String>() + "detections_2d"
    }

    /// The keys of the messages.
    fn keys(&self) -> [String; 3] {
        let Self { domain, .. } = self;
        let topic = self.topic();
        [
            format!("{domain}/{topic}/{TYPE}/{HASH}"),
            format!("{domain}/{topic}/{TYPE}/{NO_HASH}"),
            topic,
        ]
    }

    /// The keys of the liveliness tokens by which ROS 2 sees the node and its publisher.
    fn tokens(&self, session: &str) -> [String; 2] {
        let Self { domain, camera, .. } = self;
        let namespace: String = self.namespace.iter().map(|part| format!("%{part}")).collect();
        let topic = self.topic().replace('/', "%");
        // One ROS 2 node per camera, whose name tells them apart within the session.
        [
            format!("@ros2_lv/{domain}/{session}/0/0/NN/%/{namespace}/{camera}"),
            format!(
                "@ros2_lv/{domain}/{session}/0/1/MP/%/{namespace}/{camera}/%{topic}/{TYPE}/{HASH}/{QOS}"
            ),
        ]
    }
}

/// A part of a name as ROS 2 allows it.
fn word(part: &str) -> String {
    let allowed = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let word: String = part.chars().map(allowed).collect();
    if word.starts_with(|c: char| c.is_ascii_digit()) {
        format!("_{word}")
    } else {
        word
    }
}

/// A topic of ROS 2 for a camera's boxes.
pub(crate) struct Ros2Outlet {
    place: Ros2Place,
    publishers: Vec<Publisher<'static>>,
    /// Identifies the publisher in attachments.
    gid: [u8; 16],
    sequence: AtomicI64,
    unpublished: Unpublished,
    /// Held for as long as ROS 2 is to see the node and its publisher.
    _tokens: Vec<LivelinessToken>,
}

impl Ros2Outlet {
    /// Declares the topic.
    ///
    /// # Errors
    /// [`NodeError`] if Zenoh rejects a declaration.
    pub(crate) async fn declare(
        session: &Session,
        place: Ros2Place,
        unpublished: &Unpublished,
    ) -> Result<Self, NodeError> {
        let mut publishers = Vec::new();
        for key in place.keys() {
            let refused = NodeError::refused(format!("`{key}` cannot be published"));
            let publisher = session
                .declare_publisher(key)
                .congestion_control(CongestionControl::Drop)
                .priority(LIVE)
                .await;
            publishers.push(publisher.map_err(refused)?);
        }
        let mut tokens = Vec::new();
        for key in place.tokens(&session.zid().to_string()) {
            let refused = NodeError::refused(format!("`{key}` cannot be declared"));
            tokens.push(session.liveliness().declare_token(key).await.map_err(refused)?);
        }
        tracing::info!(
            topic = format!("/{}", place.topic()),
            "boxes are published for ROS 2"
        );
        Ok(Self {
            place,
            publishers,
            gid: *uuid::Uuid::new_v4().as_bytes(),
            sequence: AtomicI64::new(1),
            unpublished: unpublished.clone(),
            _tokens: tokens,
        })
    }

    /// Puts an answer.
    pub(crate) fn put(&self, message: &DetectionsMessage) {
        let array = detection_array(message, &self.place.camera);
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let attachment = attachment(sequence, unix_nanoseconds(), &self.gid);
        for publisher in &self.publishers {
            let put = publisher.put(array.clone()).attachment(attachment.clone());
            if let Err(error) = put.wait() {
                self.unpublished.count();
                let key = publisher.key_expr();
                tracing::debug!(%key, %error, "a message was not published");
            }
        }
    }
}

/// The attachment of rmw_zenoh from its release 0.2.4 on: number, time of sending in nanoseconds, and the publisher's id with
/// its length.
fn attachment(sequence: i64, time_ns: u64, gid: &[u8; 16]) -> Vec<u8> {
    let time = i64::try_from(time_ns).unwrap_or(i64::MAX);
    [&sequence.to_le_bytes()[..], &time.to_le_bytes(), &[16], gid].concat()
}

/// An answer as `vision_msgs/msg/Detection2DArray`: boxes in pixels, the class by name, the object's number as its id.
fn detection_array(message: &DetectionsMessage, frame_id: &str) -> Vec<u8> {
    let mut cdr = CdrWriter::default();
    cdr.header(message.t_ns, frame_id);
    cdr.count(message.boxes.len());
    for found in &message.boxes {
        cdr.header(message.t_ns, frame_id);
        cdr.detection(found);
    }
    cdr.finish()
}

/// Writes plain CDR, little-endian.
#[derive(Default)]
struct CdrWriter {
    /// The message behind the encapsulation header, from which alignment counts.
    bytes: Vec<u8>,
}

impl CdrWriter {
    fn align(&mut self, to: usize) {
        self.bytes.resize(self.bytes.len().next_multiple_of(to), 0);
    }

    fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes the length of a list. A frame has a few hundred boxes at most.
    fn count(&mut self, number: usize) {
        self.u32(u32::try_from(number).unwrap_or(u32::MAX));
    }

    fn text(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// Writes a `std_msgs/msg/Header`. Its seconds are signed and end in 2038.
    fn header(&mut self, time_ns: u64, frame_id: &str) {
        let seconds = i32::try_from(time_ns / 1_000_000_000).unwrap_or(i32::MAX);
        self.u32(seconds.cast_unsigned());
        self.u32((time_ns % 1_000_000_000) as u32);
        self.text(frame_id);
    }

    /// Writes a `vision_msgs/msg/Detection2D` behind its header: one hypothesis, whose pose is unknown, box and id.
    fn detection(&mut self, found: &BoxMessage) {
        self.count(1);
        self.text(&found.class);
        self.f64(f64::from(found.confidence));
        let unknown_pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        for value in unknown_pose {
            self.f64(value);
        }
        for value in [0.0; COVARIANCE] {
            self.f64(value);
        }
        let [left, top, right, bottom] = found.corners.map(f64::from);
        let angle = 0.0;
        for value in [
            (left + right) / 2.0,
            (top + bottom) / 2.0,
            angle,
            right - left,
            bottom - top,
        ] {
            self.f64(value);
        }
        self.text(&found.object.map(|object| object.0.to_string()).unwrap_or_default());
    }

    fn finish(self) -> Vec<u8> {
        const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
        [&LITTLE_ENDIAN[..], &self.bytes].concat()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_those_that_ros_2_allows() {
        let place = Ros2Place::new(3, "fleet/north", "car-7", "2.front");
        assert_eq!(place.topic(), "fleet/north/car_7/_2_front/detections_2d");
        let [rihs, humble, bridge] = place.keys();
        assert_eq!(rihs, format!("3/{bridge}/{TYPE}/{HASH}"));
        assert_eq!(humble, format!("3/{bridge}/{TYPE}/TypeHashNotSupported"));
        let [node, publisher] = place.tokens("a1b2");
        assert_eq!(node, "@ros2_lv/3/a1b2/0/0/NN/%/%fleet%north%car_7/_2_front");
        let place = "@ros2_lv/3/a1b2/0/1/MP/%/%fleet%north%car_7/_2_front";
        let topic = "%fleet%north%car_7%_2_front%detections_2d";
        assert_eq!(
            publisher,
            format!("{place}/{topic}/{TYPE}/{HASH}/2::,10:,:,:,,")
        );
    }
}
