//! Counts and names whom the router turns away. Zenoh tells of it in its trace log only, and in parts with hints that
//! lead astray; a layer of the log reads that, counts it by kind and hands it on for the service's own log.

use parking_lot::{Mutex, RwLock};
use std::cell::RefCell;
use std::collections::HashMap;
use std::fmt::{self, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc;
use tracing::callsite::Identifier;
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// Where Zenoh tells of it.
const ACCESS: &str = "zenoh::net::routing::interceptor::access_control";
const TLS: &str = "zenoh_link_tls::unicast";
const SESSIONS: &str = "zenoh_transport::unicast::manager";

/// Refusals that may wait to be logged; further ones are counted only.
const WAITING: usize = 256;

/// Sessions whose certificate is remembered for the log.
const REMEMBERED: usize = 20_000;

/// Why somebody was turned away.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Refusal {
    /// No certificate, one of another authority, one that has ended, or no TLS at all.
    Handshake,
    /// A certificate that the rules do not name: revoked, or made after they were generated.
    Unknown,
    /// A message that its sender may not send.
    Access,
    /// More sessions, or more that come at a time, than there may be.
    Sessions,
}

impl Refusal {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Handshake, Self::Unknown, Self::Access, Self::Sessions];

    /// The word for it.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Handshake => "handshake",
            Self::Unknown => "unknown",
            Self::Access => "access",
            Self::Sessions => "sessions",
        }
    }
}

/// Somebody who was turned away.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Why.
    pub kind: Refusal,
    /// Who: the session's Zenoh id, and its certificate's common name where that is known.
    pub who: String,
    /// What was wanted, or what is wrong.
    pub what: String,
}

#[derive(Debug, Default)]
struct Counts([AtomicU64; Refusal::ALL.len()]);

/// The counters.
#[derive(Clone, Debug, Default)]
pub struct Refusals(Arc<Counts>);

impl Refusals {
    /// How many there were of each kind, in the order of [`Refusal::ALL`].
    pub fn counts(&self) -> [(Refusal, u64); Refusal::ALL.len()] {
        let mut counts = Refusal::ALL.map(|kind| (kind, 0));
        for ((_, count), counter) in counts.iter_mut().zip(&self.0.0) {
            *count = counter.load(Ordering::Relaxed);
        }
        counts
    }

    fn count(&self, kind: Refusal) {
        let place = Refusal::ALL.iter().position(|one| *one == kind);
        if let Some(counter) = place.and_then(|place| self.0.0.get(place)) {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// What a line of Zenoh's log says, told by its place in the sources: lines of one place all say the same thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Line {
    /// Nothing of interest.
    Other,
    /// Rules are looked up ahead for a key: what follows for it on this thread was not attempted.
    LookedUp,
    /// A message was, or would be, denied.
    Denied,
    NoSubject,
    Handshake,
    Sessions,
}

impl Line {
    fn of(target: &str, text: &str) -> Self {
        match target {
            ACCESS if text.contains(": caching permissions for ") => Self::LookedUp,
            ACCESS if text.contains(" is unauthorized to ") => Self::Denied,
            ACCESS if text.contains("did not match any configured ACL subject") => Self::NoSubject,
            TLS if text.contains("Hint: increase the system open file limit") => Self::Handshake,
            SESSIONS if text.starts_with("Max transports reached") => Self::Sessions,
            SESSIONS if text.starts_with("Closing link for preventing") => Self::Sessions,
            _ => Self::Other,
        }
    }
}

thread_local! {
    /// The key that rules were last looked up for ahead on this thread, and the messages seen of it since.
    static LOOKED_UP: RefCell<(String, Vec<String>)> = const { RefCell::new((String::new(), Vec::new())) };
}

/// The layer that reads Zenoh's log.
#[derive(Debug)]
struct RefusalLayer {
    refusals: Refusals,
    told: mpsc::Sender<Refused>,
    places: RwLock<HashMap<Identifier, Line>>,
    /// Common names by Zenoh id: the line of a refusal has the id only.
    names: Mutex<HashMap<String, String>>,
}

/// The layer, the counters, and what is to be logged.
pub fn layer<S>() -> (
    impl Layer<S> + Send + Sync,
    Refusals,
    mpsc::Receiver<Refused>,
)
where
    S: Subscriber + for<'a> LookupSpan<'a>,
{
    let (told, heard) = mpsc::channel(WAITING);
    let refusals = Refusals::default();
    let layer = RefusalLayer {
        refusals: refusals.clone(),
        told,
        places: RwLock::default(),
        names: Mutex::default(),
    };
    let targets = Targets::new()
        .with_target(ACCESS, LevelFilter::TRACE)
        .with_target(TLS, LevelFilter::WARN)
        .with_target(SESSIONS, LevelFilter::TRACE);
    (layer.with_filter(targets), refusals, heard)
}

impl<S: Subscriber> Layer<S> for RefusalLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let place = event.metadata().callsite();
        let known = self.places.read().get(&place).copied();
        if known == Some(Line::Other) {
            return;
        }
        let mut text = Text::default();
        event.record(&mut text);
        let text = text.0;
        let line = known.unwrap_or_else(|| {
            let line = Line::of(event.metadata().target(), &text);
            self.places.write().insert(place, line);
            line
        });
        if let Some(refused) = self.read(line, &text) {
            self.refusals.count(refused.kind);
            // A full queue costs a line in the log; the count is made.
            let _ = self.told.try_send(refused);
        }
    }
}

impl RefusalLayer {
    fn read(&self, line: Line, text: &str) -> Option<Refused> {
        let refused = |kind, who: &str, what: &str| {
            let (who, what) = (who.to_owned(), what.to_owned());
            Some(Refused { kind, who, what })
        };
        match line {
            Line::Other => None,
            Line::LookedUp => {
                let key = text.split('`').nth(1).unwrap_or_default();
                LOOKED_UP.with_borrow_mut(|(of, seen)| {
                    key.clone_into(of);
                    seen.clear();
                });
                None
            }
            Line::Denied => {
                let (who, wanted) = text.split_once(" is unauthorized to ")?;
                let (message, key) = wanted.rsplit_once(" on ")?;
                let at_hand = who.strip_prefix("Using cached result: ");
                let zid = match (at_hand, who.split_once(" on ")) {
                    (Some(zid), _) => zid,
                    (None, Some((zid, subject))) => {
                        self.remember(zid, subject);
                        zid
                    }
                    (None, None) => who,
                };
                // What a session is not sent was not attempted by it, nor was what is looked up ahead.
                if !message.ends_with("(ingress)") || (at_hand.is_none() && ahead(key, message)) {
                    return None;
                }
                let what = format!("{} on {key}", message.trim_end_matches(" (ingress)"));
                refused(Refusal::Access, &self.name(zid), &what)
            }
            Line::NoSubject => {
                let (zid, _) = text.split_once(' ')?;
                refused(
                    Refusal::Unknown,
                    zid,
                    "its certificate is not among those the rules name",
                )
            }
            Line::Handshake => {
                let what = text.split(". Hint:").next().unwrap_or(text);
                refused(Refusal::Handshake, "", what)
            }
            Line::Sessions => refused(Refusal::Sessions, "", text),
        }
    }

    fn remember(&self, zid: &str, subject: &str) {
        let mut names = self.names.lock();
        if names.len() >= REMEMBERED {
            names.clear();
        }
        if !names.contains_key(zid) {
            names.insert(zid.to_owned(), common_name(subject).to_owned());
        }
    }

    fn name(&self, zid: &str) -> String {
        match self.names.lock().get(zid) {
            Some(name) => format!("{name} ({zid})"),
            None => zid.to_owned(),
        }
    }
}

/// Whether this belongs to a look ahead: each message of it comes once.
fn ahead(key: &str, message: &str) -> bool {
    LOOKED_UP.with_borrow_mut(|(of, seen)| {
        let ahead = of == key && !seen.iter().any(|one| one == message);
        if ahead {
            seen.push(message.to_owned());
        } else {
            of.clear();
        }
        ahead
    })
}

/// The common name in Zenoh's words for a session.
fn common_name(subject: &str) -> &str {
    ["node/", "hub/", "router/"]
        .into_iter()
        .find_map(|role| subject.find(role))
        .and_then(|at| subject.get(at..))
        .map_or(subject, |rest| {
            rest.split(|c: char| !(c.is_ascii_alphanumeric() || "/-_.".contains(c)))
                .next()
                .unwrap_or(rest)
        })
}

/// The message of an event.
#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            // Writing to a String cannot fail.
            let _ = write!(self.0, "{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::layer::SubscriberExt;

    fn heard(tell: impl FnOnce()) -> (Refusals, Vec<Refused>) {
        let (layer, refusals, mut told) = layer();
        let subscriber = tracing_subscriber::registry().with(layer);
        tracing::subscriber::with_default(subscriber, tell);
        let mut all = Vec::new();
        while let Ok(refused) = told.try_recv() {
            all.push(refused);
        }
        (refusals, all)
    }

    #[test]
    fn an_attempt_is_counted_and_a_look_ahead_is_not() {
        let (refusals, told) = heard(|| {
            tracing::trace!(target: ACCESS, "ACL (ingress): caching permissions for `{}` ...", "albireo/a/front/threshold");
            for message in ["Put (ingress)", "Query (ingress)"] {
                tracing::trace!(target: ACCESS, "{} on {} is unauthorized to {} on {}",
                    "7f", "[cert_common_name: node/car-7/1]", message, "albireo/a/front/threshold");
            }
            tracing::trace!(target: ACCESS, "Using cached result: {} is unauthorized to {} on {}",
                "7f", "Put (ingress)", "albireo/a/front/threshold");
            tracing::trace!(target: ACCESS, "Using cached result: {} is unauthorized to {} on {}",
                "7f", "Put (egress)", "albireo/a/front/threshold");
            tracing::trace!(target: ACCESS, "Using cached result: {} is authorized to {} on {}",
                "7f", "Put (ingress)", "albireo/@status/car-7");
        });
        let what = "Put on albireo/a/front/threshold".to_owned();
        let who = "node/car-7/1 (7f)".to_owned();
        let kind = Refusal::Access;
        assert_eq!(told, [Refused { kind, who, what }]);
        assert_eq!(refusals.counts()[2], (Refusal::Access, 1));
    }

    #[test]
    fn a_denial_without_a_look_ahead_is_counted() {
        let (refusals, _) = heard(|| {
            for _ in 0..2 {
                tracing::trace!(target: ACCESS, "{} on {} is unauthorized to {} on {}",
                    "7f", "x", "Declare Queryable (ingress)", "albireo/@report/**");
            }
        });
        assert_eq!(refusals.counts()[2].1, 2);
    }

    #[test]
    fn handshakes_unknown_certificates_and_full_houses_are_told_apart() {
        let (refusals, told) = heard(|| {
            tracing::warn!(target: TLS, "{}. Hint: increase the system open file limit.", "invalid peer certificate: Expired");
            tracing::info!(target: ACCESS, "{} did not match any configured ACL subject. Default permission `Deny` will be applied on all messages", "9a");
            tracing::trace!(target: SESSIONS, "Max transports reached ({}). Denying new transport with peer: {}", 1, "9b");
            tracing::trace!(target: SESSIONS, "Accepting link... {}", 1);
            tracing::warn!("something else");
        });
        assert_eq!(refusals.counts().map(|(_, count)| count), [1, 1, 0, 1]);
        assert_eq!(told[0].what, "invalid peer certificate: Expired");
        assert_eq!(told[1].who, "9a");
    }
}
