use super::*;
use albireo_service::config::Configuration as _;
use albireo_service::config::{ConfigError, Role};
use std::path::Path;

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/node.toml")
}

/// How many keys there are, of every section.
const KEYS: usize = 80;
const _: () = assert!(KEYS <= 80, "the most that somebody should have to read");

fn load(text: &str) -> Result<NodeConfig, ConfigError> {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("node.toml");
    std::fs::write(&file, text).unwrap();
    albireo_service::config::load(Some(&file))
}

/// The problems of a configuration, one `key: reason` line each.
fn problems(text: &str) -> Vec<String> {
    load(text)
        .expect_err(text)
        .findings
        .iter()
        .map(ToString::to_string)
        .collect()
}

/// All keys of a value, `section.key` each; keys of tables in lists count as those of the section.
fn keys(value: &serde_json::Value, section: &str, found: &mut Vec<String>) {
    match value {
        serde_json::Value::Object(map) => {
            for (key, value) in map {
                let path = if section.is_empty() {
                    key.clone()
                } else {
                    format!("{section}.{key}")
                };
                if value.as_object().is_some_and(|map| !map.is_empty())
                    || value
                        .as_array()
                        .is_some_and(|list| list.iter().any(serde_json::Value::is_object))
                {
                    keys(value, &path, found);
                } else {
                    found.push(path);
                }
            }
        }
        serde_json::Value::Array(list) => list.iter().for_each(|value| keys(value, section, found)),
        _ => {}
    }
}

#[test]
fn the_shipped_file_is_exactly_the_defaults() {
    assert_eq!(
        albireo_service::config::load::<NodeConfig>(Some(&shipped())).unwrap(),
        NodeConfig::default()
    );
    assert_eq!(
        albireo_service::config::load::<NodeConfig>(None).unwrap(),
        NodeConfig::default()
    );
}

/// The key of a line that sets one, also when it is commented out.
fn key_of(line: &str) -> Option<&str> {
    let (key, _) = line.strip_prefix("# ").unwrap_or(line).split_once(" = ")?;
    let is_key = |byte: u8| {
        byte.is_ascii_lowercase() || byte.is_ascii_digit() || matches!(byte, b'_' | b'.')
    };
    key.bytes().all(is_key).then_some(key)
}

#[test]
fn every_key_is_in_the_shipped_file_with_a_comment() {
    let text = std::fs::read_to_string(shipped()).unwrap();
    let mut section = String::new();
    let mut shown = Vec::new();
    let mut commented = false;
    for line in text.lines() {
        // There is no token by default: its section is a comment too.
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
    let mut wanted = Vec::new();
    let token = NamedToken {
        name: "a".to_owned(),
        role: Role::Read,
        token: None,
        token_file: None,
    };
    let shown_once = NodeConfig {
        tokens: vec![token],
        ..NodeConfig::default()
    };
    keys(&serde_json::to_value(shown_once).unwrap(), "", &mut wanted);
    shown.sort();
    wanted.sort();
    assert_eq!(shown, wanted);
    assert_eq!(shown.len(), KEYS);
}

/// The keys that a section takes, as its refusal of an unknown one names them.
fn keys_taken(section: &str, text: &str) -> Vec<String> {
    let found = problems(&format!("{text}unknown_key = 1"));
    let known = found[0].split_once("; known are ").expect("known keys").1;
    let named = known.split('`').skip(1).step_by(2);
    named.map(|key| format!("{section}{key}")).collect()
}

#[test]
fn the_program_takes_no_key_that_the_shipped_file_does_not_show() {
    let sections = keys_taken("", "");
    let mut taken = Vec::new();
    for section in sections {
        let text = match section.as_str() {
            "camera" | "token" => format!("[[{section}]]\nname = \"a\"\n"),
            _ => format!("[{section}]\n"),
        };
        taken.extend(keys_taken(&format!("{section}."), &text));
    }
    // Sections of their own: the GPU's, and those of the policies to compare with (docs/policies.md).
    let compared = "fixed_skip ctd statues in_tracker";
    let mut sections: Vec<_> = compared
        .split(' ')
        .map(|name| format!("policy.{name}"))
        .collect();
    sections.push("detector.gpu".to_owned());
    taken.retain(|key| !sections.contains(key));
    taken.extend(keys_taken("detector.gpu.", "[detector.gpu]\n"));
    assert_eq!(taken.len(), KEYS, "{taken:#?}");
}

#[test]
fn the_keys_shown_as_comments_can_be_used_as_they_stand() {
    let text: String = std::fs::read_to_string(shipped())
        .unwrap()
        .lines()
        // A token and a token file exclude each other, and so do a key and a source.
        .filter(|line| key_of(line) != Some("token_file"))
        .filter(|line| key_of(line) != Some("key"))
        .map(|line| match key_of(line) {
            Some(_) => format!("{}\n", line.trim_start_matches("# ")),
            None if line == "# [[token]]" => "[[token]]\n".to_owned(),
            None => format!("{line}\n"),
        })
        .collect();
    let config = load(&text).unwrap();
    assert_eq!(config.http.token.unwrap().secret(), "a-long-random-secret");
    assert_eq!(config.tokens[0].name, "prometheus");
    assert_eq!(
        config.cameras[0].source.as_ref().unwrap().to_string(),
        "rtsp://192.168.0.20/stream"
    );
}

#[test]
fn an_unknown_key_is_named_with_the_known_ones() {
    for (text, key) in [
        ("[http]\nlisten_on = 1", "http.listen_on"),
        ("[detector]\nconfidense = 0.5", "detector.confidense"),
        ("[[camera]]\nname = \"a\"\nformt = \"x\"", "camera.a.formt"),
        ("[nod]\nname = \"a\"", "nod"),
        ("colour = 1", "colour"),
    ] {
        let found = problems(text);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].starts_with(&format!("{key}: unknown key")),
            "{found:?}"
        );
    }
}

#[test]
fn every_removed_key_is_refused_with_what_became_of_it() {
    for (key, became) in NodeConfig::REMOVED {
        let text = match key.split_once(" = ") {
            Some((key, value)) => format!("{key} = \"{value}\"\n"),
            None if key.matches('.').count() == 1 && key.starts_with("policy.") => {
                format!("[{key}]\na = 1\n")
            }
            None => match key.strip_prefix("camera.") {
                Some(key) => format!("[[camera]]\nname = \"a\"\n{key} = 1\n"),
                None => format!("{key} = 1\n"),
            },
        };
        let found = problems(&text);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(
            found[0].contains(&format!("was removed: {became}")),
            "{found:?}"
        );
    }
}

#[test]
fn answers_at_once_need_a_policy_that_predicts_and_time_to_settle() {
    let camera = "[[camera]]\nname = \"front\"\nanswer = \"at_once\"\n";
    for policy in ["albireo", "expected-loss", "expected-loss+flow"] {
        let text = format!("policy.name = \"{policy}\"\n{camera}");
        assert_eq!(
            load(&text).unwrap().cameras[0].answer,
            Some(AnswerTime::AtOnce)
        );
    }
    let found = problems(&format!("policy.name = \"vanilla\"\n{camera}"));
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("does not predict boxes"), "{found:?}");
    let settle = "settle = { enabled = true, longest_ms = 500 }\ndetector.timeout_ms = 1000\n";
    assert!(load(settle).is_ok());
    let found = problems(&format!("{settle}{camera}"));
    assert!(
        found[0].starts_with("settle.longest_ms: is 500"),
        "{found:?}"
    );
}

#[test]
fn an_impossible_value_is_refused_with_its_key() {
    for (text, key) in [
        ("[node]\nname = \"a/b\"", "node.name"),
        ("[node]\nname = 7", "node.name"),
        ("[node]\nprefix = \"\"", "node.prefix"),
        ("[node]\nstate_dir = \"\"", "node.state_dir"),
        ("[zenoh]\nmode = \"boss\"", "zenoh.mode"),
        ("[zenoh]\nlisten = [\"127.0.0.1:7447\"]", "zenoh.listen"),
        ("[zenoh]\nmode = \"client\"", "zenoh.connect"),
        ("[http]\nlisten = \"127.0.0.1:99999\"", "http.listen"),
        ("[http]\nlisten = \"localhost\"", "http.listen"),
        ("[http]\nlisten = \"0.0.0.0:8080\"", "http.listen"),
        ("[http]\nlisten = \"[::]:8080\"", "http.listen"),
        ("[http]\ntoken = \"\"", "http.token"),
        ("[http]\ntoken = \"two words\"", "http.token"),
        ("[http]\ncors_origins = [\"*\"]", "http.cors_origins"),
        ("[detector]\nconfidence = nan", "detector.confidence"),
        ("[detector]\nconfidence = 1.5", "detector.confidence"),
        ("[detector]\nproviders = []", "detector.providers"),
        (
            "[detector]\nproviders = [\"cpu\", \"cpu\"]",
            "detector.providers",
        ),
        ("[detector]\nproviders = [\"npu\"]", "detector.providers[0]"),
        ("[detector]\ntimeout_ms = 0", "detector.timeout_ms"),
        ("[detector]\nbatch_size = 0", "detector.batch_size"),
        ("[detector]\nbatch_size = -1", "detector.batch_size"),
        ("[detector]\nhead = \"ssd\"", "detector.head"),
        ("[clip]\nwindow_s = 0", "clip.window_s"),
        ("[clip]\nwindow_s = inf", "clip.window_s"),
        ("[clip]\nsilence_s = -1.0", "clip.silence_s"),
        ("[frame]\nmax_payload_bytes = 0", "frame.max_payload_bytes"),
        ("[power]\ninterval_ms = 0", "power.interval_ms"),
        ("[power]\nidle_watts = nan", "power.idle_watts"),
        ("[power]\nidle_watts = 30.0", "power.busy_watts"),
        ("[log]\nlevel = \"loud\"", "log.level"),
        ("[policy]\nname = \"albiro\"", "policy.name"),
        ("[policy]\nu = 0", "policy.u"),
        ("[policy]\nu = nan", "policy.u"),
        ("[policy]\nu = \"small\"", "policy.u"),
        ("[policy]\nprofile = \"mine\"", "policy.profile"),
        ("[log]\nformat = \"xml\"", "log.format"),
        ("camera = []", "camera"),
        ("[[camera]]\nkey = \"a\"", "camera[0]"),
        ("[[camera]]\nname = \"a b\"", "camera.a b.name"),
        ("[[camera]]\nname = \"..\"", "camera....name"),
        (
            "[[camera]]\nname = \"a\"\n[[camera]]\nname = \"a\"",
            "camera.a.name",
        ),
        ("[[camera]]\nname = \"a\"\nkey = \"x/**\"", "camera.a.key"),
        ("[[camera]]\nname = \"a\"\nkey = \"/x\"", "camera.a.key"),
        ("[outbox]\ngather_s = 86401", "outbox.gather_s"),
        ("[[camera]]\nname = \"a\"\nsource = \"\"", "camera.a.source"),
        (
            "[[camera]]\nname = \"a\"\nsource = \"rtsp://${NOBODY_SETS_THIS}@b\"",
            "camera.a.source",
        ),
        (
            "[[camera]]\nname = \"a\"\nsource = \"b.mp4\"\nkey = \"c\"",
            "camera.a.key",
        ),
        (
            "[[camera]]\nname = \"a\"\nsource = \"b.mp4\"\ndelivery = \"every\"",
            "camera.a.delivery",
        ),
        (
            "[[camera]]\nname = \"a\"\nsource = \"b ! jpegenc\"\nhardware = \"cuda\"",
            "camera.a.hardware",
        ),
        (
            "[[camera]]\nname = \"a\"\nmax_rate = 5",
            "camera.a.max_rate",
        ),
        (
            "[[camera]]\nname = \"a\"\nsource = \"b.mp4\"\nmax_rate = 0",
            "camera.a.max_rate",
        ),
        (
            "[[camera]]\nname = \"a\"\nsource = \"b.mp4\"\nrtsp_transport = \"sctp\"",
            "camera.a.rtsp_transport",
        ),
        (
            "[[camera]]\nname = \"a\"\nthreshold = 0",
            "camera.a.threshold",
        ),
        (
            "[[camera]]\nname = \"a\"\nthreshold = nan",
            "camera.a.threshold",
        ),
        (
            "[[camera]]\nname = \"a\"\nthreshold = 2.0",
            "camera.a.threshold",
        ),
        (
            "[policy]\nname = \"vanilla\"\n[[camera]]\nname = \"a\"\nthreshold = 3e-4",
            "camera.a.threshold",
        ),
    ] {
        let found = problems(text);
        assert_eq!(found.len(), 1, "{text}: {found:?}");
        assert!(
            found[0].starts_with(&format!("{key}: ")),
            "{text}: {found:?}"
        );
    }
}

#[test]
fn a_wrong_policy_hides_no_wrong_number_and_the_likely_name_is_offered() {
    let mut found = problems("[policy]\nname = \"expectedloss\"\nu = 5\nlambda = -1");
    found.sort();
    assert_eq!(found.len(), 3, "{found:?}");
    assert!(found[0].starts_with("policy.lambda: "), "{found:?}");
    assert!(
        found[1].contains("did you mean `expected-loss`?"),
        "{found:?}"
    );
    assert!(found[2].starts_with("policy.u: "), "{found:?}");
}

#[test]
fn everything_wrong_is_told_at_once() {
    let found = problems("[clip]\nwindow_s = 0\nsilence_s = nan\n[frame]\nmax_payload_bytes = 0");
    assert_eq!(found.len(), 3, "{found:?}");
}

#[test]
fn a_file_that_is_missing_or_no_toml_is_named() {
    let error = albireo_service::config::load::<NodeConfig>(Some(Path::new("/nowhere/node.toml")))
        .unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("/nowhere/node.toml cannot be used:"),
        "{error}"
    );
    let error = load("[http\nlisten = 1").unwrap_err();
    assert!(error.to_string().contains("line 1"), "{error}");
}

#[test]
fn an_address_that_others_reach_is_accepted_with_a_token_or_a_word() {
    for rest in [
        "token = \"s3cret-s3cret-s3cret\"",
        "token_file = \"/run/token\"",
        "allow_unauthenticated = true",
    ] {
        let config = load(&format!("[http]\nlisten = \"0.0.0.0:8080\"\n{rest}")).unwrap();
        assert!(!format!("{config:?}").contains("s3cret"));
    }
}
