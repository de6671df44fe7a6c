//! What a page may do with a session: fit it anew, export a fit, have its certificate written.

use std::ffi::OsString;
use std::path::{Path as FilePath, PathBuf};

use axum::Router;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::routing::post;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::exports::{self, EXPORTS_FOLDER};
use crate::beneath;
use crate::brdf::Dictionary;
use crate::catalogue::row::check_name;
use crate::console::blocking::blocking;
use crate::console::control::Controlled;
use crate::console::jobs::{Jobs, Kind, Work};
use crate::console::refusal::{Accepted, Refusal, accepted};
use crate::console::request::Asked;
use crate::report::certificate::browser::Browser;
use crate::session::layout::FITS_FOLDER;
use crate::workflow::FitRequest;

/// `api/sessions/NAME/fit` and `api/sessions/NAME/export`.
pub fn action_routes(jobs: Jobs) -> Router {
    Router::new()
        .route("/api/sessions/{name}/fit", post(fit))
        .route("/api/sessions/{name}/export", post(export))
        .with_state(jobs)
}

/// Options of a fit by key. Whether their values are right decides `rig fit`.
type FitForm = Map<String, Value>;

/// The options as `rig fit` takes them.
///
/// # Errors
/// What is no option, or names a file; a dictionary that is neither built in nor a file below the
/// folder of sessions, to which no link leads.
fn arguments(form: &FitForm, folder: &FilePath) -> Result<Vec<OsString>, Refusal> {
    let mut arguments = Vec::new();
    for (key, value) in form.iter().filter(|(_, value)| !value.is_null()) {
        let value = match (key.as_str(), value) {
            ("dictionary", Value::String(named)) => Some(dictionary(named, folder)?),
            ("dictionary" | "mask", _) => None,
            (_, Value::String(text)) => Some(text.clone()),
            (_, Value::Bool(_) | Value::Number(_)) => Some(value.to_string()),
            _ => None,
        };
        let words = value.and_then(|value| FitRequest::words(key, &value));
        let Some(words) = words else {
            return Err(Refusal::bad(format!(
                "body: a page gives a fit no option `{key}` with such a value"
            )));
        };
        arguments.extend(words.into_iter().map(OsString::from));
    }
    Ok(arguments)
}

/// A dictionary of the program's own, or a file below the folder of sessions.
fn dictionary(named: &str, folder: &FilePath) -> Result<String, Refusal> {
    if Dictionary::NAMES.contains(&named) {
        return Ok(named.to_owned());
    }
    let known = Dictionary::NAMES.join(", ");
    if beneath::open(folder, named).is_err() {
        let fact = format!(
            "{named:?} is no dictionary of the program's own, and no file below the folder of sessions"
        );
        let hint = format!("take one of {known}, or put the file there");
        return Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact).hint(hint));
    }
    let file = folder.join(named).into_os_string().into_string();
    file.map_err(|_| Refusal::bad("the folder of sessions has a name that is no Unicode"))
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
        arguments.extend(self::arguments(&form, &jobs.program().folder)?);
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
        let is_certificate = format == exports::CERTIFICATE;
        let files = match is_certificate {
            // PDF where a browser of this machine prints.
            true => Some(vec![exports::certificate_file(
                number,
                Browser::find().is_some(),
            )]),
            false => exports::files(number, &format),
        };
        let Some(files) = files else {
            return Err(Refusal::bad(format!("there is no format {format:?}")));
        };
        let sessions = &jobs.program().folder;
        let fit = format!("{name}/{FITS_FOLDER}/{number}");
        beneath::check_folder(sessions, &fit)
            .map_err(|_| Refusal::missing(format!("the session has no fit {number}")))?;

        // Where to.
        let folder =
            exports::folder(sessions, &name).map_err(|error| Refusal::failed(error.to_string()))?;
        let mut arguments: Vec<OsString> = match is_certificate {
            true => vec![
                "report".into(),
                sessions.join(&name).into_os_string(),
                "--certificate".into(),
                format!("--fit={number}").into(),
            ],
            false => vec![
                "export".into(),
                sessions.join(fit).into_os_string(),
                format!("--format={format}").into(),
            ],
        };
        arguments.extend(["--out".into(), folder.join(&files[0]).into_os_string()]);
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
            "--dictionary=rig26",
            "--model-error=0.05",
            "--refine-bench=false",
            "--seed=3",
            "--shared-weights",
        ];
        let folder = tempfile::tempdir().unwrap();
        let arguments = |form: &FitForm| arguments(form, &folder.path().join("sessions"));
        assert_eq!(arguments(&form).unwrap(), expected.map(OsString::from));
        assert!(arguments(&FitForm::default()).unwrap().is_empty());
        for (key, value) in [
            ("out", json!("/x")),
            ("mask", json!("/x.png")),
            ("pose", json!("/x.toml")),
            ("job", json!("1")),
            ("seed", json!([3])),
            ("dictionary", json!(3)),
            ("shared_weights", json!(1)),
        ] {
            let form = FitForm::from_iter([(key.to_owned(), value)]);
            let refused = arguments(&form).unwrap_err();
            assert_eq!(refused.status, StatusCode::BAD_REQUEST, "{key}");
        }
        let unchosen = json!({"seed": null, "shared_weights": false});
        let unchosen: FitForm = serde_json::from_value(unchosen).unwrap();
        assert!(arguments(&unchosen).unwrap().is_empty());

        // Files of dictionaries stand below the folder of sessions.
        std::fs::create_dir(folder.path().join("sessions")).unwrap();
        std::fs::write(folder.path().join("outside.toml"), "secret = 1").unwrap();
        std::fs::write(folder.path().join("sessions/own.toml"), "").unwrap();
        std::os::unix::fs::symlink("../outside.toml", folder.path().join("sessions/link.toml"))
            .unwrap();
        let named = |dictionary: &str| {
            arguments(&FitForm::from_iter([(
                "dictionary".to_owned(),
                dictionary.into(),
            )]))
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
