//! A cable that fails: a second pseudo-terminal between a host and a simulated
//! device, which drops, delays, cuts, garbles and doubles the device's lines,
//! and goes away and comes back under the same name.

use crate::clock::lock;
use crate::pty::open_pty;
use crate::random;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What happens to a line from the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    /// It is lost.
    Drop,
    /// It comes later by this much wall time; nothing overtakes it.
    Delay(Duration),
    /// Only this many bytes come, without a line end.
    Truncate(usize),
    /// Every byte but the line end is replaced by noise.
    Garble,
    /// It comes twice.
    Duplicate,
}

#[derive(Debug)]
struct Rule {
    starts_with: Vec<u8>,
    damage: Damage,
    left: Option<u32>,
}

#[derive(Debug, Default)]
struct State {
    rules: Vec<Rule>,
    /// The host's end; none while the cable is out.
    host: Option<File>,
    garbled: u64,
}

/// A cable between a host and a device. Dropping it takes the host's port away.
#[derive(Debug)]
pub struct Proxy {
    folder: PathBuf,
    path: PathBuf,
    state: Arc<Mutex<State>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

static COUNT: AtomicU64 = AtomicU64::new(0);

impl Proxy {
    /// Opens the device's port and makes another for the host.
    pub fn to(device: &Path) -> io::Result<Self> {
        Self::to_packets(device, b'\n')
    }

    /// The same for a device whose packets end with another byte than lines.
    pub fn to_packets(device: &Path, end: u8) -> io::Result<Self> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
        let mut device = File::from(open(device, flags, Mode::empty())?);
        let name = format!(
            "mock-proxy-{}-{}",
            std::process::id(),
            COUNT.fetch_add(1, Ordering::Relaxed)
        );
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir(&folder)?;
        let state = Arc::new(Mutex::new(State::default()));
        let stop = Arc::new(AtomicBool::new(false));
        let (its_state, its_stop) = (state.clone(), stop.clone());
        let thread = std::thread::Builder::new()
            .name("proxy".to_owned())
            .spawn(move || {
                let mut partial = Vec::new();
                let mut outgoing = VecDeque::new();
                while !its_stop.load(Ordering::Acquire) {
                    carry(&its_state, &mut device, end, &mut partial, &mut outgoing);
                }
            })?;
        let proxy = Self {
            path: folder.join("port"),
            folder,
            state,
            stop,
            thread: Some(thread),
        };
        proxy.plug_in()?;
        Ok(proxy)
    }

    /// The port that a driver opens: a link that keeps its name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Damages every line from the device that begins like this.
    pub fn damage(&self, starts_with: &str, damage: Damage) {
        self.rule(starts_with, damage, None);
    }

    /// Damages the next `times` lines from the device that begin like this.
    pub fn damage_times(&self, starts_with: &str, damage: Damage, times: u32) {
        self.rule(starts_with, damage, Some(times));
    }

    fn rule(&self, starts_with: &str, damage: Damage, left: Option<u32>) {
        lock(&self.state).rules.push(Rule {
            starts_with: starts_with.as_bytes().to_vec(),
            damage,
            left,
        });
    }

    /// No line is damaged any more.
    pub fn clear(&self) {
        lock(&self.state).rules.clear();
    }

    /// Pulls the host's end: its port is gone.
    pub fn unplug(&self) {
        lock(&self.state).host = None;
        let _ = std::fs::remove_file(&self.path);
    }

    /// Puts it back, as another terminal under the same name.
    pub fn plug_in(&self) -> io::Result<()> {
        let (host, terminal) = open_pty()?;
        lock(&self.state).host = Some(host);
        std::os::unix::fs::symlink(terminal, &self.path)
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Lines with the time at which they leave.
type Outgoing = VecDeque<(Instant, Vec<u8>)>;

fn carry(
    state: &Mutex<State>,
    device: &mut File,
    end: u8,
    partial: &mut Vec<u8>,
    outgoing: &mut Outgoing,
) {
    let moment = Timespec {
        tv_sec: 0,
        tv_nsec: 1_000_000,
    };
    let _ = poll(&mut [PollFd::new(&*device, PollFlags::IN)], Some(&moment));
    let mut buffer = [0_u8; 512];
    if let Ok(count) = device.read(&mut buffer) {
        partial.extend(&buffer[..count]);
    }
    let mut state = lock(state);
    while let Some(last) = partial.iter().position(|&byte| byte == end) {
        let line: Vec<u8> = partial.drain(..=last).collect();
        let (bytes, delay) = state.shape(line);
        let due = Instant::now() + delay;
        let earliest = outgoing
            .back()
            .map_or(due, |(earlier, _)| due.max(*earlier));
        outgoing.push_back((earliest, bytes));
    }
    let Some(host) = &mut state.host else {
        outgoing.clear();
        return;
    };
    while outgoing
        .front()
        .is_some_and(|(due, _)| *due <= Instant::now())
    {
        if let Some((_, bytes)) = outgoing.pop_front() {
            // A host that is not there loses what is said.
            let _ = host.write_all(&bytes);
        }
    }
    if let Ok(count) = host.read(&mut buffer) {
        let _ = device.write_all(&buffer[..count]);
    }
}

impl State {
    fn shape(&mut self, line: Vec<u8>) -> (Vec<u8>, Duration) {
        let mut bytes = line.clone();
        let mut delay = Duration::ZERO;
        for rule in &mut self.rules {
            if !line.starts_with(&rule.starts_with) || rule.left == Some(0) {
                continue;
            }
            rule.left = rule.left.map(|left| left - 1);
            match rule.damage {
                Damage::Drop => bytes.clear(),
                Damage::Delay(by) => delay += by,
                Damage::Truncate(keep) => bytes.truncate(keep),
                Damage::Duplicate => bytes.extend_from_within(..),
                Damage::Garble => {
                    self.garbled += 1;
                    let mut numbers = random::stream(&[30, self.garbled]);
                    for byte in bytes.iter_mut().filter(|byte| !b"\r\n".contains(byte)) {
                        // Printable, so that it might be a line, and never what was meant.
                        let noise = b'!' + (numbers.bits() % 90) as u8;
                        *byte = if noise == *byte { b'~' } else { noise };
                    }
                }
            }
        }
        (bytes, delay)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::{Bench, BenchConfig};
    use crate::clock::Clock;
    use crate::zaber::{ZaberConfig, ZaberSimulator};
    use std::fs::OpenOptions;

    struct Host(File);

    impl Host {
        fn open(path: &Path) -> Self {
            let file = OpenOptions::new().read(true).write(true).open(path);
            Self(file.unwrap())
        }

        /// What comes back: at least as many bytes as awaited, until a moment of silence.
        fn ask(&mut self, line: &str, awaited: usize) -> String {
            self.0.write_all(line.as_bytes()).unwrap();
            let mut heard = Vec::new();
            loop {
                let patience = match heard.len() < awaited {
                    true => Timespec {
                        tv_sec: 10,
                        tv_nsec: 0,
                    },
                    false => Timespec {
                        tv_sec: 0,
                        tv_nsec: 200_000_000,
                    },
                };
                let mut fds = [PollFd::new(&self.0, PollFlags::IN)];
                if poll(&mut fds, Some(&patience)).unwrap() == 0 {
                    return String::from_utf8(heard).unwrap();
                }
                let mut buffer = [0; 256];
                let count = self.0.read(&mut buffer).unwrap();
                heard.extend(&buffer[..count]);
            }
        }
    }

    #[test]
    fn lines_are_damaged_as_told_and_the_port_comes_back() {
        let bench = Bench::new(BenchConfig::default(), Clock::instant());
        let devices = ZaberSimulator::spawn(ZaberConfig::default(), bench).unwrap();
        let proxy = Proxy::to(devices.path()).unwrap();
        let mut host = Host::open(proxy.path());
        let request = "/1 0 get version\n";
        let whole = host.ask(request, "@01 0 OK IDLE -- 7.00\r\n".len());
        assert!(
            whole.starts_with("@01 0 OK") && whole.ends_with("\r\n"),
            "{whole:?}"
        );
        for (damage, expected) in [
            (Damage::Drop, String::new()),
            (Damage::Truncate(3), "@01".to_owned()),
            (Damage::Duplicate, whole.repeat(2)),
            (Damage::Delay(Duration::from_millis(50)), whole.clone()),
        ] {
            proxy.damage_times("@", damage, 1);
            assert_eq!(host.ask(request, expected.len()), expected, "{damage:?}");
        }
        proxy.damage("", Damage::Garble);
        let garbled = host.ask(request, whole.len());
        assert_eq!(garbled.len(), whole.len());
        assert!(!garbled.contains("OK"), "{garbled:?}");
        proxy.clear();
        proxy.unplug();
        assert!(!proxy.path().exists());
        assert!(host.0.write_all(b"x").is_err());
        proxy.plug_in().unwrap();
        assert_eq!(Host::open(proxy.path()).ask(request, whole.len()), whole);
    }
}
