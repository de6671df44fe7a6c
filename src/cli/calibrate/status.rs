//! `rig calibrate status`: every record in force, at a glance.

use jiff::Timestamp;
use serde::Serialize;

use crate::calibration::Library;
use crate::calibration::status::{RecordStatus, State, status};
use crate::cli::output::write_json;
use crate::cli::rig_choice::RigArg;
use crate::cli::{CliError, Context};
use crate::out;

#[derive(clap::Args, Debug)]
pub(super) struct StatusArgs {
    #[command(flatten)]
    rig: RigArg,
    /// The same as JSON
    #[arg(long)]
    json: bool,
}

/// A record's status, and what to do about it.
#[derive(Serialize)]
struct Line {
    #[serde(flatten)]
    status: RecordStatus,
    /// What to run, where there is no record that can be used without concern.
    run: Option<String>,
}

#[derive(Serialize)]
struct Report {
    rig: String,
    library: String,
    records: Vec<Line>,
}

pub(super) fn run(args: &StatusArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.rig.resolve(context)?;
    let library = Library::of_rig(&rig);
    let records = status(&rig.config, &library, Timestamp::now());
    let records: Vec<Line> = records
        .into_iter()
        .map(|status| Line {
            run: (status.needs_calibration() && !library.is_built_in())
                .then(|| format!("rig calibrate {}", status.kind.command())),
            status,
        })
        .collect();
    if args.json {
        return write_json(&Report {
            rig: rig.config.name.clone(),
            library: library.place(),
            records,
        });
    }
    out!("{}: records in {}", rig.config.name, library.place())?;
    for Line { status, run } in &records {
        let mark = match status.state {
            State::Good => "ok",
            State::Doubtful => "doubtful",
            State::Refused => "refused",
            State::Missing => "none",
        };
        let age = status.age_days.map_or(String::new(), |days| match days {
            days if days < 1.0 => "today".to_owned(),
            days => format!("{days:.0} d"),
        });
        let kind = status.kind.folder();
        out!("{kind:<10} {mark:<9} {age:>6}  {}", status.summary)?;
        for concern in &status.concerns {
            out!("{:<27}  {concern}", "")?;
        }
        if let Some(run) = run {
            out!("{:<27}  run `{run}`", "")?;
        }
    }
    Ok(())
}
