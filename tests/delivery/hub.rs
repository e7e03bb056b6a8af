//! A stand-in for a hub: commits what it is sent to a file, synced, and answers then. Its manners can be bad.

use crate::support::PATIENCE;
use albireo_wire::{
    ClipReport, ReceivedBatch, RefusalReason, ReportAnswer, ReportRefusal, VERSION, read,
};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use zenoh::query::Query;
use zenoh::{Session, Wait};

/// How a hub behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Manner {
    /// Commits, then answers.
    Honest,
    /// Takes batches, keeps nothing, never answers.
    TakesAndSaysNothing,
    /// Commits and never answers.
    CommitsAndSaysNothing,
    /// Refuses for a while.
    Busy { retry_after_ms: u64 },
}

struct Inner {
    manner: Manner,
    file: tempfile::NamedTempFile,
    /// Last number stored of each instance.
    cursors: BTreeMap<String, u64>,
    /// Instance, number and clip, in the order stored.
    stored: Vec<(String, u64, String)>,
    asked: Vec<Instant>,
    /// Queries kept unanswered.
    held: Vec<Query>,
}

pub(super) struct Hub {
    session: Session,
    inner: Arc<Mutex<Inner>>,
}

impl Hub {
    pub(super) async fn start(endpoint: &str, manner: Manner) -> Self {
        let session = albireo::cli::replay::open_session(&[endpoint.to_owned()], &[], PATIENCE)
            .await
            .unwrap();
        let inner = Arc::new(Mutex::new(Inner {
            manner,
            file: tempfile::NamedTempFile::new().unwrap(),
            cursors: BTreeMap::new(),
            stored: Vec::new(),
            asked: Vec::new(),
            held: Vec::new(),
        }));
        let of_callback = Arc::clone(&inner);
        session
            .declare_queryable("albireo/@report/*")
            .callback(move |query| of_callback.lock().unwrap().take(query))
            .background()
            .await
            .unwrap();
        Self { session, inner }
    }

    pub(super) fn become_honest(&self) {
        self.inner.lock().unwrap().manner = Manner::Honest;
    }

    /// Ends as a killed process does: without an answer to what it holds.
    pub(super) async fn die(self) {
        self.session.close().await.unwrap();
        self.inner.lock().unwrap().held.clear();
    }

    async fn until(&self, what: &str, done: impl Fn(&Inner) -> bool) {
        let start = Instant::now();
        while !done(&self.inner.lock().unwrap()) {
            let (stored, asked) = {
                let inner = self.inner.lock().unwrap();
                (inner.stored.len(), inner.asked.len())
            };
            assert!(
                start.elapsed() < PATIENCE,
                "{what}: {stored} stored, asked {asked} times"
            );
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    pub(super) async fn wait_for(&self, reports: usize) {
        self.until("reports", |inner| inner.stored.len() >= reports)
            .await;
    }

    pub(super) async fn wait_for_asked(&self, times: usize) {
        self.until("queries", |inner| inner.asked.len() >= times)
            .await;
    }

    /// Time between two batches.
    pub(super) fn pauses(&self) -> Vec<Duration> {
        let inner = self.inner.lock().unwrap();
        inner.asked.windows(2).map(|two| two[1] - two[0]).collect()
    }

    /// Exactly the numbers from 1 of one instance, each once, no clip twice.
    pub(super) fn assert_gapless(&self, reports: usize) {
        let inner = self.inner.lock().unwrap();
        let numbers: Vec<u64> = inner.stored.iter().map(|(_, number, _)| *number).collect();
        assert_eq!(numbers, (1..=reports as u64).collect::<Vec<_>>());
        assert_eq!(inner.cursors.len(), 1, "one instance");
    }
}

impl Inner {
    fn take(&mut self, query: Query) {
        self.asked.push(Instant::now());
        match self.manner {
            Manner::TakesAndSaysNothing => self.held.push(query),
            Manner::Busy { retry_after_ms } => {
                let refusal = ReportRefusal {
                    v: VERSION,
                    reason: RefusalReason::Busy,
                    detail: "too much to do".to_owned(),
                    retry_after_ms: Some(retry_after_ms),
                };
                query
                    .reply_err(serde_json::to_vec(&refusal).unwrap())
                    .wait()
                    .unwrap();
            }
            Manner::CommitsAndSaysNothing => {
                self.commit(&query);
                self.held.push(query);
            }
            Manner::Honest => {
                let stored = self.commit(&query);
                let answer = serde_json::to_vec(&ReportAnswer::new(stored, None)).unwrap();
                query
                    .reply(query.key_expr().clone(), answer)
                    .wait()
                    .unwrap();
            }
        }
    }

    fn commit(&mut self, query: &Query) -> u64 {
        let payload = query.payload().unwrap().to_bytes();
        assert!(
            payload.len() < 1 << 20,
            "a batch is below 1 MiB on the wire"
        );
        let batch = ReceivedBatch::from_payload(&payload).unwrap();
        let cursor = self.cursors.entry(batch.instance.clone()).or_default();
        for raw in &batch.reports {
            let report: ClipReport = read(raw.get().as_bytes()).unwrap();
            if report.report > *cursor {
                *cursor = report.report;
                writeln!(
                    self.file,
                    "{} {} {}",
                    batch.instance, report.report, report.clip
                )
                .unwrap();
                self.stored
                    .push((batch.instance.clone(), report.report, report.clip));
            }
        }
        self.file.as_file().sync_data().unwrap();
        *cursor
    }
}

/// A router in this process.
pub(super) async fn router(endpoint: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", serde_json::json!("router")),
        ("listen/endpoints", serde_json::json!([endpoint])),
        ("scouting/multicast/enabled", serde_json::json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// Writes the last report of the file `times` times more, under the numbers that follow.
pub(super) fn multiply(file: &Path, times: u64) {
    let db = rusqlite::Connection::open(file).unwrap();
    db.execute(
        "WITH RECURSIVE more(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM more WHERE n < ?1)
         INSERT INTO report (instance, number, kept_ns, json)
         SELECT instance, number + n, kept_ns, json FROM more, report
         WHERE number = (SELECT max(number) FROM report)",
        [times as i64],
    )
    .unwrap();
    db.execute("UPDATE instance SET last = last + ?1", [times as i64])
        .unwrap();
}
