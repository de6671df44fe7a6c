//! stderr, written by a thread of its own from a bounded queue.
//!
//! A terminal after Ctrl-S, a pager that is not scrolled or a stalled ssh
//! connection takes no bytes. Threads only put their messages into the queue and
//! go on: nothing that happens to stderr may hold the thread that drives a bench
//! whose lamp is lit. What does not fit is dropped, progress first and remarks
//! last, and the number of lost messages is reported once there is room.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use indicatif::TermLike;

use crate::shown;

/// How long a program that ends waits for stderr to take what is left.
pub const LAST_WORDS: Duration = Duration::from_secs(1);
/// How long stdout waits for earlier messages on stderr, so that a terminal
/// shows both in their order.
const IN_ORDER: Duration = Duration::from_millis(100);

/// What a text is worth: how many bytes may wait in front of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Worth {
    /// A bar, drawn anew soon.
    Progress,
    /// A line of the trace.
    Trace,
    /// A note, warning or error.
    Remark,
}

impl Worth {
    fn waiting_bytes(self) -> usize {
        match self {
            Self::Progress => 1 << 13,
            Self::Trace => 1 << 18,
            Self::Remark => 1 << 19,
        }
    }
}

/// The queue. One writer takes from it, everybody puts into it.
#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    texts: VecDeque<String>,
    /// Bytes that wait, those being written included.
    waiting_bytes: usize,
    lost: u64,
    /// A wait ended before everything was written, and nothing was written since.
    is_stuck: bool,
}

impl Queue {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, text: &str, worth: Worth) {
        let mut state = self.state();
        let waiting = state.waiting_bytes;
        if waiting > 0 && waiting + text.len() > worth.waiting_bytes() {
            state.lost += u64::from(worth != Worth::Progress);
            return;
        }
        state.waiting_bytes += text.len();
        state.texts.push_back(text.to_owned());
        self.changed.notify_all();
    }

    /// Writes what comes, for ever; a stream that is closed takes everything.
    fn write_to(&self, mut stream: impl Write) {
        loop {
            let mut state = self.state();
            let text = loop {
                if let Some(text) = state.texts.pop_front() {
                    break text;
                }
                let lost = std::mem::take(&mut state.lost);
                if lost > 0 {
                    let text = format!("{lost} messages were lost: stderr took none\n");
                    state.waiting_bytes += text.len();
                    break text;
                }
                state = self
                    .changed
                    .wait(state)
                    .unwrap_or_else(PoisonError::into_inner);
            };
            drop(state);
            drop(stream.write_all(text.as_bytes()));
            let mut state = self.state();
            state.waiting_bytes -= text.len();
            state.is_stuck = false;
            self.changed.notify_all();
        }
    }

    /// Waits until everything is written, this long at most.
    fn flush(&self, longest: Duration) {
        let end = Instant::now() + longest;
        let mut state = self.state();
        while state.waiting_bytes > 0 {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                state.is_stuck = true;
                return;
            }
            let waited = self.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// The queue of this process, with its thread; `None` where no thread can be had.
fn queue() -> Option<&'static Queue> {
    static QUEUE: OnceLock<Option<&'static Queue>> = OnceLock::new();
    *QUEUE.get_or_init(|| {
        let queue: &'static Queue = Box::leak(Box::default());
        let writer = std::thread::Builder::new().name("stderr".to_owned());
        writer.spawn(|| queue.write_to(io::stderr())).ok()?;
        Some(queue)
    })
}

/// Writes a message. Never waits; a closed stderr is ignored.
pub fn write(text: &str, worth: Worth) {
    match queue() {
        Some(queue) => queue.put(text, worth),
        None => drop(io::stderr().write_all(text.as_bytes())),
    }
}

/// Waits until everything is written, this long at most.
pub fn flush(longest: Duration) {
    if let Some(queue) = queue() {
        queue.flush(longest);
    }
}

/// Waits shortly until stderr has taken all messages, unless it takes none.
pub fn flush_in_order() {
    if let Some(queue) = queue()
        && !queue.state().is_stuck
    {
        queue.flush(IN_ORDER);
    }
}

/// What the trace is written to, line by line.
#[derive(Clone, Copy, Debug)]
pub struct Trace;

impl Write for Trace {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        write(
            &shown::traced(&String::from_utf8_lossy(bytes)),
            Worth::Trace,
        );
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The terminal that a progress bar draws on: each drawing is one text of the queue.
#[derive(Debug, Default)]
pub struct Drawing(Mutex<String>);

impl Drawing {
    fn add(&self, text: &str) -> io::Result<()> {
        let mut drawn = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        drawn.push_str(text);
        Ok(())
    }

    fn escape(&self, count: usize, action: char) -> io::Result<()> {
        match count {
            0 => Ok(()),
            count => self.add(&format!("\x1b[{count}{action}")),
        }
    }
}

impl TermLike for Drawing {
    fn width(&self) -> u16 {
        match rustix::termios::tcgetwinsize(io::stderr()) {
            Ok(size) if size.ws_col > 0 => size.ws_col,
            _ => 80,
        }
    }

    fn move_cursor_up(&self, lines: usize) -> io::Result<()> {
        self.escape(lines, 'A')
    }

    fn move_cursor_down(&self, lines: usize) -> io::Result<()> {
        self.escape(lines, 'B')
    }

    fn move_cursor_right(&self, columns: usize) -> io::Result<()> {
        self.escape(columns, 'C')
    }

    fn move_cursor_left(&self, columns: usize) -> io::Result<()> {
        self.escape(columns, 'D')
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.add(text)?;
        self.add("\n")
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        self.add(text)
    }

    fn clear_line(&self) -> io::Result<()> {
        self.add("\r\x1b[2K")
    }

    fn flush(&self) -> io::Result<()> {
        let drawn = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        if !drawn.is_empty() {
            write(&drawn, Worth::Progress);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::mpsc;

    /// Takes one text at each token, and keeps what it got.
    struct Slow(mpsc::Receiver<()>, Arc<Mutex<String>>);

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            // A closed channel takes everything.
            let _ = self.0.recv();
            self.1
                .lock()
                .unwrap()
                .push_str(std::str::from_utf8(bytes).unwrap());
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn nobody_waits_and_what_matters_is_kept_longest() {
        let queue: &'static Queue = Box::leak(Box::default());
        let written = Arc::new(Mutex::new(String::new()));
        let (token, tokens) = mpsc::channel();
        let slow = Slow(tokens, written.clone());
        std::thread::spawn(|| queue.write_to(slow));
        let line = format!("{}\n", "x".repeat(1023));
        for _ in 0..2000 {
            queue.put(&line, Worth::Progress);
            queue.put(&line, Worth::Trace);
        }
        queue.put("warning: the lamp\n", Worth::Remark);
        let began = Instant::now();
        queue.flush(Duration::from_millis(20));
        assert!(queue.state().is_stuck && began.elapsed() < LAST_WORDS);
        let waiting = queue.state().waiting_bytes;
        assert!(waiting <= Worth::Remark.waiting_bytes(), "{waiting}");
        drop(token);
        queue.flush(Duration::from_secs(60));
        let written = written.lock().unwrap();
        assert!(written.contains("warning: the lamp\n"), "{written}");
        let lost = written.lines().last().unwrap();
        assert!(
            lost.ends_with("messages were lost: stderr took none"),
            "{lost}"
        );
    }

    #[test]
    fn a_drawing_is_one_text_and_moves_by_what_is_asked() {
        let drawing = Drawing::default();
        drawing.move_cursor_up(0).unwrap();
        drawing.clear_line().unwrap();
        drawing.write_str("half").unwrap();
        drawing.move_cursor_up(2).unwrap();
        assert_eq!(*drawing.0.lock().unwrap(), "\r\x1b[2Khalf\x1b[2A");
    }
}
