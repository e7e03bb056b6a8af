//! Reports are stored exactly once.

use crate::support::postgres::Postgres;
use crate::support::{
    Hub, Reply, YESTERDAY, assert_has, batch, batch_of, config, id, now_ns, number, on_both, script,
};
use albireo_wire::{BatchCompression, RefusalReason, ReportBatch};
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use rstest::rstest;
use serde_json::json;
use uuid::Uuid;

async fn a_batch_sent_again_in_any_split_is_stored_once(database: &str) {
    let hub = Hub::start(config(database)).await;
    let first = batch("car-1", 1..=8);
    let answer = hub.deliver(&first).await.answer();
    assert!(answer.refused.is_empty(), "{answer:?}");
    assert!(answer.missing.is_empty(), "{answer:?}");
    // The answer was lost: the same reports come again, then split differently, then with more behind them.
    for numbers in [1..=8, 3..=5, 6..=12] {
        let again = hub.deliver(&batch("car-1", numbers)).await.answer();
        assert!(again.refused.is_empty(), "{again:?}");
    }
    // One batch has the same report twice.
    let mut twice = batch("car-1", 12..=13);
    twice.reports.push(twice.reports[1].clone());
    hub.deliver(&twice).await.assert_stored();
    let numbers: Vec<u64> = (1..=13).collect();
    assert_eq!(hub.counts("car-1").await, numbers);
    let node = hub.get("/api/v1/nodes/car-1").await;
    assert_has(&node["reports"], &json!({"stored": 13, "missing": 0}));
    assert_eq!(hub.clips_with_energy().await, 13);

    // Acknowledged reports are there after a restart, and are recognised when they come again.
    let hub = hub.restart().await;
    hub.deliver(&first).await.assert_stored();
    assert_eq!(hub.counts("car-1").await, numbers);
    hub.stop().await;
}

on_both!(a_batch_sent_again_in_any_split_is_stored_once);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn an_unreadable_report_is_set_aside_with_its_cause_and_rejected() {
    let hub = Hub::fresh().await;
    let mut wrong = batch("car-3", 1..=3);
    wrong.reports[1].energy.joules = Some(-1.0);
    let unread = wrong.reports[2].id;
    let mut json = serde_json::to_value(&wrong).unwrap();
    json["reports"][2] = json!({"v": 1, "id": unread, "hello": "\u{0}"});
    // A frame compressed without the dictionary can be read with it.
    let frame = zstd::encode_all(json.to_string().as_bytes(), 3).unwrap();
    let payload = [&[albireo_wire::REPORT_DICTIONARY], &frame[..]].concat();
    let answer = hub.send("car-3", payload).await.answer();
    let refused: Vec<Uuid> = answer.refused.iter().map(|one| one.id).collect();
    assert_eq!(refused, [wrong.reports[1].id, unread]);

    let page = hub.get("/api/v1/set-aside").await;
    let aside = page["reports"].as_array().unwrap();
    assert_eq!(aside.len(), 2, "{aside:?}");
    for expected in ["energy_uj: -1", "missing field"] {
        let mut causes = aside.iter().map(|one| one["cause"].as_str().unwrap());
        assert!(causes.any(|cause| cause.contains(expected)), "{aside:?}");
    }
    assert_eq!(hub.counts("car-3").await, [1]);

    // A payload that is no batch is refused and not acknowledged.
    match hub.send("car-3", b"nonsense".to_vec()).await {
        Reply::Refused(refusal) => assert_eq!(refusal.reason, RefusalReason::Unreadable),
        reply => panic!("{reply:?}"),
    }
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_node_with_restored_state_or_a_wrong_clock_loses_and_duplicates_nothing_and_is_shown() {
    let hub = Hub::fresh().await;
    hub.store("car-4", 1..=10).await;
    // The disk was restored as of report 6: waiting reports come again, and new clips are counted from 7 on.
    let mut back = batch("car-4", 5..=6);
    let counted_again = batch_of("car-4", 7..=13, *YESTERDAY + 1_000_000);
    back.reports.extend(counted_again.reports);
    hub.deliver(&back).await.assert_stored();
    let mut expected: Vec<u64> = (1..=10).chain(7..=13).collect();
    expected.sort_unstable();
    assert_eq!(hub.counts("car-4").await, expected);
    let node = hub.get("/api/v1/nodes/car-4").await;
    assert_has(&node["reports"], &json!({"resets": 1, "missing": 0}));

    // A clock of 1970, and one of the far future.
    let mut off = batch_of("car-6", 1..=2, 0);
    off.reports[1].started_ns = u64::MAX;
    off.reports[1].id = id("car-6", 2, u64::MAX);
    hub.deliver(&off).await.assert_stored();
    hub.deliver(&off).await.assert_stored();
    let page = hub.get("/api/v1/clips?node=car-6").await;
    let clips = page["clips"].as_array().unwrap();
    assert_eq!(clips.len(), 2);
    for clip in clips {
        assert_eq!(clip["at_ms"], clip["received_ms"]);
    }
    hub.assert_metrics(&["albireo_hub_clock_off_total 2"]).await;
    hub.stop().await;
}

async fn a_hub_restored_from_a_backup_asks_each_node_for_what_it_lost(database: &str) {
    use sqlx::Connection as _;
    let hub = Hub::start(config(database)).await;
    let first = batch("car-1", 1..=5);
    hub.deliver(&first).await.assert_stored();
    hub.stop().await;
    let backup = if let Some(file) = database.strip_prefix("sqlite:") {
        let connection = rusqlite::Connection::open(file).unwrap();
        let copy = format!("VACUUM INTO '{file}.backup'");
        connection.execute_batch(&copy).unwrap();
        format!("{database}.backup")
    } else {
        // A database is copied over a connection to another one.
        let other = |name: &str| database.replace("/postgres", &format!("/{name}"));
        let mut connection = sqlx::PgConnection::connect(&other("template1")).await.unwrap();
        let copy = sqlx::query("CREATE DATABASE backup TEMPLATE postgres");
        copy.execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        other("backup")
    };

    // Reports stored after the copy are lost with the database, all of car-2 among them.
    let hub = Hub::start(config(database)).await;
    hub.store("car-1", 6..=10).await;
    hub.store("car-2", 1..=4).await;
    hub.stop().await;

    let hub = Hub::start(config(&backup)).await;
    // Of the second node this database has no earlier report, so that it misses none.
    for (node, next, lost, missing) in [("car-1", 11, (6, 10), 5), ("car-2", 5, (1, 4), 0)] {
        // The next report shows that earlier ones are missing; the hub repeats an answer that was lost.
        for _ in 0..2 {
            let answer = hub.deliver(&batch(node, next..=next)).await.answer();
            assert_eq!(answer.missing, [lost]);
        }
        let path = format!("/api/v1/nodes/{node}");
        assert_eq!(hub.get(&path).await["reports"]["missing"], missing);
        let (first, last) = lost;
        let sent = batch(node, first..=last);
        for _ in 0..2 {
            let answer = hub.deliver(&sent).await.answer();
            assert!(answer.refused.is_empty(), "{answer:?}");
            assert!(answer.missing.is_empty(), "{answer:?}");
        }
        let all: Vec<u64> = (1..=next).collect();
        assert_eq!(hub.counts(node).await, all);
        let shown = hub.get(&path).await;
        let expected = json!({"stored": next, "missing": 0, "resets": 0});
        assert_has(&shown["reports"], &expected);
    }
    assert_eq!(hub.clips_with_energy().await, 16);
    hub.stop().await;
}

on_both!(a_hub_restored_from_a_backup_asks_each_node_for_what_it_lost);

/// A report made `days` ago by a correct clock.
fn aged(node: &str, number: u64, days: u64) -> ReportBatch {
    let made = now_ns() - days * 86_400_000_000_000;
    let mut batch = batch_of(node, number..=number, made);
    batch.reports[0].id = id(node, number, made);
    batch
}

async fn ids_are_remembered_for_thirty_days_and_older_reports_are_rejected_by_id(database: &str) {
    let mut configuration = config(database);
    // Rows of clips are removed soon; the ids of stored reports are kept as long as a node may send them.
    configuration.history.clips_days = 1;
    let hub = Hub::start(configuration).await;
    for (number, days) in [(1, 0), (2, 1), (3, 29)] {
        let sent = aged("car-9", number, days);
        for _ in 0..2 {
            hub.deliver(&sent).await.assert_stored();
        }
    }
    let old = aged("car-9", 4, 32);
    let answer = hub.deliver(&old).await.answer();
    assert_eq!(answer.refused.len(), 1);
    assert_eq!(answer.refused[0].id, old.reports[0].id);
    let reason = &answer.refused[0].reason;
    assert!(reason.contains("older than 30 days"), "{reason}");
    let node = hub.get("/api/v1/nodes/car-9").await;
    assert_has(&node["reports"], &json!({"stored": 3, "refused": 1}));
    hub.stop().await;
}

on_both!(ids_are_remembered_for_thirty_days_and_older_reports_are_rejected_by_id);

/// Old events with numbers far apart, behind one of a clock that was ahead.
const OLD_EVENTS: &str = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 2500) \
     INSERT INTO events (id, at_ms, kind, detail) SELECT i * 2000, i, 'gap', '{}' FROM n; \
     INSERT INTO events (id, at_ms, kind, detail) VALUES (0, 4102444800000, 'gap', '{}')";

async fn old_rows_are_deleted_without_a_pause_however_far_apart_their_numbers_are(database: &str) {
    use albireo_hub::ingest::Recorder;
    use albireo_hub::store::Store;
    use albireo_service::clock::{DAY_MS, Now};
    let configured = config(database);
    let store = Store::open(&configured.database).await.unwrap();
    script(database, OLD_EVENTS).await;
    let deleting = tokio::task::spawn_blocking(move || {
        let begin = Now::system();
        let mut recorder = Recorder::new(&store, &configured.history, begin);
        // The clock is believed after a day.
        let now = Now {
            at: begin.at + std::time::Duration::from_secs(86_400),
            unix_ms: begin.unix_ms + DAY_MS,
            ..begin
        };
        // Each deletes at most a thousand rows.
        for _ in 0..3 {
            recorder.record(&[], &[], now).unwrap();
        }
    });
    deleting.await.unwrap();
    let left = number(database, "SELECT count(*) FROM events").await;
    assert_eq!(left, 1, "the one that is not old");
}

on_both!(old_rows_are_deleted_without_a_pause_however_far_apart_their_numbers_are);

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_a_lost_database_delays_acknowledgements_and_loses_nothing() {
    let server = Postgres::start();
    let hub = Hub::start(config(&server.url())).await;
    hub.store("car-7", 1..=2).await;
    let counts = || hub.counts("car-7");
    tokio::join!(counts(), counts(), counts(), counts());
    server.kill();
    match hub.deliver(&batch("car-7", 3..=4)).await {
        Reply::Refused(refusal) => {
            assert_eq!(refusal.reason, RefusalReason::Unavailable);
            assert!(refusal.retry_after_ms.is_some());
        }
        reply => panic!("{reply:?}"),
    }
    hub.until("/readyz", |page| page["ready"] == false).await;
    server.up();
    loop {
        match hub.deliver(&batch("car-7", 3..=4)).await {
            Reply::Answer(answer) => {
                assert!(answer.refused.is_empty(), "{answer:?}");
                break;
            }
            Reply::Refused(refusal) => assert_eq!(refusal.reason, RefusalReason::Unavailable),
            Reply::Nothing => unreachable!(),
        }
    }
    hub.until("/readyz", |answer| answer["ready"] == true).await;
    // The connections that were open before the kill work too.
    let (one, two, three, four) = tokio::join!(counts(), counts(), counts(), counts());
    for counts in [one, two, three, four] {
        assert_eq!(counts, [1, 2, 3, 4]);
    }
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_two_hubs_on_one_database_store_a_report_once() {
    let server = Postgres::start();
    let one = Hub::start(config(&server.url())).await;
    let two = Hub::start(config(&server.url())).await;
    for first in (1..400).step_by(20) {
        let same = batch("car-8", first..=first + 19);
        let (here, there) = tokio::join!(one.deliver(&same), two.deliver(&same));
        here.assert_stored();
        there.assert_stored();
    }
    assert_eq!(two.counts("car-8").await.len(), 400);
    assert_eq!(one.clips_with_energy().await, 400);
    one.stop().await;
    two.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_batch_that_would_be_written_too_late_is_answered_busy_and_the_others_are_stored() {
    let hub = Hub::fresh_with(|config| config.database.timeout_ms = 600_000).await;
    // Another connection writes, so the hub's commit waits.
    let file = hub.config.database.url.strip_prefix("sqlite:").unwrap();
    let other = rusqlite::Connection::open(file).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    let mut under_way = FuturesUnordered::new();
    let busy = 'answered: {
        for number in 0..1000 {
            let hub = &hub;
            let batch = batch(&format!("car-{number}"), 1..=2);
            under_way.push(async move { hub.deliver(&batch).await });
            let answer = std::time::Duration::from_millis(100);
            if let Ok(Some(said)) = tokio::time::timeout(answer, under_way.next()).await {
                break 'answered said;
            }
        }
        panic!("no batch was answered");
    };
    let Reply::Refused(refusal) = busy else {
        panic!("{busy:?}")
    };
    assert_eq!(refusal.reason, RefusalReason::Busy);
    assert_eq!(refusal.retry_after_ms, Some(2000));
    other.execute_batch("ROLLBACK").unwrap();
    // Accepted batches are written, and then batches are accepted again.
    while let Some(said) = under_way.next().await {
        match said {
            Reply::Answer(_) => {}
            Reply::Refused(refusal) => assert_eq!(refusal.reason, RefusalReason::Busy),
            Reply::Nothing => unreachable!(),
        }
    }
    drop(under_way);
    hub.store("car-last", 1..=2).await;
    hub.stop().await;
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL"]
async fn postgres_days_are_partitions_and_are_dropped_whole() {
    use albireo_hub::ingest::{Recorder, decode};
    use albireo_hub::store::Store;
    use albireo_service::clock::Now;
    use sqlx::Connection as _;
    let server = Postgres::start();
    let configured = config(&server.url());
    let store = Store::open(&configured.database).await.unwrap();
    let record = move |days_kept: u32, numbers: &'static [(u64, u64)]| {
        let store = store.clone();
        let mut history = configured.history.clone();
        history.clips_days = days_kept;
        tokio::task::spawn_blocking(move || {
            let now = Now::system();
            let mut recorder = Recorder::new(&store, &history, now);
            for (minute, (number, days)) in (0..).zip(numbers) {
                let payload = aged("car-1", *number, *days).to_payload(BatchCompression::Best);
                let batch = decode("car-1", &payload.unwrap().into(), now.unix_ms).unwrap();
                // Old rows are deleted once a minute.
                let at = now.at + std::time::Duration::from_secs(61) * minute;
                let recorded = recorder.record(&[batch], &[], Now { at, ..now });
                assert!(recorded.unwrap().answers[0].refused.is_empty());
            }
        })
    };
    let mut connection = sqlx::PgConnection::connect(&server.url()).await.unwrap();
    let mut rows = async |table: &str| -> Option<i64> {
        let text = format!("SELECT count(*) FROM {table}");
        sqlx::query_scalar(sqlx::AssertSqlSafe(text))
            .fetch_one(&mut connection)
            .await
            .ok()
    };
    let today = now_ns() / 86_400_000_000_000;
    record(14, &[(1, 0), (2, 5)]).await.unwrap();
    let new = format!("clips_{today}");
    let old = format!("clips_{}", today - 5);
    assert_eq!(rows(&new).await, Some(1));
    assert_eq!(rows(&old).await, Some(1));
    // The clock is believed once a node agrees with it.
    record(2, &[(3, 0), (4, 0)]).await.unwrap();
    assert_eq!(rows(&new).await, Some(3));
    assert_eq!(rows(&old).await, None, "the partition is gone");
    for table in ["clips_other", "report_ids_other", "sums_5m_other"] {
        assert_eq!(rows(table).await, Some(0), "{table}");
    }
    assert_eq!(rows("report_ids").await, Some(4));
    // A clip of a day that is no longer kept counts, and is removed by itself.
    record(2, &[(5, 4), (6, 0)]).await.unwrap();
    assert_eq!(rows("clips").await, Some(4));
    assert_eq!(rows("report_ids").await, Some(6));
}
