#[path = "../../../../tests/support/configuration.rs"]
mod configuration;

use super::*;
use configuration::{load, problem};

type Config = HubConfig;
const SHIPPED: &str = include_str!("../../../../config/hub.toml");
/// One of each section of which there are none by default.
const LISTED: &str = "[[token]]\nname = \"a\"\ntoken = \"a-long-random-secret\"";

#[test]
fn a_missing_key_has_the_hubs_default_and_not_the_nodes() {
    let text = "zenoh.multicast_scouting = true\nhttp.cors_origins = [\"https://a.example\"]";
    let config = load(text).unwrap();
    assert_eq!(config.zenoh.listen, ["tcp/127.0.0.1:7448"]);
    assert!(config.zenoh.multicast_scouting);
    assert_eq!(config.http.listen.port(), 8090);
    assert_eq!(config.http.cors_origins, ["https://a.example"]);
}

#[test]
fn an_impossible_value_is_rejected_with_its_key() {
    // After `->` stands the key that is reported, where that is not the key that the text sets.
    for case in [
        r#"hub.prefix = "a//b""#,
        r#"zenoh.mode = "boss""#,
        "zenoh.listn = []",
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
        let found = problem(text);
        let expected = format!("{key}: ");
        assert!(found.starts_with(&expected), "{text}: {found}");
    }
}

#[test]
fn a_password_that_ends_the_host_is_rejected_and_not_shown() {
    for url in [
        "postgres://u:pa/ss@host/db",
        "postgres://u:pa#ss@host/db",
        "postgres://u:p@ss/word@host/db",
        "postgres://u:12/34@host:5432/db?sslmode=require",
    ] {
        let found = problem(&format!("database.url = \"{url}\""));
        assert!(found.starts_with("database.url: "), "{url}: {found}");
        assert!(found.contains("/ as %2F"), "{url}: {found}");
        assert!(!found.contains("ss@"), "{url}: {found}");
    }
    for url in [
        "postgres://u:p%2Fss@host/db",
        "postgres://u:p@ss@host/db",
        "postgres://host:5432/my@db",
        "postgres://u@host/db?password=a@b&host=/run/postgresql",
    ] {
        load(&format!("database.url = \"{url}\"")).unwrap();
    }
}

#[test]
fn a_database_url_is_shown_without_its_password_also_one_with_a_question_mark() {
    for (url, expected) in [
        ("postgres://u:secret@host/db", "postgres://u@host/db"),
        ("postgres://u:pa?ss@host/db", "postgres://u@host/db"),
        (
            "postgres://u:secret@host/db?sslmode=require",
            "postgres://u@host/db?***",
        ),
        (
            "postgres://u@host/db?password=a@b",
            "postgres://u@host/db?***",
        ),
        ("sqlite:hub.db?mode=ro", "sqlite:hub.db?mode=ro"),
    ] {
        let config = DatabaseConfig {
            url: url.to_owned(),
            ..DatabaseConfig::default()
        };
        assert_eq!(config.shown(), expected);
    }
}
