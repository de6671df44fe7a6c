//! Where the records of a calibration go, and how they are shown.

use std::path::PathBuf;

use jiff::Timestamp;
use serde::Serialize;

use crate::calibrating::{CalibratingError, Kept, Place};
use crate::cli::bracket_files;
use crate::cli::output::{write_json, write_path};
use crate::cli::rig_choice::RigArg;
use crate::cli::{CliError, Context};
use crate::config::ResolvedRig;

#[derive(clap::Args, Debug)]
pub(super) struct CommonArgs {
    #[command(flatten)]
    pub rig: RigArg,
    /// Folder of the rig's records; the record goes into its folder of that kind
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Name of the record; the date and the kind if not given
    #[arg(long, value_name = "ID")]
    pub id: Option<String>,
    /// Time of the measurement (UTC, RFC 3339); now if not given
    #[arg(long, value_name = "TIME", hide = true)]
    pub date: Option<Timestamp>,
    /// How long the record may be used (days; default: no end, and a warning when it is old)
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=36_500))]
    valid_days: Option<u32>,
    /// What was found, as JSON
    #[arg(long)]
    pub json: bool,
    /// Progress and questions as JSON lines on stdout, answers as lines on stdin
    #[arg(long, hide = true, conflicts_with = "json")]
    pub events: bool,
}

/// A record's file, and what was found.
#[derive(Serialize)]
struct Found<'a, T> {
    record: String,
    #[serde(flatten)]
    found: &'a T,
}

impl CommonArgs {
    /// Where the records go; files can be made there.
    pub fn place(&self, rig: &ResolvedRig, context: &Context) -> Result<Place, CliError> {
        let mut place = Place::of_rig(rig, self.out.as_deref());
        if place.instead_of_built_in {
            context.note(format_args!(
                "built-in records stay as they are: writing to {}",
                place.library.place()
            ));
        }
        place.check()?;
        place.measurement.id = self.id.clone();
        place.measurement.date = self.date.unwrap_or(place.measurement.date);
        place.measurement.valid_days = self.valid_days;
        Ok(place)
    }

    /// The record's path, or what was found as JSON, on stdout.
    pub fn show<T: Serialize>(&self, kept: &Kept, found: &T) -> Result<(), CliError> {
        if !self.json {
            return write_path(&kept.record);
        }
        write_json(&Found {
            record: kept.record.display().to_string(),
            found,
        })
    }
}

/// Notes where the record's figure is.
pub(super) fn noted(kept: Kept, context: &Context) -> Kept {
    if let Some(figure) = &kept.figure {
        context.note(format_args!("figure: {}", figure.display()));
    }
    kept
}

/// The error with advice on what was named.
pub(super) fn advised(error: CalibratingError) -> CliError {
    match error {
        CalibratingError::Frames(error) => bracket_files::advised(error),
        CalibratingError::OtherRig { ref of, .. } => {
            let hint = format!("name the session's rig: `--rig {of}`");
            CliError::from(error).hint(hint)
        }
        CalibratingError::NoLight { lights, .. } => {
            CliError::from(error).hint(format!("--light counts from 1 to {lights}"))
        }
        CalibratingError::NoAngles => {
            CliError::from(error).hint("capture the sphere with `rig capture` and name the session")
        }
        CalibratingError::ImageCount { .. } => CliError::from(error).hint(
            "name one image per light, in the order of the rig file's [[stage.light]] tables",
        ),
        error => error.into(),
    }
}
