//! The one server of the program: it listens, lets in whoever has the token, and hands the
//! requests to the routes of the console's parts.
//!
//! It runs in a thread of its own. Nothing that a client does holds up any other thread.

mod connections;
mod events;
mod gate;
mod hosts;
mod pages;
mod patient;
mod token;

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::http::StatusCode;
use serde_json::Value;
use tokio::sync::oneshot;

use self::connections::{Inside, LONGEST_QUEUE, Served, accept};
use self::events::Viewers;
use self::gate::Gate;
use self::hosts::Hosts;
pub use self::hosts::is_host_name;
use self::token::Token;
use super::control::{self, Control};
use super::hub::Hub;
use super::refusal::Refusal;

/// How often the age of the control is published anew.
const CONTROL_TICK: Duration = Duration::from_secs(5);
/// Threads for work that waits (files, child processes).
const BLOCKING_THREADS: usize = 8;

/// Where to listen, and under which names the server is reached.
#[derive(Clone, Debug)]
pub struct ListenOptions {
    /// Port 0 takes a free one.
    pub address: SocketAddr,
    /// Names besides the address itself, such as that of a TLS proxy in front.
    pub host_names: Vec<String>,
}

impl Default for ListenOptions {
    /// A free port of this machine alone.
    fn default() -> Self {
        Self {
            address: (Ipv4Addr::LOCALHOST, 0).into(),
            host_names: Vec::new(),
        }
    }
}

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address cannot be listened at.
    #[error("{address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// No token could be made.
    #[error("no random numbers for a token: {0}")]
    Token(#[source] getrandom::Error),
    /// The server's thread could not begin.
    #[error("the server cannot begin: {0}")]
    Begin(#[source] std::io::Error),
}

/// What the server serves.
#[derive(Debug)]
pub struct Parts {
    /// What the pages are shown.
    pub hub: Hub,
    /// Which page controls.
    pub control: Control,
    /// The topic `console`, without the number of viewers.
    pub facts: Value,
    /// The addresses of the other parts. Those that end with `/stop` are STOPs: answered
    /// whatever else is under way, without their body.
    pub routes: Router,
}

/// A server that listens, and answers once it serves something; it stops when this is dropped.
#[derive(Debug)]
pub struct Server {
    listener: std::net::TcpListener,
    address: SocketAddr,
    gate: Gate,
    running: Option<Running>,
}

impl Server {
    /// Listens, with a new token.
    ///
    /// # Errors
    /// If the address is taken or may not be used, or the system has no random numbers.
    pub fn bind(options: &ListenOptions) -> Result<Self, ServerError> {
        let failed = |source| ServerError::Listen {
            address: options.address,
            source,
        };
        let listener = std::net::TcpListener::bind(options.address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        // It listens already, for a queue of 128.
        rustix::net::listen(&listener, LONGEST_QUEUE).map_err(|errno| failed(errno.into()))?;
        let address = listener.local_addr().map_err(failed)?;
        let gate = Gate {
            token: Token::random().map_err(ServerError::Token)?,
            hosts: Hosts::new(address, &options.host_names),
        };
        Ok(Self {
            listener,
            address,
            gate,
            running: None,
        })
    }

    /// Where it listens.
    pub fn socket_address(&self) -> SocketAddr {
        self.address
    }

    /// The page's address, token included: whoever has it has the bench.
    pub fn address(&self) -> String {
        let ip = match self.address.ip() {
            ip if ip.is_unspecified() => own_address(ip).unwrap_or(ip),
            ip => ip,
        };
        let reached = SocketAddr::new(ip, self.address.port());
        format!("http://{reached}/{}/", self.gate.token.reveal())
    }

    /// Serves these parts from now on, in a thread of its own. Where others were served before,
    /// they still answer what was asked of them, and nobody is turned away between; only their
    /// streams of events end, and the pages come back by themselves.
    ///
    /// # Errors
    /// If the system gives no thread, no event queue or no file descriptor.
    pub fn serve(&mut self, parts: Parts) -> Result<(), ServerError> {
        let viewers = Viewers::new(parts.hub, parts.facts);
        let nothing = || async { Refusal::missing("there is no such address") };
        let other_method =
            || async { Refusal::new(StatusCode::METHOD_NOT_ALLOWED, "not with this method") };
        let routes = pages::routes()
            .merge(events::routes(viewers.clone()))
            .merge(control::routes(parts.control.clone()))
            .merge(parts.routes)
            .fallback(nothing)
            .method_not_allowed_fallback(other_method);
        let served = Arc::new(Served {
            control: parts.control,
            viewers,
            routes,
        });
        if let Some(running) = &self.running {
            running.inside.serve(served).viewers.end();
            return Ok(());
        }
        let listener = self.listener.try_clone().map_err(ServerError::Begin)?;
        let inside = Inside::new(self.gate.clone(), served);
        self.running = Some(Running::start(listener, inside)?);
        Ok(())
    }
}

async fn tick(inside: &Inside) {
    loop {
        tokio::time::sleep(CONTROL_TICK).await;
        let control = &inside.served().control;
        if control.silence().is_some() {
            control.publish();
        }
    }
}

/// The address that other machines reach this one at: that of the interface of the default
/// route. Nothing is sent.
fn own_address(unspecified: IpAddr) -> Option<IpAddr> {
    // Addresses that are reserved for documents (RFC 5737, RFC 3849).
    let elsewhere = match unspecified {
        IpAddr::V4(_) => "192.0.2.1:9",
        IpAddr::V6(_) => "[2001:db8::1]:9",
    };
    let socket = UdpSocket::bind((unspecified, 0)).ok()?;
    socket.connect(elsewhere).ok()?;
    let ip = socket.local_addr().ok()?.ip();
    (!ip.is_unspecified()).then_some(ip)
}

/// The thread that answers; it stops when this is dropped.
#[derive(Debug)]
struct Running {
    inside: Inside,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn start(listener: std::net::TcpListener, inside: Inside) -> Result<Self, ServerError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(BLOCKING_THREADS)
            .build()
            .map_err(ServerError::Begin)?;
        let (stop, stopped) = oneshot::channel::<()>();
        let shared = inside.clone();
        let serving = move || {
            runtime.block_on(async {
                // It has been bound, so nothing can fail but the system as a whole.
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
                    return;
                };
                tokio::select! {
                    () = accept(listener, shared.clone()) => {}
                    () = tick(&shared) => {}
                    _ = stopped => {}
                }
                shared.served().viewers.end();
                shared.answered().await;
            });
            // What a handler still waits for ends by itself.
            runtime.shutdown_background();
        };
        let thread = std::thread::Builder::new()
            .name("console".to_owned())
            .spawn(serving)
            .map_err(ServerError::Begin)?;
        Ok(Self {
            inside,
            stop: Some(stop),
            thread: Some(thread),
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;

    use super::*;

    fn parts(routes: Router) -> Parts {
        let hub = Hub::default();
        Parts {
            control: Control::new(hub.clone()),
            hub,
            facts: serde_json::json!({}),
            routes,
        }
    }

    /// As when a page chooses another bench while other pages ask something, then as when the
    /// console ends meanwhile.
    #[test]
    fn what_was_asked_before_is_answered() {
        let mut server = Server::bind(&ListenOptions::default()).unwrap();
        let (address, socket) = (server.address(), server.socket_address());
        let ask = |mut stream: TcpStream, path: &str| {
            let path = address.splitn(4, '/').nth(3).unwrap().to_owned() + path;
            write!(stream, "GET /{path} HTTP/1.1\r\nhost: {socket}\r\n\r\n").unwrap();
            stream
        };
        let connect = || TcpStream::connect(socket).unwrap();
        let answer_on = |mut stream: TcpStream| {
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer
        };
        let (asked, is_asked) = std::sync::mpsc::channel();
        let slow = |answer: &'static str, millis| {
            let asked = asked.clone();
            let handler = move || async move {
                asked.send(()).unwrap();
                tokio::time::sleep(Duration::from_millis(millis)).await;
                answer
            };
            parts(Router::new().route("/slow", axum::routing::get(handler)))
        };
        // Longer than a server that ends would wait.
        server.serve(slow("first", 1500)).unwrap();
        let mut events = ask(connect(), "api/events?viewer=a");
        assert_eq!(events.read(&mut [0; 1]).unwrap(), 1);
        let first = ask(connect(), "slow");
        is_asked.recv().unwrap();
        let silent = connect();
        // One more connection is accepted after the silent one.
        let missing = answer_on(ask(connect(), "nowhere"));
        assert!(missing.starts_with("HTTP/1.1 404"), "{missing}");

        server.serve(slow("second", 100)).unwrap();
        // The last chunk.
        assert!(answer_on(events).ends_with("\r\n0\r\n\r\n"));
        let second = answer_on(ask(silent, "slow"));
        assert!(second.ends_with("second"), "{second}");
        let first = answer_on(first);
        assert!(first.ends_with("first"), "{first}");

        let last = ask(connect(), "slow");
        is_asked.recv().unwrap();
        is_asked.recv().unwrap();
        drop(server);
        let last = answer_on(last);
        assert!(last.ends_with("second"), "{last}");
        assert!(TcpStream::connect(socket).is_err());
    }
}
