//! Says why a session reaches none of its endpoints, which Zenoh does not: a connection of our own finds it out.

use crate::config::{HostPort, shown_endpoint};
use crate::connection::{Authorities, Connector};
use futures_util::future::join_all;
use std::path::PathBuf;
use tokio::task::spawn_blocking;
use zenoh::config::EndPoint;

/// The beginning of Zenoh's error, which has no cause.
const WITHOUT_CAUSE: &str = "Unable to connect to any of";

/// How the certificate of an endpoint is verified.
enum Verification {
    /// Only Zenoh can: its authorities are not in a file.
    ByZenohOnly,
    By(Authorities),
    /// Not at all, for this reason.
    Impossible(String),
}

/// Zenoh's `error`, or the cause at each endpoint of `config` where the error has none.
pub(super) async fn of(config: &zenoh::Config, error: String) -> String {
    let endpoints = super::endpoints(config, "connect");
    if !error.starts_with(WITHOUT_CAUSE) || endpoints.is_empty() {
        return error;
    }
    let has_tls = endpoints.iter().any(|endpoint| endpoint.starts_with("tls/"));
    let verification = if has_tls {
        verification(config).await
    } else {
        Verification::ByZenohOnly
    };
    let mut causes = Vec::new();
    for endpoint in &endpoints {
        causes.push(named_cause(endpoint, &verification));
    }
    join_all(causes).await.join("; ")
}

/// How Zenoh verifies certificates as configured. Reads the authorities once for all endpoints.
async fn verification(config: &zenoh::Config) -> Verification {
    let tls = |name: &str| {
        let value = config.get_json(&format!("transport/link/tls/{name}"));
        value.unwrap_or_default()
    };
    let in_configuration = tls("root_ca_certificate_base64");
    if !matches!(in_configuration.as_str(), "" | "null") || tls("verify_name_on_connect") == "false"
    {
        return Verification::ByZenohOnly;
    }
    let file: Option<PathBuf> =
        serde_json::from_str(&tls("root_ca_certificate")).unwrap_or_default();
    let has_file = file.is_some();
    match spawn_blocking(move || Authorities::read(file.as_deref())).await {
        Ok(Ok(authorities)) => Verification::By(authorities),
        Ok(Err(reason)) if has_file => Verification::Impossible(reason),
        // Zenoh does not need the system's authorities.
        Ok(Err(_)) | Err(_) => Verification::ByZenohOnly,
    }
}

/// The endpoint, and why no session to it can be opened.
async fn named_cause(endpoint: &str, verification: &Verification) -> String {
    let cause = cause(endpoint, verification).await;
    format!("{}: {cause}", shown_endpoint(endpoint))
}

/// Why no session to `endpoint` can be opened.
async fn cause(endpoint: &str, verification: &Verification) -> String {
    let parsed = match endpoint.parse::<EndPoint>() {
        Ok(parsed) => parsed,
        Err(error) => return super::plain(&error),
    };
    let protocol = parsed.protocol();
    let has_tls = protocol.as_str() == "tls";
    if !has_tls && protocol.as_str() != "tcp" {
        return "nobody answers".to_owned();
    }
    let HostPort { host, port } = match HostPort::read(parsed.address().as_str()) {
        Ok(place) => place,
        Err(reason) => return reason,
    };
    // What follows the address may name other authorities.
    let is_verified = has_tls && !endpoint.contains('#');
    let connector = match verification {
        Verification::By(authorities) if is_verified => {
            Connector::verified(host, port, authorities)
        }
        Verification::Impossible(reason) if is_verified => return reason.clone(),
        _ => Connector::plain(host, port),
    };
    match connector.open().await {
        Err(error) => error.to_string(),
        Ok(_) if has_tls => "accepts connections, but opens no session: does each side accept the other's certificate, \
                             and has it room for one more?"
            .to_owned(),
        Ok(_) => "accepts connections, but opens no session: is it a router of Zenoh, and has it room for one more?"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use crate::config::UplinkConfig;
    use crate::session::{attempt, open_uplink, set};
    use rcgen::{CertificateParams, KeyPair};
    use serde_json::json;
    use std::path::Path;
    use std::time::{Duration, Instant};
    use zenoh::Session;

    async fn why_not(uplink: &UplinkConfig) -> String {
        open_uplink(uplink).await.err().unwrap().to_string()
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn each_endpoint_that_cannot_be_reached_is_named_with_its_cause() {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let closed = format!("tcp/{}", free.local_addr().unwrap());
        drop(free);
        let hanging_up = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let other = format!("tcp/{}", hanging_up.local_addr().unwrap());
        std::thread::spawn(move || hanging_up.incoming().for_each(drop));
        let uplink = UplinkConfig {
            connect: vec![closed.clone(), other.clone()],
            ..UplinkConfig::default()
        };
        let said = why_not(&uplink).await;
        let expected = format!(
            "the hub's router cannot be reached: {closed}: refuses the connection: nothing listens there; \
             {other}: accepts connections, but opens no session: "
        );
        assert!(said.starts_with(&expected), "{said}");
    }

    /// A router with a certificate for another name, which is in `router.pem` of the folder, and its endpoint.
    async fn router_of_another_name(folder: &Path) -> (Session, String) {
        let key = KeyPair::generate().unwrap();
        let names = vec!["hub.example".to_owned()];
        let certificate = CertificateParams::new(names).unwrap().self_signed(&key).unwrap();
        let certificate_file = folder.join("router.pem");
        let key_file = folder.join("router.key");
        std::fs::write(&certificate_file, certificate.pem()).unwrap();
        std::fs::write(&key_file, key.serialize_pem()).unwrap();
        let mut config = zenoh::Config::default();
        let tls = json!({ "listen_certificate": certificate_file, "listen_private_key": key_file });
        let settings = [
            ("mode", json!("router")),
            ("listen/endpoints", json!(["tls/127.0.0.1:0"])),
            ("scouting/multicast/enabled", json!(false)),
            ("transport/link/tls", tls),
        ];
        set(&mut config, &settings).unwrap();
        let router = attempt(config).await.unwrap();
        let endpoint = router.info().locators().await[0].to_string();
        (router, endpoint)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_router_whose_certificate_is_for_another_name_is_told_so() {
        let folder = tempfile::tempdir().unwrap();
        let (router, endpoint) = router_of_another_name(folder.path()).await;
        let uplink = UplinkConfig {
            connect: vec![endpoint],
            root_ca_certificate: Some(folder.path().join("router.pem")),
            ..UplinkConfig::default()
        };
        let said = why_not(&uplink).await;
        let expected = "its certificate is for another name";
        assert!(said.contains(expected), "{said}");
        router.close().await.unwrap();
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_certificate_is_judged_only_by_the_authorities_that_zenoh_has() {
        let folder = tempfile::tempdir().unwrap();
        let (router, endpoint) = router_of_another_name(folder.path()).await;
        let file = folder.path().join("router.pem");
        let by_name = "its certificate is for another name";
        let unknown = "accepts connections, but opens no session";
        let in_endpoint = format!("{endpoint}#root_ca_certificate_file={}", file.display());
        for (case, connect, tls, expected) in [
            (
                "the authority's file is the node's certificate, too",
                &endpoint,
                json!({ "root_ca_certificate": file, "connect_certificate": file }),
                by_name,
            ),
            (
                "the authority is in the configuration",
                &endpoint,
                json!({ "root_ca_certificate_base64": "bm9uZQ==" }),
                unknown,
            ),
            ("it is in the endpoint", &in_endpoint, json!({}), unknown),
        ] {
            let mut config = zenoh::Config::default();
            let settings = [
                ("connect/endpoints", json!([connect])),
                ("transport/link/tls", tls),
            ];
            set(&mut config, &settings).unwrap();
            let said = super::of(&config, super::WITHOUT_CAUSE.to_owned()).await;
            assert!(said.contains(expected), "{case}: {said}");
        }
        router.close().await.unwrap();
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn many_endpoints_that_do_not_answer_are_tried_at_the_same_time() {
        // Connections wait in the queue of each, and TLS is never spoken.
        let mute: Vec<_> =
            (0..4).map(|_| std::net::TcpListener::bind("127.0.0.1:0").unwrap()).collect();
        let folder = tempfile::tempdir().unwrap();
        let key = KeyPair::generate().unwrap();
        let params = CertificateParams::new(vec!["hub.example".to_owned()]).unwrap();
        let file = folder.path().join("authority.pem");
        std::fs::write(&file, params.self_signed(&key).unwrap().pem()).unwrap();
        let endpoints: Vec<_> = mute
            .iter()
            .map(|listener| format!("tls/{}", listener.local_addr().unwrap()))
            .collect();
        let mut config = zenoh::Config::default();
        let settings = [
            ("connect/endpoints", json!(endpoints)),
            ("transport/link/tls/root_ca_certificate", json!(file)),
        ];
        set(&mut config, &settings).unwrap();
        let began = Instant::now();
        let said = super::of(&config, super::WITHOUT_CAUSE.to_owned()).await;
        assert_eq!(
            said.matches("did not answer within 5 s").count(),
            4,
            "{said}"
        );
        assert!(began.elapsed() < Duration::from_secs(10));
    }
}
