//! Advice on batches.

use super::{for_error, for_io, for_line_break};
use crate::batch::BatchError;

pub(super) fn for_batch(error: &BatchError) -> Option<String> {
    use BatchError::*;
    let advice = match error {
        Io { source, .. } => return for_io(source),
        Session { source, .. } => return for_error(&**source),
        Syntax { .. } => {
            "a list is TOML: `fit` for all, and for each session `[[job]]` with `session` and, where it differs, `fit`"
        }
        Empty => "name the sessions, or a list of them with --list",
        ForeignFolder { .. } => "give a folder with --out that is empty or does not exist",
        NoBatch { .. } => "`rig batch new SESSIONS… --out DIR` makes one",
        OtherVersion { then, .. } => {
            return Some(format!(
                "complete it with rig {then}, or begin another batch in a folder of its own"
            ));
        }
        OtherJobs { .. } => {
            "give the earlier sessions and options, or another --out; `rig batch run DIR` completes what is there"
        }
        Duplicate { .. } => "name each session once; other options need a batch of their own",
        Incomplete { session, .. } => {
            return Some(format!(
                "`rig capture --resume {}` captures the rest; or leave it out",
                session.display()
            ));
        }
        Options { .. } => {
            "`rig fit --help` explains the options; `--pose`, `--out` and the like belong to single fits"
        }
        OtherSession { .. } => "put the session back, or begin another batch",
        OtherOptions { .. } => {
            "a mask, a dictionary or jobs.toml has changed since: put it back, or begin another batch"
        }
        Record { .. } => "remove the file: the job finds its fit again",
        NoSuchJob { .. } => "jobs are counted from 1",
        Memory { fitting, .. } => {
            return Some(format!(
                "`--parallel {fitting}` would do; `--fit \"--memory MIB\"` bounds each fit"
            ));
        }
        Tasks { .. } => "clusters refuse larger arrays; a task does as many jobs as it has to",
        Script(error) => return Some(for_line_break(error)),
        Page(_) => return None,
    };
    Some(advice.into())
}
