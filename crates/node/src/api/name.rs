//! Holds the node's name on the network with a liveliness token, which shows that the node is alive and owns its name.
//!
//! A node that finds no claim to its name declares one, a token under the name with its session's id, and queries again
//! after the claim has had time to spread. Two nodes that start together thus find each other's claims, and the lower
//! id gets the name. Without claims, both would query, find nothing, and take the name.

use albireo_service::readiness::Part;
use albireo_service::session::jittered;
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;

/// The time for a claim to spread: a peer answers from the claims it has received itself.
const CLAIM_SPREAD_TIME: Duration = Duration::from_secs(1);

/// The time limit for claims to be reported.
const QUERY_TIMEOUT: Duration = Duration::from_secs(2);

/// The interval at which a waiting node checks the name, times 0.5 to 1.5.
const CHECK_EVERY: Duration = Duration::from_millis(if cfg!(test) { 200 } else { 5000 });

/// The interval at which the owner checks the name: separate networks may join.
const OWNER_CHECK_EVERY: Duration = Duration::from_secs(60);

const CONFLICT: &str = "another node of this name is on the network, or an earlier run of this one was killed a moment \
                        ago: both answer its frames; give each node a unique name (node.name)";

/// The tokens of a name, once owned: they last until the session is closed or the last clone is dropped.
#[derive(Clone, Default)]
pub(crate) struct NodeName(Arc<Mutex<Vec<LivelinessToken>>>);

impl NodeName {
    /// Declares the token `key` once no other node holds it, and keeps it. Until then, and if another node appears
    /// later, `part` reports that two nodes have the same name: both answer its frames.
    pub(crate) async fn hold(self, session: Session, key: String, part: Part) {
        let own = format!("{key}/{}", session.zid());
        loop {
            let pause = if self.is_held() {
                OWNER_CHECK_EVERY
            } else {
                CHECK_EVERY
            };
            match self.claim(&session, &key, &own).await {
                Ok(true) => part.works(),
                Ok(false) => part.degraded(CONFLICT),
                Err(error) => {
                    tracing::warn!(%error, key, "cannot declare the liveliness token; will retry");
                }
            }
            tokio::time::sleep(jittered(pause)).await;
        }
    }

    /// Claims the name unless this node has it. Returns true unless another node claims it: without this node, or with a
    /// lower id at the same time.
    async fn claim(&self, session: &Session, key: &str, own: &str) -> zenoh::Result<bool> {
        let is_free = other_claims(session, key, own).await?.is_empty();
        if !is_free || self.is_held() {
            return Ok(is_free);
        }
        let claim = session.liveliness().declare_token(own).await?;
        tokio::time::sleep(CLAIM_SPREAD_TIME).await;
        let others = other_claims(session, key, own).await?;
        if others.iter().any(|other| other.as_str() < own) {
            claim.undeclare().await?;
            return Ok(false);
        }
        let token = session.liveliness().declare_token(key).await?;
        self.0.lock().extend([claim, token]);
        Ok(true)
    }

    fn is_held(&self) -> bool {
        !self.0.lock().is_empty()
    }
}

/// The claims to the name other than `own`.
async fn other_claims(session: &Session, key: &str, own: &str) -> zenoh::Result<Vec<String>> {
    let replies = session.liveliness().get(format!("{key}/*")).timeout(QUERY_TIMEOUT).await?;
    let mut others = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(claim) = reply.result()
            && claim.key_expr().as_str() != own
        {
            others.push(claim.key_expr().to_string());
        }
    }
    Ok(others)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use albireo_service::readiness::Readiness;
    use tokio::task::JoinHandle;

    /// A session that looks for no others, with these settings in Zenoh's own terms.
    pub(crate) async fn session(settings: &[(&str, &str)]) -> Session {
        let mut config = zenoh::Config::default();
        let alone = [("scouting/multicast/enabled", "false")];
        for (key, value) in alone.iter().chain(settings) {
            config.insert_json5(key, value).unwrap();
        }
        zenoh::open(config).await.unwrap()
    }

    /// A session that nobody can reach.
    pub(crate) async fn session_alone() -> Session {
        session(&[("listen/endpoints", "[]")]).await
    }

    async fn until(mut holds: impl AsyncFnMut() -> bool) {
        let holding = async {
            while !holds().await {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        let waited = tokio::time::timeout(Duration::from_secs(60), holding);
        waited.await.unwrap();
    }

    /// One of two nodes of the same name.
    struct Twin {
        name: NodeName,
        readiness: Readiness,
        holding: JoinHandle<()>,
    }

    impl Twin {
        fn is_without_faults(&self) -> bool {
            self.readiness.health().faults.is_empty()
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn of_two_nodes_that_start_together_one_gets_the_name_and_the_other_reports_it() {
        let one = session(&[("listen/endpoints", r#"["tcp/127.0.0.1:0"]"#)]).await;
        let at = one.info().locators().await[0].to_string();
        let connect = format!("[{at:?}]");
        let two = session(&[("listen/endpoints", "[]"), ("connect/endpoints", &connect)]).await;
        until(async || {
            one.info().peers_zid().await.count() + two.info().peers_zid().await.count() >= 2
        })
        .await;
        let nodes = [one, two].map(|session| {
            let name = NodeName::default();
            let readiness = Readiness::default();
            let key = "albireo/@alive/n".to_owned();
            let part = readiness.part("name");
            Twin {
                holding: tokio::spawn(name.clone().hold(session, key, part)),
                name,
                readiness,
            }
        });
        until(async || {
            let [one, two] = &nodes;
            let only_one_has_it = one.name.is_held() != two.name.is_held();
            let is_right = |node: &Twin| node.name.is_held() == node.is_without_faults();
            only_one_has_it && is_right(one) && is_right(two)
        })
        .await;
        for node in nodes {
            assert!(!node.holding.is_finished(), "it is held");
            node.holding.abort();
        }
    }
}
