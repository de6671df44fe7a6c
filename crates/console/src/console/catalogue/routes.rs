//! The catalogue's addresses.

use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::{Deserialize, Serialize};

use super::comparison::ComparisonError;
use super::pages::SessionPages;
use super::served::{FileError, Served, Shown};
use crate::catalogue::row::EntryError;
use crate::console::blocking::blocking;
use crate::console::refusal::Refusal;
use crate::fault::{Advisor, Fault};

/// A report has no rights: no scripts, no forms, nothing from elsewhere. Its styles and
/// pictures are inside it.
const REPORT_POLICY: &str =
    "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'";

/// `api/sessions`, `api/sessions/NAME`, `api/compare`, `sessions/NAME/FILE`.
pub fn routes(pages: Arc<SessionPages>) -> Router {
    Router::new()
        .route("/api/sessions", get(list))
        .route("/api/sessions/{name}", get(detail))
        .route("/api/compare", get(compare))
        .route("/sessions/{name}/{*file}", get(file))
        .with_state(pages)
}

#[derive(Deserialize)]
struct Search {
    #[serde(default)]
    search: String,
}

async fn list(
    State(pages): State<Arc<SessionPages>>,
    search: Result<Query<Search>, QueryRejection>,
) -> Result<Response, Refusal> {
    let Query(Search { search }) = search.map_err(|error| Refusal::bad(error.body_text()))?;
    blocking(move || match pages.catalogue().list(&search) {
        Ok(rows) => {
            let rows: Vec<_> = rows.iter().map(|row| &**row).collect();
            Ok(json(&rows))
        }
        Err(error) => {
            let fault = pages.catalogue().advisor().fault(&error);
            let folder = pages.catalogue().folder().display();
            Err(Refusal::failed(format!("{folder}: {}", fault.error)).hint(fault.hint))
        }
    })
    .await?
}

async fn detail(
    State(pages): State<Arc<SessionPages>>,
    Path(name): Path<String>,
) -> Result<Response, Refusal> {
    blocking(move || match pages.detail(&name) {
        Ok(detail) => Ok(json(&detail)),
        Err(EntryError::File(error)) if error.is_missing() => {
            Err(Refusal::missing(format!("there is no session {name:?}")))
        }
        Err(error) => Err(Refusal::missing(error.to_string())),
    })
    .await?
}

#[derive(Deserialize)]
struct Fits {
    fits: String,
}

async fn compare(
    State(pages): State<Arc<SessionPages>>,
    fits: Result<Query<Fits>, QueryRejection>,
) -> Result<Response, Refusal> {
    let Query(Fits { fits }) = fits.map_err(|error| Refusal::bad(error.body_text()))?;
    blocking(move || match pages.compare(&fits) {
        Ok(comparison) => Ok(json(&comparison)),
        Err(error @ ComparisonError::Asked { .. }) => Err(Refusal::bad(error.to_string())),
        Err(ComparisonError::File(error)) => Err(refusal(&error, pages.catalogue().advisor())),
    })
    .await?
}

async fn file(
    State(pages): State<Arc<SessionPages>>,
    Path((name, file)): Path<(String, String)>,
) -> Result<Response, Refusal> {
    let served = blocking(move || {
        let served = pages.file(&name, &file);
        served.map_err(|error| refusal(&error, pages.catalogue().advisor()))
    });
    Ok(response(served.await??))
}

fn refusal(error: &FileError, advisor: &Advisor) -> Refusal {
    if error.is_missing() {
        return Refusal::missing("the session has no such file");
    }
    let Fault { error, hint } = match error {
        FileError::Entry(inner) => advisor.fault(inner),
        FileError::Session(inner) => advisor.fault(inner),
        FileError::Image(inner) => advisor.fault(inner),
        FileError::Brdf(inner) => advisor.fault(inner),
        error => advisor.fault(error),
    };
    Refusal::failed(error).hint(hint)
}

/// Serialised here, in the thread for work that takes long.
fn json(value: &impl Serialize) -> Response {
    Json(value).into_response()
}

fn response(served: Served) -> Response {
    let bytes = Bytes::from_owner(SharedBytes(served.bytes));
    let mut response = (StatusCode::OK, Body::from(bytes)).into_response();
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(served.kind));
    match served.shown {
        Shown::Page => {
            let policy = HeaderValue::from_static(REPORT_POLICY);
            headers.insert(CONTENT_SECURITY_POLICY, policy);
        }
        Shown::Inline => {}
        Shown::Download => {
            let download = HeaderValue::from_static("attachment");
            headers.insert(CONTENT_DISPOSITION, download);
        }
    }
    response
}

/// A picture that several pages load is in memory once.
struct SharedBytes(Arc<Vec<u8>>);

impl AsRef<[u8]> for SharedBytes {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}
