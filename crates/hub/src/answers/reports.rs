//! Takes the nodes' batches of reports, and answers each once it is stored or refused.

use super::Answers;
use crate::HubError;
use crate::ingest::{Inbox, Refusal};
use albireo_wire::{NodeKeys, RefusalReason, ReportAnswer};
use zenoh::Session;
use zenoh::query::{Query, Queryable};

impl Answers {
    /// Puts the batches of the nodes with these keys into `inbox` until the returned declaration is dropped.
    pub(crate) async fn take_reports(
        &self,
        keys: &NodeKeys,
        session: &Session,
        inbox: Inbox,
    ) -> Result<Queryable<()>, HubError> {
        let answers = self.clone();
        session
            .declare_queryable(keys.report())
            .complete(true)
            .callback(move |query| answers.reported(query, &inbox))
            .await
            .map_err(HubError::at("reports cannot be received"))
    }

    /// Never waits: it is called on Zenoh's thread.
    fn reported(&self, mut query: Query, inbox: &Inbox) {
        let node = NodeKeys::node_of(query.key_expr().as_str()).map(str::to_owned);
        let payload = query.payload_mut().map(std::mem::take);
        let (Some(node), Some(payload)) = (node, payload) else {
            // The sender is not a node, and gets no answer.
            self.counters.refuse(RefusalReason::Unreadable);
            return;
        };
        let answers = self.clone();
        let sender = node.clone();
        let reply = move |outcome| answers.conclude(&sender, query, outcome);
        inbox.take(node, &payload, Box::new(reply));
    }

    fn conclude(&self, node: &str, query: Query, outcome: Result<ReportAnswer, Refusal>) {
        match outcome {
            Ok(answer) => {
                let desired = Some(self.desired(node));
                self.replies.answer(query, &ReportAnswer { desired, ..answer });
            }
            Err(refusal) => self.replies.refuse(query, &refusal),
        }
    }
}
