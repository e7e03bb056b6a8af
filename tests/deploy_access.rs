//! Access control of a fleet: router and hub as processes, with the program's certificates and rules, and intruders.

use crate::support::camera::Camera;
use crate::support::fleet::{HubProcess, Protected, deliver, now_ns, sqlite};
use crate::support::{
    Node, PATIENCE, assert_contains, json_at, run, signal, subscribe, text_at, until, value_of,
    zenoh_session,
};
use albireo_router::authority::{Authority, DAY, Role};
use rstest::rstest;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;
use tokio::process::Child;
use tokio::time::timeout;
use zenoh::Session;
use zenoh::sample::Sample;

/// A fleet with access control whose router and hub run.
async fn started() -> (Protected, Child, HubProcess) {
    let fleet = Protected::new(["car-7", "car-8"]);
    let router = fleet.start_router().await;
    let hub = HubProcess::start(&fleet.hub(&sqlite(fleet.folder.path())));
    hub.until_ready().await;
    (fleet, router, hub)
}

/// Sessions with certificates.
impl Protected {
    async fn opens_with(&self, certificate: &Path, key: &Path) -> zenoh::Result<Session> {
        let tls = json!({
            "root_ca_certificate": self.authority().join("authority.pem"),
            "enable_mtls": true,
            "connect_certificate": certificate,
            "connect_private_key": key,
        });
        open(&self.endpoint, Some(tls)).await
    }

    /// Opens a session as `member`, `ROLE/NAME`, with a certificate from the folder `authority`.
    async fn opens_from(&self, authority: &Path, member: &str) -> zenoh::Result<Session> {
        let certificate = authority.join(member).with_extension("pem");
        let key = authority.join(member).with_extension("key");
        self.opens_with(&certificate, &key).await
    }

    async fn opens(&self, member: &str) -> zenoh::Result<Session> {
        self.opens_from(&self.authority(), member).await
    }
}

async fn open(endpoint: &str, tls: Option<Value>) -> zenoh::Result<Session> {
    let mut settings = vec![
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        // One attempt.
        ("connect/timeout_ms", json!(0)),
    ];
    settings.extend(tls.map(|tls| ("transport/link/tls", tls)));
    zenoh_session(&settings).await
}

async fn acknowledged(session: &Session, node: &str, number: u64, limit: Duration) -> bool {
    let delivered = deliver(session, node, number..=number, now_ns());
    timeout(limit, delivered).await.is_ok()
}

/// Long enough for an allowed message, on a router that has just answered others.
const NOBODY: Duration = Duration::from_secs(3);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn members_with_a_valid_certificate_work_and_every_intruder_is_rejected() {
    let (fleet, _router, hub) = started().await;

    let car_7 = fleet.opens("node/car-7").await.unwrap();
    let car_8 = fleet.opens("node/car-8").await.unwrap();
    for (session, name) in [(&car_7, "car-7"), (&car_8, "car-8")] {
        let taken = acknowledged(session, name, 1, PATIENCE).await;
        assert!(taken, "{}", fleet.log());
    }
    assert_eq!(hub.clips("car-7").await.len(), 1);

    // No TLS, no certificate, a certificate of another authority, an expired certificate.
    let plain = fleet.endpoint.replace("tls/", "tcp/");
    assert!(open(&plain, None).await.is_err(), "a plain client");
    let only_trust = json!({"root_ca_certificate": fleet.authority().join("authority.pem")});
    let nobody = open(&fleet.endpoint, Some(only_trust)).await;
    assert!(nobody.is_err(), "no certificate");
    let other = fleet.folder.path().join("other");
    let mut stranger = Authority::create(&other, "other", DAY).unwrap();
    stranger.issue(Role::Node, "car-7", &[], DAY).unwrap();
    let with_other = fleet.opens_from(&other, "node/car-7").await;
    assert!(with_other.is_err(), "a certificate of another authority");
    let mut own = Authority::open(&fleet.authority()).unwrap();
    let second = Duration::from_secs(1);
    own.issue(Role::Node, "car-9", &[], second).unwrap();
    drop(own);
    tokio::time::sleep(second * 2).await;
    let ended = fleet.opens("node/car-9").await;
    assert!(ended.is_err(), "an expired certificate");

    let node = fleet.authority().join("node");
    let certificate = node.join("car-7.pem");
    let key = node.join("car-8.key");
    let mixed = fleet.opens_with(&certificate, &key).await;
    assert!(mixed.is_err(), "another node's key");

    // A member that exceeds its rights. A hub's session would receive its messages.
    let taken = acknowledged(&car_7, "car-8", 9, NOBODY).await;
    assert!(!taken, "a report in another's name");
    let ear = fleet.opens("hub/main").await.unwrap();
    let key = |sample: Sample| sample.key_expr().to_string();
    let mut said = subscribe(&ear, "albireo/@status/*", key).await;
    let mut thresholds = subscribe(&car_8, "albireo/car-8/front/threshold", drop).await;
    for key in [
        "albireo/car-8/front/threshold",
        "albireo/car-7/front/threshold",
        "albireo/@changed/car-8",
        "albireo/@status/car-8",
    ] {
        car_7.put(key, "{}").await.unwrap();
    }
    // Its own status, sent later, arrives: the earlier messages were denied, not delayed.
    loop {
        car_7.put("albireo/@status/car-7", "{}").await.unwrap();
        if let Ok(Some(key)) = timeout(Duration::from_millis(200), said.recv()).await {
            assert_eq!(key, "albireo/@status/car-7", "{}", fleet.log());
            break;
        }
    }
    assert!(thresholds.try_recv().is_err());

    // A member cannot act as a hub, nor subscribe to the status of others.
    let queries = car_7.declare_queryable("albireo/@report/*").complete(true).await.unwrap();
    let mut overheard = subscribe(&car_7, "albireo/@status/*", drop).await;
    for number in 2..=5 {
        car_8.put("albireo/@status/car-8", "{}").await.unwrap();
        assert!(acknowledged(&car_8, "car-8", number, PATIENCE).await);
    }
    let nothing = matches!(queries.try_recv(), Ok(None)) && overheard.try_recv().is_err();
    assert!(nothing, "{}", fleet.log());
    assert_eq!(hub.clips("car-8").await.len(), 5, "its own reports only");
    let metrics = text_at(&format!("http://{}/metrics", fleet.http)).await;
    let value = |name: &str| value_of(&metrics, &format!("albireo_router_{name}"));
    assert!(value("sessions") >= 3.0 && value("probe_seconds") > 0.0);
    assert_eq!(value("probes_failed_total"), 0.0);
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_node_is_locked_out_by_the_new_rules_until_it_has_a_new_certificate() {
    let (fleet, mut router, _hub) = started().await;
    let old = fleet.folder.path().join("old");
    std::fs::create_dir_all(old.join("node")).unwrap();
    for kind in ["pem", "key"] {
        let file = format!("node/car-7.{kind}");
        std::fs::copy(fleet.authority().join(&file), old.join(&file)).unwrap();
    }
    let stolen = fleet.opens_from(&old, "node/car-7").await.unwrap();
    assert!(acknowledged(&stolen, "car-7", 1, PATIENCE).await);

    fleet.does(&["cert", "revoke", "node", "car-7"]);
    fleet.does(&["cert", "node", "car-7"]);
    let list = fleet.does(&["cert", "list"]);
    for (certificate, state) in [("node/car-7/1", "revoked"), ("node/car-7/2", "ends in")] {
        assert!(
            list.lines().any(|line| line.contains(certificate) && line.contains(state)),
            "{list}"
        );
    }
    signal(router.id().unwrap(), "-TERM");
    assert!(router.wait().await.unwrap().success(), "{}", fleet.log());
    let _router = fleet.start_router().await;

    // Its certificate is still valid, so it gets a session, and nothing else.
    let again = fleet.opens_from(&old, "node/car-7").await.unwrap();
    assert!(!acknowledged(&again, "car-7", 2, NOBODY).await);
    let renewed = fleet.opens("node/car-7").await.unwrap();
    let taken = acknowledged(&renewed, "car-7", 2, PATIENCE).await;
    assert!(taken, "{}", fleet.log());
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime"]
async fn a_real_node_reports_through_the_router_with_its_certificate() {
    let (fleet, _router, hub) = started().await;
    let settings = format!(
        "node.name = \"car-7\"\ndetector.model = \"{}/tests/fixtures/models/boxes.onnx\"\npower.source = \"none\"\n\
         uplink.connect = [\"{}\"]\n{}uplink.liveliness = true\n# development: retry_min_ms=50\n",
        env!("CARGO_MANIFEST_DIR"),
        fleet.endpoint,
        fleet.certificate("car-7"),
    );
    let node = Node::start(&settings).await;
    let mut camera = Camera::at(&node.zenoh, "car-7").await;
    camera.clips(4).await;
    let three = |page: &Value| page["clips"].as_array().map_or(0, Vec::len) >= 3;
    hub.until("/api/v1/clips?node=car-7", three).await;
    let is_online = |node: &Value| node["state"] == "online";
    hub.until("/api/v1/nodes/car-7", is_online).await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ONNX Runtime"]
async fn a_node_whose_certificate_has_ended_says_so_and_one_that_ends_soon_is_told_beforehand() {
    let (fleet, _router, hub) = started().await;
    let mut own = Authority::open(&fleet.authority()).unwrap();
    own.renew(Role::Node, "car-7", Duration::ZERO).unwrap();
    own.renew(Role::Node, "car-8", DAY * 6).unwrap();
    let ends: BTreeMap<_, _> =
        own.entries().iter().map(|entry| (entry.name.clone(), entry.ends_s)).collect();
    drop(own);
    let start = async |name: &str| {
        let settings = format!(
            "node.name = \"{name}\"\ndetector.model = \"{}/tests/fixtures/models/boxes.onnx\"\npower.source = \"none\"\n\
             outbox.offline_h = 9\nuplink.connect = [\"{}\"]\n{}",
            env!("CARGO_MANIFEST_DIR"),
            fleet.endpoint,
            fleet.certificate(name),
        );
        Node::start(&settings).await
    };
    let says = async |node: &Node, part: &str, said: &str| {
        let said_it = async || {
            let page = json_at(&format!("{}/readyz", node.http)).await;
            let mut reasons = page["reasons"].as_array().into_iter().flatten();
            reasons.any(|one| one["part"] == part && one["reason"].as_str().unwrap().contains(said))
        };
        until(said, said_it).await;
    };
    let ended = start("car-7").await;
    says(&ended, "uplink", "certificate expired on ").await;
    says(&ended, "certificates", "certificate expired on ").await;
    let ends_soon = start("car-8").await;
    says(&ends_soon, "certificates", "certificate expires on ").await;
    let metrics = text_at(&format!("{}/metrics", ends_soon.http)).await;
    let series = "albireo_certificate_until_timestamp_seconds{certificate=\"uplink.certificate\"}";
    assert_eq!(value_of(&metrics, series), ends["car-8"] as f64);
    let shown = json_at(&format!("{}/api/v1/node", ends_soon.http)).await;
    let own = json!({"name": "uplink.certificate", "until_s": ends["car-8"]});
    assert!(
        shown["certificates"].as_array().unwrap().contains(&own),
        "{shown}"
    );
    let told = async || {
        let page = hub.metrics().await;
        value_of(&page, "albireo_hub_nodes_certificate_ending{within=\"7d\"}") == 1.0
    };
    until("the hub knows of it", told).await;
}

#[test]
fn a_router_that_requires_certificates_does_not_start_without_access_rules() {
    let check = ["router", "--check", "--config", "deploy/zenoh/router.json5"];
    assert_contains(&run(&check, &[]).fails(), &["--access"]);
}
