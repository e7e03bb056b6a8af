//! The readiness of a service: the faults of its parts, and their duration.
//!
//! A fault has one of two effects: if the service cannot do its work, it is *not ready* (`/readyz` answers 503); if the
//! service works in spite of the fault, it is *degraded* (`/readyz` answers 200 with the reasons). A part reports its
//! faults as they occur ([`Part`]), or is queried each time ([`Readiness::probe`]).

use crate::clock::seconds;
use albireo_wire::{HealthState, HealthStatus};
use parking_lot::Mutex;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use tokio::sync::watch;
use tokio::time::{Duration, Instant};
use utoipa::ToSchema;

/// For so long after the start, parts that are not ready yet are no news.
const START: Duration = Duration::from_secs(10);

/// The fault of a part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Fault {
    /// `not_ready` if the service cannot do its work, `degraded` if it works in spite of the fault.
    pub effect: HealthState,
    /// The reason, human-readable. One that differs only in its numbers is no news in the log.
    pub reason: String,
}

impl Fault {
    /// Creates a fault in spite of which the service works.
    pub fn degraded(reason: impl Into<String>) -> Self {
        Self::new(HealthState::Degraded, reason)
    }

    /// Creates a fault that keeps the service from its work.
    pub fn not_ready(reason: impl Into<String>) -> Self {
        Self::new(HealthState::NotReady, reason)
    }

    pub(crate) fn new(effect: HealthState, reason: impl Into<String>) -> Self {
        let reason = reason.into();
        Self { effect, reason }
    }

    /// The reason without its numbers: a pause before the next attempt grows, and counts go on.
    fn cause(&self) -> impl Iterator<Item = char> {
        self.reason.chars().filter(|c| !c.is_ascii_digit() && *c != '.')
    }
}

/// A fault of one of the service's parts.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct PartFault {
    /// The part: `detector`, `zenoh`, …
    pub part: &'static str,
    /// The name of a camera or a task, if the part has several; absent for the part itself.
    #[serde(skip_serializing_if = "String::is_empty")]
    #[schema(value_type = Option<String>)]
    pub subject: String,
    /// The fault.
    #[serde(flatten)]
    pub fault: Fault,
    /// Seconds for which the part has been faulty, for any reason.
    pub since_s: f64,
}

impl PartFault {
    /// The part and the subject.
    fn name(&self) -> String {
        format!("{} {}", self.part, self.subject).trim_end().to_owned()
    }
}

/// A change of the health, in words.
#[derive(Debug, PartialEq, Eq)]
enum Change {
    Better(String),
    Worse(String),
}

impl Change {
    fn log(self) {
        match self {
            Self::Better(words) => tracing::info!("{words}"),
            Self::Worse(words) => tracing::warn!("{words}"),
        }
    }
}

/// All faults at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// The faults, by part and subject.
    pub faults: Vec<PartFault>,
}

impl Health {
    /// The worst effect of all faults.
    pub fn state(&self) -> HealthState {
        self.faults.iter().map(|fault| fault.fault.effect).max().unwrap_or_default()
    }

    /// True if the service does its work, possibly with a part missing.
    pub fn is_ready(&self) -> bool {
        self.state() != HealthState::NotReady
    }

    /// What has changed since `before`, in words; `None` if nothing has.
    fn since(&self, before: &Self) -> Option<Change> {
        let is_news = |one: &&PartFault| match before.of_same_part(one) {
            Some(other) => {
                let has_same_cause = other.fault.cause().eq(one.fault.cause());
                other.fault.effect != one.fault.effect || !has_same_cause
            }
            None => true,
        };
        let is_gone = |one: &&PartFault| self.of_same_part(one).is_none();
        let news: Vec<_> = self.faults.iter().filter(is_news).collect();
        let gone: Vec<_> = before.faults.iter().filter(is_gone).map(PartFault::name).collect();
        if news.is_empty() && gone.is_empty() {
            return None;
        }
        let mut sentences: Vec<_> =
            news.iter().map(|one| format!("{}: {}", one.name(), one.fault.reason)).collect();
        if !gone.is_empty() {
            sentences.push(format!("works again: {}", gone.join(", ")));
        }
        let rest = self.faults.len() - news.len();
        if rest > 0 {
            sentences.push(format!("as before: {rest} more, see /readyz"));
        }
        let words = sentences.join("; ");
        Some(match self.state() {
            HealthState::Ready => Change::Better("every part works".to_owned()),
            HealthState::Degraded if news.is_empty() => {
                Change::Better(format!("degraded; {words}"))
            }
            HealthState::Degraded => Change::Worse(format!("degraded: {words}")),
            HealthState::NotReady => Change::Worse(format!("not ready: {words}")),
        })
    }

    /// The fault here that has the part and the subject of `other`.
    fn of_same_part(&self, other: &PartFault) -> Option<&PartFault> {
        self.faults
            .iter()
            .find(|one| one.part == other.part && one.subject == other.subject)
    }

    /// The status for the wire: one reason per part.
    pub fn status(&self) -> HealthStatus {
        let mut reasons = BTreeMap::<String, String>::new();
        for one in &self.faults {
            let shown = reasons.entry(one.part.to_string()).or_default();
            if !shown.is_empty() {
                shown.push_str("; ");
            }
            if !one.subject.is_empty() {
                shown.push_str(&format!("{}: ", one.subject));
            }
            shown.push_str(&one.fault.reason);
        }
        HealthStatus {
            state: self.state(),
            reasons,
        }
    }
}

/// A part and its subject.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    part: &'static str,
    subject: String,
}

/// A fault and its start.
struct KnownFault {
    fault: Fault,
    since: Instant,
}

/// A part that is queried for its fault.
#[derive(Clone)]
struct Probe {
    key: Key,
    fault: Arc<dyn Fn() -> Option<Fault> + Send + Sync>,
}

#[derive(Default)]
struct Inner {
    faults: Mutex<BTreeMap<Key, KnownFault>>,
    probes: Mutex<Vec<Probe>>,
    changes: watch::Sender<HealthStatus>,
}

/// The state of a service and all its parts. Clones share it.
#[derive(Clone, Default)]
pub struct Readiness(Arc<Inner>);

impl fmt::Debug for Readiness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&*self.0.changes.borrow(), f)
    }
}

impl Readiness {
    /// Creates the handle through which a part reports its state.
    pub fn part(&self, part: &'static str) -> Part {
        self.part_of(part, "")
    }

    /// Like [`part`](Self::part), for one of several: the camera `front` of the part `cameras`.
    pub fn part_of(&self, part: &'static str, subject: impl Into<String>) -> Part {
        let subject = subject.into();
        Part {
            readiness: self.clone(),
            key: Key { part, subject },
        }
    }

    /// Calls `fault` at each [`health`](Self::health). It must not block.
    pub fn probe(
        &self,
        part: &'static str,
        subject: impl Into<String>,
        fault: impl Fn() -> Option<Fault> + Send + Sync + 'static,
    ) {
        let subject = subject.into();
        self.0.probes.lock().push(Probe {
            key: Key { part, subject },
            fault: Arc::new(fault),
        });
    }

    /// Returns the present faults.
    pub fn health(&self) -> Health {
        // Probes run without the lock: a probe may itself report a part.
        let probes = self.0.probes.lock().clone();
        let mut probed = Vec::new();
        for probe in probes {
            let fault = (probe.fault)();
            probed.push((probe.key, fault));
        }
        let mut known = self.0.faults.lock();
        for (key, fault) in probed {
            put(&mut known, key, fault);
        }
        let mut health = Health::default();
        for (key, one) in known.iter() {
            health.faults.push(PartFault {
                part: key.part,
                subject: key.subject.clone(),
                fault: one.fault.clone(),
                since_s: seconds(one.since.elapsed()),
            });
        }
        // Under the lock, so that the later of two concurrent reads is sent last.
        let status = health.status();
        self.0.changes.send_if_modified(|shown| {
            let has_changed = *shown != status;
            *shown = status;
            has_changed
        });
        health
    }

    /// Subscribes to changes. A change that only a probe sees is reported at the next [`health`](Self::health), so
    /// that must be called from time to time, as [`watch`](Self::watch) does.
    pub fn subscribe(&self) -> watch::Receiver<HealthStatus> {
        self.0.changes.subscribe()
    }

    /// Checks the health every `period` and logs what has changed, for as long as it is polled.
    pub async fn watch(self, period: Duration) {
        self.tell_changes(period, Change::log).await;
    }

    /// Passes each change of the health to `tell`, for as long as it is polled. Nothing is told before the service is ready
    /// for the first time, or [`START`] is over.
    async fn tell_changes(&self, period: Duration, mut tell: impl FnMut(Change)) {
        let mut changes = self.subscribe();
        let mut ticks = tokio::time::interval(period);
        let begun = Instant::now();
        let mut has_started = false;
        let mut known = Health::default();
        loop {
            tokio::select! {
                _ = ticks.tick() => {}
                Ok(()) = changes.changed() => {}
            }
            let now = self.health();
            changes.mark_unchanged();
            if now.is_ready() || begun.elapsed() >= START {
                has_started = true;
            }
            if !has_started {
                continue;
            }
            if let Some(change) = now.since(&known) {
                tell(change);
            }
            known = now;
        }
    }

    fn set(&self, key: &Key, fault: Option<Fault>) {
        // Parts report after each transaction or message that they work: nothing changed then.
        if fault.is_some() || self.0.faults.lock().contains_key(key) {
            put(&mut self.0.faults.lock(), key.clone(), fault);
            self.health();
        }
    }
}

/// Notes the fault of a part, or that it has none.
fn put(faults: &mut BTreeMap<Key, KnownFault>, key: Key, fault: Option<Fault>) {
    let Some(fault) = fault else {
        faults.remove(&key);
        return;
    };
    let since = match faults.get(&key) {
        Some(known) => known.since,
        None => Instant::now(),
    };
    faults.insert(key, KnownFault { fault, since });
}

/// The state of a service in words.
pub(crate) fn sentence(status: &HealthStatus) -> String {
    match status.state {
        HealthState::Ready => "every part works".to_owned(),
        HealthState::Degraded => format!("degraded: {}", status.text()),
        HealthState::NotReady => format!("not ready: {}", status.text()),
    }
}

/// The handle through which one part reports its state. The last report holds even after this is dropped.
#[derive(Clone, Debug)]
pub struct Part {
    readiness: Readiness,
    key: Key,
}

impl Part {
    /// Reports that the part works.
    pub fn works(&self) {
        self.readiness.set(&self.key, None);
    }

    /// Reports a fault in spite of which the service works.
    pub fn degraded(&self, reason: impl Into<String>) {
        self.fault(Fault::degraded(reason));
    }

    /// Reports a fault that keeps the service from its work.
    pub fn not_ready(&self, reason: impl Into<String>) {
        self.fault(Fault::not_ready(reason));
    }

    /// Reports a fault.
    pub(crate) fn fault(&self, fault: Fault) {
        self.readiness.set(&self.key, Some(fault));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[tokio::test(start_paused = true)]
    async fn the_worst_fault_decides_and_parts_have_reasons_and_durations() {
        let readiness = Readiness::default();
        assert_eq!(readiness.health().state(), HealthState::Ready);
        readiness.part("power").degraded("the meter cannot be read");
        tokio::time::advance(Duration::from_secs(3)).await;
        let health = readiness.health();
        assert_eq!(health.state(), HealthState::Degraded);
        assert!(health.is_ready());
        assert_eq!(health.faults[0].since_s, 3.0);
        let front = readiness.part_of("cameras", "front");
        front.not_ready("its loop failed");
        readiness.part_of("cameras", "rear").degraded("silent");
        let health = readiness.health();
        assert!(!health.is_ready());
        let expected = "front: its loop failed; rear: silent";
        assert_eq!(health.status().reasons["cameras"], expected);
        front.works();
        assert_eq!(readiness.health().state(), HealthState::Degraded);
    }

    #[test]
    fn a_change_is_said_without_what_is_as_it_was() {
        let readiness = Readiness::default();
        let [front, rear] = ["front", "rear"].map(|name| readiness.part_of("cameras", name));
        let mut known = Health::default();
        let mut said = || {
            let now = readiness.health();
            let change = now.since(&known);
            known = now;
            change
        };
        assert_eq!(said(), None);
        let worse = |words: &str| Some(Change::Worse(words.to_owned()));
        let better = |words: &str| Some(Change::Better(words.to_owned()));
        front.degraded("silent");
        rear.degraded("refused; next attempt in 0.5 s");
        assert_eq!(
            said(),
            worse("degraded: cameras front: silent; cameras rear: refused; next attempt in 0.5 s")
        );
        rear.degraded("refused; next attempt in 1 s");
        assert_eq!(said(), None);
        rear.degraded("no address; next attempt in 2 s");
        assert_eq!(
            said(),
            worse(
                "degraded: cameras rear: no address; next attempt in 2 s; as before: 1 more, see /readyz"
            )
        );
        front.works();
        assert_eq!(
            said(),
            better("degraded; works again: cameras front; as before: 1 more, see /readyz")
        );
        rear.not_ready("its loop failed");
        assert_eq!(said(), worse("not ready: cameras rear: its loop failed"));
        rear.works();
        assert_eq!(said(), better("every part works"));
    }

    /// The changes that are told of a part that is not ready at first and works after `starting`.
    async fn told_of_a_start(starting: Duration) -> Vec<Change> {
        let readiness = Readiness::default();
        let cameras = readiness.part("cameras");
        cameras.not_ready("not yet");
        let told = Mutex::new(Vec::new());
        let period = Duration::from_secs(1);
        let watching = readiness.tell_changes(period, |change| told.lock().push(change));
        let acting = async {
            tokio::time::sleep(starting).await;
            cameras.works();
            tokio::time::sleep(2 * period).await;
        };
        tokio::select! {
            () = watching => {}
            () = acting => {}
        }
        told.into_inner()
    }

    #[tokio::test(start_paused = true)]
    async fn a_start_in_progress_is_no_news_unless_it_lasts() {
        assert_eq!(told_of_a_start(Duration::from_secs(3)).await, []);
        let worse = Change::Worse("not ready: cameras: not yet".to_owned());
        let better = Change::Better("every part works".to_owned());
        let told = told_of_a_start(Duration::from_secs(30)).await;
        assert_eq!(told, [worse, better]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_probed_fault_is_published_once() {
        let readiness = Readiness::default();
        let is_closed = Arc::new(AtomicBool::new(false));
        let probed = Arc::clone(&is_closed);
        readiness.probe("zenoh", "", move || {
            if probed.load(Ordering::Relaxed) {
                Some(Fault::not_ready("the session is closed"))
            } else {
                None
            }
        });
        let mut changes = readiness.subscribe();
        let watching = tokio::spawn(readiness.clone().watch(Duration::from_secs(1)));
        tokio::time::sleep(Duration::from_secs(5)).await;
        assert!(!changes.has_changed().unwrap());
        is_closed.store(true, Ordering::Relaxed);
        changes.changed().await.unwrap();
        assert_eq!(changes.borrow_and_update().state, HealthState::NotReady);
        tokio::time::sleep(Duration::from_secs(5)).await;
        assert!(!changes.has_changed().unwrap());
        assert!(readiness.health().faults[0].since_s >= 5.0);
        watching.abort();
    }
}
