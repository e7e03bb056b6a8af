//! A fake hub: it commits reports to a synced file and then answers, unless it is set to misbehave.

use crate::support::{until, zenoh_client, zenoh_session};
use albireo_wire::{RefusalReason, ReportAnswer, ReportBatch, ReportRefusal, VERSION};
use std::collections::BTreeSet;
use std::io::Write;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use uuid::Uuid;
use zenoh::query::Query;
use zenoh::{Session, Wait};

/// The behaviour of a hub.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Manner {
    /// Commits, then answers.
    Honest,
    /// Accepts batches, keeps nothing and never answers.
    TakesAndSaysNothing,
    /// Commits and never answers.
    CommitsAndSaysNothing,
    /// Refuses, and asks for a retry later.
    Busy { retry_after_ms: u64 },
}

struct Inner {
    manner: Manner,
    file: tempfile::NamedTempFile,
    /// The ids of stored reports.
    known: BTreeSet<Uuid>,
    /// The counts of stored reports, in storage order.
    stored: Vec<u64>,
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
        let session = zenoh_client(endpoint).await;
        let inner = Arc::new(Mutex::new(Inner {
            manner,
            file: tempfile::NamedTempFile::new().unwrap(),
            known: BTreeSet::new(),
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

    /// Stops as a killed process does, without answers to the queries it holds.
    pub(super) async fn die(self) {
        self.session.close().await.unwrap();
        self.inner.lock().unwrap().held.clear();
    }

    async fn until(&self, what: &str, done: impl Fn(&Inner) -> bool) {
        until(what, async || done(&self.inner.lock().unwrap())).await;
    }

    pub(super) async fn wait_for(&self, reports: usize) {
        let done = |inner: &Inner| inner.stored.len() >= reports;
        self.until("reports", done).await;
    }

    pub(super) async fn wait_for_asked(&self, times: usize) {
        let done = |inner: &Inner| inner.asked.len() >= times;
        self.until("queries", done).await;
    }

    /// The times between batches.
    pub(super) fn pauses(&self) -> Vec<Duration> {
        let inner = self.inner.lock().unwrap();
        inner.asked.windows(2).map(|two| two[1] - two[0]).collect()
    }

    /// Asserts that exactly the first `reports` reports are stored, each once and in order.
    pub(super) fn assert_gapless(&self, reports: usize) {
        let inner = self.inner.lock().unwrap();
        assert_eq!(inner.stored, (1..=reports as u64).collect::<Vec<_>>());
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
                let refusal = serde_json::to_vec(&refusal).unwrap();
                query.reply_err(refusal).wait().unwrap();
            }
            Manner::CommitsAndSaysNothing => {
                self.commit(&query);
                self.held.push(query);
            }
            Manner::Honest => {
                self.commit(&query);
                let answer = serde_json::to_vec(&ReportAnswer::new(Uuid::max())).unwrap();
                let reply = query.reply(query.key_expr().clone(), answer);
                reply.wait().unwrap();
            }
        }
    }

    fn commit(&mut self, query: &Query) {
        let payload = query.payload().unwrap().to_bytes();
        assert!(
            payload.len() < 1 << 20,
            "a batch is below 1 MiB on the wire"
        );
        for report in ReportBatch::from_payload(&payload).unwrap().reports {
            if self.known.insert(report.id) {
                writeln!(self.file, "{} {}", report.id, report.clip).unwrap();
                self.stored.push(report.count.unwrap());
            }
        }
        self.file.as_file().sync_data().unwrap();
    }
}

/// A router in this process.
pub(super) async fn router(endpoint: &str) -> Session {
    let settings = [
        ("mode", "router".into()),
        ("listen/endpoints", vec![endpoint].into()),
    ];
    zenoh_session(&settings).await.unwrap()
}
