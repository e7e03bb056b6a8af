//! The address of a source, and its options. Both may contain a password, or the name of an environment variable with
//! one: they are shown without it, and it is removed from the messages of programs.

use albireo_vision::recordings::are_several;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use serde::{Deserialize, Serialize, Serializer};
use serde_with::SerializeDisplay;
use std::fmt;
use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use strsim::osa_distance;

/// The characters encoded between `://` and `@`: all but the unreserved ones of RFC 3986, section 2.3.
const LOGIN: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// Common schemes of addresses. Others are left to the program that opens the source.
const SCHEMES: [&str; 12] = [
    "rtsp", "rtsps", "http", "https", "rtmp", "rtmps", "rtp", "srt", "udp", "tcp", "tls", "ftp",
];

/// Shown instead of a secret.
const MASK: &str = "***";

const CONTROL: &str = "contains a control character";

const LOGIN_AFTER_QUERY: &str =
    "has an `@` behind a `?`: write a `?` in a password as `%3F`, and an `@` in a query as `%40`";

fn no_control(text: &str) -> Result<(), String> {
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

/// Secrets, longest first.
#[derive(Clone, Default)]
pub(crate) struct Secrets(Vec<String>);

impl Secrets {
    pub(super) fn add(&mut self, secret: &str) {
        let decoded = percent_decode_str(secret).decode_utf8_lossy().into_owned();
        let encoded = utf8_percent_encode(secret, LOGIN).to_string();
        for form in [secret.to_owned(), decoded, encoded] {
            if !form.is_empty() && !self.0.contains(&form) {
                self.0.push(form);
            }
        }
        self.0.sort_by_key(|secret| std::cmp::Reverse(secret.len()));
    }

    /// Adds the user and password of an address. A name of one or two letters would be masked everywhere.
    fn add_login(&mut self, login: Option<&str>) {
        let Some(login) = login else { return };
        let (user, password) = login.split_once(':').unwrap_or((login, ""));
        self.add(login);
        self.add(password);
        if user.len() > 2 {
            self.add(user);
        }
    }

    /// Adds the query of an address.
    fn add_query(&mut self, query: Option<&str>) {
        let Some(query) = query else { return };
        self.add(query);
        let values = query.split('&').filter_map(|pair| pair.split_once('='));
        for (_, value) in values.filter(|(_, value)| value.len() > 2) {
            self.add(value);
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns `text` with the secrets masked.
    pub(super) fn redact(&self, text: &str) -> String {
        let hidden = |text: String, secret: &String| text.replace(secret.as_str(), MASK);
        self.0.iter().fold(text.to_owned(), hidden)
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
        let resolved = self.resolve(&|name| std::env::var(name).ok());
        resolved.map_err(|reason| format!("the source {reason}"))
    }

    fn resolve(&self, variable: &dyn Fn(&str) -> Option<String>) -> Result<Resolved, String> {
        if self.0.trim().is_empty() {
            return Err("is empty".to_owned());
        }
        no_control(&self.0)?;
        let kind = self.kind();
        if let SourceKind::Network(scheme) = &kind
            && !SCHEMES.contains(&scheme.as_str())
            && let Some(meant) = SCHEMES.iter().find(|&known| osa_distance(known, scheme) == 1)
        {
            return Err(format!(
                "begins with `{scheme}://`; did you mean `{meant}://`?"
            ));
        }
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
        let written = match kind {
            SourceKind::Pipeline => shlex::split(&self.0),
            _ => Some(vec![self.0.clone()]),
        };
        let mut words = Vec::new();
        for word in written.ok_or("has a quotation mark that is not closed")? {
            if query(&word).is_some_and(|query| query.contains('@')) && login(&word).is_none() {
                return Err(LOGIN_AFTER_QUERY.to_owned());
            }
            let (before, after) = word.split_at(login_end(&word));
            let before = variables.filled(before, kind != SourceKind::Pipeline)?;
            words.push(before + &variables.filled(after, false)?);
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
        words.iter().try_for_each(|word| no_control(word))?;
        for word in &words {
            secrets.add_login(login(word));
            secrets.add_query(query(word));
            // A pipeline's property.
            if let Some(("user-id" | "user-pw" | "proxy-pw", value)) = word.split_once('=') {
                secrets.add(value);
            }
        }
        let kind = match (kind, &words[..]) {
            // Only now its variables are known.
            (SourceKind::File, [path]) => file_or_files(path),
            (kind, _) => kind,
        };
        Ok(Resolved {
            kind,
            words,
            secrets,
        })
    }
}

/// Fills environment variables into an address, and notes which are secret and which are not set.
struct Variables<'a> {
    value: &'a dyn Fn(&str) -> Option<String>,
    are_secret: bool,
    secrets: Secrets,
    unset: Vec<String>,
}

impl Variables<'_> {
    /// Returns `text` with the value of each `${NAME}`, encoded as part of a URL's login if `encode`.
    fn filled(&mut self, text: &str, encode: bool) -> Result<String, String> {
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
            if encode {
                filled.extend(utf8_percent_encode(&value, LOGIN));
            } else {
                filled.push_str(&value);
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
pub(super) fn without_scheme(path: &str) -> &str {
    path.trim_start_matches("file://")
}

/// True for a device, also under another name: `/dev/v4l/by-id/…`, or a link to it from anywhere.
fn is_device(path: &str) -> bool {
    let is_there =
        || fs::metadata(path).is_ok_and(|metadata| metadata.file_type().is_char_device());
    path.starts_with("/dev/") || is_there()
}

/// The end of the part of an address with user and password: behind the last `@` before the query, so that a password
/// with a `/` in it is also masked.
fn login_end(address: &str) -> usize {
    let end = address.find('?').unwrap_or(address.len());
    let (Some(_), Some(at)) = (address.find("://"), address[..end].rfind('@')) else {
        return 0;
    };
    at + 1
}

/// The user and password of an address.
fn login(address: &str) -> Option<&str> {
    let begin = address.find("://")? + 3;
    address.get(begin..login_end(address).checked_sub(1)?)
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
                    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                    let name = if name.chars().all(plain) { name } else { "…" };
                    let between = if place > 0 { " ! " } else { "" };
                    write!(f, "{between}{name}")?;
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

/// Options of ffmpeg for a source, each name followed by its value. Shown (and serialised) without secret
/// values.
#[derive(Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(transparent)]
pub struct SourceOptions(pub Vec<String>);

impl SourceOptions {
    /// Checks that they can be passed to a program.
    ///
    /// # Errors
    /// The fault.
    pub fn check(&self) -> Result<(), String> {
        self.0.iter().try_for_each(|word| no_control(word))
    }

    /// Name, without its `-`, and value. An option without a value is a flag.
    pub(super) fn pairs(&self) -> Vec<(&str, Option<&str>)> {
        let mut pairs: Vec<(&str, Option<&str>)> = Vec::new();
        for word in &self.0 {
            match (word.strip_prefix('-'), pairs.last_mut()) {
                // A value may be a negative number.
                (Some(name), _) if !name.starts_with(|c: char| c.is_ascii_digit()) => {
                    pairs.push((name, None));
                }
                (_, Some((_, value @ None))) => *value = Some(word),
                _ => pairs.push((word, None)),
            }
        }
        pairs
    }

    /// The secret values.
    pub(super) fn secrets(&self) -> impl Iterator<Item = &str> {
        self.pairs()
            .into_iter()
            .filter_map(|(name, value)| value.filter(|_| is_secret(name)))
    }
}

/// True if the option `name` carries a secret.
fn is_secret(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let parts = [
        "key", "pass", "secret", "token", "header", "cookie", "auth", "proxy", "user", "login",
    ];
    parts.iter().any(|part| name.contains(part))
}

impl Serialize for SourceOptions {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let shown = self.pairs().into_iter().flat_map(|(name, value)| {
            let shown = value.map(|value| if is_secret(name) { MASK } else { value });
            std::iter::once(format!("-{name}")).chain(shown.map(str::to_owned))
        });
        serializer.collect_seq(shown)
    }
}

impl fmt::Debug for SourceOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = serde_json::to_string(self).unwrap_or_default();
        write!(f, "SourceOptions({shown})")
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

    #[test]
    fn options_are_shown_without_secrets() {
        let words = "-headers 'Authorization: Bearer abc' -video_size 1280x720 -re -cenc_decryption_key 0123 \
                     -itsoffset -1.5";
        let options = SourceOptions(shlex::split(words).unwrap());
        let shown = serde_json::to_string(&options).unwrap();
        let masked =
            "-headers *** -video_size 1280x720 -re -cenc_decryption_key *** -itsoffset -1.5";
        let expected = serde_json::to_string(&Vec::from_iter(masked.split(' ')));
        assert_eq!(shown, expected.unwrap());
        assert_eq!(format!("{options:?}"), format!("SourceOptions({shown})"));
        let secrets: Vec<_> = options.secrets().collect();
        assert_eq!(secrets, ["Authorization: Bearer abc", "0123"]);
        options.check().unwrap();
        let broken = SourceOptions(vec!["-headers".to_owned(), "A: b\r\nC: d".to_owned()]);
        assert_eq!(broken.check().unwrap_err().to_string(), CONTROL);
    }
}
