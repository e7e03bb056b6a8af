//! Answers the nodes' pulls for their desired settings.

use super::Answers;
use crate::HubError;
use crate::ingest::Refusal;
use albireo_wire::{NodeKeys, RevisionMessage};
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
        // The query waits for its answer, and must not hold its payload meanwhile.
        let payload = query.payload_mut().map(std::mem::take).unwrap_or_default();
        match albireo_wire::read::<RevisionMessage>(&payload.to_bytes()) {
            Ok(_) => {
                let node = NodeKeys::node_of(query.key_expr().as_str()).unwrap_or_default();
                let desired = self.desired(node);
                self.replies.answer(query, &desired);
            }
            Err(error) => {
                let refusal = Refusal::unreadable(error.to_string());
                self.replies.refuse(query, &refusal);
            }
        }
    }
}
