//! Addresses of the console that start, steer and query commands of the program.

use std::ffi::OsString;
use std::path::Path as FilePath;
use std::time::Duration;

use axum::Json;
use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::{get, post};
use serde::Deserialize;
use serde_json::{Value, json};

use super::job_state::Kind;
use super::{Answer, JobError, Jobs, QueryError, Work, is_session, shown};
use crate::beneath;
use crate::capture::lights::{Lights, most_chosen, until};
use crate::config::RIG_FILE;
use crate::console::blocking::blocking;
use crate::console::control::Controlled;
use crate::console::refusal::{Accepted, Refusal, accepted};
use crate::console::request::Asked;
use crate::session::layout::session_name;

/// A short command has so long.
pub const SHORT: Duration = Duration::from_secs(30);
/// A plan of the best lights compares many.
const PLANNING: Duration = Duration::from_secs(120);
/// Lights that may be listed one by one.
const MOST_LIGHTS: usize = 500;

/// The lights of a form, each as the option of this name takes it.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct AskedLights {
    /// How many, or which.
    pub lights: Option<String>,
    /// Directions.
    #[serde(default)]
    pub light: Vec<String>,
    /// The expected error until which others follow.
    pub until: Option<String>,
    /// Lights at most then.
    pub max_lights: Option<String>,
}

impl AskedLights {
    /// As options.
    pub fn arguments(&self) -> impl Iterator<Item = OsString> {
        let one = |name, value: &Option<String>| value.as_ref().map(|value| option(name, value));
        let listed = self.light.iter().map(|at| option("--light=", at));
        one("--lights=", &self.lights)
            .into_iter()
            .chain(listed)
            .chain(one("--until=", &self.until))
            .chain(one("--max-lights=", &self.max_lights))
    }

    fn texts(&self) -> impl Iterator<Item = &String> {
        let one = self.lights.iter().chain(&self.until);
        self.light.iter().chain(one).chain(&self.max_lights)
    }

    /// Before anything follows from them.
    ///
    /// # Errors
    /// What is no light, error or number.
    pub fn check(&self) -> Result<(), Refusal> {
        let one = |name: &str, value: &Option<String>, checked: fn(&str) -> Result<(), String>| {
            let fact = value.as_deref().and_then(|value| checked(value).err());
            fact.map(|fact| format!("{name}: {fact}"))
        };
        let fact = one("lights", &self.lights, |text| {
            text.parse::<Lights>().map(drop)
        })
        .or_else(|| one("until", &self.until, |text| until(text).map(drop)))
        .or_else(|| {
            one("max_lights", &self.max_lights, |text| {
                most_chosen(text).map(drop)
            })
        });
        fact.map_or(Ok(()), |fact| {
            Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact))
        })
    }
}

/// The form of a capture.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct CaptureForm {
    sample: Option<String>,
    #[serde(flatten)]
    lights: AskedLights,
    fit: Option<bool>,
}

impl CaptureForm {
    /// The command line, without the program's name. Values stand behind `=` and are never
    /// read as options; whether they are right decides the command itself.
    fn arguments(&self, jobs: &Jobs) -> Result<Vec<OsString>, Refusal> {
        let program = jobs.program();
        let mut texts = self.lights.texts().chain(&self.sample);
        if let Some(bad) = texts.find(|text| text.chars().any(char::is_control)) {
            return Err(Refusal::bad(format!("{bad:?} has control characters")));
        }
        if self.lights.light.len() > MOST_LIGHTS {
            return Err(Refusal::bad(format!("more than {MOST_LIGHTS} lights")));
        }
        if let Some(sample) = &self.sample {
            session_name(jiff::Timestamp::now(), sample, "")
                .map_err(|error| Refusal::bad(error.to_string()))?;
        }
        let mut arguments = vec!["capture".into(), option("--rig=", &program.rig)];
        arguments.push(option("--out=", &program.folder));
        arguments.extend(self.sample.iter().map(|sample| option("--sample=", sample)));
        arguments.extend(self.lights.arguments());
        arguments.extend(without_fit(self.fit));
        Ok(arguments)
    }
}

/// What tells a capture that no fit follows; it does if the page does not say.
pub fn without_fit(fit: Option<bool>) -> Option<OsString> {
    (fit == Some(false)).then(|| "--no-fit".into())
}

/// `--name=value` as one argument.
pub fn option(name: &str, value: impl AsRef<std::ffi::OsStr>) -> OsString {
    let mut whole = OsString::from(name);
    whole.push(value);
    whole
}

impl From<JobError> for Refusal {
    fn from(error: JobError) -> Self {
        let status = match error {
            JobError::Busy(_) | JobError::Ending | JobError::Devices { .. } => StatusCode::CONFLICT,
            JobError::Begin { .. } => StatusCode::INTERNAL_SERVER_ERROR,
        };
        let fact = error.to_string();
        match error {
            JobError::Devices { hint, .. } => Refusal::new(status, fact).hint(hint),
            _ => Refusal::new(status, fact),
        }
    }
}

impl From<QueryError> for Refusal {
    fn from(error: QueryError) -> Self {
        let status = match error {
            QueryError::Begin { .. } => StatusCode::INTERNAL_SERVER_ERROR,
            QueryError::Many => StatusCode::SERVICE_UNAVAILABLE,
            QueryError::Slow { .. } => StatusCode::GATEWAY_TIMEOUT,
            QueryError::Failed { .. } => StatusCode::UNPROCESSABLE_ENTITY,
        };
        let fact = error.to_string();
        match error {
            QueryError::Failed { hint, .. } => Refusal::new(status, fact).hint(hint),
            _ => Refusal::new(status, fact),
        }
    }
}

/// The addresses of jobs and short commands.
pub fn routes(jobs: Jobs) -> Router {
    Router::new()
        .route("/api/doctor", get(doctor))
        .route("/api/devices", get(devices))
        .route("/api/setup", get(questions).post(set_up))
        .route("/api/plan", post(plan))
        .route("/api/capture/start", post(start))
        .route("/api/capture/resume", post(resume))
        .route("/api/capture/pause", post(pause))
        .route("/api/capture/continue", post(go_on))
        .route("/api/capture/finish", post(finish))
        .route("/api/capture/answer", post(answer))
        .route("/api/capture/stop", post(stop))
        .route("/api/jobs/stop", post(stop))
        .with_state(jobs)
}

type Done = Result<Json<Value>, Refusal>;

async fn shown_json(jobs: &Jobs, arguments: Vec<OsString>) -> Done {
    Ok(Json(jobs.ask(arguments, Vec::new(), SHORT).await?.value))
}

async fn doctor(State(jobs): State<Jobs>) -> Done {
    let rig = option("--rig=", &jobs.program().rig);
    shown_json(&jobs, vec!["doctor".into(), rig, "--json".into()]).await
}

async fn devices(State(jobs): State<Jobs>) -> Done {
    shown_json(&jobs, ["devices", "--json"].map(OsString::from).into()).await
}

async fn questions(State(jobs): State<Jobs>) -> Done {
    let arguments = ["init", "--questions", "--json"].map(OsString::from);
    let Json(mut questions) = shown_json(&jobs, arguments.into()).await?;
    for question in questions.as_array_mut().into_iter().flatten() {
        if let Some(choices) = question.get_mut("choices").and_then(Value::as_array_mut) {
            choices.retain(|choice| !is_program(choice.get("value")));
        }
    }
    Ok(Json(questions))
}

/// Whether a camera is a program of the operator's: only the terminal may name one, because
/// every later command runs it.
fn is_program(camera: Option<&Value>) -> bool {
    let named = camera.and_then(Value::as_str).unwrap_or_default();
    named.trim_start().to_lowercase().starts_with("command")
}

/// A mesh, or a folder of a camera's frames, that is named and is not below the folder of the rig
/// file: a page has no other files of this machine read.
fn elsewhere<'a>(
    answers: &'a serde_json::Map<String, Value>,
    folder: &FilePath,
) -> Option<&'a str> {
    let answer = |key: &str| answers.get(key).and_then(Value::as_str);
    let mesh = answer("sample_mesh").filter(|mesh| beneath::open(folder, mesh).is_err());
    let frames = match answer("camera").map(|camera| camera.trim().to_lowercase()) {
        Some(camera) if camera.starts_with("folder") => answer("camera_address"),
        _ => None,
    };
    mesh.or_else(|| frames.filter(|frames| beneath::check_folder(folder, frames).is_err()))
}

/// Where a bench of this name is written: the first one of a folder in [`RIG_FILE`], another in
/// a file of its own name.
///
/// # Errors
/// Both exist, or the name makes no plain file name.
fn free_file(name: Option<&str>) -> Result<String, Refusal> {
    let is_free = |file: &str| FilePath::new(file).symlink_metadata().is_err();
    if is_free(RIG_FILE) {
        return Ok(RIG_FILE.to_owned());
    }
    let name = name.unwrap_or_default().trim();
    let is_plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | ' ' | '.');
    if name.is_empty() || name.starts_with(['-', '.', ' ']) || !name.chars().all(is_plain) {
        let fact = format!("{RIG_FILE} exists, and {name:?} names no other file");
        let hint = "give this bench a name of letters, digits, - and _".to_owned();
        return Err(Refusal::conflict(fact).hint(Some(hint)));
    }
    let file = format!("{}.toml", name.replace(' ', "-"));
    if !is_free(&file) {
        let fact = format!("{RIG_FILE} and {file} exist in the console's folder");
        let hint = "give this bench another name: a rig file is never replaced".to_owned();
        return Err(Refusal::conflict(fact).hint(Some(hint)));
    }
    Ok(file)
}

#[derive(Deserialize)]
struct SetUp {
    answers: serde_json::Map<String, Value>,
}

async fn set_up(State(jobs): State<Jobs>, _: Controlled, Asked(form): Asked<SetUp>) -> Done {
    if is_program(form.answers.get("camera")) {
        let fact = "camera = \"command\": a page may not name a program";
        let hint = "run `rig init` at the terminal";
        return Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact).hint(Some(hint.into())));
    }
    let file = free_file(form.answers.get("name").and_then(Value::as_str))?;
    if let Some(named) = elsewhere(&form.answers, FilePath::new(".")) {
        let fact = format!("{named:?} is not below the console's folder, where {file} is written");
        let hint = "put it there and name it by its path from there (links are not followed), or run `rig init` at the terminal";
        return Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact).hint(Some(hint.into())));
    }
    let mut arguments = Vec::from(["init", "--answers=-", "--json"].map(OsString::from));
    arguments.push(option("--out=", &file));
    let answers = Value::Object(form.answers).to_string().into_bytes();
    let answer = jobs.ask(arguments, answers, SHORT).await?;
    match answer.failure {
        None => Ok(Json(answer.value)),
        Some((fact, hint)) => Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact).hint(hint)),
    }
}

async fn plan(State(jobs): State<Jobs>, Asked(form): Asked<CaptureForm>) -> Done {
    let mut arguments = form.arguments(&jobs)?;
    let command = shown("rig", &arguments);
    arguments.extend(["--dry-run".into(), "--json".into()]);
    let Answer { value, failure } = jobs.ask(arguments, Vec::new(), PLANNING).await?;
    let (error, hint) = failure.map_or((None, None), |(fact, hint)| (Some(fact), hint));
    Ok(Json(
        json!({"command": command, "plan": value, "error": error, "hint": hint}),
    ))
}

/// Starts a capture; closing the devices may take a moment, so on another thread.
pub async fn capture(jobs: Jobs, work: Work) -> Accepted {
    let command = blocking(move || jobs.start(work)).await??;
    accepted(json!({"command": command}))
}

async fn start(
    State(jobs): State<Jobs>,
    _: Controlled,
    Asked(form): Asked<CaptureForm>,
) -> Accepted {
    let work = Work {
        hidden: vec!["--events".into()],
        ..Work::new(Kind::Capture, form.arguments(&jobs)?)
    };
    capture(jobs, work).await
}

#[derive(Deserialize)]
struct Resumed {
    session: String,
    fit: Option<bool>,
}

async fn resume(State(jobs): State<Jobs>, _: Controlled, Asked(form): Asked<Resumed>) -> Accepted {
    let folder = &jobs.program().folder;
    if !is_session(folder, &form.session) {
        return Err(Refusal::missing("there is no such session"));
    }
    let mut arguments = vec!["capture".into()];
    arguments.push(option("--resume=", folder.join(&form.session)));
    arguments.extend(without_fit(form.fit));
    let work = Work {
        hidden: vec!["--events".into()],
        session: Some(form.session),
        ..Work::new(Kind::Capture, arguments)
    };
    capture(jobs, work).await
}

/// Only a capture can be paused or ended in good order.
fn of_capture(jobs: &Jobs, act: impl FnOnce(&Jobs)) -> Accepted {
    if !jobs.is_capturing() {
        return Err(Refusal::conflict("no capture is running"));
    }
    act(jobs);
    accepted(json!({}))
}

async fn pause(State(jobs): State<Jobs>, _: Controlled, _: Asked<Value>) -> Accepted {
    of_capture(&jobs, Jobs::pause)
}

async fn go_on(State(jobs): State<Jobs>, _: Controlled, _: Asked<Value>) -> Accepted {
    of_capture(&jobs, Jobs::resume)
}

async fn finish(State(jobs): State<Jobs>, _: Controlled, _: Asked<Value>) -> Accepted {
    of_capture(&jobs, Jobs::finish)
}

#[derive(Deserialize)]
struct HandAnswer {
    number: u64,
    done: bool,
}

async fn answer(
    State(jobs): State<Jobs>,
    _: Controlled,
    Asked(form): Asked<HandAnswer>,
) -> Accepted {
    match blocking(move || jobs.answer(form.number, form.done)).await? {
        true => accepted(json!({})),
        false => Err(Refusal::conflict("this question is answered already")),
    }
}

/// By anyone, at any time. What is being stopped: null where no job runs.
async fn stop(State(jobs): State<Jobs>) -> Accepted {
    let stopping = jobs.stop().map(Kind::what);
    accepted(json!({"stopping": stopping}))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_options_and_checked_before() {
        let asked = |text: &str| serde_json::from_str::<AskedLights>(text).unwrap();
        let whole =
            asked(r#"{"lights": "1", "light": ["-40,35"], "until": "5%", "max_lights": "8"}"#);
        let options: Vec<_> = whole.arguments().collect();
        let expected = [
            "--lights=1",
            "--light=-40,35",
            "--until=5%",
            "--max-lights=8",
        ];
        assert_eq!(options, expected.map(OsString::from));
        assert!(whole.check().is_ok() && asked("{}").check().is_ok());
        for bad in [
            r#"{"lights": "0"}"#,
            r#"{"until": "0"}"#,
            r#"{"until": "5", "max_lights": "61"}"#,
        ] {
            assert!(asked(bad).check().is_err(), "{bad}");
        }
    }
}
