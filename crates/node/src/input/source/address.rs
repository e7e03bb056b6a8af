//! The address of a source. It may contain a password, or the name of an environment variable with one: it is shown
//! without it, and the password is removed from the messages of programs.

use super::secrets::{LOGIN, Secrets};
use albireo_vision::recordings::are_several;
use percent_encoding::utf8_percent_encode;
use serde::Deserialize;
use serde_with::SerializeDisplay;
use std::fmt;
use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use strsim::osa_distance;

/// Common schemes of addresses. Others are left to the program that opens the source.
const SCHEMES: [&str; 12] = [
    "rtsp", "rtsps", "http", "https", "rtmp", "rtmps", "rtp", "srt", "udp", "tcp", "tls", "ftp",
];

const CONTROL: &str = "contains a control character";

const LOGIN_AFTER_QUERY: &str =
    "has an `@` behind a `?`: write a `?` in a password as `%3F`, and an `@` in a query as `%40`";

pub(super) fn no_control(text: &str) -> Result<(), String> {
    if text.contains(char::is_control) {
        return Err(CONTROL.to_owned());
    }
    Ok(())
}

/// A source as named by the user, with `${NAME}` for environment variables. Shown (and serialised) without credentials.
#[derive(Clone, PartialEq, Eq, Deserialize, SerializeDisplay)]
#[serde(transparent)]
pub struct SourceAddress(String);

/// The kinds of sources, which are opened differently.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// A GStreamer pipeline: elements with `!` between them.
    Pipeline,
    /// A camera on this machine: `/dev/video0`, `/dev/v4l/by-id/…`.
    Device,
    /// An address with this scheme: `rtsp`, `http`.
    Network(String),
    /// A video file.
    File,
    /// A folder of video files, or a pattern for their names.
    Files,
}

impl SourceKind {
    /// True for the addresses of RTSP, also of its encrypted form.
    pub(super) fn is_rtsp(&self) -> bool {
        matches!(self, Self::Network(scheme) if scheme.starts_with("rtsp"))
    }

    /// True for the addresses of HTTP and HTTPS.
    pub(super) fn is_http(&self) -> bool {
        matches!(self, Self::Network(scheme) if scheme.starts_with("http"))
    }
}

/// An address with its variables substituted.
#[derive(Clone)]
pub(crate) struct Resolved {
    pub kind: SourceKind,
    /// The address, or the words of a pipeline.
    pub words: Vec<String>,
    pub secrets: Secrets,
}

impl Resolved {
    /// A file, whatever its name looks like.
    pub(super) fn file(path: &Path) -> Self {
        Self {
            kind: SourceKind::File,
            words: vec![path.to_string_lossy().into_owned()],
            secrets: Secrets::default(),
        }
    }

    /// The address, if it is one word.
    pub(super) fn text(&self) -> &str {
        self.words.first().map_or("", String::as_str)
    }
}

impl SourceAddress {
    /// Creates the source with that name.
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }

    /// Returns its kind.
    pub fn kind(&self) -> SourceKind {
        if self.0.contains(" ! ") {
            return SourceKind::Pipeline;
        }
        if is_device(&self.0) {
            return SourceKind::Device;
        }
        match self.0.split_once("://") {
            Some((scheme, _)) if !scheme.eq_ignore_ascii_case("file") => {
                SourceKind::Network(scheme.to_ascii_lowercase())
            }
            _ => file_or_files(&self.0),
        }
    }

    /// True if the address itself, not a variable, contains a password.
    pub fn holds_password(&self) -> bool {
        login(&self.0)
            .and_then(|login| login.split_once(':'))
            .is_some_and(|(_, password)| !password.is_empty() && !password.starts_with("${"))
    }

    /// Substitutes the variables: percent-encoded in an address's user and password, unchanged elsewhere and in a
    /// pipeline. An error does not show the address.
    ///
    /// # Errors
    /// The fault of the address, or the variables that are not set.
    pub(crate) fn resolved(&self) -> Result<Resolved, String> {
        self.resolve(&|name| std::env::var(name).ok())
            .map_err(|reason| format!("the source {reason}"))
    }

    fn resolve(&self, variable: &dyn Fn(&str) -> Option<String>) -> Result<Resolved, String> {
        if self.0.trim().is_empty() {
            return Err("is empty".to_owned());
        }
        no_control(&self.0)?;
        let kind = self.kind();
        check_scheme(&kind)?;
        let mut variables = Variables {
            value: variable,
            // A path with a variable in it is shown, as a login is not.
            are_secret: !matches!(
                kind,
                SourceKind::File | SourceKind::Files | SourceKind::Device
            ),
            secrets: Secrets::default(),
            unset: Vec::new(),
        };
        let is_pipeline = kind == SourceKind::Pipeline;
        let written = if is_pipeline {
            shlex::split(&self.0).ok_or("has a quotation mark that is not closed")?
        } else {
            vec![self.0.clone()]
        };
        let mut words = Vec::new();
        for word in written {
            if query(&word).is_some_and(|query| query.contains('@')) && login(&word).is_none() {
                return Err(LOGIN_AFTER_QUERY.to_owned());
            }
            let (before, after) = word.split_at(login_end(&word));
            let before = if is_pipeline {
                variables.filled(before, Encoding::None)?
            } else {
                variables.filled(before, Encoding::AsLogin)?
            };
            words.push(before + &variables.filled(after, Encoding::None)?);
        }
        let Variables {
            mut secrets, unset, ..
        } = variables;
        if !unset.is_empty() {
            let names = unset.join("`, `");
            return Err(format!(
                "needs environment variables that are not set: `{names}`"
            ));
        }
        if matches!(kind, SourceKind::File | SourceKind::Files) {
            // ffmpeg knows the scheme in lower case only, and GStreamer not at all.
            for word in &mut words {
                *word = without_scheme(word).to_owned();
            }
        }
        words.iter().try_for_each(|word| no_control(word))?;
        for word in &words {
            secrets.add_login(login(word));
            secrets.add_query(query(word));
            // A pipeline's property.
            if let Some(("user-id" | "user-pw" | "proxy-pw", value)) = word.split_once('=') {
                secrets.add(value);
            }
        }
        let mut resolved = Resolved {
            kind,
            words,
            secrets,
        };
        if resolved.kind == SourceKind::File {
            // A variable may name a folder: only now its value is known.
            resolved.kind = file_or_files(resolved.text());
        }
        Ok(resolved)
    }
}

/// Checks that the scheme is not a misspelt one.
fn check_scheme(kind: &SourceKind) -> Result<(), String> {
    if let SourceKind::Network(scheme) = kind
        && !SCHEMES.contains(&scheme.as_str())
        && let Some(meant) = SCHEMES.iter().find(|&known| osa_distance(known, scheme) == 1)
    {
        return Err(format!(
            "begins with `{scheme}://`; did you mean `{meant}://`?"
        ));
    }
    Ok(())
}

/// How the value of a variable is written into an address.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    /// As it is.
    None,
    /// As a part of a URL's login.
    AsLogin,
}

/// Fills environment variables into an address, and notes which are secret and which are not set.
struct Variables<'a> {
    value: &'a dyn Fn(&str) -> Option<String>,
    are_secret: bool,
    secrets: Secrets,
    unset: Vec<String>,
}

impl Variables<'_> {
    /// Returns `text` with the value of each `${NAME}`.
    fn filled(&mut self, text: &str, encoding: Encoding) -> Result<String, String> {
        let mut filled = String::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once("${") {
            let (name, after) =
                after.split_once('}').ok_or("has `${` without `}` behind the variable's name")?;
            let value = (self.value)(name).unwrap_or_default();
            if value.is_empty() {
                self.unset.push(name.to_owned());
            }
            if self.are_secret {
                self.secrets.add(&value);
            }
            filled.push_str(before);
            match encoding {
                Encoding::None => filled.push_str(&value),
                Encoding::AsLogin => filled.extend(utf8_percent_encode(&value, LOGIN)),
            }
            rest = after;
        }
        filled.push_str(rest);
        Ok(filled)
    }
}

fn file_or_files(path: &str) -> SourceKind {
    if are_several(without_scheme(path)) {
        SourceKind::Files
    } else {
        SourceKind::File
    }
}

/// A file's path, also of an address that begins with `file://`.
fn without_scheme(path: &str) -> &str {
    match path.split_once("://") {
        Some((scheme, path)) if scheme.eq_ignore_ascii_case("file") => path,
        _ => path,
    }
}

/// True for a device, also under another name: `/dev/v4l/by-id/…`, or a link to it from anywhere.
fn is_device(path: &str) -> bool {
    if path.starts_with("/dev/") {
        return true;
    }
    fs::metadata(path).is_ok_and(|metadata| metadata.file_type().is_char_device())
}

/// The end of the part of an address with user and password: behind the last `@` before the query, so that a password
/// with a `/` in it is also masked.
fn login_end(address: &str) -> usize {
    if !address.contains("://") {
        return 0;
    }
    let query = address.find('?').unwrap_or(address.len());
    match address[..query].rfind('@') {
        Some(at) => at + 1,
        None => 0,
    }
}

/// The user and password of an address.
fn login(address: &str) -> Option<&str> {
    let begin = address.find("://")? + 3;
    // Without its `@`.
    let end = login_end(address).checked_sub(1)?;
    address.get(begin..end)
}

/// What follows the scheme and the login of an address.
pub(super) fn after_login(address: &str) -> &str {
    let begin = address.find("://").map_or(0, |at| at + 3);
    address.get(begin.max(login_end(address))..).unwrap_or_default()
}

fn query(address: &str) -> Option<&str> {
    address.find("://")?;
    address.split_once('?').map(|(_, query)| query)
}

impl fmt::Display for SourceAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind() {
            SourceKind::Pipeline => {
                // Only the elements' names: a property may be a password.
                for (place, element) in self.0.split(" ! ").enumerate() {
                    let name = element.split_whitespace().next().unwrap_or_default();
                    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                    let shown = if name.chars().all(is_plain) {
                        name
                    } else {
                        "…"
                    };
                    let between = if place > 0 { " ! " } else { "" };
                    write!(f, "{between}{shown}")?;
                }
                Ok(())
            }
            SourceKind::Network(scheme) => {
                let begin = login_end(&self.0).max(scheme.len() + 3);
                let rest = self.0.get(begin..).unwrap_or_default();
                match rest.split_once('?') {
                    Some((place, _)) => write!(f, "{scheme}://{place}?…"),
                    None => write!(f, "{scheme}://{rest}"),
                }
            }
            SourceKind::Device | SourceKind::File | SourceKind::Files => f.write_str(&self.0),
        }
    }
}

impl fmt::Debug for SourceAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SourceAddress({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(text: &str) -> Result<Resolved, String> {
        SourceAddress::new(text).resolve(&|name| match name {
            "USER" => Some("viewer".to_owned()),
            "PASSWORD" => Some("p@ss/w:rd".to_owned()),
            "LINES" => Some("a'\noption x y".to_owned()),
            _ => None,
        })
    }

    #[test]
    fn the_kind_of_a_source_follows_from_its_name() {
        let kind = |text: &str| SourceAddress::new(text).kind();
        assert_eq!(kind("rtsp://a/b"), SourceKind::Network("rtsp".to_owned()));
        assert_eq!(kind("HTTP://a/b"), SourceKind::Network("http".to_owned()));
        assert_eq!(kind("/dev/video2"), SourceKind::Device);
        let by_id = "/dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920-video-index0";
        assert_eq!(kind(by_id), SourceKind::Device);
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("front");
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();
        assert_eq!(kind(link.to_str().unwrap()), SourceKind::Device);
        assert_eq!(kind("drive 1.mp4"), SourceKind::File);
        assert_eq!(kind("file:///a.mp4"), SourceKind::File);
        assert_eq!(kind("v4l2src ! jpegenc"), SourceKind::Pipeline);
    }

    #[test]
    fn a_file_is_its_path_with_a_scheme_in_any_case_and_without() {
        for text in ["/a/1.mp4", "file:///a/1.mp4", "FILE:///a/1.mp4"] {
            let resolved = resolve(text).unwrap();
            assert_eq!(resolved.kind, SourceKind::File);
            assert_eq!(resolved.text(), "/a/1.mp4");
        }
    }

    #[test]
    fn shown_addresses_have_no_credentials() {
        let pipeline = "rtspsrc location=rtsp://u:pw@cam/s user-pw=x ! rtph264depay ! jpegenc";
        for (text, shown) in [
            ("rtsp://u:pw@cam:554/s", "rtsp://cam:554/s"),
            ("rtsp://u:p/w@cam/s", "rtsp://cam/s"),
            ("rtsp://${U}:${P}@cam/s", "rtsp://cam/s"),
            ("http://cam/v.mjpg?token=secret", "http://cam/v.mjpg?…"),
            ("http://cam/v.mjpg?mail=a@b", "http://cam/v.mjpg?…"),
            ("/dev/video0", "/dev/video0"),
            (pipeline, "rtspsrc ! rtph264depay ! jpegenc"),
        ] {
            let address = SourceAddress::new(text);
            assert_eq!(address.to_string(), shown);
            assert_eq!(serde_json::to_value(&address).unwrap(), shown);
            assert_eq!(format!("{address:?}"), format!("SourceAddress({shown})"));
        }
        assert!(SourceAddress::new("rtsp://u:pw@cam/s").holds_password());
        assert!(!SourceAddress::new("rtsp://u:${P}@cam/s").holds_password());
        assert!(!SourceAddress::new("rtsp://cam/s").holds_password());
    }

    #[test]
    fn variables_are_filled_in_and_removed_from_program_output() {
        let resolved = resolve("rtsp://${USER}:${PASSWORD}@cam/s").unwrap();
        assert_eq!(resolved.text(), "rtsp://viewer:p%40ss%2Fw%3Ard@cam/s");
        let message = format!("{}: 401, password p@ss/w:rd of viewer", resolved.text());
        let redacted = resolved.secrets.redact(&message);
        for secret in ["viewer", "p@ss", "p%40ss", "w%3A"] {
            assert!(!redacted.contains(secret), "{redacted}");
        }
        assert!(redacted.contains("@cam/s: 401"), "{redacted}");

        let resolved = resolve("http://cam/v?size=full&token=abcdef").unwrap();
        let redacted = resolved.secrets.redact("GET /v?size=full&token=abcdef");
        assert!(!redacted.contains("abcdef"), "{redacted}");

        let resolved = resolve("rtspsrc user-pw=${PASSWORD} caps=\"a, b\" ! jpegenc").unwrap();
        let words = ["rtspsrc", "user-pw=p@ss/w:rd", "caps=a, b", "!", "jpegenc"];
        assert_eq!(resolved.words, words);
    }

    #[test]
    fn an_unusable_address_is_explained_without_showing_it() {
        let open = "has `${` without `}` behind the variable's name";
        let unset = "needs environment variables that are not set: `NOBODY`, `NONE`";
        let misspelt = "begins with `rtps://`; did you mean `rtsp://`?";
        for (text, error) in [
            ("", "is empty"),
            ("rtsp://a\nfile x", CONTROL),
            ("rtsp://${USER@cam", open),
            ("rtsp://${NOBODY}:${NONE}@cam", unset),
            ("rtsp://cam/${LINES}", CONTROL),
            ("a caps=\"b ! c", "has a quotation mark that is not closed"),
            ("rtps://cam/s", misspelt),
            ("rtsp://u:p?w@cam/s", LOGIN_AFTER_QUERY),
            (
                "rtspsrc location=rtsp://u:p?w@cam/s ! jpegenc",
                LOGIN_AFTER_QUERY,
            ),
        ] {
            assert_eq!(resolve(text).err().as_deref(), Some(error), "{text}");
        }
    }
}
