//! Sends frames to a node over a Zenoh session.

mod sender;
mod session;

pub(crate) use sender::Receivers;
#[cfg(feature = "eval")]
pub(crate) use sender::TURN;
pub use sender::{FrameSender, OutgoingFrame, Pacing};
#[cfg(feature = "eval")]
use session::DEFAULT_ENDPOINT;
pub(crate) use session::close;
pub use session::open_session;

use albireo_service::config::{EndpointUse, check_endpoint};
use albireo_wire::NodeKeys;

/// Heading of the options that say where frames go.
const WHERE: &str = "Where to";

/// Where a sender's frames go.
#[derive(clap::Args, Clone, Debug)]
pub struct FrameTarget {
    /// First part of the key PREFIX/NODE/CAMERA/frame
    #[arg(long, help_heading = WHERE, default_value = "albireo")]
    pub prefix: String,
    /// Node that receives the frames
    #[arg(long, help_heading = WHERE, default_value = "node")]
    pub node: String,
    /// Camera to play
    #[arg(long, help_heading = WHERE, default_value = "front")]
    pub camera: String,
    /// Publish on this key instead
    #[arg(long, help_heading = WHERE, conflicts_with_all = ["prefix", "node", "camera"])]
    pub key: Option<String>,

    /// Zenoh endpoint to connect to; may be repeated [default: tcp/127.0.0.1:7447]
    #[arg(long, help_heading = WHERE, value_name = "ENDPOINT", value_parser = to_connect)]
    pub connect: Vec<String>,
    /// Zenoh endpoint to listen on; may be repeated
    #[arg(long, help_heading = WHERE, value_name = "ENDPOINT", value_parser = to_listen)]
    pub listen: Vec<String>,
}

/// Reads an endpoint: a sender goes on trying to reach one that is not there, and would for ever with one that cannot be.
fn to_connect(text: &str) -> Result<String, String> {
    check_endpoint(text, EndpointUse::Connect).map(|()| text.to_owned())
}

/// Reads an endpoint to listen on.
fn to_listen(text: &str) -> Result<String, String> {
    check_endpoint(text, EndpointUse::Listen).map(|()| text.to_owned())
}

impl FrameTarget {
    /// The key to publish on.
    ///
    /// # Errors
    /// When a name is not valid in a key.
    pub fn frame_key(&self) -> anyhow::Result<String> {
        if let Some(key) = &self.key {
            return Ok(key.clone());
        }
        let node = NodeKeys::new(&self.prefix, &self.node)?;
        Ok(node.camera(&self.camera)?.frame())
    }

    /// The endpoints of the session.
    #[cfg(feature = "eval")]
    pub(crate) fn endpoints(&self) -> String {
        if self.connect.is_empty() && self.listen.is_empty() {
            return DEFAULT_ENDPOINT.to_owned();
        }
        let endpoints: Vec<&str> =
            self.connect.iter().chain(&self.listen).map(String::as_str).collect();
        endpoints.join(", ")
    }
}

/// The advice if no node subscribes to a key.
pub(crate) const NOBODY: &str =
    "is the node running, and does one of its cameras have this name (or this key)?";
