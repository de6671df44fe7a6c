//! A GigE Vision camera on UDP that looks at the bench.
//!
//! It answers GVCP on port 3956 of an address of this machine, mostly a loopback one, and
//! sends its frames by GVSP. One controller at a time has it, and loses it when it is silent
//! for longer than the heartbeat time-out. Nothing of it needs root.

mod exposing;
pub mod faults;
pub mod gvcp;
pub mod gvsp;
pub mod memory;
pub mod pixels;
mod stream;
mod xml;

use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub use exposing::Exposer;
pub use faults::GigeFaults;
use gvcp::{Command, Request, Status};
use memory::{Identity, Memory};
use stream::Streaming;

use mock_devices::clock::lock;

/// How often a thread looks whether it is to end.
const TICK: Duration = Duration::from_millis(20);
/// Values of the register of the control privilege: exclusive, and with others reading.
const CONTROLLED: u32 = 0b11;
const CONTROL_WITH_READERS: u32 = 0b10;

/// What the threads share.
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    faults: GigeFaults,
    exposer: Exposer,
    identity: Identity,
}

struct State {
    memory: Memory,
    controller: Option<SocketAddr>,
    heard: Instant,
    streaming: Streaming,
    was_gone: bool,
    ends: bool,
}

/// The device; it ends when this is dropped.
pub struct GigeCamera {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl GigeCamera {
    /// A device at this address with this serial number (at most 15 characters).
    ///
    /// # Errors
    /// The address is none of this machine, or its port is taken.
    pub fn start(address: Ipv4Addr, serial: &str, exposer: Exposer) -> io::Result<Self> {
        let control = UdpSocket::bind((address, gvcp::PORT))?;
        let identity = Identity {
            serial: serial.chars().take(15).collect(),
            address,
        };
        let state = State {
            memory: exposer.memory(&identity),
            controller: None,
            heard: Instant::now(),
            streaming: Streaming::default(),
            was_gone: false,
            ends: false,
        };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            changed: Condvar::new(),
            faults: GigeFaults::default(),
            exposer,
            identity,
        });
        // Commands to this address, and those to every device.
        let sockets = vec![control, broadcasts()?];
        let mut threads = Vec::new();
        for socket in sockets {
            socket.set_read_timeout(Some(TICK))?;
            let shared = Arc::clone(&shared);
            threads.push(std::thread::spawn(move || shared.answer(&socket)));
        }
        let socket = UdpSocket::bind((address, 0))?;
        let streamed = Arc::clone(&shared);
        threads.push(std::thread::spawn(move || streamed.stream(&socket)));
        Ok(Self { shared, threads })
    }

    /// Handle for making it fail.
    pub fn faults(&self) -> GigeFaults {
        self.shared.faults.clone()
    }

    /// Whether a controller has it now.
    pub fn is_controlled(&self) -> bool {
        self.shared.lock().controller.is_some()
    }
}

/// A socket that gets what is sent to every device, next to those of other devices here.
fn broadcasts() -> io::Result<UdpSocket> {
    use rustix::net::{AddressFamily, SocketType, bind, socket, sockopt::set_socket_reuseaddr};
    let all = socket(AddressFamily::INET, SocketType::DGRAM, None)?;
    set_socket_reuseaddr(&all, true)?;
    let address = SocketAddr::from((Ipv4Addr::BROADCAST, gvcp::PORT));
    bind(&all, &address)?;
    Ok(UdpSocket::from(all))
}

impl Drop for GigeCamera {
    fn drop(&mut self) {
        self.shared.lock().ends = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            // A panic of a thread has been printed.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Answers commands until the device ends.
    fn answer(&self, socket: &UdpSocket) {
        let mut bytes = [0; 2048];
        loop {
            let received = socket.recv_from(&mut bytes);
            let mut state = self.lock();
            if state.ends {
                return;
            }
            self.look_after(&mut state);
            let Ok((count, from)) = received else {
                continue;
            };
            if state.was_gone {
                continue;
            }
            let answer = match Request::decode(&bytes[..count]) {
                None => None,
                Some(Err((status, id))) => Some(gvcp::unreadable(status, id)),
                Some(Ok(request)) => {
                    let done = self.carry_out(&mut state, &request.command, from, socket);
                    let answer = match done {
                        Ok(payload) => gvcp::done(&request, &payload),
                        Err(status) => gvcp::refused(&request, status),
                    };
                    request.wants_reply.then_some(answer)
                }
            };
            drop(state);
            self.changed.notify_all();
            if let Some(answer) = answer {
                // As on a network, an answer may be lost.
                let _ = socket.send_to(&answer, from);
            }
        }
    }

    /// Heartbeat, and the device being unplugged and back as new.
    fn look_after(&self, state: &mut State) {
        let is_gone = self.faults.now().is_gone;
        let silent = state.heard.elapsed().as_millis();
        let is_late = silent > u128::from(state.memory.get(memory::HEARTBEAT));
        let is_forgotten = std::mem::take(&mut self.faults.now().forgets_controller);
        if is_gone || is_forgotten || (state.controller.is_some() && is_late) {
            state.controller = None;
            state.memory.put(memory::CONTROL, 0);
            state.memory.put(memory::STREAM_PORT, 0);
            state.streaming.stop();
        }
        if is_gone && !state.was_gone {
            state.memory = self.exposer.memory(&self.identity);
        }
        state.was_gone = is_gone;
    }

    fn carry_out(
        &self,
        state: &mut State,
        command: &Command,
        from: SocketAddr,
        socket: &UdpSocket,
    ) -> Result<Vec<u8>, Status> {
        if state.controller == Some(from) {
            state.heard = Instant::now();
        }
        match command {
            Command::Discovery => state.memory.read(0, memory::DISCOVERED),
            Command::ForceIp => Err(Status::NotImplemented),
            Command::Resend { block, first, last } => {
                let state = &mut *state;
                self.resend(state, socket, *block, *first..=*last);
                Ok(Vec::new())
            }
            Command::ReadRegisters(addresses) => {
                self.measure(state);
                let words = addresses.iter().map(|&at| state.memory.read(at, 4));
                Ok(words.collect::<Result<Vec<_>, _>>()?.concat())
            }
            Command::WriteRegisters(pairs) => {
                for (at, value) in pairs {
                    self.write(state, *at, &value.to_be_bytes(), from, socket)?;
                }
                Ok(vec![0, 0, 0, pairs.len() as u8])
            }
            Command::ReadMemory { address, count } => {
                if usize::from(*count) > gvcp::MEMORY_MAX {
                    return Err(Status::InvalidParameter);
                }
                self.measure(state);
                let read = state.memory.read(*address, usize::from(*count))?;
                Ok([&address.to_be_bytes()[..], &read].concat())
            }
            Command::WriteMemory { address, bytes } => {
                self.write(state, *address, bytes, from, socket)?;
                let [high, low] = (bytes.len() as u16).to_be_bytes();
                Ok(vec![0, 0, high, low])
            }
        }
    }

    /// What changes by itself is brought up to date before it is read.
    fn measure(&self, state: &mut State) {
        let temperature_c = self.exposer.temperature_c();
        state.memory.put_float(memory::TEMPERATURE, temperature_c);
        let is_held = self.faults.now().is_held;
        let privilege = match (is_held, state.controller) {
            (false, None) => 0,
            _ => CONTROL_WITH_READERS,
        };
        state.memory.put(memory::CONTROL, privilege);
    }

    fn write(
        &self,
        state: &mut State,
        at: u32,
        bytes: &[u8],
        from: SocketAddr,
        socket: &UdpSocket,
    ) -> Result<(), Status> {
        // Who may.
        let is_other = state
            .controller
            .is_some_and(|controller| controller != from);
        let is_free = state.controller.is_none();
        let takes_control = at == memory::CONTROL;
        if is_other || self.faults.now().is_held || (is_free && !takes_control) {
            return Err(Status::AccessDenied);
        }
        if at == memory::EXPOSURE && self.faults.now().ignores_exposure {
            return Ok(());
        }
        if at == memory::EXPOSURE && self.faults.now().locks_settings && state.streaming.runs() {
            return Err(Status::WriteProtect);
        }
        if at == memory::EXPOSURE && state.memory.get(memory::EXPOSURE_AUTO) != 0 {
            return Err(Status::WriteProtect);
        }
        if at == memory::GAIN && state.memory.get(memory::GAIN_AUTO) != 0 {
            return Err(Status::WriteProtect);
        }
        state.memory.write(at, bytes)?;
        let value = bytes.get(..4).map_or(0, |four| {
            four.iter()
                .fold(0_u32, |value, &byte| value << 8 | u32::from(byte))
        });
        // What follows.
        match at {
            memory::CONTROL if value & CONTROLLED != 0 => {
                state.controller = Some(from);
                state.heard = Instant::now();
            }
            memory::CONTROL => {
                state.controller = None;
                state.memory.put(memory::STREAM_PORT, 0);
                state.streaming.stop();
            }
            memory::TIMESTAMP_CONTROL => state.memory.latch(self.exposer.ticks()),
            memory::ACQUISITION_START => state.streaming.start(),
            memory::ACQUISITION_STOP => state.streaming.stop(),
            memory::TRIGGER_SOFTWARE => state.streaming.trigger(),
            memory::PACKET_SIZE if value >> 31 == 1 => {
                let packet_bytes = value & 0xffff;
                state.memory.put(memory::PACKET_SIZE, value & 0x7fff_ffff);
                if let Some(to) = stream::destination(&state.memory) {
                    let packet = gvsp::test_packet(packet_bytes as usize);
                    // Too large a packet does not arrive, which is the test.
                    let _ = socket.send_to(&packet, to);
                }
            }
            _ => {}
        }
        Ok(())
    }
}
