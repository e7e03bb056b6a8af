//! Options of ffmpeg for a source. They may contain a password: they are shown without it.

use super::address::no_control;
use super::secrets::MASK;
use serde::{Deserialize, Serialize, Serializer};
use std::fmt;

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
            // A value may be a negative number.
            let is_name = |rest: &&str| !rest.starts_with(|c: char| c.is_ascii_digit());
            if let Some(name) = word.strip_prefix('-').filter(is_name) {
                pairs.push((name, None));
            } else if let Some((_, value @ None)) = pairs.last_mut() {
                *value = Some(word);
            } else {
                pairs.push((word, None));
            }
        }
        pairs
    }

    /// The secret values.
    pub(super) fn secrets(&self) -> impl Iterator<Item = &str> {
        self.pairs()
            .into_iter()
            .filter(|(name, _)| is_secret(name))
            .filter_map(|(_, value)| value)
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
        let mut shown = Vec::new();
        for (name, value) in self.pairs() {
            shown.push(format!("-{name}"));
            if let Some(value) = value {
                let value = if is_secret(name) { MASK } else { value };
                shown.push(value.to_owned());
            }
        }
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
        assert_eq!(broken.check().unwrap_err(), "contains a control character");
    }
}
