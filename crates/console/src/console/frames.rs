//! The last captured frame as a picture; whoever looks at it also gets its figures.

use std::sync::Arc;

use axum::Router;
use axum::http::StatusCode;
use axum::middleware::map_response;
use axum::response::Response;

use super::jobs::Jobs;
use super::picture::frame_routes;
use super::picture::last_frame::LastFrame;

/// `api/frame.jpg` of the frames that captures store from now on. A frame is read only when
/// a page wants to see it.
pub fn routes(jobs: &Jobs) -> Router {
    let last = LastFrame::default();
    let newest = last.clone();
    jobs.watch_frames(Arc::new(move |session, file| newest.stored(session, file)));
    let (seen, jobs) = (last.clone(), jobs.clone());
    let publish = move |response: Response| {
        let (seen, jobs) = (seen.clone(), jobs.clone());
        async move {
            if response.status() == StatusCode::OK {
                // It has just been read, so this reads nothing.
                tokio::task::spawn_blocking(move || {
                    if let Ok(Some(shot)) = seen.look() {
                        jobs.set_frame_figures(shot.number, (*shot.figures).clone());
                    }
                });
            }
            response
        }
    };
    frame_routes(last).layer(map_response(publish))
}
