//! Which of the open pages controls the bench.
//!
//! Any number of pages look on, one controls. A page takes control with a button, from
//! whichever page had it; the first action takes it if no page has it, or if the one that
//! has it has been silent for as long as a lamp may stay lit without it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::Json;
use axum::Router;
use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use axum::routing::post;
use serde_json::{Value, json};

use super::hub::Hub;
use super::refusal::Refusal;
use super::request::{Asked, Viewer};

/// A controlling page that has not been heard of for so long may be replaced by any action
/// of another; a lamp that it lit goes out.
pub const LONGEST_SILENCE: Duration = Duration::from_secs(30);

/// Which viewer controls, and when it was last heard of.
#[derive(Clone, Debug, Default)]
pub struct Custody {
    holder: Option<Holder>,
}

#[derive(Clone, Debug)]
struct Holder {
    viewer: Viewer,
    last: Instant,
}

impl Custody {
    /// Control goes to this viewer, whichever had it.
    pub fn take(&mut self, viewer: Viewer, now: Instant) {
        self.holder = Some(Holder { viewer, last: now });
    }

    /// No viewer controls any more, if this one did.
    pub fn release(&mut self, viewer: &Viewer) {
        if self.holder.as_ref().is_some_and(|h| h.viewer == *viewer) {
            self.holder = None;
        }
    }

    /// A sign of life; whether this viewer controls.
    pub fn ping(&mut self, viewer: &Viewer, now: Instant) -> bool {
        match &mut self.holder {
            Some(holder) if holder.viewer == *viewer => {
                holder.last = now;
                true
            }
            _ => false,
        }
    }

    /// Whether this viewer may act; if no other controls, it does from now on.
    pub fn admits(&mut self, viewer: &Viewer, now: Instant) -> bool {
        let is_free = self.silence(now).is_none_or(|s| s >= LONGEST_SILENCE);
        if self.ping(viewer, now) {
            return true;
        }
        if is_free {
            self.take(viewer.clone(), now);
        }
        is_free
    }

    /// How long the controlling viewer has been silent; `None` if no viewer controls.
    pub fn silence(&self, now: Instant) -> Option<Duration> {
        let holder = self.holder.as_ref()?;
        Some(now.saturating_duration_since(holder.last))
    }

    /// The topic `control`.
    fn state(&self, now: Instant) -> Value {
        let age_s = self.silence(now).map(|silence| silence.as_secs_f64());
        let viewer = self.holder.as_ref().map(|holder| holder.viewer.id());
        json!({"viewer": viewer, "age_s": age_s})
    }
}

/// [`Custody`] that the parts of the console share; each change is published.
#[derive(Clone, Debug)]
pub struct Control {
    custody: Arc<Mutex<Custody>>,
    hub: Hub,
}

impl Control {
    /// No viewer controls yet.
    pub fn new(hub: Hub) -> Self {
        let control = Self {
            custody: Arc::default(),
            hub,
        };
        control.publish();
        control
    }

    fn custody(&self) -> MutexGuard<'_, Custody> {
        self.custody.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How long the controlling page has been silent; `None` if none controls.
    pub fn silence(&self) -> Option<Duration> {
        self.custody().silence(Instant::now())
    }

    /// Publishes the topic `control` with the age as it is now.
    pub fn publish(&self) {
        let state = self.custody().state(Instant::now());
        self.hub.publish("control", state);
    }

    fn change<T>(&self, change: impl FnOnce(&mut Custody, Instant) -> T) -> T {
        let result = change(&mut self.custody(), Instant::now());
        self.publish();
        result
    }
}

/// An action that only the controlling viewer may do: as an argument of a handler it
/// refuses all others with 409.
#[derive(Clone, Debug)]
pub struct Controlled(pub Viewer);

impl<S: Sync> FromRequestParts<S> for Controlled {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Refusal> {
        let viewer = Viewer::from_request_parts(parts, state).await?;
        // The server puts it there, so that a route needs no state for it.
        let control = parts.extensions.get::<Control>();
        let control = control.ok_or_else(|| Refusal::failed("no server, no control"))?;
        match control.change(|custody, now| custody.admits(&viewer, now)) {
            true => Ok(Self(viewer)),
            false => Err(Refusal::conflict("another page controls the bench")
                .hint("take control first".to_owned())),
        }
    }
}

/// `api/control/…`.
pub fn routes(control: Control) -> Router {
    Router::new()
        .route("/api/control/take", post(take))
        .route("/api/control/release", post(release))
        .route("/api/control/ping", post(ping))
        .with_state(control)
}

async fn take(State(control): State<Control>, viewer: Viewer, _: Asked<Value>) -> Json<Value> {
    control.change(|custody, now| custody.take(viewer, now));
    Json(json!({"controls": true}))
}

async fn release(State(control): State<Control>, viewer: Viewer, _: Asked<Value>) -> Json<Value> {
    control.change(|custody, _| custody.release(&viewer));
    Json(json!({"controls": false}))
}

async fn ping(State(control): State<Control>, viewer: Viewer, _: Asked<Value>) -> Json<Value> {
    let controls = control.custody().ping(&viewer, Instant::now());
    if controls {
        control.publish();
    }
    Json(json!({"controls": controls}))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn viewers() -> [Viewer; 2] {
        ["a", "b"].map(|id| Viewer::parse(id).unwrap())
    }

    #[test]
    fn the_first_action_takes_control_and_a_second_viewer_is_refused() {
        let [a, b] = viewers();
        let (mut custody, now) = (Custody::default(), Instant::now());
        assert_eq!(custody.silence(now), None);
        assert!(!custody.ping(&a, now), "a ping takes nothing");
        assert!(custody.admits(&a, now));
        assert!(!custody.admits(&b, now));
        assert!(custody.admits(&a, now));
        custody.take(b.clone(), now);
        assert!(!custody.admits(&a, now) && custody.admits(&b, now));
        custody.release(&a);
        assert!(custody.ping(&b, now), "only its holder can release control");
        custody.release(&b);
        assert!(!custody.ping(&b, now) && custody.admits(&a, now));
    }

    #[test]
    fn a_silent_viewer_keeps_control_until_another_acts() {
        let [a, b] = viewers();
        let (mut custody, began) = (Custody::default(), Instant::now());
        custody.take(a.clone(), began);
        let nearly = began + LONGEST_SILENCE - Duration::from_millis(1);
        assert!(!custody.admits(&b, nearly));
        // A refused action of another is no sign of life.
        assert_eq!(custody.silence(nearly), Some(nearly - began));
        assert!(custody.ping(&a, nearly));
        let later = nearly + LONGEST_SILENCE;
        assert_eq!(custody.silence(later), Some(LONGEST_SILENCE));
        assert!(custody.clone().ping(&a, later), "it can come back");
        assert!(custody.admits(&b, later) && !custody.ping(&a, later));
        let state = custody.state(later + Duration::from_secs(3));
        assert_eq!(state, json!({"viewer": "b", "age_s": 3.0}));
    }
}
