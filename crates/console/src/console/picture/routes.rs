//! Addresses of what goes with the pictures: the running capture's last frame, and the
//! sample's outline.

use std::sync::{Arc, OnceLock};

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};

use super::last_frame::LastFrame;
use super::outline::{Outline, outline};
use crate::config::RigConfig;
use crate::console::blocking::blocking;
use crate::console::refusal::Refusal;
use crate::fault::{Advisor, Fault};

const NUMBER: HeaderName = HeaderName::from_static("x-rig-number");

/// `api/frame.jpg`.
pub fn frame_routes(last: LastFrame) -> Router {
    Router::new()
        .route("/api/frame.jpg", get(frame))
        .with_state(last)
}

async fn frame(State(last): State<LastFrame>) -> Result<Response, Refusal> {
    match blocking(move || last.look()).await? {
        Ok(Some(shot)) => {
            let kind = (CONTENT_TYPE, "image/jpeg".to_owned());
            let number = (NUMBER, shot.number.to_string());
            Ok(([kind, number], shot.jpeg.to_vec()).into_response())
        }
        Ok(None) => Ok(StatusCode::NO_CONTENT.into_response()),
        Err(error) => Err(Refusal::failed(error.to_string())),
    }
}

/// The rig's outline, found when it is requested first.
struct OfRig {
    rig: Option<RigConfig>,
    advisor: Advisor,
    found: OnceLock<Result<Outline, Fault>>,
}

/// `api/outline` of a rig's sample; nothing where no rig is known.
pub fn outline_routes(rig: Option<RigConfig>, advisor: Advisor) -> Router {
    let of = OfRig {
        rig,
        advisor,
        found: OnceLock::new(),
    };
    Router::new()
        .route("/api/outline", get(sample_outline))
        .with_state(Arc::new(of))
}

async fn sample_outline(State(of): State<Arc<OfRig>>) -> Result<Response, Refusal> {
    blocking(move || {
        let Some(rig) = &of.rig else {
            return Ok(StatusCode::NO_CONTENT.into_response());
        };
        let find = || outline(rig).map_err(|error| of.advisor.fault(&error));
        match of.found.get_or_init(find) {
            Ok(outline) => Ok(Json(outline).into_response()),
            Err(Fault { error, hint }) => Err(Refusal::failed(error.clone()).hint(hint.clone())),
        }
    })
    .await?
}
