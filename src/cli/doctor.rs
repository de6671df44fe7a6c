//! `rig doctor`: everything that can be checked without moving or lighting
//! anything, each with its remedy.

use serde::Serialize;

use super::capture_notices::{for_record, for_warm_up};
use super::context::Context;
use super::error::CliError;
use super::output::{write_json, write_line};
use super::rig_choice::RigArg;
use super::{hints, preflight};
use crate::doctor::{Check, Trouble, Verdict, examine};

/// Checks configuration, devices, permissions, disk and calibration
///
/// Nothing moves and no port is opened. Exit code 1 if a check fails; warnings don't count.
#[derive(clap::Args, Debug)]
pub struct DoctorArgs {
    #[command(flatten)]
    rig: RigArg,
    /// The checks as JSON
    #[arg(long)]
    json: bool,
}

/// A check as it is shown.
#[derive(Serialize)]
struct Line {
    name: &'static str,
    verdict: Verdict,
    fact: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<String>,
}

#[derive(Serialize)]
struct Findings {
    verdict: Verdict,
    checks: Vec<Line>,
}

/// `rig doctor`.
pub fn run(args: &DoctorArgs, context: &Context) -> Result<(), CliError> {
    let rig = match args.rig.resolve(context) {
        Ok(rig) => rig,
        // Nothing else can be checked, so the command's own error says it all.
        Err(error) => {
            if args.json {
                let line = Line {
                    name: "configuration",
                    verdict: Verdict::Failed,
                    fact: error.fact().to_owned(),
                    remedy: Some(error.advice().unwrap_or_default().to_owned()),
                };
                report(vec![line], true)?;
            }
            return Err(error);
        }
    };
    let checks = examine(&rig).into_iter();
    let lines = checks.map(|check| Line {
        remedy: remedy(&check),
        name: check.name,
        verdict: check.verdict,
        fact: check.fact,
    });
    let failed = report(lines.collect(), args.json)?;
    match failed {
        0 => Ok(()),
        1 => Err(CliError::new("1 check failed").hint(REMEDIES)),
        n => Err(CliError::new(format!("{n} checks failed")).hint(REMEDIES)),
    }
}

/// Where to look, once the checks are printed.
const REMEDIES: &str = "what to do stands after the arrow of each check above that FAILED";

/// Prints the checks and returns how many failed.
fn report(checks: Vec<Line>, json: bool) -> Result<usize, CliError> {
    let failed = |check: &&Line| check.verdict == Verdict::Failed;
    let failed = checks.iter().filter(failed).count();
    if json {
        let verdict = checks.iter().map(|check| check.verdict).max();
        let verdict = verdict.unwrap_or(Verdict::Ok);
        write_json(&Findings { verdict, checks })?;
    } else {
        checks.iter().try_for_each(print)?;
    }
    Ok(failed)
}

fn print(check: &Line) -> Result<(), CliError> {
    let verdict = match check.verdict {
        Verdict::Ok => "ok     ",
        Verdict::Warning => "warning",
        Verdict::Failed => "FAILED ",
    };
    write_line(format_args!("{verdict}  {:<14} {}", check.name, check.fact))?;
    if let Some(remedy) = &check.remedy {
        write_line(format_args!("{:24} -> {remedy}", ""))?;
    }
    Ok(())
}

/// What to do about it.
fn remedy(check: &Check) -> Option<String> {
    use Trouble::*;
    let remedy = match check.trouble.as_ref()? {
        Error(error) => {
            let otherwise = match check.name {
                "camera" | "stage" => "",
                "view" | "light paths" => "correct [geometry] in the rig file",
                "depth of field" => "correct [geometry.sample]",
                _ => "calibrate anew",
            };
            return Some(hints::for_error(&**error).unwrap_or_else(|| otherwise.to_owned()));
        }
        Unused => {
            "to use them, write a rig file (rig-configs/grbl-arm-v4l2.toml is a start) and name it with --rig"
        }
        WithoutFeature(feature) => return Some(format!("build it with the feature `{feature}`")),
        NoDeviceFile => "check the cable and the rig file; `rig devices` lists what is connected",
        NoAccess => {
            "add yourself to the group that owns it (`sudo usermod -aG dialout,video $USER`) and log in again"
        }
        InUse => "end that process first",
        NameChanges { lasting } => return Some(format!("name it by its link in {lasting}")),
        NoWatchdog => {
            "fit a hardware emergency stop, and don't leave a capture alone with a lamp that can do harm"
        }
        LampNotReported => "look at the lamp before you reach into the bench",
        ReadOnly => OTHER_FOLDER,
        NoSession(error) => {
            return Some(hints::for_error(error).unwrap_or_else(|| OTHER_FOLDER.to_owned()));
        }
        Lacking => {
            "sessions work there with that; for all of it, put them on a local disk (`rig capture --out`)"
        }
        SpaceUnknown => {
            "see to it that there is enough: a capture cannot stop before the disk is full"
        }
        DiskFull => "free some space, or lower capture.disk_reserve_mb in the rig file",
        DiskFails => "run in another folder",
        FewFiles => {
            "remove some files there (`df -i` counts them), or give `rig capture` another disk with --out"
        }
        NoRecord(kind) => return Some(format!("run `rig calibrate {}`", kind.command())),
        OldRecord { kind, concern } => return Some(for_record(*kind, concern)),
        WarmUp { needed_s } => return Some(for_warm_up(*needed_s)),
        OutOfReach => {
            "correct [geometry.sample_from_stage] or the limits of [stage] in the rig file"
        }
        Scene(concern) => return Some(preflight::remedy_of(concern)),
        Mesh(remark) => return Some(format!("repair the mesh where it was made: {remark}")),
        AllBlocked => "correct [geometry.camera] body, or the limits of [stage] in the rig file",
        SomeBlocked => {
            "move the camera farther away, take a slimmer lens, or leave those lights out of the rig file"
        }
        Blurred => preflight::FOR_BLUR,
    };
    Some(remedy.to_owned())
}

const OTHER_FOLDER: &str = "run in another folder, or give `rig capture` one with --out";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::DeviceError;

    #[test]
    fn a_check_has_the_advice_of_its_error() {
        let error = DeviceError::of_address("bench:23").unwrap();
        let check = Check {
            name: "stage",
            verdict: Verdict::Failed,
            fact: error.to_string(),
            trouble: Some(Trouble::Error(Box::new(error))),
        };
        assert!(remedy(&check).unwrap().contains("tcp:bench:23"));
    }
}
