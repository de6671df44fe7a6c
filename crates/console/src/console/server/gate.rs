//! What every request must pass before a handler sees it, and what every answer carries.

use std::time::Duration;

use axum::body::{Body, Bytes, to_bytes};
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE, HOST, LOCATION, ORIGIN, TRANSFER_ENCODING};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Request, StatusCode, Uri};
use axum::response::{IntoResponse, Response};

use super::hosts::Hosts;
use super::token::Token;
use crate::console::refusal::Refusal;
use crate::console::request::Viewer;

/// A body is at most so long (bytes).
pub const LONGEST_BODY: usize = 64 << 10;
/// A body has so long to arrive.
const BODY_PATIENCE: Duration = Duration::from_secs(5);

/// What answers carry unless their handler has set it otherwise.
const HEADERS: &[(&str, &str)] = &[
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; \
         img-src 'self' blob: data:; connect-src 'self'; frame-src 'self'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("referrer-policy", "no-referrer"),
    ("x-content-type-options", "nosniff"),
    ("cache-control", "no-store"),
];

/// What a request must bring.
#[derive(Clone, Debug)]
pub struct Gate {
    /// The secret that its path begins with.
    pub token: Token,
    /// The names that it may call the server by.
    pub hosts: Hosts,
}

/// Why a request stays outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outside {
    /// It does not have the token: it learns nothing at all.
    Stranger,
    /// It has the token and is refused.
    Refused(Refusal),
    /// The page's address without its last slash, which its relative addresses need.
    Elsewhere(String),
}

impl IntoResponse for Outside {
    fn into_response(self) -> Response {
        match self {
            Outside::Stranger => StatusCode::NOT_FOUND.into_response(),
            Outside::Refused(refusal) => refusal.into_response(),
            Outside::Elsewhere(to) => {
                (StatusCode::PERMANENT_REDIRECT, [(LOCATION, to)]).into_response()
            }
        }
    }
}

impl Gate {
    /// Whether a request may come in; its address behind the token.
    pub fn admit(&self, head: &Parts) -> Result<Uri, Outside> {
        let refused = |status, fact: &str| Err(Outside::Refused(Refusal::new(status, fact)));
        let forbidden = |fact| refused(StatusCode::FORBIDDEN, fact);

        // The token, before anything is said.
        let path = head.uri.path().strip_prefix('/').unwrap_or_default();
        let (token, inside) = match path.split_once('/') {
            Some((token, _)) => (token, &path[token.len()..]),
            None => (path, ""),
        };
        if !self.token.is(token) {
            return Err(Outside::Stranger);
        }

        // The form of the request.
        if head.uri.authority().is_some() {
            return refused(StatusCode::BAD_REQUEST, "the address names another server");
        }
        if head.headers.contains_key(TRANSFER_ENCODING) {
            return refused(StatusCode::LENGTH_REQUIRED, "a body needs a Content-Length");
        }

        // Where it comes from.
        let Some(host) = once(&head.headers, &HOST).filter(|host| self.hosts.admit(host)) else {
            return forbidden("the Host is none of this server's");
        };
        let is_action = head.method == Method::POST;
        if let Some(site) = head.headers.get("sec-fetch-site") {
            let is_opened = || {
                head.headers
                    .get("sec-fetch-mode")
                    .is_some_and(|m| m == "navigate")
            };
            let is_own = match is_action {
                true => site == "same-origin",
                false => site == "same-origin" || site == "none" || is_opened(),
            };
            if !is_own {
                return forbidden("the request comes from another site");
            }
        }
        if head.headers.contains_key(ORIGIN) {
            let origin = once(&head.headers, &ORIGIN);
            if !origin.is_some_and(|origin| self.hosts.admit_origin(origin, host)) {
                return forbidden("the Origin is another site");
            }
        }
        if inside.is_empty() {
            return Err(Outside::Elsewhere(format!("/{token}/")));
        }

        // What an action brings.
        match head.method {
            Method::GET | Method::HEAD => {}
            Method::POST => {
                let is_json = once(&head.headers, &CONTENT_TYPE).is_some_and(|kind| {
                    let kind = kind.split(';').next().unwrap_or_default();
                    kind.trim().eq_ignore_ascii_case("application/json")
                });
                if !is_json {
                    let fact = "the Content-Type of an action is application/json";
                    return refused(StatusCode::UNSUPPORTED_MEDIA_TYPE, fact);
                }
                if Viewer::of_headers(&head.headers).is_none() {
                    let fact = "the header X-Rig-Viewer names no viewer";
                    return refused(StatusCode::BAD_REQUEST, fact);
                }
            }
            _ => return refused(StatusCode::METHOD_NOT_ALLOWED, "only GET and POST"),
        }
        let inside = match head.uri.query() {
            Some(query) => format!("{inside}?{query}"),
            None => inside.to_owned(),
        };
        inside
            .parse()
            .map_err(|_| Outside::Refused(Refusal::bad("no address")))
    }
}

/// A header that is there once and is text.
fn once<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// The request with its body read; only actions have one.
///
/// # Errors
/// 413 if it is too long, 408 if it does not arrive in time or stops before its end.
pub async fn with_body<B>(request: Request<B>) -> Result<Request<Body>, Refusal>
where
    B: axum::body::HttpBody<Data = Bytes> + Send + 'static,
    B::Error: Into<axum::BoxError>,
{
    let (head, body) = request.into_parts();
    if head.method != Method::POST {
        return Ok(Request::from_parts(head, Body::empty()));
    }
    let too_long = || {
        let fact = format!("a body is at most {LONGEST_BODY} bytes long");
        Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, fact)
    };
    let stated = head.headers.get(CONTENT_LENGTH);
    let stated = stated.and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    if stated.is_some_and(|length| length > LONGEST_BODY as u64) {
        return Err(too_long());
    }
    let all = to_bytes(Body::new(body), LONGEST_BODY);
    match tokio::time::timeout(BODY_PATIENCE, all).await {
        Ok(Ok(bytes)) => Ok(Request::from_parts(head, Body::from(bytes))),
        _ => Err(Refusal::new(
            StatusCode::REQUEST_TIMEOUT,
            "the body did not arrive",
        )),
    }
}

/// Puts the headers of every answer into this one.
pub fn secure(mut response: Response) -> Response {
    for (name, value) in HEADERS {
        let headers = response.headers_mut();
        headers
            .entry(*name)
            .or_insert(HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY};

    /// The status of a request, 200 if it is let in; `TOKEN` and `PORT` are replaced.
    fn status(request: &str, headers: &[(&str, &str)]) -> (u16, String) {
        let gate = Gate {
            token: Token::random().unwrap(),
            hosts: Hosts::new("127.0.0.1:81".parse().unwrap(), &[]),
        };
        let (method, path) = request.split_once(' ').unwrap();
        let mut built = Request::builder()
            .method(method)
            .uri(path.replace("TOKEN", gate.token.reveal()));
        for (name, value) in headers {
            built = built.header(*name, *value);
        }
        match gate.admit(&built.body(()).unwrap().into_parts().0) {
            Ok(uri) => (200, uri.to_string()),
            Err(outside) => (outside.into_response().status().as_u16(), String::new()),
        }
    }

    #[test]
    fn what_comes_in_is_the_pages_own() {
        const OWN: (&str, &str) = ("host", "127.0.0.1:81");
        const JSON: (&str, &str) = ("content-type", "application/json; charset=utf-8");
        const VIEWER: (&str, &str) = ("x-rig-viewer", "a");
        let get = |path: &str, headers: &[(&str, &str)]| status(&format!("GET {path}"), headers);
        assert_eq!(get("/TOKEN/", &[OWN]), (200, "/".to_owned()));
        let (_, inside) = get("/TOKEN/api/live.jpg?n=1&marks=1", &[OWN]);
        assert_eq!(inside, "/api/live.jpg?n=1&marks=1");
        assert_eq!(get("/TOKEN", &[OWN]).0, 308);
        for path in ["/", "/api/events", "//TOKEN/", "/TOKENx/", "/%54OKEN/", "*"] {
            assert_eq!(get(path, &[OWN]).0, 404, "{path}");
        }
        let post = |headers: &[(&str, &str)]| status("POST /TOKEN/api/bench/stop", headers).0;
        assert_eq!(post(&[OWN, JSON, VIEWER]), 200);
        for (headers, expected) in [
            (&[JSON, VIEWER][..], 403),
            (&[OWN, OWN, JSON, VIEWER], 403),
            (&[("host", "evil.example:81"), JSON, VIEWER], 403),
            (&[OWN, JSON, VIEWER, ("origin", "http://127.0.0.1:81")], 200),
            (&[OWN, JSON, VIEWER, ("origin", "null")], 403),
            (&[OWN, JSON, VIEWER, ("sec-fetch-site", "same-origin")], 200),
            (&[OWN, JSON, VIEWER, ("sec-fetch-site", "none")], 403),
            (&[OWN, JSON, VIEWER, ("sec-fetch-site", "same-site")], 403),
            (&[OWN, JSON, VIEWER, ("transfer-encoding", "chunked")], 411),
            (&[OWN, JSON], 400),
            (&[OWN, JSON, VIEWER, VIEWER], 400),
            (&[OWN, VIEWER], 415),
            (&[OWN, VIEWER, ("content-type", "text/plain")], 415),
        ] {
            assert_eq!(post(headers), expected, "{headers:?}");
        }
        let from = |site: &'static str, mode: &'static str| {
            let headers = [OWN, ("sec-fetch-site", site), ("sec-fetch-mode", mode)];
            get("/TOKEN/", &headers).0
        };
        assert_eq!(from("none", "navigate"), 200);
        assert_eq!(from("cross-site", "navigate"), 200, "a link in a message");
        assert_eq!(from("cross-site", "no-cors"), 403);
        assert_eq!(status("DELETE /TOKEN/", &[OWN]).0, 405);
        assert_eq!(get("http://127.0.0.1:81/TOKEN/", &[OWN]).0, 400);
    }

    #[test]
    fn a_handlers_own_policy_stays() {
        let own = [(CONTENT_SECURITY_POLICY, "sandbox")];
        let response = secure((own, "report").into_response());
        assert_eq!(response.headers()[CONTENT_SECURITY_POLICY], "sandbox");
        assert_eq!(response.headers()[CACHE_CONTROL], "no-store");
        let response = secure(Outside::Stranger.into_response());
        assert_eq!(response.headers().get_all(CACHE_CONTROL).iter().count(), 1);
    }
}
