//! Everything about a bench that can be checked without moving or lighting anything.
//!
//! It never opens a port: opening one resets many controllers.

mod devices;
mod disk;
mod records;
mod view;

use std::error::Error;
use std::path::Path;

use serde::Serialize;

use crate::calibration::Library;
use crate::calibration::fitness::Concern;
use crate::calibration::record::Kind;
use crate::config::ResolvedRig;
use crate::config::scene_concern::SceneConcern;
use crate::session::layout::SESSIONS_FOLDER;

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum Verdict {
    Ok,
    Warning,
    Failed,
}

/// One check.
#[derive(Debug)]
pub struct Check {
    /// What was checked, in a word or two.
    pub name: &'static str,
    /// How it ended.
    pub verdict: Verdict,
    /// What is the case.
    pub fact: String,
    /// What kind of trouble it is, unless all is well.
    pub trouble: Option<Trouble>,
}

/// What stands against a bench.
#[derive(Debug)]
#[allow(missing_docs)]
pub enum Trouble {
    /// Something else refuses it.
    Error(Box<dyn Error + Send + Sync>),
    /// Devices are connected, and the simulated rig stands in.
    Unused,
    /// The program was built without this feature.
    WithoutFeature(&'static str),
    /// A device file that is not there, may not be opened, or is in use.
    NoDeviceFile,
    NoAccess,
    InUse,
    /// A name that changes; those in this folder last.
    NameChanges {
        lasting: &'static str,
    },
    /// Nothing turns the lamp off where this program cannot.
    NoWatchdog,
    /// Nothing reports the lamp.
    LampNotReported,
    /// The folder of the sessions.
    ReadOnly,
    NoSession(std::io::Error),
    Lacking,
    SpaceUnknown,
    DiskFull,
    DiskFails,
    FewFiles,
    /// A record that is not there, should be measured anew, or is refused.
    NoRecord(Kind),
    OldRecord {
        kind: Kind,
        concern: Concern,
    },
    WarmUp {
        needed_s: f64,
    },
    /// No light within reach lights what the camera sees.
    OutOfReach,
    Scene(Box<SceneConcern>),
    /// A remark on the mesh.
    Mesh(String),
    /// The camera's body blocks all directions, or some of fixed lights.
    AllBlocked,
    SomeBlocked,
    Blurred,
}

impl Check {
    fn ok(name: &'static str, fact: impl Into<String>) -> Self {
        Self {
            name,
            verdict: Verdict::Ok,
            fact: fact.into(),
            trouble: None,
        }
    }

    fn warning(name: &'static str, fact: impl Into<String>, trouble: Trouble) -> Self {
        Self {
            verdict: Verdict::Warning,
            trouble: Some(trouble),
            ..Self::ok(name, fact)
        }
    }

    fn failed(name: &'static str, fact: impl Into<String>, trouble: Trouble) -> Self {
        Self {
            verdict: Verdict::Failed,
            ..Self::warning(name, fact, trouble)
        }
    }

    /// What something else refuses.
    fn refused(name: &'static str, error: impl Error + Send + Sync + 'static) -> Self {
        Self::failed(name, error.to_string(), Trouble::Error(Box::new(error)))
    }
}

/// Checks configuration, devices, disk, calibration and view of a rig.
pub fn examine(rig: &ResolvedRig) -> Vec<Check> {
    let mut checks = devices::checks(rig);
    let sessions = Path::new(SESSIONS_FOLDER);
    let place = match sessions.is_dir() {
        true => sessions,
        false => Path::new("."),
    };
    checks.extend(disk::checks(rig, place));
    let library = Library::of_rig(rig);
    checks.extend(records::checks(rig, &library));
    checks.extend(view::checks(rig, &library));
    checks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Surroundings, resolve_rig};

    #[test]
    fn nothing_of_the_simulated_bench_fails() {
        let rig = resolve_rig(Some("simulated"), &Surroundings::of_process(), Vec::new).unwrap();
        let checks = examine(&rig);
        let failed = checks.iter().find(|check| check.verdict == Verdict::Failed);
        assert!(failed.is_none(), "{failed:?}");
        // Its records are built into the program, so no check may advise to record more.
        let lacks = |check: &&Check| matches!(check.trouble, Some(Trouble::NoRecord(_)));
        let lacking = checks.iter().find(lacks);
        assert!(lacking.is_none(), "{lacking:?}");
        for name in [
            "configuration",
            "disk space",
            "sensor",
            "view",
            "depth of field",
        ] {
            assert!(checks.iter().any(|check| check.name == name), "{name}");
        }
    }
}
