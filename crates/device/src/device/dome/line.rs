//! The line to a dome that speaks the dome line protocol.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use super::Lit;
use super::port::{Found, LightPort, ReadBack};
use super::protocol::{self, Info, LONGEST_LINE, Line, State, info, parse, request, state};
use crate::device::DeviceError;
use crate::device::guardian::Exchange;
use crate::device::serial_line::SerialLine;

/// A request is sent this often before the dome counts as lost. All of them may
/// be repeated.
const ATTEMPTS: u32 = 3;

/// An open dome. One request at a time is under way.
pub struct DomeLine {
    line: SerialLine,
    reply_timeout: Duration,
    /// Held while a request is under way: the number of the last one.
    turn: Mutex<u16>,
    restarts: Mutex<u64>,
}

impl DomeLine {
    /// Opens the port. Nothing is sent.
    pub fn open(path: &str, baud: u32, reply_timeout: Duration) -> Result<Self, DeviceError> {
        Ok(Self {
            line: SerialLine::open(path, baud)?,
            reply_timeout,
            turn: Mutex::new(0),
            restarts: Mutex::new(0),
        })
    }

    /// The words of the answer to a request.
    fn ask(&self, words: &str, timeout: Duration) -> Result<String, DeviceError> {
        let mut turn = lock(&self.turn);
        let mut damaged = None;
        for _ in 0..ATTEMPTS {
            *turn = *turn % 999 + 1;
            self.line.send(request(*turn, words).as_bytes())?;
            let deadline = Instant::now() + timeout / ATTEMPTS;
            let mut reader = self.line.reader();
            while let Some(line) = reader.line(LONGEST_LINE, deadline)? {
                match parse(&line) {
                    Line::Answer { number, outcome } if number == *turn => {
                        return outcome.map_err(|reason| self.line.refused(words, &reason));
                    }
                    // Late, or double.
                    Line::Answer { .. } => {}
                    Line::Restarted => *lock(&self.restarts) += 1,
                    Line::Unknown(text) => damaged = Some(text),
                }
            }
        }
        Err(match damaged {
            Some(text) => {
                let expected = "an answer of the dome line protocol";
                self.line.garbled(&text, expected)
            }
            None => self.line.no_reply(words, timeout),
        })
    }

    fn words_of(lit: Option<Lit>) -> String {
        match lit {
            None => "off".to_owned(),
            Some(Lit {
                light,
                channel,
                level,
            }) => format!("light {light} {channel} {level}"),
        }
    }

    fn info(&self, timeout: Duration) -> Result<Info, DeviceError> {
        let data = self.ask("info", timeout)?;
        info(&data).ok_or_else(|| self.line.garbled(&data, "what a dome reports of itself"))
    }
}

impl LightPort for DomeLine {
    fn line(&self) -> &SerialLine {
        &self.line
    }

    fn identify(&self, timeout: Duration) -> Result<Found, DeviceError> {
        let info = self.info(timeout)?;
        Ok(Found {
            firmware: info.firmware,
            lights: Some((info.lights, info.channels)),
            watchdog: (info.watchdog_s > 0.0).then(|| Duration::from_secs_f64(info.watchdog_s)),
        })
    }

    fn show(&self, lit: Option<Lit>) -> Result<(), DeviceError> {
        self.ask(&Self::words_of(lit), self.reply_timeout).map(drop)
    }

    fn read_back(&self) -> Result<ReadBack, DeviceError> {
        let data = self.ask("state", self.reply_timeout)?;
        match state(&data) {
            Some(State::Off) => Ok(ReadBack::Off),
            Some(State::Driven { lit, shines: true }) => Ok(ReadBack::Lit(lit)),
            Some(State::Driven { lit, shines: false }) => Ok(ReadBack::Dark(lit)),
            None => Err(self
                .line
                .garbled(&data, "what a dome reports of its lights")),
        }
    }

    fn temperature_c(&self) -> Result<Option<f64>, DeviceError> {
        let data = self.ask("temperature", self.reply_timeout)?;
        Ok(protocol::temperature_c(&data))
    }

    fn restarts(&self) -> u64 {
        *lock(&self.restarts)
    }

    fn off_now(&self) -> Result<(), DeviceError> {
        // Beside a request that is under way; its number answers nothing.
        self.line.send(request(0, "off").as_bytes())
    }

    fn off_exchanges(&self) -> Vec<Exchange> {
        // A line that was begun is ended first, and so is damaged.
        let off = format!("\n{}", request(998, "off"));
        let state = request(999, "state");
        vec![
            Exchange::new(off.as_bytes(), &[b"998 ok*"]),
            Exchange::new(state.as_bytes(), &[b"999 ok off*"]),
        ]
    }

    fn reports_lights(&self) -> bool {
        true
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Lets a dome with a watchdog receive something while the driver is busy
/// elsewhere. Ends when it is dropped.
pub struct KeepAlive {
    stop: Arc<(Mutex<bool>, Condvar)>,
}

impl KeepAlive {
    /// Requests the state at this interval as long as the port is there.
    pub fn start(port: Weak<dyn LightPort>, interval: Duration) -> std::io::Result<Self> {
        let stop = Arc::new((Mutex::new(false), Condvar::new()));
        let its_stop = stop.clone();
        std::thread::Builder::new()
            .name("dome-keep-alive".to_owned())
            .spawn(move || {
                let (stopped, changed) = &*its_stop;
                loop {
                    let guard = lock(stopped);
                    let Ok((guard, _)) = changed.wait_timeout(guard, interval) else {
                        return;
                    };
                    if *guard {
                        return;
                    }
                    drop(guard);
                    let Some(port) = port.upgrade() else {
                        return;
                    };
                    // What fails here fails for the driver too, which says so.
                    let _ = port.read_back();
                }
            })?;
        Ok(Self { stop })
    }
}

impl Drop for KeepAlive {
    fn drop(&mut self) {
        *lock(&self.stop.0) = true;
        self.stop.1.notify_all();
    }
}
