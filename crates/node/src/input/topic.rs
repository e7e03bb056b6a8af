//! ROS 2 topics: their names, and the Zenoh keys of their messages.

/// Returns the Zenoh keys on which a topic's messages arrive: those of rmw_zenoh (`<domain>/<topic>/<type>/<type hash>`, of
/// which only newer distributions know the hash), and of the bridge zenoh-bridge-ros2dds (`<topic>`).
pub(crate) fn keys_of_topic(domain: u32, topic: &str) -> [String; 2] {
    let topic = topic.trim_matches('/');
    [format!("{domain}/{topic}/*/*"), topic.to_owned()]
}

/// Checks that `topic` is a name that ROS 2 allows.
///
/// # Errors
/// The reason.
pub(crate) fn check_topic(topic: &str) -> Result<(), String> {
    let is_word = |part: &str| {
        let starts = part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
        starts && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    match topic.strip_prefix('/') {
        Some(parts) if parts.split('/').all(is_word) => Ok(()),
        Some(_) => Err(format!(
            "`{topic}` is not the name of a ROS 2 topic: its parts are letters, digits and `_`, and begin with no digit"
        )),
        None => Err(format!(
            "`{topic}` must begin with `/`, as `ros2 topic list` shows it"
        )),
    }
}
