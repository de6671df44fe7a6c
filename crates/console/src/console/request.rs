//! What a page sends with a request: its body and its viewer's id.

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::HeaderMap;
use axum::http::request::Parts;
use serde::de::DeserializeOwned;

use super::refusal::Refusal;

/// The header that names the viewer.
pub const VIEWER_HEADER: &str = "x-rig-viewer";
/// An id is at most so long.
const LONGEST_ID: usize = 64;

/// The id that a tab gave itself: letters, digits, hyphens and underscores, 64 at most.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Viewer(String);

impl Viewer {
    /// `None` if it is none.
    pub fn parse(text: &str) -> Option<Self> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
        let is_one = (1..=LONGEST_ID).contains(&text.len()) && text.chars().all(allowed);
        is_one.then(|| Self(text.to_owned()))
    }

    /// The one that the headers name, once.
    pub fn of_headers(headers: &HeaderMap) -> Option<Self> {
        let mut named = headers.get_all(VIEWER_HEADER).iter();
        let viewer = Self::parse(named.next()?.to_str().ok()?)?;
        named.next().is_none().then_some(viewer)
    }

    /// The id.
    pub fn id(&self) -> &str {
        &self.0
    }
}

impl<S: Sync> FromRequestParts<S> for Viewer {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refusal> {
        Self::of_headers(&parts.headers)
            .ok_or_else(|| Refusal::bad("the header X-Rig-Viewer names no viewer"))
    }
}

/// The body of an action, as JSON.
#[derive(Clone, Debug)]
pub struct Asked<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Asked<T> {
    type Rejection = Refusal;

    async fn from_request(request: Request, state: &S) -> Result<Self, Refusal> {
        let body = Bytes::from_request(request, state)
            .await
            .map_err(|error| Refusal::new(error.status(), error.body_text()))?;
        serde_json::from_slice(&body)
            .map(Self)
            .map_err(|error| Refusal::bad(format!("body: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viewers_id_is_one_short_word() {
        assert_eq!(Viewer::parse("a-B_9").unwrap().id(), "a-B_9");
        for bad in ["", "a b", "a\n", "é", "a/b", &"x".repeat(65)] {
            assert_eq!(Viewer::parse(bad), None, "{bad}");
        }
        let mut headers = HeaderMap::new();
        assert_eq!(Viewer::of_headers(&headers), None);
        headers.append(VIEWER_HEADER, "a".parse().unwrap());
        assert_eq!(Viewer::of_headers(&headers), Viewer::parse("a"));
        headers.append(VIEWER_HEADER, "b".parse().unwrap());
        assert_eq!(Viewer::of_headers(&headers), None);
    }
}
