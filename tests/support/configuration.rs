//! Reads configurations. Its parent has the service's configuration as `Config`, the shipped file as `SHIPPED`, and one of
//! each section of which there are none by default as `LISTED`.

use super::{Config, LISTED, SHIPPED};
use albireo_service::config::ConfigError;

pub(crate) fn load(text: &str) -> Result<Config, ConfigError> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("service.toml");
    std::fs::write(&file, text).unwrap();
    albireo_service::config::load(Some(&file))
}

/// The problems of a configuration, one `key: reason` line each.
pub(crate) fn problems(text: &str) -> Vec<String> {
    let error = load(text).expect_err(text);
    error.findings.iter().map(ToString::to_string).collect()
}

/// The only problem of a configuration.
pub(crate) fn problem(text: &str) -> String {
    let mut found = problems(text);
    assert_eq!(found.len(), 1, "{text}: {found:?}");
    found.remove(0)
}

/// The key that a line sets, even in a comment.
pub(crate) fn key_of(line: &str) -> Option<&str> {
    let (key, _) = line.strip_prefix("# ").unwrap_or(line).split_once(" = ")?;
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    key.bytes().all(is_plain).then_some(key)
}

#[test]
fn the_shipped_file_is_exactly_the_defaults() {
    assert_eq!(load(SHIPPED).unwrap(), Config::default());
    let without: Config = albireo_service::config::load(None).unwrap();
    assert_eq!(without, Config::default());
}

#[test]
fn the_shipped_file_has_exactly_the_accepted_keys_each_with_a_comment() {
    let mut section = "";
    let mut shown = Vec::new();
    let mut commented = false;
    for line in SHIPPED.lines() {
        // There is no token or hook by default: their sections are comments too.
        let bare = line.strip_prefix("# ").unwrap_or(line);
        if bare.starts_with('[') {
            section = bare.trim_matches(['[', ']']);
            commented = false;
        } else if let Some(key) = key_of(line) {
            assert!(commented, "no comment above: {line}");
            shown.push(format!("{section}.{key}"));
            commented = false;
        } else {
            commented = line.starts_with('#');
        }
    }
    // The tables of the policies for comparison are written only if they differ from their defaults.
    let config = load(LISTED).unwrap();
    let mut wanted = Vec::new();
    for (section, keys) in serde_json::to_value(&config).unwrap().as_object().unwrap() {
        for (key, value) in keys.get(0).unwrap_or(keys).as_object().unwrap() {
            let key = format!("{section}.{key}");
            match value.as_object().filter(|keys| !keys.is_empty()) {
                Some(keys) => wanted.extend(keys.keys().map(|inner| format!("{key}.{inner}"))),
                None => wanted.push(key),
            }
        }
    }
    shown.sort();
    wanted.sort();
    assert_eq!(shown, wanted);
    assert!(shown.len() <= 120, "more than a user should have to read");
}
