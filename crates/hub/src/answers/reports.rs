//! Takes the nodes' batches of reports, and answers each once it is stored or refused.

use super::Answers;
use crate::HubError;
use crate::ingest::{Inbox, Refusal};
use crate::store::row::beginning;
use albireo_service::rate_limit::RateLimit;
use albireo_wire::{KeyError, NodeKeys, RefusalReason, ReportAnswer};
use std::time::Duration;
use zenoh::Session;
use zenoh::query::{Query, Queryable};

/// A node under a wrong name sends its reports again and again.
static WRONG_NAME: RateLimit = RateLimit::new(Duration::from_secs(10));

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
        let named = NodeKeys::sender_of(query.key_expr().as_str()).map(str::to_owned);
        let node = match named {
            Ok(node) => node,
            Err(error) => return self.refuse_name(query, &error),
        };
        let Some(payload) = query.payload_mut().map(std::mem::take) else {
            // The sender is not a node, and gets no answer.
            self.counters.refuse(RefusalReason::Unreadable);
            return;
        };
        let answers = self.clone();
        let sender = node.clone();
        let reply = move |outcome| answers.conclude(&sender, query, outcome);
        inbox.take(node, &payload, Box::new(reply));
    }

    /// Refuses a batch on the key of a name that no node may have. The node keeps its reports until it has another name.
    fn refuse_name(&self, query: Query, error: &KeyError) {
        self.counters.refuse(RefusalReason::Unreadable);
        WRONG_NAME.log(|held_back| {
            let key = beginning(query.key_expr().as_str());
            tracing::warn!(held_back, key, %error, "reports under a wrong name are refused");
        });
        let refusal = Refusal::unreadable(error.to_string());
        self.replies.refuse(query, &refusal);
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
