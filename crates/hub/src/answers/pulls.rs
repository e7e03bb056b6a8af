//! Answers the nodes' pulls for their desired settings.

use super::Answers;
use crate::HubError;
use albireo_wire::{NodeKeys, RefusalReason, RevisionMessage};
use zenoh::Session;
use zenoh::query::{Query, Queryable};

impl Answers {
    /// Answers the pulls of the nodes with these keys until the returned declaration is dropped.
    pub(crate) async fn answer_pulls(
        &self,
        keys: &NodeKeys,
        session: &Session,
    ) -> Result<Queryable<()>, HubError> {
        let answers = self.clone();
        session
            .declare_queryable(keys.pull())
            .complete(true)
            .callback(move |query| answers.pulled(query))
            .await
            .map_err(HubError::at("pulls cannot be answered"))
    }

    fn pulled(&self, mut query: Query) {
        self.counters.count(|counts| counts.pulls += 1);
        // The query waits for its answer without it.
        let payload = query.payload_mut().map(std::mem::take);
        match albireo_wire::read::<RevisionMessage>(&payload.unwrap_or_default().to_bytes()) {
            Ok(_) => {
                let node = NodeKeys::node_of(query.key_expr().as_str());
                let desired = self.desired(node.unwrap_or_default());
                self.replies.answer(query, &desired);
            }
            Err(error) => {
                let reason = RefusalReason::Unreadable;
                self.replies.refuse(query, reason, &error.to_string(), None);
            }
        }
    }
}
