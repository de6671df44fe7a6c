//! What a page may do with a session: fit it anew, export a fit.
//!
//! Exports are no files of the session, whose folder has nothing but what its journal names:
//! they stand in a hidden folder next to the sessions.

use std::ffi::OsString;
use std::path::PathBuf;

use axum::Router;
use axum::extract::{Path, State};
use axum::routing::post;
use serde::Deserialize;
use serde_json::json;

use super::files::{EXPORTS_FOLDER, EXPORTS_ROOT};
use crate::beneath;
use crate::catalogue::row::check_name;
use crate::console::blocking::blocking;
use crate::console::control::Controlled;
use crate::console::jobs::{Jobs, Kind, Work};
use crate::console::refusal::{Accepted, Refusal, accepted};
use crate::console::request::Asked;
use crate::export::Format;
use crate::session::layout::FITS_FOLDER;

/// `api/sessions/NAME/fit` and `api/sessions/NAME/export`.
pub fn action_routes(jobs: Jobs) -> Router {
    Router::new()
        .route("/api/sessions/{name}/fit", post(fit))
        .route("/api/sessions/{name}/export", post(export))
        .with_state(jobs)
}

/// Options of a fit. Whether their values are right decides `rig fit`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct FitForm {
    dictionary: Option<String>,
    model_error: Option<f64>,
    refine_bench: Option<bool>,
    shared_weights: Option<bool>,
    seed: Option<u64>,
}

impl FitForm {
    /// Values stand behind `=` and are never read as options.
    fn arguments(&self) -> Vec<OsString> {
        let options = [
            ("--dictionary", self.dictionary.clone()),
            ("--model-error", self.model_error.map(|e| e.to_string())),
            ("--refine-bench", self.refine_bench.map(|is| is.to_string())),
            ("--seed", self.seed.map(|seed| seed.to_string())),
        ];
        let given = options.into_iter();
        let mut arguments: Vec<OsString> = given
            .filter_map(|(name, value)| Some(format!("{name}={}", value?).into()))
            .collect();
        if self.shared_weights == Some(true) {
            arguments.push("--shared-weights".into());
        }
        arguments
    }
}

async fn fit(
    State(jobs): State<Jobs>,
    Path(name): Path<String>,
    _: Controlled,
    Asked(form): Asked<FitForm>,
) -> Accepted {
    start(jobs, move |jobs| {
        let session = session(jobs, &name)?;
        let mut arguments = vec!["fit".into(), session.into_os_string()];
        arguments.extend(form.arguments());
        Ok(Work {
            hidden: vec!["--events".into()],
            session: Some(name),
            ..Work::new(Kind::Fit, arguments)
        })
    })
    .await
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExportForm {
    fit: String,
    format: String,
}

/// The formats of `rig export` by their names there, with the usual ending of their files.
fn formats() -> impl Iterator<Item = (&'static str, &'static str)> {
    let of_any_fit = Format::ALL.map(|(name, format)| (name, format.ending()));
    of_any_fit.into_iter().chain([("birdf", "json")])
}

async fn export(
    State(jobs): State<Jobs>,
    Path(name): Path<String>,
    _: Controlled,
    Asked(form): Asked<ExportForm>,
) -> Accepted {
    start(jobs, move |jobs| {
        // What is exported.
        let session = session(jobs, &name)?;
        let named = formats().find(|(named, _)| *named == form.format);
        let Some((format, ending)) = named else {
            let format = form.format;
            return Err(Refusal::bad(format!("there is no format {format:?}")));
        };
        let Ok(number) = form.fit.parse::<u32>() else {
            let fit = form.fit;
            return Err(Refusal::bad(format!("fit {fit:?} is no number")));
        };
        let fit = session.join(FITS_FOLDER).join(number.to_string());

        // Where to.
        let file = format!("fit-{number}-{format}.{ending}");
        let folder = jobs.program().folder.join(EXPORTS_ROOT).join(&name);
        std::fs::create_dir_all(&folder)
            .map_err(|error| Refusal::failed(format!("{}: {error}", folder.display())))?;
        let arguments = vec![
            "export".into(),
            fit.into_os_string(),
            format!("--format={format}").into(),
            "--out".into(),
            folder.join(&file).into_os_string(),
        ];
        Ok(Work {
            download: Some(format!("sessions/{name}/{EXPORTS_FOLDER}/{file}")),
            session: Some(name),
            ..Work::new(Kind::Export, arguments)
        })
    })
    .await
}

/// Starts the work that `of` describes.
async fn start(
    jobs: Jobs,
    of: impl FnOnce(&Jobs) -> Result<Work, Refusal> + Send + 'static,
) -> Accepted {
    let command = blocking(move || {
        let work = of(&jobs)?;
        jobs.start(work).map_err(Refusal::from)
    });
    let command = command.await??;
    accepted(json!({"command": command}))
}

/// The folder of a session that no link leads to.
fn session(jobs: &Jobs, name: &str) -> Result<PathBuf, Refusal> {
    let folder = &jobs.program().folder;
    let checked = check_name(name).and_then(|()| beneath::check_folder(folder, name));
    match checked {
        // It is an argument of a command, and no option.
        Ok(()) if !name.starts_with('-') => Ok(folder.join(name)),
        _ => Err(Refusal::missing(format!("there is no session {name:?}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_offers_all_formats() {
        let page = include_str!("../page/session.js");
        let (_, list) = page.split_once("const FORMATS = [").unwrap();
        let (list, _) = list.split_once("];").unwrap();
        let offered: Vec<_> = list
            .lines()
            .filter_map(|line| line.split('"').nth(1))
            .collect();
        let known: Vec<_> = formats().map(|(name, _)| name).collect();
        assert_eq!(offered, known);
    }

    #[test]
    fn a_form_becomes_options_that_cannot_be_taken_for_others() {
        let form: FitForm = serde_json::from_value(json!({
            "dictionary": "--out", "model_error": 0.05, "refine_bench": false,
            "shared_weights": true, "seed": 3
        }))
        .unwrap();
        let expected = [
            "--dictionary=--out",
            "--model-error=0.05",
            "--refine-bench=false",
            "--seed=3",
            "--shared-weights",
        ];
        assert_eq!(form.arguments(), expected.map(OsString::from));
        assert!(serde_json::from_value::<FitForm>(json!({"out": "/x"})).is_err());
        assert!(FitForm::default().arguments().is_empty());
    }
}
