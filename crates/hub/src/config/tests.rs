use super::*;
use albireo_service::config::{ConfigError, load};
use std::path::{Path, PathBuf};

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/hub.toml")
}

fn read(text: &str) -> Result<HubConfig, ConfigError> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hub.toml");
    std::fs::write(&file, text).unwrap();
    load(Some(&file))
}

#[test]
fn the_shipped_file_is_exactly_the_defaults() {
    let shipped = shipped();
    for file in [Some(&*shipped), None] {
        assert_eq!(load::<HubConfig>(file).unwrap(), HubConfig::default());
    }
}

/// The key that a line sets, even in a comment.
fn key_of(line: &str) -> Option<&str> {
    let (key, _) = line.strip_prefix("# ").unwrap_or(line).split_once(" = ")?;
    let plain = |byte: u8| byte.is_ascii_lowercase() || byte == b'_';
    key.bytes().all(plain).then_some(key)
}

#[test]
fn every_key_is_in_the_shipped_file_with_a_comment() {
    let text = std::fs::read_to_string(shipped()).unwrap();
    let (mut section, mut shown, mut above) = ("", Vec::new(), "");
    for line in text.lines() {
        let bare = line.strip_prefix("# ").unwrap_or(line);
        if bare.starts_with('[') {
            section = bare.trim_matches(['[', ']']);
        } else if let Some(key) = key_of(line) {
            let is_other = above.starts_with("# [") || key_of(above).is_some();
            let is_commented = above.starts_with('#') && !is_other;
            assert!(is_commented, "no comment above: {line}");
            shown.push(format!("{section}.{key}"));
        }
        above = line;
    }
    let mut config = HubConfig::default();
    config.tokens.push(NamedToken::default());
    let mut wanted = Vec::new();
    for (section, values) in serde_json::to_value(&config).unwrap().as_object().unwrap() {
        let values = values.get(0).unwrap_or(values).as_object().unwrap();
        wanted.extend(values.keys().map(|key| format!("{section}.{key}")));
    }
    shown.sort();
    wanted.sort();
    assert_eq!(shown, wanted);
}

#[test]
fn a_missing_key_has_the_hubs_default_and_not_the_nodes() {
    let config =
        read("[zenoh]\nmulticast_scouting = true\n[http]\ncors_origins = [\"https://a.example\"]")
            .unwrap();
    assert_eq!(config.zenoh.listen, ["tcp/127.0.0.1:7448"]);
    assert!(config.zenoh.multicast_scouting);
    assert_eq!(config.http.listen.port(), 8090);
    assert_eq!(config.http.cors_origins, ["https://a.example"]);
}

#[test]
fn an_impossible_value_is_rejected_with_its_key() {
    // With the key of the finding, if it is not the one that is set.
    for case in [
        r#"hub.prefix = "a//b""#,
        r#"zenoh.mode = "boss" -> zenoh"#,
        "zenoh.listn = [] -> zenoh",
        r#"http.listen = "0.0.0.0:8090""#,
        r#"database.url = "mysql://x""#,
        r#"database.url = "sqlite::memory:""#,
        "database.timeout_ms = 0",
        "database.readers = 4",
        "ingest.busy_after_ms = 3000",
        "presence.silent_after_s = nan",
        "presence.offline_after_s = 1.0",
        "history.clips_days = 0",
        r#"token = [{name = "a"}] -> token.a.token"#,
        r#"token = [{name = "", token = "0123456789abcdef"}] -> token[0].name"#,
        r#"token = [{name = "a", token = "0123456789abcdef", role = "all"}] -> token.a.role"#,
        r#"hubb.prefix = "a" -> hubb"#,
    ] {
        let set = case.split(" = ").next().unwrap();
        let (text, key) = case.split_once(" -> ").unwrap_or((case, set));
        let error = read(text).expect_err(text);
        let found: Vec<String> = error.findings.iter().map(ToString::to_string).collect();
        assert_eq!(found.len(), 1, "{text}: {found:?}");
        let expected = format!("{key}: ");
        assert!(found[0].starts_with(&expected), "{text}: {found:?}");
    }
}
