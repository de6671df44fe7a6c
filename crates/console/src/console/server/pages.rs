//! The page itself: files that are built into the program.

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;

/// The files of `crates/console/src/console/page`, with their content.
macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../page/", $name)))),*]
    };
}

/// What is served. The page is plain files; one more is one more name here.
const FILES: &[(&str, &str)] = files![
    "index.html",
    "console.css",
    "icon.svg",
    "main.js",
    "api.js",
    "stream.js",
    "dom.js",
    "format.js",
    "header.js",
    "notices.js",
    "bench.js",
    "calibrate.js",
    "exposing.js",
    "guide.js",
    "live.js",
    "picture.js",
    "histogram.js",
    "hemisphere.js",
    "capture.js",
    "prepare.js",
    "running.js",
    "queue.js",
    "sessions.js",
    "session.js",
    "compare.js",
    "curves.js",
    "trying.js",
    "work.js",
    "shortcuts.js",
    "setup.js",
    "benches.js",
    "drawings.js",
    "verdict.js",
    "reach.js",
    "records.js",
];

/// The kind of a file by its ending.
fn kind(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

/// The page's files; `index.html` is the page itself.
pub fn routes() -> Router {
    FILES.iter().fold(Router::new(), |router, (name, content)| {
        let kind = kind(name);
        let file = get(move || async move { ([(CONTENT_TYPE, kind)], *content) });
        let path = match *name {
            "index.html" => "/".to_owned(),
            name => format!("/{name}"),
        };
        router.route(&path, file)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file that is forgotten here would be missing in the browser alone.
    #[test]
    fn every_file_of_the_folder_is_served_with_its_kind() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/console/page");
        let mut there: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        there.sort();
        let mut served: Vec<_> = FILES.iter().map(|(name, _)| (*name).to_owned()).collect();
        served.sort();
        assert_eq!(served, there);
        assert!(
            served
                .iter()
                .all(|name| !kind(name).starts_with("application/"))
        );
    }
}
