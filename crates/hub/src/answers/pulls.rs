//! Answers the nodes' pulls for their desired settings.

use super::Answers;
use crate::HubError;
use crate::ingest::Refusal;
use albireo_wire::{Desired, NodeKeys, RevisionMessage};
use zenoh::Session;
use zenoh::bytes::ZBytes;
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
        match self.answer_to(query.key_expr().as_str(), &payload) {
            Ok(desired) => self.replies.answer(query, &desired),
            Err(reason) => self.replies.refuse(query, &Refusal::unreadable(reason)),
        }
    }

    /// The answer to a pull on a key.
    ///
    /// # Errors
    /// When no node may have the name in the key, or the message cannot be read.
    fn answer_to(&self, key: &str, payload: &ZBytes) -> Result<Desired, String> {
        let node = NodeKeys::sender_of(key).map_err(|error| error.to_string())?;
        albireo_wire::read::<RevisionMessage>(&payload.to_bytes())
            .map_err(|error| error.to_string())?;
        Ok(self.desired(node))
    }
}
