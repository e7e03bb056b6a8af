//! The node's name on the network: its liveliness token, which says that the node lives, and that its name is taken.

use albireo_service::readiness::Part;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;

/// How long others may take to say that they have the name.
const ASKING: Duration = Duration::from_secs(2);

/// Time between two looks whether the name is free.
const LOOK_EVERY: Duration = Duration::from_secs(5);

/// The token of a name, once it could be had.
#[derive(Clone, Default)]
pub(crate) struct NodeName(Arc<Mutex<Option<LivelinessToken>>>);

impl NodeName {
    /// Declares the token `key` as soon as no other node holds it, and keeps it until `shutdown`. Until then `part`
    /// says that two nodes have one name: both answer its frames.
    ///
    /// # Errors
    /// When Zenoh refuses.
    pub(crate) async fn hold(
        self,
        session: Session,
        key: String,
        part: Part,
        shutdown: CancellationToken,
    ) -> Result<(), String> {
        let words = |error: zenoh::Error| format!("the liveliness token cannot be had: {error}");
        let mut told = false;
        while self.0.lock().await.is_none() {
            let replies = session
                .liveliness()
                .get(&key)
                .timeout(ASKING)
                .await
                .map_err(words)?;
            let mut taken = false;
            while let Ok(reply) = replies.recv_async().await {
                taken |= reply.result().is_ok();
            }
            if !taken {
                let token = session.liveliness().declare_token(&key).await;
                *self.0.lock().await = Some(token.map_err(words)?);
                part.works();
                break;
            }
            part.degraded("another node of this name is on the network: both answer its frames");
            if !std::mem::replace(&mut told, true) {
                tracing::warn!(
                    key,
                    "another node of this name is on the network, or an earlier run of this one was killed a moment \
                     ago: give each node a name of its own (node.name)"
                );
            }
            tokio::select! {
                () = tokio::time::sleep(LOOK_EVERY) => {}
                () = shutdown.cancelled() => return Ok(()),
            }
        }
        shutdown.cancelled().await;
        Ok(())
    }

    /// The token, to be given back.
    pub(crate) async fn take(&self) -> Option<LivelinessToken> {
        self.0.lock().await.take()
    }
}
