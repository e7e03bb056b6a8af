//! Checks the endpoints of Zenoh sessions, such as `tcp/127.0.0.1:7447`.

use super::Findings;
use crate::session;
use ::zenoh::config::EndPoint;
use std::net::Ipv6Addr;

/// The transports that are compiled in.
const TRANSPORTS: [&str; 4] = ["tcp", "tls", "udp", "unixsock-stream"];

/// The transport whose address is a file.
const OF_A_FILE: &str = "unixsock-stream";

/// The other transports of Zenoh.
const OTHER_TRANSPORTS: [&str; 6] = ["quic", "quic_datagram", "ws", "unixpipe", "serial", "vsock"];

/// An endpoint without what follows its address, which may be a private key.
pub(crate) fn shown_endpoint(endpoint: &str) -> &str {
    endpoint.split(['?', '#']).next().unwrap_or_default()
}

/// Endpoints, each without what follows its address.
pub fn shown_endpoints(endpoints: &[String]) -> String {
    let shown: Vec<&str> = endpoints.iter().map(|endpoint| shown_endpoint(endpoint)).collect();
    shown.join(", ")
}

/// A text in which each endpoint is without what follows its address: errors of Zenoh quote them whole.
pub(crate) fn with_shown_endpoints(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find(['?', '#']) {
        let (before, behind) = rest.split_at(at);
        shown.push_str(before);
        let end = if ends_in_endpoint(before) {
            behind.find(ends_parameters).unwrap_or(behind.len())
        } else {
            0
        };
        if end == 0 {
            let (mark, after) = behind.split_at(1);
            shown.push_str(mark);
            rest = after;
            continue;
        }
        let (parameters, after) = behind.split_at(end);
        let hidden = parameters.trim_end_matches([':', ';', '.']);
        // The punctuation of the text.
        shown.push_str(parameters.strip_prefix(hidden).unwrap_or_default());
        rest = after;
    }
    shown.push_str(rest);
    shown
}

/// True if the last word of a text begins as an endpoint does.
fn ends_in_endpoint(text: &str) -> bool {
    let is_border = |c: char| c.is_whitespace() || "\"'`,=".contains(c);
    let word = text.rsplit(is_border).next().unwrap_or_default();
    let begin = word.trim_start_matches(['[', '(', '{']).split_once('/');
    begin.is_some_and(|(transport, _)| {
        TRANSPORTS.contains(&transport) || OTHER_TRANSPORTS.contains(&transport)
    })
}

/// True for a character that no parameter of an endpoint has, unless it is a file's name.
fn ends_parameters(c: char) -> bool {
    c.is_whitespace() || "\"'`,\\)]}!".contains(c)
}

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
    /// Reads `hub.example:7447`, `127.0.0.1:7447`, `[::1]:7447` or, as Zenoh does, `::1:7447`.
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
            None if host.contains(':') && host.parse::<Ipv6Addr>().is_err() => {
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
    fault(endpoint, usage).map_err(|reason| format!("`{}` {reason}", shown_endpoint(endpoint)))
}

fn fault(endpoint: &str, usage: EndpointUse) -> Result<(), String> {
    let parsed = endpoint.parse::<EndPoint>().map_err(|error| {
        // It quotes the endpoint.
        let said = error.to_string().replace(endpoint, shown_endpoint(endpoint));
        let said = session::plain(&said);
        format!("is not an endpoint such as `tcp/127.0.0.1:7447`: {said}")
    })?;
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
            ("tcp/fd00::7", "needs brackets"),
            ("tcp/a::b::c:7447", "needs brackets"),
            ("tcp/127.0.0.1:74480", "has the port `74480`"),
            ("udp/hub:-1", "has the port `-1`"),
            ("tcp/hub:", "has the port ``"),
            ("tls/hub:0#iface=eth0", "has the port 0"),
        ] {
            let refused = check_endpoint(endpoint, EndpointUse::Connect).unwrap_err();
            let shown = shown_endpoint(endpoint);
            assert!(refused.starts_with(&format!("`{shown}` ")), "{refused}");
            assert!(refused.contains(reason), "{reason}: {refused}");
        }
    }

    #[test]
    fn an_endpoint_that_a_session_can_use_is_accepted() {
        for endpoint in [
            "tcp/hub.example:7447",
            "tls/[fd00::7]:7448?rel=0#iface=eth0",
            "udp/203.0.113.7:65535",
            "tcp/::1:28001",
            "tcp/:::28002",
            "unixsock-stream//run/albireo.sock",
        ] {
            assert_eq!(check_endpoint(endpoint, EndpointUse::Connect), Ok(()));
        }
        let any_port = check_endpoint("tcp/127.0.0.1:0", EndpointUse::Listen);
        assert_eq!(any_port, Ok(()));
    }

    #[test]
    fn what_follows_the_address_of_an_endpoint_is_never_shown() {
        for endpoint in [
            "tls/hub:0?meta=M3TA#connect_private_key_base64=S3CRET=",
            "quix/hub:1#connect_private_key_base64=S3CRET",
            "tls/hub#connect_private_key_base64=S3CRET",
            "tls/hub:1?M3TA#",
            "tls?x=S3CRET",
        ] {
            let refused = check_endpoint(endpoint, EndpointUse::Connect).unwrap_err();
            let is_hidden = !refused.contains("S3CRET") && !refused.contains("M3TA");
            assert!(is_hidden, "{refused}");
        }
        for (text, shown) in [
            (
                "Unable to connect to tls/[::1]:1?a=b#k=S3CRET+/=! No answer",
                "Unable to connect to tls/[::1]:1! No answer",
            ),
            (
                "any of [tls/a:1#k=S3CRET, tcp/b:2?k=S3CRET]: why?",
                "any of [tls/a:1, tcp/b:2]: why?",
            ),
            (
                r#"{"message":"listener udp/a:1#k=S3CRET: in use","of":"tls/a:1#k=S3CRET"}"#,
                r#"{"message":"listener udp/a:1: in use","of":"tls/a:1"}"#,
            ),
            ("albireo/@report/n?x=1 #2", "albireo/@report/n?x=1 #2"),
        ] {
            assert_eq!(with_shown_endpoints(text), shown);
        }
    }
}
