//! Reports are taken exactly once.

use crate::support::postgres::Postgres;
use crate::support::{
    Hub, Said, batch, config, deliver, instance, now_ns, report, send, sqlite, uplink,
};
use albireo_wire::{BatchCompression, RefusalReason};

async fn taken_once(database: &str) {
    let hub = Hub::start(config(database)).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    let first = batch("car-1", &instance('a'), 0..=7, start);
    assert_eq!(deliver(&session, &first).await, Said::Stored(7));
    // The answer was lost: the same comes again, then in another cut, then with more behind it.
    assert_eq!(deliver(&session, &first).await, Said::Stored(7));
    let cut = batch("car-1", &instance('a'), 2..=4, start);
    assert_eq!(deliver(&session, &cut).await, Said::Stored(4));
    let more = batch("car-1", &instance('a'), 5..=11, start);
    assert_eq!(deliver(&session, &more).await, Said::Stored(11));

    let clips = hub.get("/api/v1/clips?node=car-1&limit=1000").await;
    let mut numbers: Vec<u64> = clips["clips"]
        .as_array()
        .unwrap()
        .iter()
        .map(|clip| clip["report"].as_u64().unwrap())
        .collect();
    numbers.sort_unstable();
    assert_eq!(numbers, (0..=11).collect::<Vec<_>>());
    let node = hub.get("/api/v1/nodes/car-1").await;
    assert_eq!(node["instances"][0]["reports"], 12);
    assert_eq!(node["instances"][0]["missing"], 0);
    session.close().await.unwrap();

    // What was acknowledged is there after a restart.
    let again = hub.config.clone();
    hub.stop().await;
    let hub = Hub::start(again).await;
    let clips = hub.get("/api/v1/clips?node=car-1&limit=1000").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 12);
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_that_comes_again_in_any_cut_is_stored_once() {
    let folder = tempfile::tempdir().unwrap();
    taken_once(&sqlite(folder.path())).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_batch_that_comes_again_in_any_cut_is_stored_once() {
    let server = Postgres::start();
    taken_once(&server.url()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gap_is_counted_and_named_and_filled_when_its_reports_come_late() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    let one = instance('b');
    assert_eq!(
        deliver(&session, &batch("car-2", &one, 0..=1, start)).await,
        Said::Stored(1)
    );
    assert_eq!(
        deliver(&session, &batch("car-2", &one, 5..=6, start)).await,
        Said::Stored(6)
    );
    let node = hub.get("/api/v1/nodes/car-2").await;
    assert_eq!(node["instances"][0]["missing"], 3);
    assert_eq!(
        deliver(&session, &batch("car-2", &one, 2..=4, start)).await,
        Said::Stored(4)
    );
    let node = hub.get("/api/v1/nodes/car-2").await;
    assert_eq!(node["instances"][0]["reports"], 7);
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_report_that_cannot_be_read_is_set_aside_with_its_cause_and_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    let mut wrong = batch("car-3", &instance('c'), 0..=2, start);
    wrong.reports[1].energy.joules = Some(-1.0);
    let mut json = serde_json::to_value(&wrong).unwrap();
    json["reports"][2] = serde_json::json!({"v": 1, "report": 2, "hello": "\u{0}"});
    let json = json.to_string();
    let payload = BatchCompression::Quick.compress(json.as_bytes()).unwrap();
    assert_eq!(
        send(&session, "car-3", payload.clone()).await,
        Said::Stored(2)
    );
    // Again: known, and not set aside twice.
    assert_eq!(send(&session, "car-3", payload).await, Said::Stored(2));

    let aside = hub.get("/api/v1/set-aside").await;
    let aside = aside["reports"].as_array().unwrap();
    assert_eq!(aside.len(), 2, "{aside:?}");
    let causes: Vec<&str> = aside
        .iter()
        .map(|one| one["cause"].as_str().unwrap())
        .collect();
    assert!(
        causes
            .iter()
            .any(|cause| cause.contains("energy.joules is -1")),
        "{causes:?}"
    );
    assert!(
        causes.iter().any(|cause| cause.contains("missing field")),
        "{causes:?}"
    );
    let clips = hub.get("/api/v1/clips?node=car-3").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 1);

    // What is no batch at all is refused, and not acknowledged.
    match send(&session, "car-3", b"nonsense".to_vec()).await {
        Said::Refused(refusal) => assert_eq!(refusal.reason, RefusalReason::Unreadable),
        said => panic!("{said:?}"),
    }
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restored_disk_is_named_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    let one = instance('d');
    assert_eq!(
        deliver(&session, &batch("car-4", &one, 0..=9, start)).await,
        Said::Stored(9)
    );
    // The disk went back to report 6, and new clips took the numbers from 7 on.
    let mut back = batch("car-4", &one, 5..=12, start);
    for report in &mut back.reports[2..] {
        report.started_ns += 7_000_000_000;
    }
    assert_eq!(deliver(&session, &back).await, Said::Stored(6));
    back.reports.drain(..2);
    back.first = 7;
    match deliver(&session, &back).await {
        Said::Refused(refusal) => {
            assert_eq!(refusal.reason, RefusalReason::Conflict);
            assert!(
                refusal.detail.contains("went back in time"),
                "{}",
                refusal.detail
            );
        }
        said => panic!("{said:?}"),
    }
    // The node makes a new instance, numbers what waits anew, and sends it again.
    back.instance = instance('e');
    for (number, report) in (0..).zip(&mut back.reports) {
        report.report = number;
    }
    (back.first, back.last) = (0, 5);
    assert_eq!(deliver(&session, &back).await, Said::Stored(5));
    let clips = hub.get("/api/v1/clips?node=car-4&limit=1000").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 16);
    let node = hub.get("/api/v1/nodes/car-4").await;
    assert_eq!(node["instances"].as_array().unwrap().len(), 2);
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_instance_on_two_machines_is_named_and_not_merged() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    let mut here = batch("car-5", &instance('f'), 0..=3, start);
    here.machine = Some("aaaa".into());
    assert_eq!(deliver(&session, &here).await, Said::Stored(3));
    // The clone has the same reports up to 3, which are known, and others from there.
    let mut clone = batch("car-5", &instance('f'), 2..=5, start);
    clone.machine = Some("bbbb".into());
    assert_eq!(deliver(&session, &clone).await, Said::Stored(3));
    clone.reports.drain(..2);
    clone.first = 4;
    match deliver(&session, &clone).await {
        Said::Refused(refusal) => {
            assert_eq!(refusal.reason, RefusalReason::Conflict);
            assert!(
                refusal.detail.contains("its state was copied"),
                "{}",
                refusal.detail
            );
        }
        said => panic!("{said:?}"),
    }
    let mut more = batch("car-5", &instance('f'), 4..=5, start + 1);
    more.machine = Some("aaaa".into());
    assert_eq!(deliver(&session, &more).await, Said::Stored(5));
    let clips = hub.get("/api/v1/clips?node=car-5").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 6);
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_whose_clock_is_years_off_loses_nothing_and_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let hub = Hub::start(config(&sqlite(folder.path()))).await;
    let session = uplink(&hub.zenoh).await;
    let mut off = batch("car-6", &instance('1'), 0..=1, 0);
    off.reports[1] = report("car-6", 1, 0);
    off.reports[1].started_ns = u64::MAX;
    assert_eq!(deliver(&session, &off).await, Said::Stored(1));
    assert_eq!(deliver(&session, &off).await, Said::Stored(1));
    let clips = hub.get("/api/v1/clips?node=car-6").await;
    let clips = clips["clips"].as_array().unwrap();
    assert_eq!(clips.len(), 2);
    assert!(
        clips
            .iter()
            .all(|clip| clip["at_ms"] == clip["received_ms"])
    );
    let metrics = reqwest::get(format!("{}/metrics", hub.http)).await.unwrap();
    let metrics = metrics.text().await.unwrap();
    assert!(
        metrics.contains("albireo_hub_clock_off_total 2"),
        "{metrics}"
    );
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_database_that_is_gone_holds_acknowledgements_back_and_loses_nothing() {
    let server = Postgres::start();
    let hub = Hub::start(config(&server.url())).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    let one = instance('2');
    assert_eq!(
        deliver(&session, &batch("car-7", &one, 0..=1, start)).await,
        Said::Stored(1)
    );
    server.kill();
    match deliver(&session, &batch("car-7", &one, 2..=3, start)).await {
        Said::Refused(refusal) => {
            assert_eq!(refusal.reason, RefusalReason::Unavailable);
            assert!(refusal.retry_after_ms.is_some());
        }
        said => panic!("{said:?}"),
    }
    hub.until("/readyz", |answer| answer["ready"] == false)
        .await;
    server.up();
    loop {
        match deliver(&session, &batch("car-7", &one, 2..=3, start)).await {
            Said::Stored(number) => break assert_eq!(number, 3),
            Said::Refused(refusal) => assert_eq!(refusal.reason, RefusalReason::Unavailable),
            Said::Nothing => unreachable!(),
        }
    }
    hub.until("/readyz", |answer| answer["ready"] == true).await;
    let clips = hub.get("/api/v1/clips?node=car-7").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 4);
    session.close().await.unwrap();
    hub.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_two_hubs_on_one_database_store_a_report_once() {
    let server = Postgres::start();
    let one = Hub::start(config(&server.url())).await;
    let two = Hub::start(config(&server.url())).await;
    let (to_one, to_two) = (uplink(&one.zenoh).await, uplink(&two.zenoh).await);
    let start = now_ns() - 3_600_000_000_000;
    let name = instance('3');
    for first in (1..400).step_by(20) {
        let same = batch("car-8", &name, first..=first + 19, start);
        let (here, there) = tokio::join!(deliver(&to_one, &same), deliver(&to_two, &same));
        assert_eq!(
            (here, there),
            (Said::Stored(first + 19), Said::Stored(first + 19))
        );
    }
    let clips = two.get("/api/v1/clips?node=car-8&limit=1000").await;
    assert_eq!(clips["clips"].as_array().unwrap().len(), 400);
    let energy = one.get("/api/v1/energy?by=node").await;
    let clips: i64 = energy["groups"]
        .as_array()
        .unwrap()
        .iter()
        .map(|group| group["clips"].as_i64().unwrap())
        .sum();
    assert_eq!(clips, 400);
    to_one.close().await.unwrap();
    to_two.close().await.unwrap();
    one.stop().await;
    two.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_that_would_be_written_too_late_is_answered_busy_and_the_others_are_stored() {
    use sqlx::Connection as _;
    sqlx::any::install_default_drivers();
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(&sqlite(folder.path()));
    config.database.timeout_ms = 600_000;
    config.ingest.busy_after_ms = 20;
    let hub = Hub::start(config.clone()).await;
    let session = uplink(&hub.zenoh).await;
    let start = now_ns() - 3_600_000_000_000;
    // Somebody else writes, and the hub's commit waits.
    let mut other = sqlx::AnyConnection::connect(&config.database.url)
        .await
        .unwrap();
    sqlx::query("BEGIN IMMEDIATE")
        .execute(&mut other)
        .await
        .unwrap();
    let mut under_way = tokio::task::JoinSet::new();
    let busy = 'told: {
        for number in 0..1000 {
            let batch = batch(&format!("car-{number}"), &instance('c'), 0..=1, start);
            let session = session.clone();
            under_way.spawn(async move { deliver(&session, &batch).await });
            let answer = std::time::Duration::from_millis(100);
            if let Ok(Some(said)) = tokio::time::timeout(answer, under_way.join_next()).await {
                break 'told said.unwrap();
            }
        }
        panic!("no batch was answered");
    };
    let Said::Refused(refusal) = busy else {
        panic!("{busy:?}")
    };
    assert_eq!(refusal.reason, RefusalReason::Busy);
    assert_eq!(refusal.retry_after_ms, Some(config.ingest.busy_retry_ms));
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    // What was taken is written; and then batches are taken again.
    while let Some(said) = under_way.join_next().await {
        let said = said.unwrap();
        let refused =
            matches!(&said, Said::Refused(refusal) if refusal.reason == RefusalReason::Busy);
        assert!(refused || said == Said::Stored(1), "{said:?}");
    }
    let last = batch("car-last", &instance('d'), 0..=1, start);
    assert_eq!(deliver(&session, &last).await, Said::Stored(1));
    session.close().await.unwrap();
    hub.stop().await;
}
