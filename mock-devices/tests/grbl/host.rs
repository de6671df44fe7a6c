//! A host at the other end of the simulated controller's cable.

use mock_devices::bench::{Bench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::grbl::{GrblConfig, GrblSimulator};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;

/// How long an answer may take, wall time: far longer than it ever does.
const PATIENCE_MS: i64 = 5000;
/// Silence that counts as silence, wall time.
const SILENCE_MS: i64 = 30;

pub const BANNER: [&str; 2] = ["", "Grbl 1.1h ['$' for help]"];
pub const UNLOCK: &str = "[MSG:'$H'|'$X' to unlock]";

pub struct Host {
    port: File,
    pending: Vec<u8>,
    sent: u64,
}

impl Host {
    pub fn open(simulator: &GrblSimulator) -> Self {
        let port = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(rustix::fs::OFlags::NOCTTY.bits() as i32)
            .open(simulator.path())
            .expect("the port opens");
        // A driver elsewhere, whose own port is gone, may look for it under this one's name,
        // which the system gives anew: the drivers ask for this lock, too, and keep out.
        rustix::fs::flock(&port, rustix::fs::FlockOperation::LockExclusive)
            .expect("the port is this host's alone");
        Self {
            port,
            pending: Vec::new(),
            sent: simulator.bytes_taken(),
        }
    }

    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.sent += bytes.as_ref().len() as u64;
        self.port
            .write_all(bytes.as_ref())
            .expect("the port takes bytes");
    }

    /// Returns when the board has taken all that was sent: before a test moves
    /// the time by hand.
    pub fn taken_by(&self, simulator: &GrblSimulator) {
        while simulator.bytes_taken() < self.sent {
            std::thread::yield_now();
        }
    }

    pub fn try_send(&mut self, bytes: impl AsRef<[u8]>) -> std::io::Result<()> {
        self.port.write_all(bytes.as_ref())
    }

    /// Reads what there is within the time; an error if the port is gone.
    pub fn read_some(&mut self, timeout_ms: i64) -> std::io::Result<bool> {
        let timeout = Timespec {
            tv_sec: timeout_ms / 1000,
            tv_nsec: timeout_ms % 1000 * 1_000_000,
        };
        let mut fds = [PollFd::new(&self.port, PollFlags::IN)];
        if poll(&mut fds, Some(&timeout))? == 0 {
            return Ok(false);
        }
        let mut buffer = [0; 4096];
        let count = self.port.read(&mut buffer)?;
        if count == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        self.pending.extend(&buffer[..count]);
        Ok(true)
    }

    /// The next line, without its end; `None` after a silence of the patience.
    pub fn line(&mut self) -> Option<String> {
        self.line_within(PATIENCE_MS)
    }

    fn line_within(&mut self, timeout_ms: i64) -> Option<String> {
        loop {
            if let Some(end) = self.pending.iter().position(|&b| b == b'\n') {
                let mut line: Vec<u8> = self.pending.drain(..=end).collect();
                line.pop();
                assert_eq!(line.pop(), Some(b'\r'), "every line ends with CR LF");
                return Some(String::from_utf8_lossy(&line).into_owned());
            }
            if !self.read_some(timeout_ms).ok()? {
                return None;
            }
        }
    }

    /// As many lines as expected.
    pub fn lines(&mut self, count: usize) -> Vec<String> {
        (0..count).map_while(|_| self.line()).collect()
    }

    /// Lines until nothing more comes for a moment.
    pub fn rest(&mut self) -> Vec<String> {
        std::iter::from_fn(|| self.line_within(SILENCE_MS)).collect()
    }

    /// Bytes that are no whole line.
    pub fn fragment(&mut self) -> String {
        while self.read_some(SILENCE_MS).unwrap_or(false) {}
        String::from_utf8_lossy(&std::mem::take(&mut self.pending)).into_owned()
    }

    /// Sends a line and expects exactly these lines.
    #[track_caller]
    pub fn exchange(&mut self, sent: &str, expected: &[&str]) {
        self.send(format!("{sent}\n"));
        assert_eq!(self.lines(expected.len()), expected, "answer to {sent:?}");
    }

    /// The next status report, split at its bars, without the chevrons.
    #[track_caller]
    pub fn status(&mut self) -> Vec<String> {
        self.send("?");
        let line = self.line().expect("a status report");
        let inner = line
            .strip_prefix('<')
            .and_then(|rest| rest.strip_suffix('>'))
            .unwrap_or_else(|| panic!("{line:?} is no status report"));
        inner.split('|').map(str::to_owned).collect()
    }

    #[track_caller]
    pub fn state(&mut self) -> String {
        self.status()[0].clone()
    }

    #[track_caller]
    pub fn machine_position(&mut self) -> [f64; 3] {
        let status = self.status();
        let values = status[1].strip_prefix("MPos:").expect("MPos is reported");
        let numbers: Vec<f64> = values.split(',').map(|v| v.parse().unwrap()).collect();
        numbers.try_into().unwrap()
    }

    #[track_caller]
    pub fn expect_banner(&mut self, locked: bool) {
        assert_eq!(self.lines(2), BANNER);
        if locked {
            assert_eq!(self.line().as_deref(), Some(UNLOCK));
        }
    }
}

/// A controller on a bench, a host that has opened it and read its banner.
pub fn connect(config: GrblConfig, bench: BenchConfig, clock: Clock) -> (GrblSimulator, Host) {
    let locked = config.settings.homing;
    let boots = config.reset_on_open;
    let simulator =
        GrblSimulator::spawn(config, Bench::new(bench, clock)).expect("a pseudo-terminal");
    let mut host = Host::open(&simulator);
    if boots {
        host.expect_banner(locked);
    }
    (simulator, host)
}

/// A stage without homing lock, on the given clock; boots without delay.
pub fn unlocked(clock: Clock) -> (GrblSimulator, Host) {
    let mut config = GrblConfig {
        boot_s: 0.0,
        ..GrblConfig::default()
    };
    config.settings.homing = false;
    config.settings.soft_limits = false;
    connect(config, BenchConfig::default(), clock)
}

/// A homed stage with soft limits on the given clock.
pub fn homed(clock: Clock) -> (GrblSimulator, Host) {
    let config = GrblConfig {
        boot_s: 0.0,
        ..GrblConfig::default()
    };
    let (simulator, mut host) = connect(config, BenchConfig::default(), clock.clone());
    host.send("$H\n");
    while host.rest().is_empty() {
        clock.advance(60.0);
    }
    (simulator, host)
}
