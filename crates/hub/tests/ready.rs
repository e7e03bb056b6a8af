//! A hub is ready if reports get through, whatever the reason that they do not.

use crate::support::postgres::Postgres;
use crate::support::{Hub, Reply, batch, config, free_port, names, on_both, script};
use albireo_wire::RefusalReason;
use rstest::rstest;
use serde_json::Value;
use std::fs;
use std::time::{Duration, Instant};

async fn assert_unavailable(hub: &Hub, node: &str) {
    match hub.deliver(&batch(node, 1..=2)).await {
        Reply::Refused(refusal) => assert_eq!(refusal.reason, RefusalReason::Unavailable),
        reply => panic!("{reply:?}"),
    }
}

async fn commits(hub: &Hub) -> u64 {
    let metrics = reqwest::get(format!("{}/metrics", hub.http))
        .await
        .unwrap()
        .text()
        .await
        .unwrap();
    metrics
        .lines()
        .find_map(|line| line.strip_prefix("albireo_hub_commits_total "))
        .unwrap()
        .parse()
        .unwrap()
}

/// Asserts that the hub is not ready, and stays so while it commits other rows than reports.
async fn assert_stays_not_ready(hub: &Hub, commits_more: u64) -> Value {
    let last = commits(hub).await + commits_more;
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let done = commits(hub).await >= last;
        let page = hub.get("/readyz").await;
        assert_eq!(page["ready"], false, "{page}");
        hub.assert_metrics(&["albireo_hub_ready 0"]).await;
        if done {
            return page;
        }
        assert!(Instant::now() < until, "it commits nothing");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn a_hub_that_can_store_no_report_is_not_ready_until_it_stores_one(database: &str) {
    let hub = Hub::start(config(database)).await;
    hub.store("car-1", 1..=2).await;
    script(database, "ALTER TABLE sums_hour RENAME TO hidden").await;
    assert_unavailable(&hub, "car-2").await;
    let page = assert_stays_not_ready(&hub, 5).await;
    let why = page["reasons"]["database"].as_str().unwrap();
    assert!(why.contains("sums_hour"), "{why}");
    script(database, "ALTER TABLE hidden RENAME TO sums_hour").await;
    hub.store("car-2", 1..=2).await;
    let page = hub.get("/readyz").await;
    assert_eq!(page["ready"], true, "{page}");
    hub.assert_metrics(&["albireo_hub_ready 1"]).await;
    hub.stop().await;
}

on_both!(a_hub_that_can_store_no_report_is_not_ready_until_it_stores_one);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_hub_with_a_damaged_page_is_not_ready() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hub.db");
    let url = format!("sqlite:{}", file.display());
    let hub = Hub::start(config(&url)).await;
    hub.store("car-1", 1..=50).await;
    hub.stop().await;
    let page: u32 = {
        let connection = rusqlite::Connection::open(&file).unwrap();
        let text = "SELECT rootpage FROM sqlite_schema WHERE name = 'report_ids'";
        connection.query_row(text, [], |row| row.get(0)).unwrap()
    };
    let mut bytes = fs::read(&file).unwrap();
    let begin = (page as usize - 1) * 4096;
    bytes[begin..begin + 64].fill(0xa5);
    fs::write(&file, bytes).unwrap();
    let hub = Hub::start(config(&url)).await;
    assert_unavailable(&hub, "car-2").await;
    let page = assert_stays_not_ready(&hub, 5).await;
    let why = page["reasons"]["database"].as_str().unwrap();
    assert!(why.contains("malformed"), "{why}");
    hub.stop().await;
}

#[rstest]
#[case::deleted(false)]
#[case::replaced(true)]
#[tokio::test(flavor = "multi_thread")]
async fn a_database_file_that_was_deleted_or_replaced_acknowledges_nothing(#[case] replace: bool) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hub.db");
    let url = format!("sqlite:{}", file.display());
    let hub = Hub::start(config(&url)).await;
    hub.store("car-1", 1..=3).await;
    if replace {
        let other = folder.path().join("other.db");
        fs::copy(&file, &other).unwrap();
        fs::rename(other, &file).unwrap();
    } else {
        for entry in fs::read_dir(folder.path()).unwrap() {
            fs::remove_file(entry.unwrap().path()).unwrap();
        }
    }
    let page = hub.until("/readyz", |page| page["ready"] == false).await;
    let why = page["reasons"]["database"].as_str().unwrap();
    assert!(why.contains("was deleted or replaced"), "{why}");
    assert_unavailable(&hub, "car-1").await;
    // It ends in order, and a new start uses what is there, or creates a new file.
    let hub = hub.restart().await;
    hub.store("car-1", 4..=5).await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_second_hub_on_one_file_says_so_and_takes_over() {
    let folder = tempfile::tempdir().unwrap();
    let url = format!("sqlite:{}", folder.path().join("hub.db").display());
    let one = Hub::start(config(&url)).await;
    one.store("car-1", 1..=2).await;
    let mut second = config(&url);
    second.zenoh.listen = vec![format!("tcp/127.0.0.1:{}", free_port())];
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let http = format!("http://{}", listener.local_addr().unwrap());
    let shutdown = tokio_util::sync::CancellationToken::new();
    let stop = shutdown.clone();
    let two = tokio::spawn(async move { albireo_hub::run(&second, listener, stop).await });
    let ready = async || -> Value {
        let response = reqwest::get(format!("{http}/readyz")).await.unwrap();
        response.json().await.unwrap()
    };
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let page = ready().await;
        let why = page["reasons"]["database"].as_str().unwrap_or_default();
        assert_eq!(page["ready"], false, "{page}");
        if why.contains("is in use by another hub") {
            break;
        }
        assert!(Instant::now() < until, "{page}");
    }
    one.stop().await;
    while ready().await["ready"] == false {
        assert!(Instant::now() < until, "it does not take over");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    shutdown.cancel();
    two.await.unwrap().unwrap();
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_frozen_server_makes_a_hub_not_ready_within_seconds() {
    let server = Postgres::start();
    let hub = Hub::start(config(&server.url())).await;
    hub.store("car-1", 1..=2).await;
    server.signal("-STOP");
    let frozen = Instant::now();
    let page = hub.until("/readyz", |page| page["ready"] == false).await;
    let waited = frozen.elapsed();
    // The hub does not wait for the end of the 50 s that the server has to answer.
    assert!(waited < Duration::from_secs(20), "{waited:?}");
    let why = page["reasons"]["database"].as_str().unwrap();
    assert!(why.contains("waits for the database"), "{why}");
    server.signal("-CONT");
    hub.until("/readyz", |page| page["ready"] == true).await;
    hub.store("car-1", 3..=4).await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_server_that_became_read_only_makes_a_hub_not_ready() {
    let server = Postgres::start();
    let hub = Hub::start(config(&server.url())).await;
    hub.store("car-1", 1..=2).await;
    set_system(
        &server.url(),
        &["ALTER SYSTEM SET default_transaction_read_only = on"],
    )
    .await;
    assert_unavailable(&hub, "car-2").await;
    // It tries again twice a second: what succeeds without writing must not count.
    for _ in 0..20 {
        let page = hub.get("/readyz").await;
        assert_eq!(page["ready"], false, "{page}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    set_system(
        &server.url(),
        &[
            "SET default_transaction_read_only = off",
            "ALTER SYSTEM RESET default_transaction_read_only",
        ],
    )
    .await;
    while !matches!(hub.deliver(&batch("car-2", 1..=2)).await, Reply::Answer(_)) {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    hub.until("/readyz", |page| page["ready"] == true).await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_revoked_rights_make_a_hub_not_ready_until_they_are_back() {
    let server = Postgres::start();
    let as_owner = server.url();
    script(&as_owner, "CREATE ROLE fleet LOGIN").await;
    script(&as_owner, "CREATE DATABASE fleet OWNER fleet").await;
    let (address, _) = as_owner.rsplit_once('/').unwrap();
    let as_fleet = format!("{}/fleet", address.replace("hub@", "fleet@"));
    let hub = Hub::start(config(&as_fleet)).await;
    hub.store("car-1", 1..=2).await;
    script(&as_fleet, "REVOKE INSERT ON clips FROM fleet").await;
    assert_unavailable(&hub, "car-2").await;
    let page = assert_stays_not_ready(&hub, 5).await;
    let why = page["reasons"]["database"].as_str().unwrap();
    assert!(why.contains("permission denied for table clips"), "{why}");
    script(&as_fleet, "GRANT INSERT ON clips TO fleet").await;
    hub.store("car-2", 1..=2).await;
    let page = hub.get("/readyz").await;
    assert_eq!(page["ready"], true, "{page}");
    hub.stop().await;
}

/// Changes a setting of the server for all sessions.
async fn set_system(url: &str, statements: &[&'static str]) {
    use sqlx::{Connection as _, Executor as _};
    let mut connection = sqlx::PgConnection::connect(url).await.unwrap();
    for statement in statements.iter().chain(&["SELECT pg_reload_conf()"]) {
        connection.execute(sqlx::raw_sql(*statement)).await.unwrap();
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_number_that_one_node_invents_is_not_the_fleet_s() {
    let hub = Hub::fresh().await;
    hub.store("car-1", 1..=2).await;
    let mut jump = batch("evil", 1..=2);
    jump.reports[1].count = Some(1 << 53);
    hub.deliver(&jump).await.assert_stored();
    hub.assert_metrics(&["albireo_hub_reports_missing_total 1000000\n"]).await;
    let node = hub.get("/api/v1/nodes/evil").await;
    assert_eq!(node["reports"]["missing"], 32_000_000);
    let page = hub.get("/api/v1/nodes").await;
    assert_eq!(names(&page), ["car-1", "evil"]);
    hub.stop().await;
}
