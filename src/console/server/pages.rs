//! The page itself: files that are built into the program.

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;

const HTML: &str = "text/html; charset=utf-8";

/// What is served: address, kind, content. The page is plain files; one more is one more
/// line here.
const FILES: &[(&str, &str, &str)] = &[("/", HTML, include_str!("../page/index.html"))];

/// The page's files.
pub fn routes() -> Router {
    FILES.iter().fold(Router::new(), |router, file| {
        let (path, kind, content) = *file;
        router.route(
            path,
            get(move || async move { ([(CONTENT_TYPE, kind)], content) }),
        )
    })
}
