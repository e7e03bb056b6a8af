//! What waits for an MQTT broker. Pure. State is kept once per topic, only the newest; events wait in a queue of limited length.

use std::collections::{BTreeMap, VecDeque};
use std::mem::take;

/// The most messages that may be unacknowledged.
pub(super) const WINDOW: usize = 16;

/// The most events that wait; then the oldest is given up.
pub(super) const MOST_EVENTS: usize = 256;

/// A message for a broker.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Message {
    pub topic: String,
    pub payload: String,
    /// State, which the broker keeps, and not an event.
    pub is_retained: bool,
}

#[derive(Debug)]
struct TopicState {
    payload: String,
    /// True if the broker may not have it.
    is_new: bool,
}

/// The messages that a broker has not acknowledged.
#[derive(Debug, Default)]
pub(super) struct Mailbox {
    states: BTreeMap<String, TopicState>,
    events: VecDeque<Message>,
    /// Given to the connection, which has not numbered them yet.
    given: VecDeque<Message>,
    /// Sent under a number, in this order: numbers begin again after the largest.
    sent: VecDeque<SentMessage>,
}

#[derive(Debug)]
struct SentMessage {
    number: u16,
    message: Message,
}

impl Mailbox {
    /// Sets the state of a topic. The same again costs nothing.
    pub(super) fn set(&mut self, topic: String, payload: String) {
        if self.states.get(&topic).is_some_and(|state| state.payload == payload) {
            return;
        }
        let state = TopicState {
            payload,
            is_new: true,
        };
        self.states.insert(topic, state);
    }

    /// Adds an event; returns how many older ones were given up for it.
    pub(super) fn tell(&mut self, topic: String, payload: String) -> u64 {
        self.events.push_back(Message {
            topic,
            payload,
            is_retained: false,
        });
        let too_many = self.events.len().saturating_sub(MOST_EVENTS);
        self.events.drain(..too_many);
        too_many as u64
    }

    /// The next message to give to the connection, states first; `None` while too many are unacknowledged.
    pub(super) fn next(&mut self) -> Option<Message> {
        if self.given.len() + self.sent.len() >= WINDOW {
            return None;
        }
        let state = self.states.iter_mut().find(|(_, state)| state.is_new);
        let message = match state {
            Some((topic, state)) => {
                state.is_new = false;
                Message {
                    topic: topic.clone(),
                    payload: state.payload.clone(),
                    is_retained: true,
                }
            }
            None => self.events.pop_front()?,
        };
        self.given.push_back(message.clone());
        Some(message)
    }

    /// The connection sent the oldest message given to it under this number.
    pub(super) fn numbered(&mut self, number: u16) {
        if let Some(message) = self.given.pop_front() {
            self.sent.push_back(SentMessage { number, message });
        }
    }

    /// The broker has the message with this number. Returns false if there is none.
    pub(super) fn acknowledged(&mut self, number: u16) -> bool {
        let Some(place) = self.sent.iter().position(|sent| sent.number == number) else {
            return false;
        };
        self.sent.remove(place);
        true
    }

    /// The connection is lost: what was not acknowledged is sent again, and all states, which a broker may have forgotten.
    /// Returns how many events were given up.
    pub(super) fn disconnected(&mut self) -> u64 {
        let sent = take(&mut self.sent).into_iter().map(|sent| sent.message);
        let unacknowledged = sent.chain(take(&mut self.given));
        let mut events: VecDeque<_> =
            unacknowledged.filter(|message| !message.is_retained).collect();
        events.append(&mut self.events);
        let too_many = events.len().saturating_sub(MOST_EVENTS);
        events.drain(..too_many);
        self.events = events;
        for state in self.states.values_mut() {
            state.is_new = true;
        }
        too_many as u64
    }

    /// The number of events that wait.
    pub(super) fn waiting(&self) -> usize {
        self.events.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(mailbox: &mut Mailbox, number: usize) -> u64 {
        mailbox.tell("event".to_owned(), number.to_string())
    }

    /// Gives messages to the connection until none follows; returns their payloads.
    fn given(mailbox: &mut Mailbox) -> Vec<String> {
        std::iter::from_fn(|| mailbox.next()).map(|message| message.payload).collect()
    }

    #[test]
    fn a_state_is_sent_once_and_only_its_newest_value() {
        let mut mailbox = Mailbox::default();
        for payload in ["OFF", "ON", "ON"] {
            mailbox.set("car".to_owned(), payload.to_owned());
        }
        told(&mut mailbox, 1);
        assert_eq!(given(&mut mailbox), ["ON", "1"], "states first");
        mailbox.set("car".to_owned(), "ON".to_owned());
        assert_eq!(given(&mut mailbox), [""; 0]);
    }

    #[test]
    fn the_oldest_of_too_many_events_are_given_up_and_counted() {
        let mut mailbox = Mailbox::default();
        let mut lost = 0;
        for number in 0..MOST_EVENTS + 3 {
            lost += told(&mut mailbox, number);
        }
        assert_eq!(lost, 3);
        assert_eq!(mailbox.waiting(), MOST_EVENTS);
        assert_eq!(given(&mut mailbox)[0], "3");
    }

    #[test]
    fn no_more_than_a_window_is_unacknowledged() {
        let mut mailbox = Mailbox::default();
        for number in 0..2 * WINDOW {
            assert_eq!(told(&mut mailbox, number), 0);
        }
        assert_eq!(given(&mut mailbox).len(), WINDOW);
        mailbox.numbered(7);
        assert_eq!(given(&mut mailbox), [""; 0]);
        assert!(mailbox.acknowledged(7));
        assert!(!mailbox.acknowledged(7), "once only");
        assert_eq!(given(&mut mailbox), [WINDOW.to_string()]);
    }

    #[test]
    fn after_a_lost_connection_events_without_an_answer_come_first_and_in_order() {
        let mut mailbox = Mailbox::default();
        mailbox.set("car".to_owned(), "ON".to_owned());
        for number in 0..4 {
            assert_eq!(told(&mut mailbox, number), 0);
        }
        assert_eq!(given(&mut mailbox), ["ON", "0", "1", "2", "3"]);
        // Numbers begin again after the largest.
        for number in [99, 100, 1] {
            mailbox.numbered(number);
        }
        assert!(mailbox.acknowledged(100), "event 0");
        told(&mut mailbox, 4);
        assert_eq!(mailbox.disconnected(), 0);
        assert_eq!(given(&mut mailbox), ["ON", "1", "2", "3", "4"]);
    }
}
