//! Key expressions: `{prefix}/{node}/{camera}/…`.

use std::fmt::Display;

/// The error for a name that cannot be part of a key expression.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct KeyError(String);

/// Checks that `name` is valid as one segment of a key expression.
///
/// # Errors
/// [`KeyError`] if it is empty, or has a character that is special to Zenoh (`/ * $ # ? @`) or not allowed in names. A
/// leading `@` is reserved by Zenoh (verbatim segments), so names may not have it.
pub fn check_segment(what: &str, name: &str) -> Result<(), KeyError> {
    let refused = |reason: &str| {
        Err(KeyError(format!(
            "{what} `{name}` cannot be used in a Zenoh key: {reason}; use letters, digits, `-`, `_` and `.`"
        )))
    };
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.is_empty() {
        refused("it is empty")
    } else if !name.chars().all(is_allowed) {
        refused("it has a character that is not allowed")
    } else {
        Ok(())
    }
}

/// Longest name of a node, bytes: it is the first column of every table, and a part of every key.
const LONGEST_NODE_NAME: usize = 64;
/// Longest name of a camera, bytes: with its time, that of a recording must be the name of a file (255 bytes).
const LONGEST_CAMERA_NAME: usize = 200;

/// Checks that `name` can be the name of a `what`: one segment of a key that is neither above `longest` bytes nor only dots,
/// which mean something else in an HTTP path.
fn check_name(what: &str, name: &str, longest: usize) -> Result<(), KeyError> {
    // First, because no shorter name of such characters is allowed, either.
    check_segment(what, name)?;
    if name.len() > longest {
        let length = name.len();
        return Err(KeyError(format!(
            "{what} with {length} bytes: it must have at most {longest}"
        )));
    }
    if name.bytes().all(|byte| byte == b'.') {
        return Err(KeyError(format!(
            "{what} `{name}` must not be only dots, which mean something else in an HTTP path"
        )));
    }
    Ok(())
}

/// Checks that `name` can be the name of a camera.
///
/// # Errors
/// [`KeyError`] if it is too long, only dots, or no segment of a key.
pub fn check_camera_name(name: &str) -> Result<(), KeyError> {
    check_name("camera name", name, LONGEST_CAMERA_NAME)
}

/// Checks that `name` can be the name of a node, which must not be `all`, either: that selects every node.
///
/// # Errors
/// [`KeyError`] if it is too long, only dots, no segment of a key, or `all`.
pub fn check_node_name(name: &str) -> Result<(), KeyError> {
    check_name("node name", name, LONGEST_NODE_NAME)?;
    if name == "all" {
        return Err(KeyError(
            "node name `all` would select every node: choose another".to_owned(),
        ));
    }
    Ok(())
}

/// The keys of one node. In keys between a node and a hub, the kind precedes the node: with the node first, a router
/// would match every message against all nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeKeys {
    prefix: String,
    node: String,
}

impl NodeKeys {
    /// Returns the keys of `node` under `prefix`, which may have several parts.
    ///
    /// # Errors
    /// [`KeyError`] if either name is invalid.
    pub fn new(prefix: &str, node: &str) -> Result<Self, KeyError> {
        check_node_name(node)?;
        let mut keys = Self::all(prefix)?;
        keys.node = node.to_owned();
        Ok(keys)
    }

    /// Returns the keys of all nodes under `prefix`, for a hub's subscriptions.
    ///
    /// # Errors
    /// [`KeyError`] if the prefix is invalid.
    pub fn all(prefix: &str) -> Result<Self, KeyError> {
        for part in prefix.split('/') {
            check_segment("the part", part)
                .map_err(|KeyError(reason)| KeyError(format!("prefix `{prefix}`: {reason}")))?;
        }
        Ok(Self {
            prefix: prefix.to_owned(),
            node: "*".to_owned(),
        })
    }

    fn key(&self, kind: &str) -> String {
        format!("{}/{kind}/{}", self.prefix, self.node)
    }

    /// [`ReportBatch`](super::ReportBatch)es as queries to the hub.
    pub fn report(&self) -> String {
        self.key("@report")
    }

    /// [`StatusMessage`](super::StatusMessage)s out.
    pub fn status(&self) -> String {
        self.key("@status")
    }

    /// [`RevisionMessage`](super::RevisionMessage)s as queries to the hub.
    pub fn pull(&self) -> String {
        self.key("@pull")
    }

    /// [`RevisionMessage`](super::RevisionMessage)s from the hub.
    pub fn changed(&self) -> String {
        self.key("@changed")
    }

    /// The liveliness token, present while the node is alive.
    pub fn alive(&self) -> String {
        self.key("@alive")
    }

    /// [`TargetMessage`](super::TargetMessage)s in by put and query, [`TargetReport`](super::TargetReport)s out by
    /// query.
    pub fn target(&self) -> String {
        format!("{}/{}/target", self.prefix, self.node)
    }

    /// [`PolicyMessage`](super::PolicyMessage)s in by put, in and out by query.
    pub fn policy(&self) -> String {
        format!("{}/{}/policy", self.prefix, self.node)
    }

    /// [`ScreenMessage`](super::ScreenMessage)s in by put, in and out by query.
    pub fn screen(&self) -> String {
        format!("{}/{}/screen", self.prefix, self.node)
    }

    /// The counters of all cameras of the node, for subscribers that watch it.
    pub fn all_counters(&self) -> String {
        format!("{}/{}/*/counters", self.prefix, self.node)
    }

    /// The pictures of all cameras of the node, for rules of access.
    pub fn all_pictures(&self) -> String {
        format!("{}/{}/*/picture", self.prefix, self.node)
    }

    /// Returns the keys of the camera named `camera`.
    ///
    /// # Errors
    /// [`KeyError`] if the name is invalid.
    pub fn camera(&self, camera: &str) -> Result<CameraKeys, KeyError> {
        check_camera_name(camera)?;
        Ok(CameraKeys {
            root: format!("{}/{}/{camera}", self.prefix, self.node),
        })
    }

    /// Returns the node of a key of this kind: its last part. `None` if that is not a valid node name, such as a
    /// wildcard or a part with invalid characters.
    pub fn node_of(key: &str) -> Option<&str> {
        Self::sender_of(key).ok()
    }

    /// Returns the node of a key of this kind, as [`node_of`](Self::node_of) does.
    ///
    /// # Errors
    /// [`KeyError`] with the reason why the last part of the key is not a valid node name.
    pub fn sender_of(key: &str) -> Result<&str, KeyError> {
        let node = key.rsplit_once('/').map_or("", |(_, node)| node);
        check_node_name(node)?;
        Ok(node)
    }
}

/// The keys of one camera of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraKeys {
    root: String,
}

impl CameraKeys {
    /// Frames in.
    pub fn frame(&self) -> String {
        format!("{}/frame", self.root)
    }

    /// [`DetectionsMessage`](super::DetectionsMessage)s out, one per frame.
    pub fn detections(&self) -> String {
        format!("{}/detections", self.root)
    }

    /// [`DetectionsMessage`](super::DetectionsMessage)s out: the final answers of frames that were `pending`.
    pub fn late(&self) -> String {
        format!("{}/late", self.root)
    }

    /// [`SettledMessage`](super::SettledMessage)s out, one per frame.
    pub fn settled(&self) -> String {
        format!("{}/settled", self.root)
    }

    /// [`ClipReport`](super::ClipReport)s out, one per clip.
    pub fn clip(&self) -> String {
        format!("{}/clip", self.root)
    }

    /// [`CountersMessage`](super::CountersMessage)s out, one per second.
    pub fn counters(&self) -> String {
        format!("{}/counters", self.root)
    }

    /// The newest picture as JPEG, by query, answered while the node is watched. The attachment is its sequence number
    /// in decimal digits.
    pub fn picture(&self) -> String {
        format!("{}/picture", self.root)
    }

    /// [`ThresholdMessage`](super::ThresholdMessage)s in by put, in and out by query.
    pub fn threshold(&self) -> String {
        format!("{}/threshold", self.root)
    }
}

/// Returns the key of the liveliness token that a publisher of frames holds while it runs, so that the next stream is
/// accepted at once: `{frame key}/@stream/{stream}`. The stream `*` stands for all of them.
pub fn stream_token(frame_key: &str, stream: impl Display) -> String {
    format!("{frame_key}/@stream/{stream}")
}

/// Returns the stream of a [`stream_token`].
pub fn stream_of_token(key: &str) -> Option<u64> {
    let (_, stream) = key.rsplit_once('/')?;
    stream.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_follow_the_documented_layout() {
        let node = NodeKeys::new("albireo", "car-7").unwrap();
        let camera = node.camera("front").unwrap();
        assert_eq!(node.target(), "albireo/car-7/target");
        assert_eq!(node.policy(), "albireo/car-7/policy");
        assert_eq!(node.screen(), "albireo/car-7/screen");
        assert_eq!(node.alive(), "albireo/@alive/car-7");
        assert_eq!(node.report(), "albireo/@report/car-7");
        let all = NodeKeys::all("albireo").unwrap();
        assert_eq!(all.status(), "albireo/@status/*");
        assert_eq!(NodeKeys::node_of("albireo/@status/car-7"), Some("car-7"));
        assert_eq!(NodeKeys::node_of("albireo/@status/*"), None);
        assert_eq!(NodeKeys::node_of("albireo/@status/a\0b"), None);
        assert_eq!(camera.frame(), "albireo/car-7/front/frame");
        assert_eq!(camera.detections(), "albireo/car-7/front/detections");
        assert_eq!(camera.clip(), "albireo/car-7/front/clip");
        assert_eq!(camera.counters(), "albireo/car-7/front/counters");
        assert_eq!(camera.threshold(), "albireo/car-7/front/threshold");
        assert_eq!(camera.picture(), "albireo/car-7/front/picture");
        let token = stream_token(&camera.frame(), 7);
        assert_eq!(token, "albireo/car-7/front/frame/@stream/7");
        assert_eq!(stream_of_token(&token), Some(7));
        assert_eq!(node.all_counters(), "albireo/car-7/*/counters");
        assert_eq!(node.all_pictures(), "albireo/car-7/*/picture");
    }

    #[test]
    fn a_node_name_is_short_has_more_than_dots_and_does_not_select_every_node() {
        let longest = "n".repeat(64);
        for name in [
            "car-7",
            "a",
            "all-1",
            "ALL",
            ".car",
            "car.",
            longest.as_str(),
        ] {
            assert!(check_node_name(name).is_ok(), "{name:?}");
            assert!(NodeKeys::new("albireo", name).is_ok(), "{name:?}");
        }
        let too_long = "n".repeat(65);
        for name in ["", ".", "..", "...", "all", "a/b", too_long.as_str()] {
            assert!(check_node_name(name).is_err(), "{name:?}");
            assert!(NodeKeys::new("albireo", name).is_err(), "{name:?}");
            let key = format!("albireo/@status/{name}");
            let is_read = NodeKeys::node_of(&key).is_some_and(|node| node == name);
            assert!(!is_read, "{name:?}");
        }
        let refused = NodeKeys::sender_of("albireo/@status/all").unwrap_err();
        assert!(refused.to_string().contains("`all`"), "{refused}");
    }

    #[test]
    fn a_camera_name_is_short_and_has_more_than_dots() {
        let node = NodeKeys::new("albireo", "car-7").unwrap();
        let longest = "c".repeat(LONGEST_CAMERA_NAME);
        for name in ["front", "all", "rear.2", longest.as_str()] {
            assert!(check_camera_name(name).is_ok(), "{name:?}");
            assert!(node.camera(name).is_ok(), "{name:?}");
        }
        let too_long = "c".repeat(LONGEST_CAMERA_NAME + 1);
        for name in ["", ".", "..", "a/b", too_long.as_str()] {
            assert!(check_camera_name(name).is_err(), "{name:?}");
            assert!(node.camera(name).is_err(), "{name:?}");
        }
    }

    #[test]
    fn names_unsafe_in_a_zenoh_key_are_rejected() {
        for name in ["", "a/b", "*", "a$*", "@alive", "a b", "a#b", "ä"] {
            assert!(check_segment("camera name", name).is_err(), "{name:?}");
        }
        assert!(NodeKeys::new("fleet/north", "n").is_ok());
        assert!(NodeKeys::new("fleet//north", "n").is_err());
    }
}
