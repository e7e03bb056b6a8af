//! Opens the Zenoh sessions of a service or a tool. Opening waits for the network, so it never runs on an async
//! worker.

mod causes;

use crate::ServiceError;
use crate::config::{UplinkConfig, ZenohConfig, shown_endpoints, with_shown_endpoints};
use std::fmt::Display;
use std::hash::{BuildHasher, RandomState};
use std::time::Duration;
use zenoh::{Session, Wait};

/// The first pause between two attempts to open a session, without jitter; it doubles with each attempt.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// The longest pause between two attempts, without jitter.
const LONGEST_PAUSE: Duration = Duration::from_secs(15);

/// Inserts settings by Zenoh's names, such as `("transport/link/tx/lease", 60000)`, into a Zenoh configuration.
///
/// # Errors
/// The setting that Zenoh rejects, and why.
pub fn set<V: Display>(config: &mut zenoh::Config, settings: &[(&str, V)]) -> Result<(), String> {
    for (key, value) in settings {
        config.insert_json5(key, &value.to_string()).map_err(|error| {
            let error = plain(&error);
            with_shown_endpoints(&format!("{key} = {value}: {error}"))
        })?;
    }
    Ok(())
}

/// The endpoints in the section `connect` or `listen` of a Zenoh configuration, but those of only some modes.
pub fn endpoints(config: &zenoh::Config, section: &str) -> Vec<String> {
    let json = config.get_json(&format!("{section}/endpoints")).unwrap_or_default();
    serde_json::from_str(&json).unwrap_or_default()
}

/// Opens a session as configured, with `settings` added. `max_payload_bytes` limits what is accepted from the network. A
/// client waits for its router without limit, and so does any other session if `patient`: drop the future to give up.
/// `failed` receives the error of each failed attempt.
///
/// # Errors
/// [`ServiceError`] if Zenoh rejects the configuration, or cannot listen on an endpoint and does not retry.
pub async fn open(
    config: &ZenohConfig,
    max_payload_bytes: usize,
    settings: &[(&str, &str)],
    patient: bool,
    mut failed: impl FnMut(&ServiceError),
) -> Result<Session, ServiceError> {
    let malformed = |reason: String| ServiceError(format!("[zenoh] {reason}"));
    let mut zenoh = config.to_zenoh(max_payload_bytes).map_err(malformed)?;
    set(&mut zenoh, settings).map_err(malformed)?;
    // From the final configuration, because a Zenoh configuration file sets its own mode.
    let mode = zenoh.get_json("mode");
    let retries = patient || mode.is_ok_and(|mode| mode == "\"client\"");
    let (place, key) = match &config.config_file {
        Some(file) => {
            let file = file.display();
            (
                format!("configuration file {file}"),
                format!("listen/endpoints in {file}"),
            )
        }
        None => {
            let listen = shown_endpoints(&config.listen);
            let connect = shown_endpoints(&config.connect);
            let place = format!("zenoh.listen = [{listen}], zenoh.connect = [{connect}]");
            (place, "zenoh.listen".to_owned())
        }
    };
    let mut pause = FIRST_PAUSE;
    loop {
        let reason = match attempt(zenoh.clone()).await {
            Ok(session) => return Ok(session),
            Err(reason) => reason,
        };
        let error = match not_listening(&key, &reason) {
            Some(words) => ServiceError(words),
            None => {
                let cause = causes::of(&zenoh, reason).await;
                ServiceError(format!("Zenoh session not opened ({place}): {cause}"))
            }
        };
        if !retries {
            return Err(error);
        }
        tracing::warn!("{error}; retrying");
        failed(&error);
        tokio::time::sleep(jittered(pause)).await;
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

/// Makes one attempt to open a session, on a thread that may wait.
///
/// # Errors
/// The reason it cannot be opened.
pub async fn attempt(config: zenoh::Config) -> Result<Session, String> {
    match tokio::task::spawn_blocking(|| zenoh::open(config).wait()).await {
        Ok(opened) => opened.map_err(|error| plain(&error)),
        Err(error) => Err(error.to_string()),
    }
}

/// What Zenoh's `error` says of an endpoint under the setting `key` that cannot be listened on, and the way out; `None` if it
/// is about something else.
pub fn not_listening(key: &str, error: &str) -> Option<String> {
    let (_, said) = error.split_once(" listener bound to ")?;
    let (endpoint, causes) = said.split_once(": [")?;
    let words = match causes.split_once(": ") {
        Some((_address, words)) => words,
        None => causes,
    };
    let without_number = match words.split_once(" (os error") {
        Some((before, _)) => before,
        None => words,
    };
    let cause = without_number.trim_end_matches(['.', ']']);
    let way_out = if cause.starts_with("Address already in use") {
        " (by a running node or hub? another port in the same key works, too)"
    } else {
        ""
    };
    Some(format!(
        "{key}: {endpoint} cannot be listened on: {cause}{way_out}"
    ))
}

/// Opens the session to the hub: one attempt.
///
/// # Errors
/// [`ServiceError`] if no router can be reached or Zenoh rejects the configuration.
pub async fn open_uplink(uplink: &UplinkConfig) -> Result<Session, ServiceError> {
    let config = uplink
        .to_zenoh(jittered(Duration::from_millis(1000)))
        .map_err(|reason| ServiceError(format!("[uplink] {reason}")))?;
    match attempt(config.clone()).await {
        Ok(session) => Ok(session),
        Err(reason) => {
            let cause = causes::of(&config, reason).await;
            Err(ServiceError(format!(
                "the hub's router cannot be reached: {cause}"
            )))
        }
    }
}

/// A random duration between half and one and a half of `pause`, so that many nodes do not retry at the same time.
pub fn jittered(pause: Duration) -> Duration {
    let random = RandomState::new().hash_one(pause) % 1000;
    pause.mul_f64(0.5 + random as f64 / 1000.0)
}

/// A text or an error from Zenoh without its source locations, which are paths on the machine that built it, and with
/// endpoints without what follows their addresses.
pub fn plain(error: &impl Display) -> String {
    let text = error.to_string();
    let mut plain = String::new();
    let mut rest = text.as_str();
    while let Some((before, after)) = rest.split_once(".rs:") {
        plain.push_str(before.rsplit_once(" at ").map_or(before, |(said, _)| said));
        rest = after.trim_start_matches(|c: char| c.is_ascii_digit());
    }
    plain.push_str(rest);
    with_shown_endpoints(plain.trim())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ZenohMode;

    #[test]
    fn a_zenoh_error_is_shown_without_source_paths() {
        let error = "Can not create listener [Address in use at /home/x/.cargo/src/a-1/b.rs:75.] at /y/o.rs:910.";
        assert_eq!(plain(&error), "Can not create listener [Address in use.].");
        assert_eq!(plain(&"nothing to hide"), "nothing to hide");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_session_that_is_not_opened_never_tells_the_key_in_its_endpoint() {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = free.local_addr().unwrap();
        drop(free);
        let endpoint = format!("tls/{address}?meta=M3TA#connect_private_key_base64=S3CRET");
        let uplink = UplinkConfig {
            connect: vec![endpoint.clone()],
            ..UplinkConfig::default()
        };
        let local = ZenohConfig {
            listen: vec![endpoint],
            ..ZenohConfig::default()
        };
        let local = open(&local, 1 << 20, &[], false, |_| {}).await;
        let uplink = open_uplink(&uplink).await;
        for opened in [local, uplink] {
            let said = opened.err().unwrap().to_string();
            assert!(said.contains(&format!("tls/{address}")), "{said}");
            assert!(!said.contains("M3TA") && !said.contains("S3CRET"), "{said}");
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_port_in_use_is_told_with_its_key_and_the_way_out() {
        let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
        let config = ZenohConfig {
            listen: vec![endpoint.clone()],
            ..ZenohConfig::default()
        };
        let opened = open(&config, 1 << 20, &[], false, |_| {}).await;
        let error = opened.err().unwrap().to_string();
        let expected =
            format!("zenoh.listen: {endpoint} cannot be listened on: Address already in use");
        assert!(error.starts_with(&expected), "{error}");
        assert!(
            error.ends_with("another port in the same key works, too)"),
            "{error}"
        );
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_client_with_a_zenoh_configuration_file_waits_for_its_router() {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", free.local_addr().unwrap());
        drop(free);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("zenoh.json5");
        let written = format!(
            r#"{{ mode: "client", connect: {{ endpoints: ["{endpoint}"] }}, scouting: {{ multicast: {{ enabled: false }} }} }}"#
        );
        std::fs::write(&file, written).unwrap();
        let client = ZenohConfig {
            config_file: Some(file),
            ..ZenohConfig::default()
        };
        let (failed, failures) = std::sync::mpsc::channel();
        let opening = tokio::spawn(async move {
            open(&client, 1 << 20, &[], false, |error| {
                let _ = failed.send(error.to_string());
            })
            .await
        });
        let first = tokio::task::spawn_blocking(move || failures.recv());
        let reason = first.await.unwrap().expect("it is tried again");
        assert!(reason.contains("zenoh.json5"), "{reason}");
        let router = ZenohConfig {
            mode: ZenohMode::Router,
            listen: vec![endpoint],
            ..ZenohConfig::default()
        };
        let router = open(&router, 1 << 20, &[], false, |_| {}).await.unwrap();
        opening.await.unwrap().unwrap().close().await.unwrap();
        router.close().await.unwrap();
    }

    #[test]
    fn retry_pauses_are_jittered() {
        let pause = Duration::from_secs(2);
        let spread: std::collections::BTreeSet<_> = (0..50).map(|_| jittered(pause)).collect();
        assert!(spread.len() > 10);
        assert!(spread.iter().all(|p| (1.0..3.0).contains(&p.as_secs_f64())));
    }
}
