//! The `[position]` section.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

/// The port on which gpsd listens.
const GPSD_PORT: u16 = 2947;
/// The time limit for a connection when a configuration is checked.
const LOOKING: Duration = Duration::from_secs(2);

/// The `[position]` section.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PositionConfig {
    /// Where positions come from.
    pub source: PositionSource,
}

/// Where positions come from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum PositionSource {
    /// Nowhere: those in frames are ignored.
    Off,
    /// Attachments of frames only.
    #[default]
    Frames,
    /// A gpsd at this host and port.
    Gpsd(String),
    /// Lines of NMEA 0183 from this host and port.
    Tcp(String),
    /// Lines of NMEA 0183 from a serial port, a FIFO or a file.
    Path(PathBuf),
}

impl PositionSource {
    /// True if the node reads positions itself.
    pub(crate) const fn is_receiver(&self) -> bool {
        !matches!(self, Self::Off | Self::Frames)
    }

    /// Finds out whether a receiver is there now; blocks for at most some seconds.
    ///
    /// # Errors
    /// The reason why it cannot be opened.
    pub(crate) fn look(&self) -> io::Result<()> {
        match self {
            Self::Off | Self::Frames => Ok(()),
            Self::Path(path) => std::fs::metadata(path).map(drop),
            Self::Gpsd(place) | Self::Tcp(place) => {
                let mut last = io::ErrorKind::AddrNotAvailable.into();
                for address in place.to_socket_addrs()? {
                    match TcpStream::connect_timeout(&address, LOOKING) {
                        Ok(_) => return Ok(()),
                        Err(error) => last = error,
                    }
                }
                Err(last)
            }
        }
    }
}

impl TryFrom<String> for PositionSource {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        if let Some(place) = text.strip_prefix("gpsd://") {
            let mut place = place.trim_end_matches('/').to_owned();
            let has_port = !place.ends_with(']') && place.contains(':');
            if !has_port {
                place = format!("{place}:{GPSD_PORT}");
            }
            return address(&text, place).map(Self::Gpsd);
        }
        if let Some(place) = text.strip_prefix("tcp://") {
            return address(&text, place.trim_end_matches('/').to_owned()).map(Self::Tcp);
        }
        match text.as_str() {
            "off" => Ok(Self::Off),
            "frames" => Ok(Self::Frames),
            path if path.starts_with(['/', '.']) => Ok(Self::Path(path.into())),
            _ => Err(format!(
                "`{text}` is none of: off, frames, gpsd://localhost:{GPSD_PORT}, tcp://HOST:PORT (NMEA), or the path of a \
                 serial port, FIFO or file, such as /dev/ttyUSB0"
            )),
        }
    }
}

/// Checks a host and port.
fn address(text: &str, place: String) -> Result<String, String> {
    let is_address = place.rsplit_once(':').is_some_and(|(host, port)| {
        !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0)
    });
    if !is_address {
        return Err(format!("`{text}` has no host and port"));
    }
    Ok(place)
}

impl fmt::Display for PositionSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Frames => f.write_str("frames"),
            Self::Gpsd(place) => write!(f, "gpsd://{place}"),
            Self::Tcp(place) => write!(f, "tcp://{place}"),
            Self::Path(path) => path.display().fmt(f),
        }
    }
}

impl From<PositionSource> for String {
    fn from(source: PositionSource) -> Self {
        source.to_string()
    }
}
