//! Accepts connections and bounds what they cost: their number, the size and time of a
//! request's head, the time that a reader may stall.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::http::Request;
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

use super::gate::{Gate, Outside, secure, with_body};
use super::patient::Patient;
use crate::console::control::Control;

/// Connections at once. Browsers open about six.
const MOST_CONNECTIONS: usize = 64;
/// The head of a request has so long to arrive.
const HEAD_PATIENCE: Duration = Duration::from_secs(5);
/// The head of a request is at most so long (bytes).
const LONGEST_HEAD: usize = 16 << 10;
/// A reader that takes nothing for so long is cut off.
const WRITE_PATIENCE: Duration = Duration::from_secs(20);
/// What a refused client still sends is read for so long, so that it gets its answer.
const LINGER: Duration = Duration::from_secs(1);

/// What connections share.
#[derive(Clone, Debug)]
pub struct Inside {
    /// Who is let in.
    pub gate: Arc<Gate>,
    /// Put into every request that is.
    pub control: Control,
    /// What answers it.
    pub routes: Router,
}

/// A connection that is open.
struct Open {
    /// It has sent a request with the token.
    is_known: Arc<AtomicBool>,
    task: AbortHandle,
}

/// Accepts connections until it is dropped.
///
/// Where there are too many, the oldest that has not shown the token gives way: whoever
/// opens connections and stays silent keeps nobody out.
pub async fn accept(listener: TcpListener, inside: Inside) {
    let mut open: Vec<Open> = Vec::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Too many open files, or a connection that was gone at once.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        open.retain(|connection| !connection.task.is_finished());
        if open.len() >= MOST_CONNECTIONS {
            let is_stranger = |c: &Open| !c.is_known.load(Ordering::Relaxed);
            match open.iter().position(is_stranger) {
                Some(oldest) => open.remove(oldest).task.abort(),
                None => continue,
            }
        }
        let is_known = Arc::new(AtomicBool::new(false));
        let serving = serve(stream, inside.clone(), is_known.clone());
        let task = tokio::spawn(serving).abort_handle();
        open.push(Open { is_known, task });
    }
}

/// One request, one answer: a kept connection would end just when the page sends its next.
async fn serve(stream: TcpStream, inside: Inside, is_known: Arc<AtomicBool>) {
    let millis = WRITE_PATIENCE.as_millis() as u32;
    // A client that has vanished from the network is noticed; best effort.
    let _ = rustix::net::sockopt::set_tcp_user_timeout(&stream, millis);
    let _ = stream.set_nodelay(true);
    let mut io = TokioIo::new(Patient::new(stream, WRITE_PATIENCE));
    let service = service_fn(move |request| {
        let (inside, is_known) = (inside.clone(), is_known.clone());
        async move { Ok::<_, Infallible>(secure(answer(request, inside, &is_known).await)) }
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

async fn answer(request: Request<Incoming>, inside: Inside, is_known: &AtomicBool) -> Response {
    let (mut head, body) = request.into_parts();
    match inside.gate.admit(&head) {
        Ok(uri) => head.uri = uri,
        Err(outside) => {
            is_known.store(outside != Outside::Stranger, Ordering::Relaxed);
            return outside.into_response();
        }
    }
    is_known.store(true, Ordering::Relaxed);
    head.extensions.insert(inside.control);
    let request = match with_body(Request::from_parts(head, body)).await {
        Ok(request) => request,
        Err(refusal) => return refusal.into_response(),
    };
    let routes = TowerToHyperService::new(inside.routes);
    match routes.call(request).await {
        Ok(response) => response,
        Err(never) => match never {},
    }
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
