use super::*;
use albireo_service::config::{ConfigError, Role, load};
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
    let (mut section, mut shown, mut commented) = (String::new(), Vec::new(), false);
    for line in text.lines() {
        let bare = line.strip_prefix("# ").unwrap_or(line);
        if bare.starts_with('[') {
            section = bare.trim_matches(['[', ']']).to_owned();
            commented = false;
        } else if let Some(key) = key_of(line) {
            assert!(commented, "no comment above: {line}");
            shown.push(format!("{section}.{key}"));
            commented = false;
        } else {
            commented = line.starts_with('#');
        }
    }
    let token = NamedToken {
        name: "a".into(),
        role: Role::Read,
        token: None,
        token_file: None,
    };
    let config = HubConfig {
        tokens: vec![token],
        ..HubConfig::default()
    };
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
    for (text, key) in [
        ("[hub]\nprefix = \"a//b\"", "hub.prefix"),
        ("[zenoh]\nmode = \"boss\"", "zenoh"),
        ("[zenoh]\nlistn = []", "zenoh"),
        ("[http]\nlisten = \"0.0.0.0:8090\"", "http.listen"),
        ("[database]\nurl = \"mysql://x\"", "database.url"),
        ("[database]\nurl = \"sqlite::memory:\"", "database.url"),
        ("[database]\ntimeout_ms = 0", "database.timeout_ms"),
        ("[database]\nreaders = 4", "database.readers"),
        ("[ingest]\nbusy_after_ms = 3000", "ingest.busy_after_ms"),
        (
            "[presence]\nsilent_after_s = nan",
            "presence.silent_after_s",
        ),
        (
            "[presence]\noffline_after_s = 1.0",
            "presence.offline_after_s",
        ),
        ("[history]\nclips_days = 0", "history.clips_days"),
        ("[[token]]\nname = \"a\"", "token.a.token"),
        (
            "[[token]]\nname = \"\"\ntoken = \"0123456789abcdef\"",
            "token[0].name",
        ),
        (
            "[[token]]\nname = \"a\"\ntoken = \"0123456789abcdef\"\nrole = \"all\"",
            "token.a.role",
        ),
        ("[hubb]\nprefix = \"a\"", "hubb"),
    ] {
        let error = read(text).expect_err(text);
        let found: Vec<String> = error.findings.iter().map(ToString::to_string).collect();
        assert_eq!(found.len(), 1, "{text}: {found:?}");
        let expected = format!("{key}: ");
        assert!(found[0].starts_with(&expected), "{text}: {found:?}");
    }
}

#[test]
fn a_password_is_never_shown() {
    let config = DatabaseConfig {
        url: "postgres://hub:s3cret@db.example/fleet".into(),
        ..DatabaseConfig::default()
    };
    assert_eq!(config.shown(), "postgres://hub@db.example/fleet");
    assert!(!format!("{config:?}").contains("s3cret"));
}
