//! What is said of a material that was written in another program's model.

use std::path::Path;

use super::brdf::spec::load;
use super::output;
use super::progress::Counting;
use super::{CliError, Context};
use crate::export::{self, ExportError, Exported, LARGEST_ERROR, ModelFormat, Subject};
use crate::progress::Progress;
use crate::session::fit_record;

/// Makes a file, which may take some seconds, with a bar at a terminal; then prints the
/// files, and what was lost.
pub fn make(
    file: &Path,
    context: &Context,
    work: impl FnOnce(&dyn Progress) -> Result<Exported, ExportError>,
) -> Result<(), CliError> {
    let bar = context.spinner();
    bar.set_message(format!("making {}", file.display()));
    let made = work(&Counting(&bar));
    bar.finish_and_clear();
    let exported = made?;
    if let Some(model) = &exported.model {
        for statement in model.statements() {
            context.note(statement);
        }
        if model.is_poor() {
            context.warn(format!(
                "{} does not hold this material: its environment error is above {:.0}%; look at the picture before using the file",
                model.format.name(),
                100.0 * LARGEST_ERROR
            ));
        }
    }
    let mut files = exported.files.iter();
    files.try_for_each(|file| output::write_path(file))
}

/// Writes the BRDF that `spec` names in a program's model.
pub fn convert(
    spec: &str,
    format: ModelFormat,
    out: &Path,
    closest: bool,
    context: &Context,
) -> Result<(), CliError> {
    if Path::new(spec).is_dir() {
        // A fit: the file says where it comes from.
        let record = fit_record::find(Path::new(spec))?;
        return make(out, context, |progress| {
            export::export_as(&record, None, closest, progress, &format.format(), out)
        });
    }
    let brdf = load(spec)?;
    let description = format!("{spec}, by rig {}", env!("CARGO_PKG_VERSION"));
    make(out, context, |progress| {
        let subject = Subject {
            brdf: brdf.as_ref(),
            description: &description,
            simulated: false,
            name: None,
            closest,
            progress,
            out,
        };
        subject.export(format)
    })
}
