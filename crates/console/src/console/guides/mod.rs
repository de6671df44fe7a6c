//! Guided calibrations: how each target is placed, whether it is, the captures that it needs,
//! its command as a job, and the result, which is accepted or measured again.
//!
//! The server keeps no state of them: what was measured and is not accepted yet lies in a
//! folder ([`Trial`]), and captures leave sessions.

mod table;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::sync::Arc;

use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::{Value, json};

use self::table::{Asked as Stated, Frames, GUIDES, Guide, guide, region};
use super::blocking::blocking;
use super::control::Controlled;
use super::held_devices::HeldDevices;
use super::jobs::{Jobs, Kind, SHORT, Work, capture, is_session, option};
use super::refusal::{Accepted, Refusal, accepted};
use super::request::Asked;
use crate::calibrating::placing::{Target, grey, placing};
use crate::calibrating::trial::Trial;
use crate::calibration::camera::Board;
use crate::calibration::mirror_sphere::outline::Stated as Ball;
use crate::calibration::record::Kind as RecordKind;
use crate::calibration::white::Region;
use crate::config::{REHEARSAL, ResolvedRig};
use crate::shell_words::quoted;

/// Sessions that a calibration may be made of.
const MOST_SESSIONS: usize = 100;

/// What the addresses of guided calibrations need.
#[derive(Clone)]
pub struct Guides {
    jobs: Jobs,
    bench: HeldDevices,
    rig: Arc<ResolvedRig>,
}

impl Guides {
    /// Of a console's bench.
    pub fn new(jobs: Jobs, bench: HeldDevices, rig: &ResolvedRig) -> Self {
        let rig = Arc::new(rig.clone());
        Self { jobs, bench, rig }
    }

    /// The bench whose target a simulated one lacks; `None` where the target is there, or an
    /// operator puts it there.
    fn lacks(&self, guide: &Guide) -> Option<&'static str> {
        let rig = &self.rig.config;
        // What is not looked for is the sample itself, which all benches have but the rehearsals'.
        let is_there = !guide.can_check && rig.name != REHEARSAL;
        let target = guide.rehearsal.filter(|_| rig.is_simulated() && !is_there);
        target.filter(|target| self.jobs.program().rig != **target)
    }

    fn shown(&self) -> Value {
        let trial = Trial::of_rig(&self.rig);
        let is_rehearsal = self.rig.config.name == REHEARSAL;
        let each = GUIDES.iter().map(|guide| {
            let mut shown = json!(guide);
            shown["lacks"] = json!(self.lacks(guide));
            shown
        });
        let found = trial.as_ref().map(|trial| {
            let (kinds, records): (Vec<_>, Vec<_>) = trial.found().into_iter().unzip();
            let of = kinds.first().map(|kind| guide_of(*kind));
            json!({"of": of, "records": records, "has_figure": trial.figure().is_some()})
        });
        json!({
            "guides": each.collect::<Vec<_>>(),
            "is_rehearsal": is_rehearsal,
            // Null where the records are in the program.
            "trial": found,
        })
    }

    fn trial(&self) -> Result<Trial, Refusal> {
        let fact = "the records of this bench are built into the program";
        let hint = format!("use the bench {REHEARSAL}, or a rig file of your own");
        Trial::of_rig(&self.rig).ok_or_else(|| Refusal::conflict(fact).hint(hint))
    }
}

/// The guide that makes records of this kind.
fn guide_of(kind: RecordKind) -> Option<&'static str> {
    let command = kind.command().split(' ').next()?;
    guide(command).map(|guide| guide.kind)
}

fn known(kind: &str) -> Result<&'static Guide, Refusal> {
    guide(kind).ok_or_else(|| Refusal::missing("there is no such calibration"))
}

fn unfit(fact: String) -> Refusal {
    Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact)
}

/// What the operator stated, by key.
type Values = BTreeMap<String, String>;

/// The text of each option, in the table's order.
fn stated(guide: &Guide, values: &Values) -> Result<Vec<(&'static str, String)>, Refusal> {
    let is_known = |key: &str| guide.values.iter().any(|asked| asked.key == key);
    if let Some(key) = values.keys().find(|key| !is_known(key)) {
        return Err(unfit(format!("{} is told no {key:?}", guide.kind)));
    }
    let mut all = Vec::new();
    for asked in guide.values {
        let Stated { key, label, .. } = asked;
        let text = values.get(*key).map_or("", String::as_str);
        let options = asked
            .options(text)
            .map_err(|must| unfit(format!("{label}: {text:?} {must}")))?;
        all.extend(options.into_iter().map(|text| (*key, text)));
    }
    Ok(all)
}

/// What is looked for in a live frame.
fn target(guide: &Guide, stated: &[(&'static str, String)]) -> Option<Target> {
    let texts = |wanted: &'static str| {
        let of_key = stated.iter().filter(move |(key, _)| *key == wanted);
        of_key.map(|(_, text)| text.as_str())
    };
    let number = |key: &'static str, default: f64| {
        texts(key)
            .next()
            .and_then(|text| text.parse().ok())
            .unwrap_or(default)
    };
    let regions = |key: &'static str| -> Vec<Region> {
        texts(key).filter_map(region).map(Region::from).collect()
    };
    Some(match guide.kind {
        "sensor" | "flat" => Target::EvenLight,
        "camera" => {
            let mut sides = texts("squares")
                .next()?
                .split(',')
                .map(|side| side.trim().parse().ok());
            Target::Board(Board {
                squares: [sides.next()??, sides.next()??],
                square_mm: number("square", 1.0),
                square_std_mm: 0.0,
                tilt_std_deg: Board::TILT_STD_DEG,
            })
        }
        "focus" => Target::Edges(regions("region")),
        "glare" => Target::Traps(regions("trap")),
        "lights" => Target::Spheres {
            stated: Ball {
                radius_mm: number("radius", 1.0),
                height_mm: number("height", 0.0),
            },
            count: number("spheres", 1.0) as usize,
        },
        "white" => Target::Standard(regions("region").first().copied()),
        _ => return None,
    })
}

/// The addresses of guided calibrations.
pub fn routes(guides: Guides) -> Router {
    Router::new()
        .route("/api/calibrations", get(records))
        .route("/api/guides", get(list))
        .route("/api/guides/check", post(check))
        .route("/api/guides/capture", post(take))
        .route("/api/guides/measure", post(measure))
        .route("/api/guides/accept", post(accept))
        .route("/api/guides/discard", post(discard))
        .route("/api/guides/figure.png", get(figure))
        .with_state(guides)
}

/// The records in force: what each is worth, and how it is made.
async fn records(State(guides): State<Guides>) -> Result<Json<Value>, Refusal> {
    let rig = &guides.jobs.program().rig;
    let arguments = [
        "calibrate".into(),
        "status".into(),
        option("--rig=", rig),
        "--json".into(),
    ];
    let asked = guides.jobs.ask(arguments.into(), Vec::new(), SHORT).await?;
    let mut status = asked.value;
    let records = status.get_mut("records").and_then(Value::as_array_mut);
    let can_be_made = Trial::of_rig(&guides.rig).is_some();
    for record in records.into_iter().flatten() {
        // Whether or not it is needed now.
        if let Ok(kind) = serde_json::from_value::<RecordKind>(record["kind"].clone()) {
            let command = kind.command();
            record["command"] = format!("rig calibrate {command} --rig {}", quoted(rig)).into();
            record["guide"] = json!(guide_of(kind).filter(|_| can_be_made));
        }
    }
    Ok(Json(status))
}

async fn list(State(guides): State<Guides>) -> Result<Json<Value>, Refusal> {
    Ok(Json(blocking(move || guides.shown()).await?))
}

#[derive(Deserialize)]
struct Check {
    kind: String,
    #[serde(default)]
    values: Values,
}

async fn check(
    State(guides): State<Guides>,
    Asked(form): Asked<Check>,
) -> Result<Json<Value>, Refusal> {
    let guide = known(&form.kind)?;
    let target = target(guide, &stated(guide, &form.values)?);
    let target =
        target.ok_or_else(|| Refusal::conflict("nothing of it can be seen in a live frame"))?;
    let newest = guides.bench.live().newest();
    let (frame, counts) = newest
        .ok_or_else(|| Refusal::conflict("there is no live picture: connect the devices first"))?;
    let found = blocking(move || {
        let image = grey(&frame, counts.bit_depth, counts.mosaic);
        placing(&target, &image, &guides.rig.config.geometry)
    });
    let found = found.await?;
    Ok(Json(
        json!({"is_right": found.is_right, "seen": found.seen}),
    ))
}

#[derive(Deserialize)]
struct Take {
    kind: String,
    lights: String,
}

/// Captures the target as a sample, without a fit.
async fn take(State(guides): State<Guides>, _: Controlled, Asked(form): Asked<Take>) -> Accepted {
    let guide = known(&form.kind)?;
    let Frames::Sessions { sample, .. } = guide.frames else {
        return Err(Refusal::conflict("it takes its frames itself"));
    };
    guides.trial()?;
    let mut arguments = vec![
        "capture".into(),
        option("--rig=", &guides.jobs.program().rig),
    ];
    arguments.push(option("--out=", &guides.jobs.program().folder));
    arguments.push(option("--sample=", sample));
    arguments.extend(lights(&form.lights)?);
    arguments.push("--no-fit".into());
    let hidden = vec!["--events".into()];
    capture(
        guides.jobs,
        Work {
            hidden,
            ..Work::new(Kind::Capture, arguments)
        },
    )
    .await
}

/// A number of lights, `all`, or directions with spaces in between.
fn lights(text: &str) -> Result<Vec<OsString>, Refusal> {
    let is_direction = |word: &str| {
        let parts: Option<Vec<f64>> = word.split(',').map(|part| part.parse().ok()).collect();
        parts.is_some_and(|parts| parts.len() == 2)
    };
    let words: Vec<_> = text.split_whitespace().collect();
    match words[..] {
        ["all"] => Ok(vec!["--lights=all".into()]),
        [count] if count.parse::<u16>().is_ok() => Ok(vec![option("--lights=", count)]),
        [_, ..] if words.len() <= 200 && words.iter().all(|word| is_direction(word)) => {
            Ok(words.iter().map(|word| option("--light=", word)).collect())
        }
        _ => Err(unfit(format!(
            "lights: {text:?} must be a number, all, or directions AZIMUTH,ELEVATION with spaces in between"
        ))),
    }
}

#[derive(Deserialize)]
struct Measure {
    kind: String,
    #[serde(default)]
    sessions: Vec<String>,
    #[serde(default)]
    values: Values,
}

/// Carries the calibration out; its record is not in force yet.
async fn measure(
    State(guides): State<Guides>,
    _: Controlled,
    Asked(form): Asked<Measure>,
) -> Accepted {
    let guide = known(&form.kind)?;
    let stated = stated(guide, &form.values)?;
    let program = guides.jobs.program();
    let takes_devices = matches!(guide.frames, Frames::Own);
    if let Some(name) = form
        .sessions
        .iter()
        .find(|name| !is_session(&program.folder, name))
    {
        return Err(Refusal::missing(format!("there is no session {name:?}")));
    }
    let has_right_number = match guide.frames {
        Frames::Own => form.sessions.is_empty(),
        Frames::Sessions { several, .. } => {
            (1..=if several { MOST_SESSIONS } else { 1 }).contains(&form.sessions.len())
        }
    };
    if !has_right_number {
        return Err(unfit(format!(
            "{} is made of other than {} sessions",
            guide.title,
            form.sessions.len()
        )));
    }
    let trial = guides.trial()?;
    let mut arguments: Vec<OsString> = vec!["calibrate".into(), guide.kind.into()];
    arguments.extend(
        form.sessions
            .iter()
            .map(|name| program.folder.join(name).into()),
    );
    arguments.push(option("--rig=", &program.rig));
    arguments.extend(
        stated
            .iter()
            .map(|(key, text)| option(&format!("--{key}="), text)),
    );
    let work = Work {
        hidden: vec![option("--out=", trial.folder()), "--events".into()],
        takes_devices,
        ..Work::new(Kind::Calibration, arguments)
    };
    let jobs = guides.jobs.clone();
    let command = blocking(move || {
        if let Some(kind) = jobs.running() {
            return Err(Refusal::conflict(format!("{} is running", kind.what())));
        }
        trial
            .discard()
            .map_err(|error| Refusal::failed(error.to_string()))?;
        Ok(jobs.start(work)?)
    });
    accepted(json!({"command": command.await??}))
}

/// Does this with the trial while no job writes it.
async fn with_trial(guides: Guides, act: fn(&Trial) -> std::io::Result<()>) -> Accepted {
    blocking(move || {
        if guides.jobs.running() == Some(Kind::Calibration) {
            return Err(Refusal::conflict("a calibration is running"));
        }
        let trial = guides.trial()?;
        if trial.found().is_empty() {
            return Err(Refusal::conflict(
                "nothing was measured that is not in force",
            ));
        }
        act(&trial).map_err(|error| Refusal::conflict(error.to_string()))
    })
    .await??;
    accepted(json!({}))
}

async fn accept(State(guides): State<Guides>, _: Controlled, _: Asked<Value>) -> Accepted {
    with_trial(guides, Trial::accept).await
}

async fn discard(State(guides): State<Guides>, _: Controlled, _: Asked<Value>) -> Accepted {
    with_trial(guides, Trial::discard).await
}

async fn figure(State(guides): State<Guides>) -> Result<Response, Refusal> {
    let read = move || {
        let figure = Trial::of_rig(&guides.rig)?.figure()?;
        rig_core::outside_file::read_regular(&figure, 16 << 20).ok()
    };
    let bytes = blocking(read).await?;
    let bytes = bytes.ok_or_else(|| Refusal::missing("there is no figure"))?;
    Ok(([(CONTENT_TYPE, "image/png")], bytes).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options_of(kind: &str, values: &[(&str, &str)]) -> Result<Vec<String>, String> {
        let values = values
            .iter()
            .map(|(key, text)| ((*key).to_owned(), (*text).to_owned()));
        let stated = stated(guide(kind).unwrap(), &values.collect());
        let stated = stated.map_err(|refusal| refusal.error)?;
        Ok(stated
            .iter()
            .map(|(key, text)| format!("--{key}={text}"))
            .collect())
    }

    /// What a page states becomes values of options, and nothing else.
    #[test]
    fn values_are_checked_before_they_become_options() {
        let good = options_of(
            "focus",
            &[("heights", "-8,-4"), ("region", "1,2,30,40  5,6,70,80")],
        );
        assert_eq!(
            good.unwrap(),
            [
                "--heights=-8,-4",
                "--region=1,2,30,40",
                "--region=5,6,70,80"
            ]
        );
        assert_eq!(options_of("sensor", &[]).unwrap(), Vec::<String>::new());
        for (kind, key, text, says) in [
            ("lights", "radius", "", "must be stated"),
            ("lights", "radius", "0", "must be a number from"),
            ("lights", "radius", "NaN", "must be a number from"),
            ("camera", "squares", "10", "must be 2 numbers"),
            ("focus", "heights", "1;2", "must be numbers"),
            ("glare", "trap", "1,2,3", "must be four whole numbers"),
            ("white", "out", "/tmp", "is told no \"out\""),
            ("sensor", "frames", "2", "is told no \"frames\""),
        ] {
            let error = options_of(kind, &[(key, text)]).unwrap_err();
            assert!(error.contains(says), "{kind} {key}: {error}");
        }
        let words = |text: &str| lights(text).map_err(|refusal| refusal.error);
        assert_eq!(words("12").unwrap(), ["--lights=12"]);
        assert_eq!(
            words("0,90 -30,45").unwrap(),
            ["--light=0,90", "--light=-30,45"]
        );
        for bad in ["", "best:3", "--help", "1 2", "0,90,1"] {
            assert!(words(bad).is_err(), "{bad}");
        }
    }

    /// What the table says of a rehearsal can be told, and gives a target where one can be seen.
    #[test]
    fn every_guide_can_be_rehearsed() {
        for guide in GUIDES {
            let values = guide
                .values
                .iter()
                .map(|asked| (asked.key.to_owned(), asked.rehearsed.to_owned()));
            let stated = stated(guide, &values.collect()).unwrap();
            assert_eq!(
                target(guide, &stated).is_some(),
                guide.can_check,
                "{}",
                guide.kind
            );
            if let Some(rig) = guide.rehearsal {
                assert!(crate::config::is_rehearsal(rig), "{rig}");
            }
            if let Frames::Sessions {
                lights: usual,
                lights_rehearsed,
                ..
            } = guide.frames
            {
                assert!(lights(usual).is_ok() && lights(lights_rehearsed).is_ok());
            }
        }
    }
}
