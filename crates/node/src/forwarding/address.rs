//! Addresses of hooks and brokers. A hook's may hold secrets, in its user, path or query: only scheme, host and port are shown.

use albireo_service::connection::Connector;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hyper::Uri;
use percent_encoding::percent_decode_str;
use serde::{Deserialize, Serialize, Serializer};
use std::fmt;
use std::path::Path;

/// A place in the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Endpoint {
    pub scheme: &'static str,
    pub host: String,
    pub port: u16,
    pub is_secure: bool,
}

impl Endpoint {
    /// What connects to it. Reads the certificates of the authorities that may sign its own: those of a file, or the
    /// system's.
    pub(super) fn connector(&self, authority: Option<&Path>) -> Result<Connector, String> {
        if self.is_secure {
            Connector::secure(&self.host, self.port, authority)
        } else {
            Ok(Connector::plain(&self.host, self.port))
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = self.scheme;
        let port = self.port;
        if self.host.contains(':') {
            write!(f, "{scheme}://[{}]:{port}", self.host)
        } else {
            write!(f, "{scheme}://{}:{port}", self.host)
        }
    }
}

/// The schemes of a protocol.
struct Schemes {
    plain: Scheme,
    /// With TLS.
    secure: Scheme,
}

struct Scheme {
    name: &'static str,
    usual_port: u16,
}

const HTTP: Schemes = Schemes {
    plain: Scheme {
        name: "http",
        usual_port: 80,
    },
    secure: Scheme {
        name: "https",
        usual_port: 443,
    },
};

const MQTT: Schemes = Schemes {
    plain: Scheme {
        name: "mqtt",
        usual_port: 1883,
    },
    secure: Scheme {
        name: "mqtts",
        usual_port: 8883,
    },
};

/// Takes an address apart. The error does not show it.
fn parse(text: &str, schemes: &Schemes) -> Result<(Uri, Endpoint), String> {
    let Schemes { plain, secure } = schemes;
    let begin = text.split_once("://").map_or("", |(begin, _)| begin);
    let is_secure = begin.eq_ignore_ascii_case(secure.name);
    if !is_secure && !begin.eq_ignore_ascii_case(plain.name) {
        return Err(format!(
            "must begin with {}:// or {}://",
            plain.name, secure.name
        ));
    }
    let scheme = if is_secure { secure } else { plain };
    let uri: Uri = text.parse().map_err(|error| format!("is no address: {error}"))?;
    let host = uri.host().unwrap_or_default().trim_matches(['[', ']']);
    if host.is_empty() {
        return Err(format!(
            "names no host, as in {}://host.example",
            secure.name
        ));
    }
    let place = Endpoint {
        scheme: scheme.name,
        host: host.to_owned(),
        port: port(&uri)?.unwrap_or(scheme.usual_port),
        is_secure,
    };
    Ok((uri, place))
}

/// The port that an address names.
fn port(uri: &Uri) -> Result<Option<u16>, String> {
    let authority = uri.authority().map_or("", |authority| authority.as_str());
    // A colon stands in a login and in an address of IPv6, too.
    let place = authority.rsplit('@').next().unwrap_or_default();
    let behind_host = place.rsplit(']').next().unwrap_or_default();
    let Some((_, port)) = behind_host.split_once(':') else {
        return Ok(None);
    };
    // Then it is the usual one (RFC 3986, section 3.2.3).
    if port.is_empty() {
        return Ok(None);
    }
    match port.parse() {
        Ok(port) if port > 0 => Ok(Some(port)),
        // Not shown: it is a password where `@` and the host are missing.
        _ => Err("has something else for its port than a number from 1 to 65535".to_owned()),
    }
}

/// Reads a broker's address.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn broker(text: &str) -> Result<Endpoint, String> {
    let (uri, place) = parse(text.trim_end_matches('/'), &MQTT)?;
    if uri.authority().is_some_and(|authority| authority.as_str().contains('@')) {
        return Err("holds a user: set mqtt.user and mqtt.password_file instead".to_owned());
    }
    if uri.path().len() > 1 || uri.query().is_some() {
        return Err("has a path, which a broker has not".to_owned());
    }
    Ok(place)
}

/// The address of a hook as configured. Shown (and serialised) without what may be secret.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(transparent)]
pub struct HookUrl(String);

impl HookUrl {
    /// Creates an address.
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }

    /// Reads the address.
    ///
    /// # Errors
    /// What is wrong with it; does not show it.
    pub(crate) fn target(&self) -> Result<Target, String> {
        let (uri, place) = parse(&self.0, &HTTP)?;
        let authority = uri.authority().map_or("", |authority| authority.as_str());
        let (login, host) = authority.rsplit_once('@').unwrap_or(("", authority));
        let login = percent_decode_str(login).collect::<Vec<u8>>();
        let path = uri.path_and_query().map_or("/", |path| path.as_str());
        Ok(Target {
            host: host.to_owned(),
            login: if login.is_empty() {
                None
            } else {
                Some(format!("Basic {}", STANDARD.encode(&login)))
            },
            path: if path.starts_with('/') {
                path.to_owned()
            } else {
                // An address with a query and no path.
                format!("/{path}")
            },
            place,
        })
    }

    /// True if more than scheme, host and port is in it.
    pub(crate) fn may_hold_secret(&self) -> bool {
        self.target().is_ok_and(|target| target.login.is_some() || target.path != "/")
    }
}

impl fmt::Debug for HookUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.target() {
            Ok(target) => write!(f, "{target}"),
            Err(_) => f.write_str("(no address)"),
        }
    }
}

impl Serialize for HookUrl {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{self:?}"))
    }
}

/// Where a hook posts to.
#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Target {
    pub place: Endpoint,
    /// The header `Host`.
    pub host: String,
    /// The header `Authorization`.
    pub login: Option<String>,
    /// Path and query.
    pub path: String,
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rest = if self.path == "/" { "" } else { "/…" };
        write!(f, "{}{rest}", self.place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_may_be_secret_is_shown() {
        let url = HookUrl::new("https://ann:s3cret@[fd00::7]:8123/api/webhook/k3y?token=t0ken");
        let shown = format!(
            "{url:?} {} {}",
            serde_json::to_string(&url).unwrap(),
            url.target().unwrap()
        );
        for secret in ["ann", "s3cret", "k3y", "t0ken"] {
            assert!(!shown.contains(secret), "{shown}");
        }
        assert!(shown.contains("https://[fd00::7]:8123/…"), "{shown}");
    }

    #[test]
    fn an_address_is_taken_apart() {
        let target = HookUrl::new("http://ann:p%40ss@house.example/a?b=c").target().unwrap();
        let expected = Endpoint {
            scheme: "http",
            host: "house.example".to_owned(),
            port: 80,
            is_secure: false,
        };
        assert_eq!(target.place, expected);
        assert_eq!(target.host, "house.example");
        assert_eq!(target.path, "/a?b=c");
        let without_path = HookUrl::new("https://house.example?token=abc").target().unwrap();
        assert_eq!(without_path.path, "/?token=abc");
        let basic = format!("Basic {}", STANDARD.encode("ann:p@ss"));
        assert_eq!(target.login, Some(basic));
        assert_eq!(broker("mqtts://b.example").unwrap().port, 8883);
        assert_eq!(broker("mqtt://b:").unwrap().port, 1883);
        let empty = HookUrl::new("http://[::1]:/x").target().unwrap();
        assert_eq!((empty.place.port, empty.path.as_str()), (80, "/x"));
        assert_eq!(
            broker("mqtt://127.0.0.1:1999/").unwrap().to_string(),
            "mqtt://127.0.0.1:1999"
        );
    }

    #[test]
    fn what_is_wrong_with_an_address_is_said_without_it() {
        for (text, reason) in [
            (
                "house.example/s3cret",
                "must begin with http:// or https://",
            ),
            ("ftp://s3cret@house.example", "must begin with"),
            ("https://s3 cret", "is no address"),
            ("", "must begin with"),
            ("https://", "is no address"),
            ("http://127.0.0.1:99999/s3cret", "a number from 1 to 65535"),
            ("http://ann:s3cret@[::1]:0", "a number from 1 to 65535"),
            ("http://ann:s3cret", "a number from 1 to 65535"),
        ] {
            let found = HookUrl::new(text).target().err().unwrap();
            assert!(found.contains(reason), "{found}");
            assert!(!found.contains("cret"), "{found}");
        }
        for (text, reason) in [
            ("broker.example:1883", "must begin with mqtt:// or mqtts://"),
            ("mqtt://ann:s3cret@b", "set mqtt.user"),
            ("mqtt://b/topic", "has a path"),
            ("mqtt://127.0.0.1:99999", "a number from 1 to 65535"),
            ("mqtt://b:-1", "a number from 1 to 65535"),
            ("mqtt://b:abc", "a number from 1 to 65535"),
        ] {
            let found = broker(text).unwrap_err();
            assert!(found.contains(reason), "{found}");
            assert!(!found.contains("cret"), "{found}");
        }
    }
}
