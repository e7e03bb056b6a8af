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

fn unannounced(error: &zenoh::Error) -> String {
    format!(
        "the name cannot be announced on the network, or checked for another node's: {error}; this is tried again"
    )
}

/// The tokens of a name, once owned: they last until the session is closed or the last clone is dropped.
#[derive(Clone, Default)]
pub(crate) struct NodeName(Arc<Mutex<Vec<LivelinessToken>>>);

impl NodeName {
    /// Declares the token `key` once no other node holds it, and keeps it. While another node has the same name, `part`
    /// reports that both answer its frames; while the network cannot be asked, it reports the error.
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
                Err(error) => part.degraded(unannounced(&error)),
            }
            tokio::time::sleep(jittered(pause)).await;
        }
    }

    /// Claims the name unless this node has it. Returns false if another node has claimed it: before this one, or at the
    /// same time with a lower id.
    async fn claim(&self, session: &Session, key: &str, own: &str) -> zenoh::Result<bool> {
        let has_other_claims = !other_claims(session, key, own).await?.is_empty();
        if has_other_claims {
            return Ok(false);
        }
        if self.is_held() {
            return Ok(true);
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

    const KEY: &str = "albireo/@alive/n";

    async fn until(mut holds: impl AsyncFnMut() -> bool) {
        let holding = async {
            while !holds().await {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), holding).await.unwrap();
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
        let sees_the_other =
            async |session: &Session| session.info().peers_zid().await.next().is_some();
        until(async || sees_the_other(&one).await && sees_the_other(&two).await).await;
        let nodes = [one, two].map(|session| {
            let name = NodeName::default();
            let readiness = Readiness::default();
            let hold = name.clone().hold(session, KEY.to_owned(), readiness.part("name"));
            let holding = tokio::spawn(hold);
            Twin {
                name,
                readiness,
                holding,
            }
        });
        until(async || {
            let [one, two] = &nodes;
            let is_held_once = one.name.is_held() != two.name.is_held();
            let only_the_other_is_faulty =
                |node: &Twin| node.name.is_held() == node.is_without_faults();
            is_held_once && only_the_other_is_faulty(one) && only_the_other_is_faulty(two)
        })
        .await;
        for node in nodes {
            assert!(!node.holding.is_finished(), "it goes on checking");
            node.holding.abort();
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_name_that_cannot_be_announced_is_a_fault_of_the_node() {
        let session = session_alone().await;
        session.close().await.unwrap();
        let readiness = Readiness::default();
        let name = NodeName::default();
        let hold = name.clone().hold(session, KEY.to_owned(), readiness.part("name"));
        let holding = tokio::spawn(hold);
        until(async || !readiness.health().faults.is_empty()).await;
        holding.abort();
        let reason = &readiness.health().faults[0].fault.reason;
        assert!(reason.contains("cannot be announced"), "{reason}");
        assert!(!name.is_held());
    }
}
