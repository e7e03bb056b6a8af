//! Checks the endpoints of Zenoh sessions, such as `tcp/127.0.0.1:7447`.

use super::Findings;
use ::zenoh::config::EndPoint;

/// The transports that are compiled in.
const TRANSPORTS: [&str; 4] = ["tcp", "tls", "udp", "unixsock-stream"];

/// The transport whose address is a file.
const OF_A_FILE: &str = "unixsock-stream";

/// What a session does with an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndpointUse {
    /// It connects to it.
    Connect,
    /// It listens on it: port 0 is any free one.
    Listen,
}

/// A place in the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct HostPort {
    /// A name or an address, without brackets.
    pub(crate) host: String,
    pub(crate) port: u16,
}

impl HostPort {
    /// Reads `hub.example:7447`, `127.0.0.1:7447` or `[::1]:7447`.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn read(address: &str) -> Result<Self, String> {
        let (host, port) = match address.rsplit_once(':') {
            Some(parts) if !address.ends_with(']') => parts,
            _ => return Err("names no port, as in `tcp/127.0.0.1:7447`".to_owned()),
        };
        let bare = match host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            Some(bare) => bare,
            None if host.contains(':') => {
                return Err("needs brackets around its address, as in `tcp/[::1]:7447`".to_owned());
            }
            None => host,
        };
        if bare.is_empty() {
            return Err("names no host, as in `tcp/127.0.0.1:7447`".to_owned());
        }
        let Ok(port) = port.parse() else {
            return Err(format!(
                "has the port `{port}`: a port is a number up to 65535"
            ));
        };
        Ok(Self {
            host: bare.to_owned(),
            port,
        })
    }
}

/// Checks that Zenoh can read an endpoint, and that this program can use it.
///
/// # Errors
/// The endpoint, and what is wrong with it.
pub fn check_endpoint(endpoint: &str, usage: EndpointUse) -> Result<(), String> {
    fault(endpoint, usage).map_err(|reason| format!("`{endpoint}` {reason}"))
}

fn fault(endpoint: &str, usage: EndpointUse) -> Result<(), String> {
    let parsed: EndPoint = endpoint
        .parse()
        .map_err(|error| format!("is not an endpoint such as `tcp/127.0.0.1:7447`: {error}"))?;
    let protocol = parsed.protocol();
    let transport = protocol.as_str();
    if !TRANSPORTS.contains(&transport) {
        return Err(format!(
            "has the transport `{transport}`, which is not built in; there are {}",
            TRANSPORTS.join(", ")
        ));
    }
    if transport == OF_A_FILE {
        return Ok(());
    }
    let place = HostPort::read(parsed.address().as_str())?;
    if place.port == 0 && usage == EndpointUse::Connect {
        return Err("has the port 0, to which nobody can connect".to_owned());
    }
    Ok(())
}

/// Adds an error for each endpoint that cannot be used.
pub(super) fn check_endpoints(
    key: &str,
    endpoints: &[String],
    usage: EndpointUse,
    findings: &mut Findings,
) {
    for endpoint in endpoints {
        findings.check(key, check_endpoint(endpoint, usage));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_that_no_session_can_use_is_refused_with_the_reason() {
        for (endpoint, reason) in [
            ("nonsense", "is not an endpoint"),
            ("quic/hub:1", "`quic`, which is not built in"),
            ("ws/hub:1", "`ws`, which is not built in"),
            ("tcp/localhost", "names no port"),
            ("tls/[::1]", "names no port"),
            ("tcp/:7447", "names no host"),
            ("tcp/::1:7447", "needs brackets"),
            ("tcp/127.0.0.1:74480", "has the port `74480`"),
            ("udp/hub:-1", "has the port `-1`"),
            ("tcp/hub:", "has the port ``"),
            ("tls/hub:0#iface=eth0", "has the port 0"),
        ] {
            let refused = check_endpoint(endpoint, EndpointUse::Connect).unwrap_err();
            assert!(refused.starts_with(&format!("`{endpoint}` ")), "{refused}");
            assert!(refused.contains(reason), "{reason}: {refused}");
        }
    }

    #[test]
    fn an_endpoint_that_a_session_can_use_is_accepted() {
        for endpoint in [
            "tcp/hub.example:7447",
            "tls/[fd00::7]:7448?rel=0#iface=eth0",
            "udp/203.0.113.7:65535",
            "unixsock-stream//run/albireo.sock",
        ] {
            assert_eq!(check_endpoint(endpoint, EndpointUse::Connect), Ok(()));
        }
        let any_port = check_endpoint("tcp/127.0.0.1:0", EndpointUse::Listen);
        assert_eq!(any_port, Ok(()));
    }
}
