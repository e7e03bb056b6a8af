//! A fake hub: it keeps reports and then answers, unless it is set to misbehave.

use crate::support::{until, zenoh_client, zenoh_session};
use albireo_wire::{RefusalReason, ReportAnswer, ReportBatch, ReportRefusal, VERSION};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use uuid::Uuid;
use zenoh::query::Query;
use zenoh::{Session, Wait};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Manner {
    /// Commits, then answers.
    Honest,
    /// Commits and never answers.
    CommitsAndSaysNothing,
    /// Refuses, and asks for a retry later.
    Busy { retry_after_ms: u64 },
}

struct Inner {
    manner: Manner,
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

    pub(super) fn behave(&self, manner: Manner) {
        self.inner.lock().unwrap().manner = manner;
    }

    /// Stops as a killed process does, without answers to the queries it holds.
    pub(super) async fn die(self) {
        self.session.close().await.unwrap();
        self.inner.lock().unwrap().held.clear();
    }

    pub(super) async fn wait_for(&self, reports: usize) {
        let stored = || self.inner.lock().unwrap().stored.len();
        until("reports", async || stored() >= reports).await;
    }

    pub(super) async fn wait_for_asked(&self, times: usize) {
        let asked = || self.inner.lock().unwrap().asked.len();
        until("queries", async || asked() >= times).await;
    }

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
        for report in ReportBatch::from_payload(&payload).unwrap().reports {
            if self.known.insert(report.id) {
                self.stored.push(report.count.unwrap());
            }
        }
    }
}

pub(super) async fn router(endpoint: &str) -> Session {
    let settings = [
        ("mode", "router".into()),
        ("listen/endpoints", vec![endpoint].into()),
    ];
    zenoh_session(&settings).await.unwrap()
}
