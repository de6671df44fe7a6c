//! Advice on experiments.

use super::{for_brdf, for_fit, for_io, for_mesh, nearest};
use crate::evaluate::experiment::EvaluateError;
use crate::evaluate::lab::materials;

pub(super) fn for_evaluate(error: &EvaluateError) -> Option<String> {
    use EvaluateError::*;
    let advice = match error {
        UnknownExperiment { name, known } => {
            let known: Vec<String> = known.split(", ").map(str::to_owned).collect();
            return Some(match nearest(name, &known) {
                Some(near) => {
                    format!("did you mean `{near}`? `rig evaluate --list` says what each shows")
                }
                None => "`rig evaluate --list` says what each shows".into(),
            });
        }
        UnknownMaterial { spec, .. } => return Some(for_material(spec)),
        Unused { .. } => "leave the option out: this experiment has nothing that it could change",
        SettingsChanged { .. } => {
            "give the earlier settings or another --out, or start anew with --restart"
        }
        ForeignFolder { .. } => "give a folder that is empty or does not exist",
        Locked { .. } => "wait for it, or give another --out",
        Journal { .. } => "start anew with --restart",
        NoSuchCase { .. } => {
            "names are made of the material, the shape and the like, as the first is"
        }
        NoMaterial { .. } => "name one with --materials",
        SameName { .. } => "name each material once; files of one name need another",
        Io { source, .. } => return for_io(source),
        // Those with a source of their own are asked for it; these have it folded in.
        Brdf(error) => return for_brdf(error),
        Fit(error) => return for_fit(error),
        Mesh(error) => return for_mesh(error),
        _ => return None,
    };
    Some(advice.into())
}

/// What a misspelt material may have meant: a name without its kind, or one that differs little.
fn for_material(spec: &str) -> String {
    let known = materials::specs();
    let bare = known.iter().find(|other| {
        let name = other.split_once(':').map_or("", |(_, name)| name);
        name == spec
    });
    match bare.map(String::as_str).or_else(|| nearest(spec, &known)) {
        Some(near) => format!("did you mean `{near}`? A file needs its path"),
        None => {
            "a file needs its path and the ending of its kind; the names are listed above".into()
        }
    }
}
