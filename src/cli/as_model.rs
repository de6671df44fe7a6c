//! What is said of a material that was written in another program's model.

use std::path::Path;

use super::brdf::spec::load;
use super::output::{self, unwritable};
use super::{CliError, Context};
use crate::export::{self, ExportError, Exported, LARGEST_ERROR, ModelFormat, Subject};
use crate::session::fit_record;

/// Makes a file, which may take some seconds, and says so at a terminal meanwhile.
pub fn waiting<T>(file: &Path, context: &Context, work: impl FnOnce() -> T) -> T {
    let spinner = context.spinner();
    spinner.set_message(format!("making {}", file.display()));
    let done = work();
    spinner.finish_and_clear();
    done
}

/// Prints the files of an export, and what was lost.
pub fn show(exported: &Exported, context: &Context) -> Result<(), CliError> {
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
    for file in &exported.files {
        output::write_path(file)?;
    }
    Ok(())
}

/// Writes the BRDF that `spec` names in a program's model.
pub fn convert(
    spec: &str,
    format: ModelFormat,
    out: &Path,
    closest: bool,
    context: &Context,
) -> Result<(), CliError> {
    let exported = if Path::new(spec).is_dir() {
        // A fit: the file says where it comes from.
        let record = fit_record::find(Path::new(spec))?;
        waiting(out, context, || {
            export::export_as(&record, None, closest, &format.format(), out)
        })
    } else {
        let brdf = load(spec)?;
        let description = format!("{spec}, by rig {}", env!("CARGO_PKG_VERSION"));
        let subject = Subject {
            brdf: brdf.as_ref(),
            description: &description,
            simulated: false,
            name: None,
            closest,
            out,
        };
        waiting(out, context, || subject.export(format))
    };
    let exported = exported.map_err(|error| match error {
        ExportError::Io { path, source } => unwritable(&path, &source),
        error => error.into(),
    })?;
    show(&exported, context)
}
