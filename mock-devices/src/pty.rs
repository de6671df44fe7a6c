//! A device behind a pseudo-terminal: the port, and the thread that carries
//! bytes and time to the device.

use crate::clock::Clock;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;

/// How often the thread looks at the time, at least, while a host has the port open.
const POLL_MS: i64 = 2;

/// A pseudo-terminal in raw mode: the device's end, which never blocks, and the
/// path of the host's.
pub(crate) fn open_pty() -> io::Result<(File, PathBuf)> {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&master)?;
    unlockpt(&master)?;
    let name = ptsname(&master, Vec::new())?;
    let path = PathBuf::from(std::ffi::OsString::from_vec(name.into_bytes()));
    {
        // Raw bytes from the first on. Opened and closed once, the terminal
        // tells from then on whether a host has it open.
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let host_side = open(&path, flags, Mode::empty())?;
        let mut raw = tcgetattr(&host_side)?;
        raw.make_raw();
        tcsetattr(&host_side, OptionalActions::Now, &raw)?;
    }
    fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
    Ok((File::from(master), path))
}

/// What answers on a port.
pub(crate) trait Board: Send + 'static {
    /// Takes bytes from the host and gives what it answers.
    fn receive(&mut self, bytes: &[u8], now_s: f64) -> Vec<u8>;
    /// Time passes; gives what it reports by itself.
    fn step(&mut self, now_s: f64) -> Vec<u8>;
    /// On a clock that jumps: the time to jump to once the host has been answered.
    fn jump_to_s(&self) -> Option<f64>;
}

/// A board on its port; dropping it takes the port away.
#[derive(Debug)]
pub(crate) struct Port<B> {
    path: PathBuf,
    board: Arc<Mutex<B>>,
    stop: Arc<AtomicBool>,
    wake: Arc<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl<B: Board> Port<B> {
    pub(crate) fn start(name: &str, board: B, clock: Clock) -> io::Result<Self> {
        let (mut master, path) = open_pty()?;
        let board = Arc::new(Mutex::new(board));
        let stop = Arc::new(AtomicBool::new(false));
        let wake = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let (its_board, its_stop, its_wake) = (board.clone(), stop.clone(), wake.clone());
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                while !its_stop.load(Ordering::Acquire) {
                    let bytes = wait_for_host(&mut master, &its_wake);
                    turn(&its_board, &clock, &bytes, &mut master);
                }
            })?;
        Ok(Self {
            path,
            board,
            stop,
            wake,
            thread: Some(thread),
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn board(&self) -> MutexGuard<'_, B> {
        crate::clock::lock(&self.board)
    }
}

impl<B> Drop for Port<B> {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let _ = rustix::io::write(&*self.wake, &1_u64.to_ne_bytes());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn turn<B: Board>(board: &Mutex<B>, clock: &Clock, bytes: &[u8], port: &mut File) {
    let mut board = crate::clock::lock(board);
    let mut answer = board.step(clock.now_s());
    if !bytes.is_empty() {
        answer.extend(board.receive(bytes, clock.now_s()));
        if clock.is_instant()
            && let Some(due_s) = board.jump_to_s()
        {
            clock.wait_until(due_s);
            answer.extend(board.step(clock.now_s()));
        }
    }
    // A host that does not read, or is not there, loses what is said.
    let _ = port.write_all(&answer);
}

/// Bytes that the host has sent; none after a moment.
fn wait_for_host(port: &mut File, wake: &OwnedFd) -> Vec<u8> {
    let timeout = Timespec {
        tv_sec: 0,
        tv_nsec: POLL_MS * 1_000_000,
    };
    let hung_up = {
        let mut fds = [
            PollFd::new(&*port, PollFlags::IN),
            PollFd::new(wake, PollFlags::IN),
        ];
        if poll(&mut fds, Some(&timeout)).is_err() {
            return Vec::new();
        }
        fds[0].revents().contains(PollFlags::HUP)
    };
    let mut buffer = [0_u8; 512];
    match port.read(&mut buffer) {
        Ok(count) => buffer[..count].to_vec(),
        _ => {
            if hung_up {
                std::thread::sleep(std::time::Duration::from_millis(POLL_MS as u64));
            }
            Vec::new()
        }
    }
}
