//! What a page may do with a session: fit it anew, export a fit.

use std::ffi::OsString;
use std::path::{Path as FilePath, PathBuf};

use axum::Router;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::routing::post;
use serde::Deserialize;
use serde_json::json;

use super::exports::{self, EXPORTS_FOLDER};
use crate::beneath;
use crate::brdf::Dictionary;
use crate::catalogue::row::check_name;
use crate::console::blocking::blocking;
use crate::console::control::Controlled;
use crate::console::jobs::{Jobs, Kind, Work};
use crate::console::refusal::{Accepted, Refusal, accepted};
use crate::console::request::Asked;
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
    ///
    /// # Errors
    /// A dictionary that is neither built in nor a file below the folder of sessions, to which
    /// no link leads.
    fn arguments(&self, folder: &FilePath) -> Result<Vec<OsString>, Refusal> {
        let options = [
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
        if let Some(named) = &self.dictionary {
            let mut argument = OsString::from("--dictionary=");
            if Dictionary::NAMES.contains(&named.as_str()) {
                argument.push(named);
            } else if beneath::open(folder, named).is_ok() {
                argument.push(folder.join(named));
            } else {
                let fact = format!(
                    "{named:?} is no dictionary of the program's own, and no file below the folder of sessions"
                );
                let hint = format!(
                    "take one of {}, or put the file there",
                    Dictionary::NAMES.join(", ")
                );
                return Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact).hint(hint));
            }
            arguments.push(argument);
        }
        Ok(arguments)
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
        arguments.extend(form.arguments(&jobs.program().folder)?);
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

async fn export(
    State(jobs): State<Jobs>,
    Path(name): Path<String>,
    _: Controlled,
    Asked(form): Asked<ExportForm>,
) -> Accepted {
    start(jobs, move |jobs| {
        // What is exported.
        session(jobs, &name)?;
        let Ok(number) = form.fit.parse::<u32>() else {
            let fit = form.fit;
            return Err(Refusal::bad(format!("fit {fit:?} is no number")));
        };
        let format = form.format;
        let Some(files) = exports::files(number, &format) else {
            return Err(Refusal::bad(format!("there is no format {format:?}")));
        };
        let sessions = &jobs.program().folder;
        let fit = format!("{name}/{FITS_FOLDER}/{number}");
        beneath::check_folder(sessions, &fit)
            .map_err(|_| Refusal::missing(format!("the session has no fit {number}")))?;

        // Where to.
        let folder =
            exports::folder(sessions, &name).map_err(|error| Refusal::failed(error.to_string()))?;
        let arguments = vec![
            "export".into(),
            sessions.join(fit).into_os_string(),
            format!("--format={format}").into(),
            "--out".into(),
            folder.join(&files[0]).into_os_string(),
        ];
        let address = |file| format!("sessions/{name}/{EXPORTS_FOLDER}/{file}");
        Ok(Work {
            downloads: files.into_iter().map(address).collect(),
            session: Some(name.clone()),
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
    fn a_form_becomes_options_that_cannot_be_taken_for_others() {
        let form: FitForm = serde_json::from_value(json!({
            "dictionary": "rig26", "model_error": 0.05, "refine_bench": false,
            "shared_weights": true, "seed": 3
        }))
        .unwrap();
        let expected = [
            "--model-error=0.05",
            "--refine-bench=false",
            "--seed=3",
            "--shared-weights",
            "--dictionary=rig26",
        ];
        let folder = tempfile::tempdir().unwrap();
        let arguments = |form: &FitForm| form.arguments(&folder.path().join("sessions"));
        assert_eq!(arguments(&form).unwrap(), expected.map(OsString::from));
        assert!(serde_json::from_value::<FitForm>(json!({"out": "/x"})).is_err());
        assert!(arguments(&FitForm::default()).unwrap().is_empty());

        // Files of dictionaries stand below the folder of sessions.
        std::fs::create_dir(folder.path().join("sessions")).unwrap();
        std::fs::write(folder.path().join("outside.toml"), "secret = 1").unwrap();
        std::fs::write(folder.path().join("sessions/own.toml"), "").unwrap();
        std::os::unix::fs::symlink("../outside.toml", folder.path().join("sessions/link.toml"))
            .unwrap();
        let named = |dictionary: &str| {
            let dictionary = Some(dictionary.to_owned());
            arguments(&FitForm {
                dictionary,
                ..FitForm::default()
            })
        };
        assert_eq!(named("own.toml").unwrap().len(), 1);
        let outside = folder.path().join("outside.toml").display().to_string();
        for bad in [
            &*outside,
            "../outside.toml",
            "link.toml",
            "--out",
            "",
            "none.toml",
        ] {
            let refused = named(bad).unwrap_err();
            assert_eq!(refused.status, StatusCode::UNPROCESSABLE_ENTITY, "{bad}");
        }
    }
}
