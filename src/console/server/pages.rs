//! The page itself: files that are built into the program.

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SVG: &str = "image/svg+xml";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Files of the folder `page` with their kind; the address is the file's name.
macro_rules! files {
    ($($name:literal $kind:expr),* $(,)?) => {
        &[$((concat!("/", $name), $kind, include_str!(concat!("../page/", $name)))),*]
    };
}

/// What is served beyond the page itself: address, kind, content. One more file is one more
/// line here.
const FILES: &[(&str, &str, &str)] = files![
    "console.css" CSS,
    "icon.svg" SVG,
    "api.js" SCRIPT,
    "bench.js" SCRIPT,
    "capture.js" SCRIPT,
    "compare.js" SCRIPT,
    "dom.js" SCRIPT,
    "format.js" SCRIPT,
    "header.js" SCRIPT,
    "hemisphere.js" SCRIPT,
    "histogram.js" SCRIPT,
    "live.js" SCRIPT,
    "main.js" SCRIPT,
    "notices.js" SCRIPT,
    "picture.js" SCRIPT,
    "prepare.js" SCRIPT,
    "reach.js" SCRIPT,
    "running.js" SCRIPT,
    "session.js" SCRIPT,
    "sessions.js" SCRIPT,
    "setup.js" SCRIPT,
    "stream.js" SCRIPT,
    "verdict.js" SCRIPT,
];

/// The page, which loads the others.
const PAGE: (&str, &str, &str) = ("/", HTML, include_str!("../page/index.html"));

/// The page's files.
pub fn routes() -> Router {
    FILES
        .iter()
        .chain([&PAGE])
        .fold(Router::new(), |router, file| {
            let (path, kind, content) = *file;
            router.route(
                path,
                get(move || async move { ([(CONTENT_TYPE, kind)], content) }),
            )
        })
}
