//! Says why a session reaches none of its endpoints, which Zenoh does not: a connection of our own finds it out.

use crate::config::HostPort;
use crate::connection::Connector;
use crate::identity;
use std::path::Path;
use zenoh::config::EndPoint;

/// The beginning of Zenoh's error, which has no cause.
const WITHOUT_CAUSE: &str = "Unable to connect to any of";

/// Zenoh's `error`, or the cause at each endpoint of `config` where the error has none.
pub(super) async fn of(config: &zenoh::Config, error: String) -> String {
    let endpoints = super::endpoints(config, "connect");
    if !error.starts_with(WITHOUT_CAUSE) || endpoints.is_empty() {
        return error;
    }
    let files = identity::tls_files(config, "certificate");
    let authority = files.iter().find(|(name, _)| name == "root_ca_certificate");
    let authority = authority.map(|(_, file)| file.as_path());
    let verifies_name = config
        .get_json("transport/link/tls/verify_name_on_connect")
        .is_ok_and(|value| value != "false");
    let mut causes = Vec::new();
    for endpoint in endpoints {
        let cause = cause(&endpoint, authority, verifies_name).await;
        causes.push(format!("{endpoint}: {cause}"));
    }
    causes.join("; ")
}

/// Why no session to `endpoint` can be opened.
async fn cause(endpoint: &str, authority: Option<&Path>, verifies_name: bool) -> String {
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
    let connector = if has_tls && verifies_name {
        match Connector::secure(&host, port, authority) {
            Ok(secure) => secure,
            // Zenoh does not need the system's authorities.
            Err(_) if authority.is_none() => Connector::plain(host, port),
            Err(reason) => return reason,
        }
    } else {
        Connector::plain(host, port)
    };
    match connector.open().await {
        Err(error) => error.to_string(),
        Ok(_) if has_tls => "accepts connections, but opens no session: does it accept this certificate, and has it \
                             room for one more?"
            .to_owned(),
        Ok(_) => "accepts connections, but opens no session: is it a router of Zenoh, and has it room for one more?"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use crate::config::UplinkConfig;
    use crate::session::open_uplink;
    use rcgen::{CertificateParams, KeyPair};
    use serde_json::json;

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

    #[tokio::test(flavor = "multi_thread")]
    async fn a_router_whose_certificate_is_for_another_name_is_told_so() {
        let folder = tempfile::tempdir().unwrap();
        let key = KeyPair::generate().unwrap();
        let names = vec!["hub.example".to_owned()];
        let certificate = CertificateParams::new(names).unwrap().self_signed(&key).unwrap();
        let certificate_file = folder.path().join("router.pem");
        let key_file = folder.path().join("router.key");
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
        crate::session::set(&mut config, &settings).unwrap();
        let router = crate::session::attempt(config).await.unwrap();
        let uplink = UplinkConfig {
            connect: vec![router.info().locators().await[0].to_string()],
            root_ca_certificate: Some(certificate_file),
            ..UplinkConfig::default()
        };
        let said = why_not(&uplink).await;
        let expected = "its certificate is for another name";
        assert!(said.contains(expected), "{said}");
        router.close().await.unwrap();
    }
}
