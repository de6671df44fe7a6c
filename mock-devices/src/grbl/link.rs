//! The pseudo-terminal and the thread behind it.

use super::GrblConfig;
use super::faults::{Cause, Faults, Mishap};
use super::firmware::Firmware;
use crate::bench::Bench;
use crate::pty::open_pty;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often the thread looks at the time and at the port, at least, while
/// something is under way, and while nothing is.
const BUSY_POLL_MS: i64 = 1;
const IDLE_POLL_MS: i64 = 5;

/// What the thread lets others see.
#[derive(Debug, Default)]
struct Seen {
    open: AtomicBool,
    bytes: AtomicU64,
}

/// Handle to the thread; dropping it ends the thread and the port.
#[derive(Debug)]
pub(super) struct Link {
    wake: Arc<OwnedFd>,
    stop: Arc<AtomicBool>,
    unplugged: Arc<AtomicBool>,
    gone: Arc<AtomicBool>,
    seen: Arc<Seen>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    pub(super) fn start(
        config: GrblConfig,
        bench: Bench,
        faults: Faults,
    ) -> io::Result<(Self, PathBuf)> {
        let (master, path) = open_pty()?;
        let wake = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let stop = Arc::new(AtomicBool::new(false));
        let unplugged = Arc::new(AtomicBool::new(false));
        let mut firmware = Firmware::new(config.clone(), bench.clone());
        if !config.reset_on_open {
            // It has long been running when the host comes.
            firmware.finish_boot(bench.clock().now_s());
        }
        let seen = Arc::new(Seen::default());
        let mut board = Board {
            seen: seen.clone(),
            boots_on_open: config.reset_on_open,
            watchdog_s: config.host_watchdog_s,
            firmware,
            bench,
            faults,
            port: Some(master),
            open: false,
            heard_s: 0.0,
            outgoing: VecDeque::new(),
        };
        let gone = Arc::new(AtomicBool::new(false));
        let (thread_wake, thread_stop) = (wake.clone(), stop.clone());
        let (thread_unplugged, thread_gone) = (unplugged.clone(), gone.clone());
        let thread = std::thread::Builder::new()
            .name("grbl-simulator".to_owned())
            .spawn(move || {
                while !thread_stop.load(Ordering::Acquire) {
                    if thread_unplugged.load(Ordering::Acquire) {
                        board.port = None;
                    }
                    thread_gone.store(board.port.is_none(), Ordering::Release);
                    board.turn(&thread_wake);
                }
            })?;
        let link = Self {
            wake,
            stop,
            unplugged,
            gone,
            seen,
            thread: Some(thread),
        };
        Ok((link, path))
    }

    /// Returns when the port is gone.
    pub(super) fn unplug(&self) {
        self.unplugged.store(true, Ordering::Release);
        self.ring();
        while !self.gone.load(Ordering::Acquire) {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    pub(super) fn is_open(&self) -> bool {
        self.seen.open.load(Ordering::Acquire)
    }

    pub(super) fn bytes_taken(&self) -> u64 {
        self.seen.bytes.load(Ordering::Acquire)
    }

    fn ring(&self) {
        // A full counter wakes as well.
        let _ = rustix::io::write(&*self.wake, &1_u64.to_ne_bytes());
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        self.ring();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The board with its side of the cable.
struct Board {
    seen: Arc<Seen>,
    firmware: Firmware,
    bench: Bench,
    faults: Faults,
    port: Option<File>,
    open: bool,
    boots_on_open: bool,
    watchdog_s: Option<f64>,
    heard_s: f64,
    /// Bytes with the time at which they leave.
    outgoing: VecDeque<(f64, Vec<u8>)>,
}

impl Board {
    /// Waits a moment for bytes or time, then does what is due.
    fn turn(&mut self, wake: &OwnedFd) {
        let received = self.wait_for_host(wake);
        for byte in received {
            let now_s = self.bench.clock().now_s();
            self.heard_s = now_s;
            self.firmware.receive(byte, now_s);
            self.settle();
            self.seen.bytes.fetch_add(1, Ordering::Release);
        }
        self.settle();
        self.seen.open.store(self.open, Ordering::Release);
    }

    fn busy(&self, now_s: f64) -> bool {
        self.firmware.moving_since_s().is_some()
            || self.firmware.waits_until_s(now_s).is_some()
            || !self.outgoing.is_empty()
    }

    /// Bytes that the host has sent; none after a while.
    fn wait_for_host(&mut self, wake: &OwnedFd) -> Vec<u8> {
        let now_s = self.bench.clock().now_s();
        let milliseconds = if self.busy(now_s) {
            BUSY_POLL_MS
        } else {
            IDLE_POLL_MS
        };
        let timeout = Timespec {
            tv_sec: 0,
            tv_nsec: milliseconds * 1_000_000,
        };
        let Some(port) = &mut self.port else {
            let _ = poll(&mut [PollFd::new(wake, PollFlags::IN)], Some(&timeout));
            drain(wake);
            return Vec::new();
        };
        let hung_up = {
            let mut fds = [
                PollFd::from_borrowed_fd(port.as_fd(), PollFlags::IN),
                PollFd::new(wake, PollFlags::IN),
            ];
            if poll(&mut fds, Some(&timeout)).is_err() {
                return Vec::new();
            }
            fds[0].revents().contains(PollFlags::HUP)
        };
        drain(wake);
        let mut buffer = [0_u8; 256];
        let received = match port.read(&mut buffer) {
            Ok(count) => buffer[..count].to_vec(),
            _ => Vec::new(),
        };
        if hung_up && received.is_empty() {
            self.open = false;
            self.outgoing.clear();
            std::thread::sleep(Duration::from_millis(1));
        } else if !self.open {
            // Bytes from a port that was hung up a moment ago: it has been
            // opened since, and their answer has a reader.
            self.open = true;
            self.heard_s = now_s;
            if self.boots_on_open {
                self.firmware.power_up(now_s);
            }
        }
        received
    }

    /// Runs the firmware as far as it goes, on an instant clock through all
    /// that it waits for.
    fn settle(&mut self) {
        let clock = self.bench.clock().clone();
        loop {
            let now_s = clock.now_s();
            self.strike(now_s);
            self.firmware.step(now_s);
            let reported = self.collect(now_s);
            self.guard(now_s);
            self.send(now_s);
            if !clock.is_instant() {
                return;
            }
            let mut next_s = self.firmware.waits_until_s(now_s);
            if next_s.is_none() && reported {
                next_s = self.firmware.motion_end_s();
            }
            if let Some(&(due_s, _)) = self.outgoing.front()
                && due_s > now_s
            {
                next_s = Some(next_s.map_or(due_s, |s| s.min(due_s)));
            }
            let Some(mut next_s) = next_s.filter(|&s| s > now_s) else {
                return;
            };
            // A mishap in mid-motion comes before its end.
            if let Some(since_s) = self.firmware.moving_since_s()
                && let Some(mishap_s) = self.faults.next_in_motion_s(since_s)
            {
                next_s = next_s.min(mishap_s.max(now_s));
            }
            clock.wait_until(next_s);
        }
    }

    fn strike(&mut self, now_s: f64) {
        let since_s = self.firmware.moving_since_s();
        for mishap in self.faults.due(now_s, since_s) {
            self.suffer(mishap, now_s);
        }
    }

    fn suffer(&mut self, mishap: Mishap, now_s: f64) {
        match mishap {
            Mishap::Reset => self.firmware.power_up(now_s),
            Mishap::Alarm(code) => self.firmware.raise_alarm(code, now_s),
            Mishap::Unplug => self.port = None,
        }
    }

    /// Takes the firmware's answers; whether one was a status report.
    fn collect(&mut self, now_s: f64) -> bool {
        let mut reported = false;
        for output in self.firmware.take_output() {
            reported |= output.cause == Cause::StatusQuery;
            let (bytes, delay_s, mishaps) = self.faults.shape(&output.cause, &output.text);
            // One wire: what comes later never overtakes.
            let earliest_s = self.outgoing.back().map_or(now_s, |(due_s, _)| *due_s);
            if !bytes.is_empty() {
                self.outgoing
                    .push_back(((now_s + delay_s).max(earliest_s), bytes));
            }
            for mishap in mishaps {
                self.suffer(mishap, now_s);
            }
        }
        reported
    }

    /// The watchdog that stock GRBL lacks.
    fn guard(&mut self, now_s: f64) {
        let Some(limit_s) = self.watchdog_s else {
            return;
        };
        let active = self.firmware.moving_since_s().is_some()
            || self.bench.lamp_drive().iter().any(|&drive| drive > 0.0);
        if active && now_s - self.heard_s > limit_s {
            self.firmware.reset(now_s);
        }
    }

    fn send(&mut self, now_s: f64) {
        let Some(port) = &mut self.port else {
            self.outgoing.clear();
            return;
        };
        if !self.open {
            self.outgoing.clear(); // nothing reads the line
            return;
        }
        while let Some((due_s, bytes)) = self.outgoing.front_mut() {
            if *due_s > now_s {
                return;
            }
            match port.write(bytes) {
                Ok(count) if count >= bytes.len() => {
                    self.outgoing.pop_front();
                }
                Ok(count) => {
                    bytes.drain(..count);
                    return;
                }
                Err(_) => return, // the host does not read: try again later
            }
        }
    }
}

/// Takes what woke the thread, so that it wakes again only for something new.
fn drain(wake: &OwnedFd) {
    let _ = rustix::io::read(wake, &mut [0_u8; 8]);
}
