//! `api/events`: the newest state of each topic as server-sent events.
//!
//! A stream asks the hub only when its reader has taken what it was sent before, so that a
//! slow reader gets fewer states, and costs one of them.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt::Write;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use hyper::body::Frame;
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::AbortHandle;
use tokio::time::MissedTickBehavior;

use crate::console::hub::Hub;
use crate::console::refusal::Refusal;
use crate::console::request::Viewer;

/// Viewers at once; a part of the connections stays free for their requests.
const MOST_VIEWERS: usize = 24;
/// A topic is sent at most once in this time.
const PAUSE: Duration = Duration::from_millis(200);
/// So often the server's time is sent, so that both sides notice a broken connection and
/// the page computes ages by the server's clock.
const HEARTBEAT: Duration = Duration::from_secs(5);

/// The open streams, by viewer.
#[derive(Clone, Debug)]
pub struct Viewers {
    hub: Hub,
    facts: Arc<Value>,
    streams: Arc<Mutex<Streams>>,
}

#[derive(Debug, Default)]
struct Streams {
    by_viewer: BTreeMap<Viewer, (u64, AbortHandle)>,
    opened: u64,
}

impl Viewers {
    /// `facts` are published as the topic `console`, with the number of viewers.
    pub fn new(hub: Hub, facts: Value) -> Self {
        let viewers = Self {
            hub,
            facts: Arc::new(facts),
            streams: Arc::default(),
        };
        viewers.publish(0);
        viewers
    }

    fn streams(&self) -> MutexGuard<'_, Streams> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn publish(&self, count: usize) {
        let mut facts = (*self.facts).clone();
        if let Some(facts) = facts.as_object_mut() {
            facts.insert("viewers".to_owned(), count.into());
        }
        self.hub.publish("console", facts);
    }

    /// A stream for this viewer; one that it had before ends.
    fn open(&self, viewer: Viewer) -> Result<mpsc::Receiver<Bytes>, Refusal> {
        let mut streams = self.streams();
        if streams.by_viewer.len() >= MOST_VIEWERS && !streams.by_viewer.contains_key(&viewer) {
            let fact = format!("{MOST_VIEWERS} pages look on already");
            return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, fact)
                .hint("close one of them".to_owned()));
        }
        streams.opened += 1;
        let number = streams.opened;
        let (sender, receiver) = mpsc::channel(1);
        let leaving = Leaving {
            viewers: self.clone(),
            viewer: viewer.clone(),
            number,
        };
        let task = tokio::spawn(send(self.hub.clone(), sender, leaving)).abort_handle();
        if let Some((_, before)) = streams.by_viewer.insert(viewer, (number, task)) {
            before.abort();
        }
        let count = streams.by_viewer.len();
        drop(streams);
        self.publish(count);
        Ok(receiver)
    }

    /// Ends all streams; the pages come back by themselves.
    pub fn end(&self) {
        for (_, task) in self.streams().by_viewer.values() {
            task.abort();
        }
    }
}

/// Takes a stream off the list when it ends.
struct Leaving {
    viewers: Viewers,
    viewer: Viewer,
    number: u64,
}

impl Drop for Leaving {
    fn drop(&mut self) {
        let mut streams = self.viewers.streams();
        let newest = streams.by_viewer.get(&self.viewer);
        if newest.is_some_and(|(number, _)| *number == self.number) {
            streams.by_viewer.remove(&self.viewer);
            let count = streams.by_viewer.len();
            drop(streams);
            self.viewers.publish(count);
        }
    }
}

/// Sends what is newer than what was sent, whenever there is room for it.
async fn send(hub: Hub, sender: mpsc::Sender<Bytes>, _leaving: Leaving) {
    let mut changes = hub.changes();
    let mut sent = 0;
    let mut text = "retry: 2000\n\n".to_owned();
    let mut heartbeat = tokio::time::interval(HEARTBEAT);
    heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    heartbeat.tick().await;
    alive(&mut text);
    loop {
        // What is newest when there is room.
        let Ok(room) = sender.reserve().await else {
            return;
        };
        changes.borrow_and_update();
        for (topic, published) in hub.newer_than(sent) {
            sent = sent.max(published.number);
            let _ = write!(text, "event: {topic}\ndata: {}\n\n", published.state);
        }
        room.send(std::mem::take(&mut text).into());
        // The pause, then the next news.
        tokio::select! {
            () = tokio::time::sleep(PAUSE) => {}
            () = sender.closed() => return,
        }
        tokio::select! {
            news = changes.changed() => match news {
                Ok(()) => {}
                Err(_) => return,
            },
            _ = heartbeat.tick() => alive(&mut text),
            () = sender.closed() => return,
        }
    }
}

/// The server's time, UTC.
fn alive(text: &mut String) {
    let now = jiff::Timestamp::now();
    let _ = write!(text, "event: alive\ndata: {{\"at\":\"{now:.3}\"}}\n\n");
}

/// The body of the answer.
struct Stream(mpsc::Receiver<Bytes>);

impl axum::body::HttpBody for Stream {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let bytes = self.0.poll_recv(context);
        bytes.map(|bytes| bytes.map(|bytes| Ok(Frame::data(bytes))))
    }
}

#[derive(serde::Deserialize)]
struct Which {
    viewer: Option<String>,
}

/// `api/events`.
pub fn routes(viewers: Viewers) -> Router {
    Router::new()
        .route("/api/events", get(events))
        .with_state(viewers)
}

async fn events(
    State(viewers): State<Viewers>,
    Query(which): Query<Which>,
) -> Result<Response, Refusal> {
    let viewer = which.viewer.as_deref().and_then(Viewer::parse);
    let viewer = viewer.ok_or_else(|| Refusal::bad("viewer=ID names the viewer"))?;
    let body = Body::new(Stream(viewers.open(viewer)?));
    Ok(([(CONTENT_TYPE, "text/event-stream")], body).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn runtime() -> tokio::runtime::Runtime {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_time().build().unwrap()
    }

    fn viewer(id: &str) -> Viewer {
        Viewer::parse(id).unwrap()
    }

    fn text(bytes: Option<Bytes>) -> String {
        String::from_utf8(bytes.unwrap().to_vec()).unwrap()
    }

    #[test]
    fn a_slow_reader_gets_the_newest_state_and_nothing_piles_up() {
        runtime().block_on(async {
            let hub = Hub::default();
            let viewers = Viewers::new(hub.clone(), json!({"version": "0"}));
            hub.publish("bench", 0.into());
            let mut stream = viewers.open(viewer("a")).unwrap();
            let first = text(stream.recv().await);
            assert!(first.starts_with("retry: 2000\n\n"), "{first}");
            assert!(first.contains("event: alive\ndata: {\"at\":\"2"), "{first}");
            assert!(first.contains("event: bench\ndata: 0\n\n"), "{first}");
            assert!(first.contains("\"viewers\":1"), "{first}");
            let began = std::time::Instant::now();
            // One text is on its way before the reader stalls, the rest is overwritten.
            for number in 1..=1000 {
                hub.publish("bench", number.into());
                if number % 300 == 0 {
                    tokio::time::sleep(Duration::from_millis(250)).await;
                }
            }
            let second = text(stream.recv().await);
            assert!(second.starts_with("event: bench\ndata: "), "{second}");
            let third = text(stream.recv().await);
            assert_eq!(third, "event: bench\ndata: 1000\n\n");
            assert!(began.elapsed() >= PAUSE);
        });
    }

    #[test]
    fn a_viewer_has_one_stream_and_their_number_is_bounded() {
        runtime().block_on(async {
            let viewers = Viewers::new(Hub::default(), json!({}));
            let mut first = viewers.open(viewer("0")).unwrap();
            let mut again = viewers.open(viewer("0")).unwrap();
            assert!(again.recv().await.is_some());
            while first.recv().await.is_some() {}
            let others: Vec<_> = (1..MOST_VIEWERS)
                .map(|id| viewers.open(viewer(&id.to_string())).unwrap())
                .collect();
            let refused = viewers.open(viewer("more")).unwrap_err();
            assert_eq!(refused.status, StatusCode::SERVICE_UNAVAILABLE);
            assert!(viewers.open(viewer("1")).is_ok());
            // Those that leave make room.
            drop(others);
            while viewers.streams().by_viewer.len() > 1 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            assert!(viewers.open(viewer("more")).is_ok());
        });
    }
}
