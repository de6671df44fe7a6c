//! Accepts connections and bounds what they cost: their number, the size and time of a
//! request's head, the time that a reader may stall.
//!
//! A connection takes a place when it has said what it wants and shown the token. A STOP has
//! places of its own and is never refused: neither for want of one, nor for its body, which
//! is not waited for.

use std::convert::Infallible;
use std::sync::{Arc, OnceLock, PoisonError, RwLock, Weak};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::request::Parts;
use axum::http::{Method, Request, StatusCode};
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;

use super::events::Viewers;
use super::gate::{Gate, secure, with_body};
use super::patient::Patient;
use crate::console::control::Control;
use crate::console::refusal::Refusal;

/// Requests that are answered at once, streams of events among them. Browsers make about six.
const MOST_PLACES: usize = 128;
/// STOPs that are answered at once and give way to nobody; more are answered as well.
const MOST_STOPS: usize = 32;
/// Connections at once that have no place: most have not said yet what they want.
const MOST_UNPLACED: usize = 512;
/// Connections that the system keeps until they are accepted: one more would have to knock
/// again, after a second.
pub const LONGEST_QUEUE: i32 = 4096;
/// Where no connection can be accepted, for want of files, this is waited for.
const NO_FILES: Duration = Duration::from_millis(10);
/// The head of a request has so long to arrive.
const HEAD_PATIENCE: Duration = Duration::from_secs(5);
/// The head of a request is at most so long (bytes).
const LONGEST_HEAD: usize = 16 << 10;
/// A reader that takes nothing for so long is cut off.
const WRITE_PATIENCE: Duration = Duration::from_secs(20);
/// What a refused client still sends is read for so long, so that it gets its answer; a server
/// that ends waits so long for its answers.
const LINGER: Duration = Duration::from_secs(1);
/// How often a server that ends looks whether all is answered.
const LOOK: Duration = Duration::from_millis(10);

/// What answers the requests.
#[derive(Debug)]
pub struct Served {
    /// Put into every request that is let in.
    pub control: Control,
    /// The streams of events.
    pub viewers: Viewers,
    /// Every address.
    pub routes: Router,
}

/// What connections share.
#[derive(Clone, Debug)]
pub struct Inside {
    /// Who is let in.
    gate: Arc<Gate>,
    served: Arc<RwLock<Arc<Served>>>,
    places: Arc<Semaphore>,
    places_of_stops: Arc<Semaphore>,
}

impl Inside {
    /// No connection yet.
    pub fn new(gate: Gate, served: Arc<Served>) -> Self {
        Self {
            gate: Arc::new(gate),
            served: Arc::new(RwLock::new(served)),
            places: Arc::new(Semaphore::new(MOST_PLACES)),
            places_of_stops: Arc::new(Semaphore::new(MOST_STOPS)),
        }
    }

    /// What answers a request that comes now.
    pub fn served(&self) -> Arc<Served> {
        let served = self.served.read();
        served.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Requests are answered by this from now on; returns what answered them before.
    pub fn serve(&self, served: Arc<Served>) -> Arc<Served> {
        let before = self.served.write();
        std::mem::replace(&mut before.unwrap_or_else(PoisonError::into_inner), served)
    }

    /// Waits until every request that was admitted is answered, but not for long.
    pub async fn answered(&self) {
        let all = async {
            // One more look is for a request that is being read.
            for _ in 0..2 {
                tokio::time::sleep(LOOK).await;
                while self.places.available_permits() < MOST_PLACES
                    || self.places_of_stops.available_permits() < MOST_STOPS
                {
                    tokio::time::sleep(LOOK).await;
                }
            }
        };
        let _ = tokio::time::timeout(LINGER, all).await;
    }
}

/// Of one connection, once it has one.
type Place = OnceLock<OwnedSemaphorePermit>;

/// A connection that is open.
struct Open {
    place: Weak<Place>,
    task: AbortHandle,
}

impl Open {
    fn has_place(&self) -> bool {
        let place = self.place.upgrade();
        place.is_some_and(|place| place.get().is_some())
    }
}

/// Accepts connections until it is dropped.
///
/// Where there are too many, the oldest without a place gives way: whoever opens connections
/// and stays silent keeps nobody out.
pub async fn accept(listener: TcpListener, inside: Inside) {
    let mut open: Vec<Open> = Vec::new();
    loop {
        let accepted = listener.accept().await;
        open.retain(|connection| !connection.task.is_finished());
        let unplaced = open.iter().filter(|connection| !connection.has_place());
        if unplaced.count() >= MOST_UNPLACED || accepted.is_err() {
            let oldest = open.iter().position(|connection| !connection.has_place());
            if let Some(oldest) = oldest {
                open.remove(oldest).task.abort();
            }
        }
        match accepted {
            Ok((stream, _)) => {
                let place = Arc::new(Place::new());
                let of = Arc::downgrade(&place);
                let serving = serve(stream, inside.clone(), place);
                let task = tokio::spawn(serving).abort_handle();
                open.push(Open { place: of, task });
                // What it has sent already is read before the next one is accepted.
                tokio::task::yield_now().await;
            }
            // Too many open files, or a connection that was gone at once.
            Err(_) => tokio::time::sleep(NO_FILES).await,
        }
    }
}

/// One request, one answer: a kept connection would end just when the page sends its next.
async fn serve(stream: TcpStream, inside: Inside, place: Arc<Place>) {
    let millis = WRITE_PATIENCE.as_millis() as u32;
    // A client that has vanished from the network is noticed; best effort.
    let _ = rustix::net::sockopt::set_tcp_user_timeout(&stream, millis);
    let _ = stream.set_nodelay(true);
    let mut io = TokioIo::new(Patient::new(stream, WRITE_PATIENCE));
    let service = service_fn(move |request| {
        let (inside, place) = (inside.clone(), place.clone());
        async move { Ok::<_, Infallible>(secure(answer(request, inside, &place).await)) }
    });
    let ended = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_PATIENCE)
        .max_header_size(LONGEST_HEAD)
        .max_buf_size(2 * LONGEST_HEAD)
        .keep_alive(false)
        .serve_connection(&mut io, service)
        .await;
    if ended.is_ok() {
        linger(io.into_inner()).await;
    }
}

async fn answer(request: Request<Incoming>, inside: Inside, place: &Place) -> Response {
    let (mut head, body) = request.into_parts();
    match inside.gate.admit(&head) {
        Ok(uri) => head.uri = uri,
        Err(outside) => return outside.into_response(),
    }
    let served = inside.served();
    head.extensions.insert(served.control.clone());
    let request = if is_stop(&head) {
        if let Ok(permit) = inside.places_of_stops.try_acquire_owned() {
            let _ = place.set(permit);
        }
        Request::from_parts(head, Body::from("{}"))
    } else {
        let Ok(permit) = inside.places.try_acquire_owned() else {
            let fact = format!("{MOST_PLACES} requests are being answered already");
            return Refusal::new(StatusCode::SERVICE_UNAVAILABLE, fact)
                .hint("close some of the open pages".to_owned())
                .into_response();
        };
        let _ = place.set(permit);
        match with_body(Request::from_parts(head, body)).await {
            Ok(request) => request,
            Err(refusal) => return refusal.into_response(),
        }
    };
    let routes = TowerToHyperService::new(served.routes.clone());
    match routes.call(request).await {
        Ok(response) => response,
        Err(never) => match never {},
    }
}

/// The addresses of all STOPs end so, and no other action's does. Their bodies say nothing.
fn is_stop(head: &Parts) -> bool {
    head.method == Method::POST && head.uri.path().ends_with("/stop")
}

/// A connection that is closed while bytes of its client wait is reset, and the client may
/// lose the answer: takes a few of them.
async fn linger(mut stream: Patient<TcpStream>) {
    let taking = async {
        let mut bytes = [0; 4096];
        let mut taken = 0;
        while taken < 4 * super::gate::LONGEST_BODY {
            match stream.read(&mut bytes).await {
                Ok(count) if count > 0 => taken += count,
                _ => break,
            }
        }
    };
    let _ = tokio::time::timeout(LINGER, taking).await;
    let _ = stream.shutdown().await;
}
