//! The bench's addresses.

use axum::Router;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde::Deserialize;
use serde_json::{Value, json};

use super::handle::HeldDevices;
use super::stop::Stopping;
use crate::console::blocking::blocking;
use crate::console::control::Controlled;
use crate::console::picture::Marks;
use crate::console::refusal::{Accepted, Refusal, accepted};
use crate::console::request::{Asked, Viewer};
use crate::device::{CameraSettings, LampChannel};
use crate::fault::Fault;
use crate::units::{Seconds, StageAngles};

/// Says which frame a picture shows.
const NUMBER: HeaderName = HeaderName::from_static("x-rig-number");

/// `api/bench/…` and `api/live.jpg`.
pub fn routes(bench: HeldDevices) -> Router {
    Router::new()
        .route("/api/bench/connect", post(connect))
        .route("/api/bench/disconnect", post(disconnect))
        .route("/api/bench/exposure", post(exposure))
        .route("/api/bench/home", post(home))
        .route("/api/bench/move", post(move_to))
        .route("/api/bench/lamp", post(lamp))
        .route("/api/bench/stop", post(stop))
        .route("/api/live.jpg", get(live))
        .with_state(bench)
}

fn begun(outcome: Result<(), Fault>) -> Accepted {
    match outcome {
        Ok(()) => accepted(json!({})),
        Err(Fault { error, hint }) => Err(Refusal::conflict(error).hint(hint)),
    }
}

async fn connect(State(bench): State<HeldDevices>, _: Controlled, _: Asked<Value>) -> Accepted {
    begun(bench.connect())
}

async fn disconnect(State(bench): State<HeldDevices>, _: Controlled, _: Asked<Value>) -> Accepted {
    bench.disconnect();
    begun(Ok(()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exposure {
    exposure_ms: f64,
    gain: f64,
}

async fn exposure(
    State(bench): State<HeldDevices>,
    _: Controlled,
    Asked(wanted): Asked<Exposure>,
) -> Accepted {
    begun(bench.set_exposure(CameraSettings::new(
        Seconds(wanted.exposure_ms * 1e-3),
        wanted.gain,
    )))
}

async fn home(State(bench): State<HeldDevices>, _: Controlled, _: Asked<Value>) -> Accepted {
    begun(bench.home())
}

async fn move_to(
    State(bench): State<HeldDevices>,
    _: Controlled,
    Asked(target): Asked<StageAngles>,
) -> Accepted {
    begun(bench.move_to(target))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Lamp {
    channel: Option<LampChannel>,
}

async fn lamp(
    State(bench): State<HeldDevices>,
    _: Controlled,
    Asked(lamp): Asked<Lamp>,
) -> Accepted {
    begun(bench.set_lamp(lamp.channel))
}

/// By any page, whichever controls. What is being stopped, or that nothing is.
async fn stop(State(bench): State<HeldDevices>, _: Viewer, _: Asked<Value>) -> Accepted {
    match bench.stop() {
        Ok(Stopping(what)) => accepted(json!({"stopping": what})),
        Err(error) => begun(Err(bench.fault(error))),
    }
}

#[derive(Deserialize)]
struct Wanted {
    #[serde(default)]
    peaking: u8,
    #[serde(default = "on")]
    marks: u8,
}

fn on() -> u8 {
    1
}

async fn live(
    State(bench): State<HeldDevices>,
    wanted: Result<Query<Wanted>, QueryRejection>,
) -> Result<Response, Refusal> {
    let Query(wanted) = wanted.map_err(|error| Refusal::bad(error.body_text()))?;
    let marks = Marks {
        limits: wanted.marks != 0,
        peaking: wanted.peaking != 0,
    };
    let picture = blocking(move || bench.live().picture(marks)).await?;
    match picture {
        Ok(Some(picture)) => {
            let kind = (CONTENT_TYPE, "image/jpeg".to_owned());
            let number = (NUMBER, picture.number.to_string());
            Ok(([kind, number], picture.jpeg.to_vec()).into_response())
        }
        Ok(None) => Ok(StatusCode::NO_CONTENT.into_response()),
        Err(error) => Err(Refusal::failed(error.to_string())),
    }
}
