//! What is published to every page: by topic, the newest state alone.
//!
//! A page that reads slowly misses states in between and always gets the last one; it
//! costs the publisher nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::Value;
use tokio::sync::watch;

/// The newest state of each topic; clones share it.
#[derive(Clone, Debug)]
pub struct Hub {
    topics: Arc<Mutex<BTreeMap<&'static str, Published>>>,
    changes: Arc<watch::Sender<u64>>,
}

/// The newest state of a topic.
#[derive(Clone, Debug, PartialEq)]
pub struct Published {
    /// Counts all publications of the hub up; a page remembers the last one it has sent.
    pub number: u64,
    /// As JSON.
    pub state: Arc<Value>,
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            topics: Arc::default(),
            changes: Arc::new(watch::Sender::new(0)),
        }
    }
}

impl Hub {
    /// Replaces the state of a topic. Never waits for a reader.
    pub fn publish(&self, topic: &'static str, state: Value) {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        self.changes.send_modify(|number| {
            *number += 1;
            let published = Published {
                number: *number,
                state: Arc::new(state),
            };
            topics.insert(topic, published);
        });
    }

    /// Wakes with the number of each publication.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// The topics that were published after this number, 0 for all, oldest first.
    pub fn newer_than(&self, number: u64) -> Vec<(&'static str, Published)> {
        let topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        let mut newer: Vec<_> = topics
            .iter()
            .filter(|(_, published)| published.number > number)
            .map(|(topic, published)| (*topic, published.clone()))
            .collect();
        newer.sort_by_key(|(_, published)| published.number);
        newer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_reader_gets_the_newest_state_of_each_topic() {
        let hub = Hub::default();
        let mut changes = hub.changes();
        hub.publish("bench", 1.into());
        hub.publish("capture", "a".into());
        hub.publish("bench", 2.into());
        assert!(changes.has_changed().unwrap());
        assert_eq!(*changes.borrow_and_update(), 3);
        let newer = |number| -> Vec<(&str, Value)> {
            let newer = hub.newer_than(number).into_iter();
            newer
                .map(|(topic, published)| (topic, (*published.state).clone()))
                .collect()
        };
        assert_eq!(newer(0), [("capture", "a".into()), ("bench", 2.into())]);
        assert_eq!(newer(2), [("bench", 2.into())]);
        assert!(newer(3).is_empty());
    }
}
