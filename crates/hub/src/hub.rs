//! Holds the parts of a running hub that its HTTP routes read and change.

use crate::config::HubConfig;
use crate::ingest::IngestCounters;
use crate::presence::Fleet;
use crate::store::Store;
use crate::tuning::{DesiredSettings, Tuner};
use albireo_service::config;
use albireo_service::http::Problem;
use albireo_service::identity::{self, Certificates};
use albireo_service::readiness::{Fault, Readiness};
use axum::http::StatusCode;
use serde_json::Value;
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use zenoh::Session;

/// Most readers of live counters at a time.
pub(crate) const MOST_LIVE: usize = 64;

/// A running hub. Clones share it.
#[derive(Clone, Debug)]
pub(crate) struct Hub {
    /// The faults of its parts: `database`, `zenoh`, `certificates`, `fleet`, `tuning`, `tasks`.
    pub(crate) readiness: Readiness,
    /// The certificates of its Zenoh session.
    pub(crate) certificates: Certificates,
    /// All nodes.
    pub(crate) fleet: Arc<Fleet>,
    /// The desired settings of the nodes.
    pub(crate) desired: Arc<DesiredSettings>,
    /// Counters of what is received and stored.
    pub(crate) ingest: Arc<IngestCounters>,
    /// Cancelled when the hub stops.
    pub(crate) shutdown: CancellationToken,
    /// The tuner, once the database is open.
    pub(crate) tuner: Arc<OnceLock<Arc<Tuner>>>,
    /// The Zenoh session, once it is open.
    pub(crate) session: Arc<OnceLock<Session>>,
    /// The prefix of all keys.
    pub(crate) prefix: Arc<str>,
    /// Limits the number of readers that watch nodes at a time.
    pub(crate) live_readers: Arc<Semaphore>,
    /// Days that five-minute sums are kept.
    pub(crate) five_minutes_days: u32,
    /// The configuration without its secrets.
    pub(crate) config: Arc<Value>,
    pub(crate) started: Instant,
}

impl Hub {
    /// A hub that knows no node yet.
    pub(crate) fn new(
        config: &HubConfig,
        desired: DesiredSettings,
        shutdown: CancellationToken,
    ) -> Self {
        let readiness = Readiness::default();
        let certificates = Certificates::read(config.zenoh.tls_files("certificate"));
        let probed = certificates.clone();
        readiness.probe(identity::PART, "", move || {
            probed.fault().map(Fault::degraded)
        });
        Self {
            readiness,
            certificates,
            fleet: Arc::new(Fleet::new(&config.presence)),
            desired: Arc::new(desired),
            ingest: Arc::default(),
            shutdown,
            tuner: Arc::default(),
            session: Arc::default(),
            prefix: config.hub.prefix.as_str().into(),
            live_readers: Arc::new(Semaphore::new(MOST_LIVE)),
            five_minutes_days: config.history.five_minutes_days,
            config: Arc::new(without_secrets(config)),
            started: Instant::now(),
        }
    }

    /// The tuner.
    ///
    /// # Errors
    /// A problem document while the database is not open yet.
    pub(crate) fn tuner(&self) -> Result<&Arc<Tuner>, Problem> {
        attached(&self.tuner, "the database")
    }

    /// The database.
    ///
    /// # Errors
    /// A problem document while it is not open yet.
    pub(crate) fn store(&self) -> Result<&Store, Problem> {
        Ok(&self.tuner()?.store)
    }
}

pub(crate) fn attached<'a, T>(part: &'a OnceLock<T>, name: &str) -> Result<&'a T, Problem> {
    part.get().ok_or_else(|| {
        let detail = format!("{name} is not open yet; /readyz says why");
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail)
    })
}

/// The configuration with every secret masked.
fn without_secrets(config: &HubConfig) -> Value {
    let mut shown = config::without_secrets(config);
    shown["database"]["url"] = config.database.shown().into();
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_service::config::{NamedToken, Token};

    #[test]
    fn no_secret_of_the_configuration_is_shown() {
        let mut config = HubConfig::default();
        config.http.token = Some(Token::new("the-token-of-everything"));
        config.tokens = vec![NamedToken {
            name: "dashboard".into(),
            token: Some(Token::new("the-token-of-the-dashboard")),
            ..NamedToken::default()
        }];
        config.database.url =
            "postgres://hub:the-password@db.example/fleet?password=the-other".into();
        let hidden: Vec<_> = config.database.passwords().collect();
        assert_eq!(hidden, ["the-password", "the-other"]);
        let shown = without_secrets(&config).to_string();
        let logged = format!("{:?}", config.database);
        for secret in ["the-token", "the-password", "the-other"] {
            assert!(!shown.contains(secret), "{shown}");
            assert!(!logged.contains(secret), "{logged}");
        }
        for kept in ["dashboard", "postgres://hub@db.example/fleet", "commit_ms"] {
            assert!(shown.contains(kept), "{shown}");
        }
    }
}
