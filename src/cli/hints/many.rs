//! Advice on queues of samples and on what is compared between sessions.

use super::{for_config, for_io};
use crate::catalogue::reproducibility::ReproducibilityError;
use crate::config::ConfigError;
use crate::queue::QueueError;

/// Instead of advice on rig files.
const SAMPLES: &str = "the list has a table [[sample]] for each sample: name, and where wanted material, comment, lights or light, repeats, again";

pub(super) fn for_queue(error: &QueueError) -> Option<String> {
    Some(match error {
        QueueError::List(inner) => return for_list(inner),
        QueueError::Taken(_) => {
            "choose another name; one more measurement of the same sample has `again = true`; --out names another folder".into()
        }
        QueueError::Journal { .. } => {
            "restore the queue's journal from a copy, or remove it to begin anew with other names or another --out".into()
        }
        QueueError::Locked { .. } => "one process at a time goes through a queue: end the other one first".into(),
        QueueError::Io { source, .. } => return for_io(source),
    })
}

fn for_list(error: &ConfigError) -> Option<String> {
    match error {
        ConfigError::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            Some(SAMPLES.to_owned())
        }
        ConfigError::Read { .. } | ConfigError::Syntax { .. } => Some(for_config(error)),
        _ => Some(SAMPLES.to_owned()),
    }
}

pub(super) fn for_reproducibility(error: &ReproducibilityError) -> String {
    match error {
        ReproducibilityError::TooFew { .. } => {
            "capture the sample again, taken off the bench and put back in between, and fit each session"
        }
        ReproducibilityError::NoCommonAngles { .. } => {
            "fit the sessions anew with one version and one dictionary"
        }
    }
    .to_owned()
}
