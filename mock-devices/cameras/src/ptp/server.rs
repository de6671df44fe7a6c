//! The body on a TCP port: one client at a time, a connection for commands and one for
//! events.

use std::io::{ErrorKind, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::body::Body;
use super::dataset::Dataset;
use super::faults::BodyFaults;
use super::packet::{Packet, kind};
use mock_devices::clock::lock;

const VERSION: u32 = 0x1_0000;
/// A client that is connected already keeps others out.
const BUSY: u32 = 2;
/// How long a new client waits for the one before to have gone: a client closes its
/// connection, and the thread that serves it notices a moment later.
const HANDOVER: Duration = Duration::from_secs(2);
const OK: u16 = 0x2001;
const GENERAL_ERROR: u16 = 0x2002;

struct Shared {
    body: Mutex<Body>,
    faults: BodyFaults,
    /// The event connection of the client that is being served.
    events: Mutex<Option<TcpStream>>,
    is_serving: AtomicBool,
    connections: AtomicU32,
    ends: AtomicBool,
}

/// A body that is listening.
pub struct PtpServer {
    address: SocketAddr,
    shared: Arc<Shared>,
    listener: Option<JoinHandle<()>>,
}

impl PtpServer {
    /// Listens on a free port of 127.0.0.1.
    ///
    /// # Errors
    /// The system's, where there is no port.
    pub fn start(body: Body) -> std::io::Result<Self> {
        let listener = TcpListener::bind(("127.0.0.1", 0))?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared {
            faults: body.faults(),
            body: Mutex::new(body),
            events: Mutex::new(None),
            is_serving: AtomicBool::new(false),
            connections: AtomicU32::new(0),
            ends: AtomicBool::new(false),
        });
        let of_thread = Arc::clone(&shared);
        Ok(Self {
            address,
            shared,
            listener: Some(std::thread::spawn(move || {
                listen(&listener, &of_thread);
            })),
        })
    }

    /// As gphoto2's option `--port` names it: the same port for commands and events.
    pub fn port(&self) -> String {
        let port = self.address.port();
        format!("ptpip:{}:{port}:{port}", self.address.ip())
    }

    /// Handle for making it fail.
    pub fn faults(&self) -> BodyFaults {
        self.shared.faults.clone()
    }

    /// Files in the body's store.
    pub fn objects(&self) -> usize {
        lock(&self.shared.body).objects()
    }
}

impl Drop for PtpServer {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::SeqCst);
        // Wakes the thread that accepts.
        drop(TcpStream::connect(self.address));
        if let Some(thread) = self.listener.take() {
            drop(thread.join());
        }
    }
}

fn listen(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.ends.load(Ordering::SeqCst) {
            return;
        }
        let Ok(stream) = stream else { continue };
        if shared.faults.now().is_gone {
            continue;
        }
        let shared = Arc::clone(shared);
        // A client that goes away ends its thread with an error, which is no concern here.
        std::thread::spawn(move || drop(serve(stream, &shared)));
    }
}

/// The first packet says which of the two connections it is.
fn serve(mut stream: TcpStream, shared: &Shared) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let first = Packet::read(&mut stream)?;
    match first.kind {
        kind::INIT_COMMAND_REQUEST => {
            let guid = first.fields().array()?;
            let until = Instant::now() + HANDOVER;
            while shared.is_serving.swap(true, Ordering::SeqCst) {
                if Instant::now() > until {
                    return send(&mut stream, kind::INIT_FAIL, Dataset::default().u32(BUSY));
                }
                std::thread::sleep(Duration::from_millis(5));
            }
            let served = serve_commands(&mut stream, guid, shared);
            *lock(&shared.events) = None;
            shared.is_serving.store(false, Ordering::SeqCst);
            served
        }
        kind::INIT_EVENT_REQUEST => {
            send(&mut stream, kind::INIT_EVENT_ACK, Dataset::default())?;
            *lock(&shared.events) = Some(stream.try_clone()?);
            // Only questions whether anybody is there come this way.
            while Packet::read(&mut stream)?.kind == kind::PING {
                send(&mut stream, kind::PONG, Dataset::default())?;
            }
            Ok(())
        }
        _ => Ok(()),
    }
}

fn serve_commands(stream: &mut TcpStream, guid: [u8; 16], shared: &Shared) -> std::io::Result<()> {
    let name = {
        let mut body = lock(&shared.body);
        body.connect();
        body.config().maker_and_model.join(" ")
    };
    let connection = shared.connections.fetch_add(1, Ordering::SeqCst) + 1;
    let accepted = Dataset::default().u32(connection).bytes(&guid);
    let accepted = accepted.name(&name).u32(VERSION);
    send(stream, kind::INIT_COMMAND_ACK, accepted)?;
    loop {
        // The operation and its data.
        let packet = Packet::read(stream)?;
        match packet.kind {
            kind::REQUEST => {}
            kind::PING => {
                send(stream, kind::PONG, Dataset::default())?;
                continue;
            }
            _ => continue,
        }
        let mut fields = packet.fields();
        let (data_phase, code, transaction) = (fields.u32()?, fields.u16()?, fields.u32()?);
        let parameters = fields.parameters()?;
        if shared.faults.now().is_gone {
            return Ok(());
        }
        let data = match data_phase {
            2 => data_of_client(stream)?,
            _ => Vec::new(),
        };
        // Its reply.
        let reply = lock(&shared.body).operation(code, &parameters, &data);
        if let Some(data) = reply.data {
            send_data(stream, transaction, &data)?;
        }
        let response = operation(reply.code, transaction, &reply.parameters);
        send(stream, kind::RESPONSE, response)?;
        if reply.exposes {
            expose(transaction, shared)?;
        }
        if code == 0x1003 && reply.code == OK {
            return Ok(());
        }
    }
}

/// Takes the frame and reports it on the event connection.
fn expose(transaction: u32, shared: &Shared) -> std::io::Result<()> {
    let exposed = lock(&shared.body).expose();
    let slow = shared.faults.now().slow;
    std::thread::sleep(slow);
    if shared.faults.now().is_gone {
        return Err(ErrorKind::ConnectionAborted.into());
    }
    let events = exposed.unwrap_or_else(|_| vec![(GENERAL_ERROR, Vec::new())]);
    if let Some(stream) = lock(&shared.events).as_mut() {
        for (code, parameters) in events {
            send(
                stream,
                kind::EVENT,
                operation(code, transaction, &parameters),
            )?;
        }
    }
    Ok(())
}

/// Code, transaction and parameters, as responses and events have them.
fn operation(code: u16, transaction: u32, parameters: &[u32]) -> Dataset {
    let start = Dataset::default().u16(code).u32(transaction);
    parameters
        .iter()
        .fold(start, |data, value| data.u32(*value))
}

fn data_of_client(stream: &mut TcpStream) -> std::io::Result<Vec<u8>> {
    let mut data = Vec::new();
    loop {
        let packet = Packet::read(stream)?;
        let mut fields = packet.fields();
        fields.u32()?;
        match packet.kind {
            kind::START_DATA => {}
            kind::DATA => data.extend(fields.rest()),
            kind::END_DATA => {
                data.extend(fields.rest());
                return Ok(data);
            }
            _ => return Err(ErrorKind::InvalidData.into()),
        }
    }
}

fn send_data(stream: &mut TcpStream, transaction: u32, data: &[u8]) -> std::io::Result<()> {
    let of_transaction = || Dataset::default().u32(transaction);
    let start = of_transaction().u64(data.len() as u64);
    send(stream, kind::START_DATA, start)?;
    send(stream, kind::END_DATA, of_transaction().bytes(data))
}

fn send(stream: &mut TcpStream, kind: u32, body: Dataset) -> std::io::Result<()> {
    stream.write_all(&Packet::new(kind, body).encode())
}
