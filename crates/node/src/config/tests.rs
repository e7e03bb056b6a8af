#[path = "../../../../tests/support/configuration.rs"]
mod configuration;

use super::*;
use albireo_service::config::Configuration as _;
use configuration::{key_of, load, problem, problems};

type Config = NodeConfig;
const SHIPPED: &str = include_str!("../../../../config/node.toml");
/// One of each section of which there are none by default.
const LISTED: &str = "[[token]]\nname = \"a\"\ntoken = \"a-long-random-secret\"\n[[hook]]\nurl = \"http://127.0.0.1\"\n";

#[test]
fn the_keys_in_comments_can_be_used_unchanged() {
    let text: String = SHIPPED
        .lines()
        // A token and a token file exclude each other, and so do a key, a topic and a source, and a hook's address and its file.
        .filter(|line| {
            let key = key_of(line);
            !matches!(key, Some("token_file" | "url_file" | "key" | "topic"))
        })
        .map(|line| {
            let is_example = key_of(line).is_some() || line.starts_with("# [[");
            if is_example {
                format!("{}\n", line.trim_start_matches("# "))
            } else {
                format!("{line}\n")
            }
        })
        .collect();
    let config = load(&text).unwrap();
    assert_eq!(config.http.token.unwrap().secret(), "a-long-random-secret");
    assert_eq!(config.tokens[0].name, "prometheus");
    let source = config.cameras[0].source.as_ref().unwrap();
    assert_eq!(source.to_string(), "rtsp://192.168.0.20/stream");
}

#[test]
fn every_removed_key_is_rejected_with_its_replacement() {
    for removed in NodeConfig::REMOVED.lines() {
        let (key, became) = removed.split_once(": ").unwrap();
        let text = if let Some((key, value)) = key.split_once(" = ") {
            format!("{key} = \"{value}\"\n")
        } else {
            match key.split_once('.') {
                Some(("policy", _)) => format!("[{key}]\na = 1\n"),
                Some(("camera", of_camera)) => {
                    format!("[[camera]]\nname = \"a\"\n{of_camera} = 1\n")
                }
                _ => format!("{key} = 1\n"),
            }
        };
        let found = problem(&text);
        let expected = format!("was removed: {became}");
        assert!(found.contains(&expected), "{found}");
    }
}

#[test]
fn answers_at_once_need_a_policy_that_predicts_and_time_to_settle() {
    let camera = "[[camera]]\nname = \"front\"\nanswer = \"at_once\"\n";
    let answer = load(camera).unwrap().cameras[0].answer;
    assert_eq!(answer, Some(AnswerTime::AtOnce));
    let found = problem(&format!("policy.name = \"vanilla\"\n{camera}"));
    assert!(found.contains("does not predict boxes"), "{found}");
    let settle = "settle = { enabled = true, longest_ms = 500 }\ndetector.timeout_ms = 1000\n";
    assert!(load(settle).is_ok());
    let found = problems(&format!("{settle}{camera}"));
    let expected = "settle.longest_ms: is 500";
    assert!(found[0].starts_with(expected), "{found:?}");
}

/// The rejected key, and a configuration with lines separated by `&`.
const IMPOSSIBLE: &str = r#"
node.name: node.name = "a/b"
node.name: node.name = ".."
node.name: node.name = "all"
node.prefix: node.prefix = ""
node.state_dir: node.state_dir = ""
node.state_dir: node.state_dir = "${HOME}/state"
record.folder: record.folder = "$HOME/recordings"
zenoh.listen: zenoh.listen = ["tcp/127.0.0.1:99999"]
uplink.connect: uplink.connect = ["tcp/localhost"]
zenoh.mode: zenoh.mode = "boss"
zenoh.listen: zenoh.listen = ["127.0.0.1:7447"]
zenoh.connect: zenoh.mode = "client"
http.listen: http.listen = "127.0.0.1:99999"
http.listen: http.listen = "0.0.0.0:8080"
http.token: http.token = ""
http.token: http.token = "two words"
http.cors_origins: http.cors_origins = ["*"]
detector.confidence: detector.confidence = nan
detector.confidence: detector.confidence = 1.5
detector.providers: detector.providers = []
detector.providers: detector.providers = ["cpu", "cpu"]
detector.providers[0]: detector.providers = ["npu"]
detector.timeout_ms: detector.timeout_ms = 0
detector.batch_size: detector.batch_size = 0
record.folder: record.folder = ""
record.before_s: record.before_s = -1
record.after_s: record.after_s = nan
record.max_gb: record.max_gb = 0
record.keep_days: record.keep_days = 0
record.when: record.when = ["audit"]
hook[0].record: hook = [{ record = true }]
hook[0].url: hook = [{ record = false }]
record.when: record.folder = "a" & record.when = ["audit"] & audit.share = 0
clip.window_s: clip.window_s = 0
clip.window_s: clip.window_s = inf
clip.silence_s: clip.silence_s = -1.0
frame.max_payload_bytes: frame.max_payload_bytes = 0
power.idle_watts: power.idle_watts = nan
log.level: log.level = "loud"
screen.pause_s: screen.pause_s = -0.1
screen.pause_s: screen.pause_s = 61
screen.after_s: screen.after_s = nan
screen.pause_s: policy.name = "expected-loss" & screen.pause_s = 0.2
policy.name: policy.name = "albiro"
policy.u: policy.u = 0
policy.profile: policy.profile = "mine"
sightings.leave_s: sightings.leave_s = -1
sightings.appear_s: sightings.appear_s = 3601
mqtt.broker: mqtt.broker = "broker.example:1883"
mqtt.broker: mqtt.broker = "mqtt://ann:secret@broker.example"
mqtt.broker: mqtt.broker = "mqtt://127.0.0.1:99999"
mqtt.broker: mqtt.user = "ann"
mqtt.password_file: mqtt.broker = "mqtt://b" & mqtt.password_file = "p"
mqtt.root_ca_certificate: mqtt.broker = "mqtt://b" & mqtt.root_ca_certificate = "a.pem"
mqtt.discovery: mqtt.discovery = "home/#"
hook[0].url: hook = [{ classes = ["car"] }]
hook[0].url: hook = [{ url = "house.example/hook" }]
hook[0].url: hook = [{ url = "http://127.0.0.1:99999/x" }]
hook[0].url_file: hook = [{ url = "http://a", url_file = "b" }]
hook[0].cameras: hook = [{ url = "http://a", cameras = ["fornt"] }]
camera: camera = []
camera[0].name: camera = [{ key = "a" }]
camera.a b.name: camera = [{ name = "a b" }]
camera....name: camera = [{ name = ".." }]
camera.a.name: camera = [{ name = "a" }, { name = "a" }]
camera.a.key: camera = [{ name = "a", key = "x/**" }]
camera.a.key: camera = [{ name = "a", key = "/x" }]
outbox.gather_s: outbox.gather_s = 86401
outbox.offline_h: outbox.offline_h = -1
camera.a.source: camera = [{ name = "a", source = "" }]
camera.a.source: camera = [{ name = "a", source = "rtsp://${NOBODY_SETS_THIS}@b" }]
camera.a.key: camera = [{ name = "a", source = "b.mp4", key = "c" }]
camera.a.delivery: camera = [{ name = "a", source = "b.mp4", delivery = "every" }]
camera.a.hardware: camera = [{ name = "a", source = "b ! jpegenc", hardware = "cuda" }]
camera.a.max_rate: camera = [{ name = "a", max_rate = 5 }]
camera.a.max_rate: camera = [{ name = "a", source = "b.mp4", max_rate = 0 }]
camera.a.threshold: camera = [{ name = "a", threshold = 0 }]
camera.a.rotate: camera = [{ name = "a", rotate = -90 }]
camera.a.flip: camera = [{ name = "a", flip = true }]
camera.a.flip: camera = [{ name = "a", flip = "left" }]
camera.a.crop: camera = [{ name = "a", crop = [0, 0, 640, 360] }]
camera.a.crop: camera = [{ name = "a", crop = [0.5] }]
camera.a.mask: camera = [{ name = "a", mask = [[0, 0], [1, 0]] }]
camera.a.mask: camera = [{ name = "a", mask = [0, 0, 1, 0] }]
camera.a.mask: camera = [{ name = "a", mask = [[[0, 0], [1, 0], [1, 1], [0, 1]]] }]
camera.a.threshold: policy.name = "vanilla" & camera = [{ name = "a", threshold = 3e-4 }]
"#;

#[test]
fn an_impossible_value_is_rejected_with_its_key() {
    for line in IMPOSSIBLE.trim().lines() {
        let (key, text) = line.split_once(": ").unwrap();
        let found = problem(&text.replace(" & ", "\n"));
        let expected = format!("{key}: ");
        assert!(found.starts_with(&expected), "{text}: {found}");
    }
}

#[test]
fn a_name_that_is_too_long_for_keys_and_files_is_rejected() {
    for (bytes, is_valid) in [(64, true), (65, false)] {
        let name = "n".repeat(bytes);
        let node = load(&format!("node.name = \"{name}\"\n"));
        assert_eq!(node.is_ok(), is_valid);
    }
    for (bytes, is_valid) in [(200, true), (201, false)] {
        let name = "c".repeat(bytes);
        let camera = load(&format!("[[camera]]\nname = \"{name}\"\n"));
        assert_eq!(camera.is_ok(), is_valid);
    }
    // A name in another script is long, and shortening it would not help.
    let name = "\u{43a}".repeat(120);
    let found = problem(&format!("[[camera]]\nname = \"{name}\"\n"));
    assert!(found.contains("a character that is not allowed"), "{found}");
}

#[test]
fn a_node_with_a_hub_has_no_more_cameras_than_a_hub_takes() {
    let most = albireo_wire::MOST_CAMERAS;
    let cameras = |number: usize| -> String {
        (0..number)
            .map(|camera| format!("[[camera]]\nname = \"c{camera}\"\n"))
            .collect()
    };
    let uplink = "uplink.connect = [\"tcp/hub.example:7447\"]\n";
    assert!(load(&format!("{uplink}{}", cameras(most))).is_ok());
    assert!(load(&cameras(most + 1)).is_ok());
    let found = problem(&format!("{uplink}{}", cameras(most + 1)));
    let expected = format!("camera: names {} cameras; ", most + 1);
    assert!(found.starts_with(&expected), "{found}");
}

#[test]
fn an_unknown_policy_hides_no_wrong_number_and_gets_a_suggestion() {
    let mut found = problems("[policy]\nname = \"expectedloss\"\nu = 5\nlambda = -1");
    found.sort();
    assert_eq!(found.len(), 3, "{found:?}");
    assert!(found[0].starts_with("policy.lambda: "), "{found:?}");
    let expected = "did you mean `expected-loss`?";
    assert!(found[1].contains(expected), "{found:?}");
    assert!(found[2].starts_with("policy.u: "), "{found:?}");
}

#[test]
fn a_file_that_is_not_toml_is_rejected_with_the_line() {
    let error = load("[http\nlisten = 1").unwrap_err();
    assert!(error.to_string().contains("line 1"), "{error}");
}

#[test]
fn an_address_open_to_others_is_accepted_with_a_token_or_explicit_permission() {
    for rest in [
        "token = \"s3cret-s3cret-s3cret\"",
        "token_file = \"/run/token\"",
        "allow_unauthenticated = true",
    ] {
        let config = load(&format!("[http]\nlisten = \"0.0.0.0:8080\"\n{rest}")).unwrap();
        assert!(!format!("{config:?}").contains("s3cret"));
    }
}
