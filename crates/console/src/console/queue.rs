//! Many samples one after the other: the list, what is next, what became of each. The list and
//! the journal are those of `rig capture --queue`, so that either goes on where the other stopped.
//!
//! The queue is opened for each request alone. What a capture or a fit has come to meanwhile it
//! finds in the sessions.

use std::path::Path;

use axum::Json;
use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::{get, post};
use serde::Deserialize;
use serde_json::{Value, json};

use super::blocking::blocking;
use super::control::Controlled;
use super::jobs::{AskedLights, Jobs, Kind, Work, capture, option, without_fit};
use super::refusal::{Accepted, Refusal, accepted};
use super::request::Asked;
use crate::capture::prepare::Lights;
use crate::queue::{Queue, QueueError, Sample, SampleList, Step, TableError, list_of_table};
use rig_core::whole_file;

/// The list of samples in the console's folder.
pub const LIST_FILE: &str = "samples.toml";

impl From<QueueError> for Refusal {
    fn from(error: QueueError) -> Self {
        let hint = match &error {
            QueueError::Locked { .. } => "a queue at the terminal is at work: end it there with q",
            QueueError::Taken(_) => "add it all the same if it is the same sample",
            QueueError::List(_) => "correct the list in an editor",
            _ => return Refusal::conflict(error.to_string()),
        };
        Refusal::conflict(error.to_string()).hint(hint.to_owned())
    }
}

impl From<TableError> for Refusal {
    fn from(error: TableError) -> Self {
        let refusal = Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string());
        match error {
            TableError::Name { .. } => refusal.hint("1 to 64 letters, digits, dots, hyphens or underscores, the first a letter or digit".to_owned()),
            _ => refusal,
        }
    }
}

/// The queue; `None` without a list.
fn opened(jobs: &Jobs) -> Result<Option<Queue>, Refusal> {
    let list = Path::new(LIST_FILE);
    match list.symlink_metadata() {
        Ok(_) => Ok(Some(Queue::open(list, &jobs.program().folder)?)),
        Err(_) => Ok(None),
    }
}

fn needed(jobs: &Jobs) -> Result<Queue, Refusal> {
    opened(jobs)?.ok_or_else(|| Refusal::conflict("there is no list of samples yet"))
}

/// Name of a session's folder.
fn name_of(session: &Path) -> String {
    let name = session.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// The whole queue as pages show it.
fn shown(queue: &Queue) -> Value {
    let rows = queue.samples().iter().map(|sample| {
        let runs = queue.entries().iter();
        let runs = runs.filter(|run| run.sample == sample.name);
        let (lights, light) = texts_of(sample);
        json!({
            "sample": sample.name,
            "material": sample.material,
            "comment": sample.comment,
            "lights": lights,
            "light": light,
            "planned": queue.planned(sample),
            "left": queue.left_of(sample),
            "left_out": queue.left_out(sample),
            "sessions": runs.collect::<Vec<_>>(),
        })
    });
    let next = match queue.step() {
        Step::Resume { sample, session } => {
            json!({"step": "resume", "sample": sample, "session": name_of(&session)})
        }
        Step::Fit { session } => json!({"step": "fit", "session": name_of(&session)}),
        Step::Capture { sample, run, of } => json!({
            "step": "capture", "sample": sample.name, "run": run, "of": of,
            "material": sample.material, "comment": sample.comment,
        }),
        Step::End => json!({"step": "end"}),
    };
    json!({
        "rows": rows.collect::<Vec<_>>(),
        "next": next,
        "left": queue.left(),
        "last": queue.last(),
    })
}

/// The addresses of the queue.
pub fn routes(jobs: Jobs) -> Router {
    Router::new()
        .route("/api/queue", get(list))
        .route("/api/queue/add", post(add))
        .route("/api/queue/next", post(next))
        .route("/api/queue/skip", post(skip))
        .route("/api/queue/back", post(back))
        .route("/api/queue/again", post(again))
        .with_state(jobs)
}

type Shown = Result<Json<Value>, Refusal>;

async fn list(State(jobs): State<Jobs>) -> Shown {
    let queue = blocking(move || Ok::<_, Refusal>(opened(&jobs)?.as_ref().map(shown))).await??;
    let empty = || json!({"rows": [], "next": {"step": "end"}, "left": 0, "last": null});
    Ok(Json(queue.unwrap_or_else(empty)))
}

#[derive(Deserialize)]
struct Added {
    /// A table with a header, or names, one a line.
    text: String,
    /// Samples may have sessions in the folder from before.
    #[serde(default)]
    again: bool,
}

async fn add(State(jobs): State<Jobs>, _: Controlled, Asked(form): Asked<Added>) -> Shown {
    let done = move || {
        append(&jobs, &list_of_table(&form.text, form.again)?)?;
        Ok::<_, Refusal>(shown(&needed(&jobs)?))
    };
    Ok(Json(blocking(done).await??))
}

/// Adds the samples at the end of the list, whose text otherwise stays as it is.
fn append(jobs: &Jobs, samples: &str) -> Result<(), Refusal> {
    let path = Path::new(LIST_FILE);
    let before = match std::fs::symlink_metadata(path) {
        Ok(_) => rig_core::outside_file::read_text(path, 1 << 20)
            .map_err(|error| Refusal::conflict(format!("{LIST_FILE}: {error}")))?,
        Err(_) => String::new(),
    };
    let gap = if before.is_empty() { "" } else { "\n" };
    let write = |text: &str| {
        whole_file::replace(path, |out| out.write_all(text.as_bytes()))
            .map_err(|error| Refusal::failed(format!("{LIST_FILE}: {error}")))
    };
    write(&format!("{before}{gap}{samples}"))?;
    // A name that is taken, or a note that is too long: the list stays as it was.
    let checked = SampleList::read(path, |_| None).map(drop);
    let opened = checked.and_then(|()| Queue::open(path, &jobs.program().folder).map(drop));
    match opened {
        Err(error) if !matches!(error, QueueError::Locked { .. }) => {
            match before.is_empty() {
                true => drop(std::fs::remove_file(path)),
                false => write(&before)?,
            }
            Err(error.into())
        }
        _ => Ok(()),
    }
}

#[derive(Deserialize)]
struct Next {
    /// Of samples that name none.
    #[serde(flatten)]
    lights: AskedLights,
    fit: Option<bool>,
    /// An interrupted capture is left as it is, or a session without a fit, instead.
    #[serde(default)]
    leave: bool,
}

/// Carries out the next step.
async fn next(State(jobs): State<Jobs>, _: Controlled, Asked(form): Asked<Next>) -> Accepted {
    let own = jobs.clone();
    let work = blocking(move || step(&own, &form)).await??;
    match work {
        Some(work) => capture(jobs, work).await,
        None => accepted(json!({})),
    }
}

/// The job of the next step; `None` where there is none to do.
fn step(jobs: &Jobs, form: &Next) -> Result<Option<Work>, Refusal> {
    if let Some(kind) = jobs.running() {
        return Err(Refusal::conflict(format!("{} is running", kind.what())));
    }
    form.lights.check()?;
    let mut queue = needed(jobs)?;
    let program = jobs.program();
    let work = match queue.step() {
        Step::End => return Err(Refusal::conflict("all samples are done")),
        Step::Resume { session, .. } if form.leave => {
            queue.abandon(&name_of(&session))?;
            return Ok(None);
        }
        Step::Fit { session } if form.leave || form.fit == Some(false) => {
            queue.done(&name_of(&session), None, None)?;
            return Ok(None);
        }
        Step::Fit { session } => Work {
            session: Some(name_of(&session)),
            ..Work::new(Kind::Fit, vec!["fit".into(), session.into()])
        },
        Step::Resume { session, .. } => {
            let mut arguments = vec!["capture".into(), option("--resume=", &session)];
            arguments.extend(without_fit(form.fit));
            Work {
                hidden: vec!["--events".into()],
                session: Some(name_of(&session)),
                ..Work::new(Kind::Capture, arguments)
            }
        }
        Step::Capture { sample, .. } => {
            let mut arguments = vec!["capture".into(), option("--rig=", &program.rig)];
            arguments.push(option("--out=", &program.folder));
            arguments.push(option("--sample=", &sample.name));
            arguments.extend(lights_of(&sample, &form.lights).arguments());
            let notes = [
                ("--material=", &sample.material),
                ("--comment=", &sample.comment),
            ];
            arguments.extend(
                notes
                    .into_iter()
                    .filter_map(|(name, note)| Some(option(name, note.as_ref()?))),
            );
            arguments.extend(without_fit(form.fit));
            queue.next(&sample.name)?;
            Work {
                hidden: vec!["--events".into()],
                ..Work::new(Kind::Capture, arguments)
            }
        }
    };
    Ok(Some(work))
}

/// The sample's lights, else these.
fn lights_of(sample: &Sample, others: &AskedLights) -> AskedLights {
    match texts_of(sample) {
        (None, listed) if listed.is_empty() => others.clone(),
        (lights, light) => AskedLights {
            lights,
            light,
            ..others.clone()
        },
    }
}

/// The sample's own lights as `--lights` takes them, or its directions as `--light` does.
fn texts_of(sample: &Sample) -> (Option<String>, Vec<String>) {
    let lights = |text: String| (Some(text), Vec::new());
    match &sample.lights {
        None => (None, Vec::new()),
        Some(Lights::Count(count)) => lights(count.to_string()),
        Some(Lights::All) => lights("all".to_owned()),
        Some(Lights::Best(count)) => lights(format!("best:{count}")),
        Some(Lights::Listed(listed)) => {
            let each = listed.iter();
            let each = each.map(|at| format!("{},{}", at.azimuth_deg, at.elevation_deg));
            (None, each.collect())
        }
    }
}

#[derive(Deserialize)]
struct OfSample {
    sample: String,
    #[serde(default)]
    reason: Option<String>,
}

/// Changes what the queue has of a listed sample.
async fn of_sample(
    jobs: Jobs,
    sample: String,
    change: impl FnOnce(&mut Queue, &str) -> Result<(), QueueError> + Send + 'static,
) -> Shown {
    let done = move || {
        let mut queue = needed(&jobs)?;
        if !queue.samples().iter().any(|listed| listed.name == sample) {
            return Err(Refusal::missing("there is no such sample in the list"));
        }
        change(&mut queue, &sample)?;
        Ok(shown(&queue))
    };
    Ok(Json(blocking(done).await??))
}

async fn skip(State(jobs): State<Jobs>, _: Controlled, Asked(form): Asked<OfSample>) -> Shown {
    let reason = form.reason.map(|reason| rig_core::shown::line(&reason));
    let reason = reason.filter(|reason| !reason.is_empty());
    of_sample(jobs, form.sample, move |queue, name| {
        queue.leave_out(name, reason.as_deref())
    })
    .await
}

async fn back(State(jobs): State<Jobs>, _: Controlled, Asked(form): Asked<OfSample>) -> Shown {
    of_sample(jobs, form.sample, |queue, name| queue.take_back(name)).await
}

async fn again(State(jobs): State<Jobs>, _: Controlled, _: Asked<Value>) -> Shown {
    let done = move || {
        let mut queue = needed(&jobs)?;
        queue.again()?;
        Ok::<_, Refusal>(shown(&queue))
    };
    Ok(Json(blocking(done).await??))
}
