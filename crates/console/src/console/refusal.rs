//! What an action answers: that it is accepted, or a status, the fact, and advice where there
//! is some.

use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

/// A refused or failed request: `{"error": fact, "hint": advice or null}`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// 4xx, or 5xx where the request was right.
    pub status: StatusCode,
    /// What is the case.
    pub error: String,
    /// What to do about it.
    pub hint: Option<String>,
}

/// What an action answers; what comes of it is published.
pub type Accepted = Result<(StatusCode, Json<Value>), Refusal>;

/// 202 with this answer.
pub fn accepted(answer: Value) -> Accepted {
    Ok((StatusCode::ACCEPTED, Json(answer)))
}

impl Refusal {
    /// A fact without advice.
    pub fn new(status: StatusCode, error: impl Into<String>) -> Self {
        Self {
            status,
            error: error.into(),
            hint: None,
        }
    }

    /// 400: the request itself is wrong.
    pub fn bad(error: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, error)
    }

    /// 404: there is no such thing.
    pub fn missing(error: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, error)
    }

    /// 409: not in the present state.
    pub fn conflict(error: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, error)
    }

    /// 500: the request was right and the work failed.
    pub fn failed(error: impl Into<String>) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, error)
    }

    /// The same with this advice.
    pub fn hint(self, hint: impl Into<Option<String>>) -> Self {
        Self {
            hint: hint.into(),
            ..self
        }
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let body = json!({"error": self.error, "hint": self.hint});
        (self.status, Json(body)).into_response()
    }
}
