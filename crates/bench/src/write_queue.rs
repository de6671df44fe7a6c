//! A stream of texts that is written by a thread of its own from a bounded queue.
//!
//! A terminal after Ctrl-S, a program that reads nothing or a stalled ssh connection
//! takes no bytes. Threads only put their texts into the queue and go on: nothing that
//! happens to the stream may hold the thread that drives a bench whose lamp is lit. What
//! does not fit is dropped, and the number of lost texts is reported in their position once
//! there is room.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long a program that ends waits for a stream to take what is left.
pub const LAST_WORDS: Duration = Duration::from_secs(1);
/// Between two attempts on a stream that does not wait itself (`O_NONBLOCK`).
const RETRY: Duration = Duration::from_millis(10);

/// The queue. One writer takes from it, every thread puts into it.
pub struct WriteQueue {
    state: Mutex<State>,
    changed: Condvar,
    /// The text that reports this many lost ones.
    lost_text: fn(u64) -> String,
}

#[derive(Default)]
struct State {
    texts: VecDeque<String>,
    /// Bytes that wait, those being written included.
    waiting_bytes: usize,
    lost: u64,
    /// A wait ended before everything was written, and nothing was written since.
    is_stuck: bool,
    /// When the stream took something last, or was given something after a rest.
    taken_at: Option<Instant>,
}

impl WriteQueue {
    /// Starts the thread, which lives as long as the process; `lost_text` makes the text that
    /// reports a number of lost ones.
    ///
    /// # Errors
    /// No thread can be had.
    pub fn start(
        name: &str,
        stream: impl Write + Send + 'static,
        lost_text: fn(u64) -> String,
    ) -> io::Result<&'static Self> {
        let queue: &'static Self = Box::leak(Box::new(Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            lost_text,
        }));
        let writer = std::thread::Builder::new().name(name.to_owned());
        writer.spawn(|| queue.write_to(stream))?;
        Ok(queue)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends a text if at most `limit_bytes` wait then, or nothing waits; never waits
    /// itself. A text that finds no room is lost, which is reported if it `counts`.
    pub fn put(&self, text: &str, limit_bytes: usize, counts: bool) {
        let mut state = self.state();
        let waiting = state.waiting_bytes;
        if waiting > 0 && waiting + text.len() > limit_bytes {
            state.lost += u64::from(counts);
            return;
        }
        if waiting == 0 {
            state.taken_at = Some(Instant::now());
        }
        if counts {
            self.report_lost(&mut state);
        }
        state.push(text.to_owned());
        self.changed.notify_all();
    }

    fn report_lost(&self, state: &mut State) {
        let lost = std::mem::take(&mut state.lost);
        if lost > 0 {
            state.push((self.lost_text)(lost));
        }
    }

    /// Writes what comes, for ever; a stream that is closed takes everything.
    fn write_to(&self, mut stream: impl Write) {
        loop {
            let mut state = self.state();
            let text = loop {
                if let Some(text) = state.texts.pop_front() {
                    break text;
                }
                self.report_lost(&mut state);
                if !state.texts.is_empty() {
                    continue;
                }
                let woken = self.changed.wait(state);
                state = woken.unwrap_or_else(PoisonError::into_inner);
            };
            drop(state);
            self.write_whole(&mut stream, text.as_bytes());
            let mut state = self.state();
            state.waiting_bytes -= text.len();
            self.changed.notify_all();
        }
    }

    fn write_whole(&self, stream: &mut impl Write, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            match stream.write(bytes) {
                Ok(0) => return,
                Ok(taken) => bytes = &bytes[taken..],
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    std::thread::sleep(RETRY);
                    continue;
                }
                // Closed.
                Err(_) => return,
            }
            let mut state = self.state();
            state.taken_at = Some(Instant::now());
            state.is_stuck = false;
        }
    }

    /// Waits until everything is written, this long at most; not at all where the stream
    /// has taken nothing for so long already.
    pub fn flush(&self, longest: Duration) {
        let end = Instant::now() + longest;
        let mut state = self.state();
        while state.waiting_bytes > 0 {
            let taken_at = state.taken_at.unwrap_or_else(Instant::now);
            let end = end.min(taken_at + longest);
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                state.is_stuck = true;
                return;
            }
            let waited = self.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// [`flush`](Self::flush), unless an earlier one was in vain and nothing was written since.
    pub fn flush_unless_stuck(&self, longest: Duration) {
        if !self.state().is_stuck {
            self.flush(longest);
        }
    }
}

impl State {
    fn push(&mut self, text: String) {
        self.waiting_bytes += text.len();
        self.texts.push_back(text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, mpsc};

    /// Takes one text at each token, and keeps what it got.
    struct Slow(mpsc::Receiver<()>, Arc<Mutex<String>>);

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            // A closed channel takes everything.
            let _ = self.0.recv();
            let text = std::str::from_utf8(bytes).unwrap();
            self.1.lock().unwrap().push_str(text);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn slow() -> (&'static WriteQueue, mpsc::Sender<()>, Arc<Mutex<String>>) {
        let written = Arc::new(Mutex::new(String::new()));
        let (token, tokens) = mpsc::channel();
        let stream = Slow(tokens, written.clone());
        let queue = WriteQueue::start("slow", stream, |lost| format!("{lost} lost\n"));
        (queue.unwrap(), token, written)
    }

    const ROOM: usize = 1 << 13;

    /// Every putter goes on, what has more room comes in when there is none for the rest, and
    /// what is lost is counted where it is missing.
    #[test]
    fn no_thread_waits_and_losses_are_counted_in_their_position() {
        let (queue, token, written) = slow();
        let [counted, other] = ["x", "y"].map(|letter| format!("{}\n", letter.repeat(1023)));
        for _ in 0..2000 {
            queue.put(&counted, ROOM, true);
            queue.put(&other, ROOM / 2, false);
        }
        queue.put("ended\n", 2 * ROOM, true);
        assert!(queue.state().waiting_bytes <= 2 * ROOM);
        let began = Instant::now();
        queue.flush(Duration::from_millis(20));
        assert!(queue.state().is_stuck && began.elapsed() < Duration::from_secs(1));
        // Nothing was taken for longer than that: no further wait.
        queue.flush(Duration::from_millis(10));
        queue.flush_unless_stuck(Duration::from_secs(60));
        drop(token);
        queue.flush(Duration::from_secs(60));
        let written = written.lock().unwrap();
        let lines = |first| written.lines().filter(move |line| line.starts_with(first));
        let [counted, other] = ['x', 'y'].map(|first| lines(first).count());
        assert_eq!((counted, other), (6, 2));
        let tail: Vec<&str> = written.lines().skip(8).collect();
        assert_eq!(tail, ["1994 lost", "ended"]);
    }

    #[test]
    fn losses_that_nothing_follows_are_reported_too() {
        let (queue, token, written) = slow();
        for _ in 0..5 {
            queue.put("12345678\n", 20, true);
        }
        drop(token);
        queue.flush(Duration::from_secs(60));
        let began = Instant::now();
        while !written.lock().unwrap().ends_with("3 lost\n") {
            assert!(began.elapsed() < Duration::from_secs(60));
            std::thread::yield_now();
        }
    }

    /// A stream whose reader is behind and that does not wait (`O_NONBLOCK`) loses no part of
    /// a line; a closed one takes everything.
    #[test]
    fn a_stream_that_does_not_wait_gets_whole_lines_and_a_closed_one_ends_the_wait() {
        struct Hesitant(u32, Arc<Mutex<String>>);
        impl Write for Hesitant {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                self.0 += 1;
                match self.0 {
                    1 | 3 => Err(ErrorKind::WouldBlock.into()),
                    0..7 => {
                        let text = std::str::from_utf8(&bytes[..2]).unwrap();
                        self.1.lock().unwrap().push_str(text);
                        Ok(2)
                    }
                    _ => Err(ErrorKind::BrokenPipe.into()),
                }
            }

            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let written = Arc::new(Mutex::new(String::new()));
        let stream = Hesitant(0, written.clone());
        let queue = WriteQueue::start("hesitant", stream, |_| String::new()).unwrap();
        queue.put("abcdefg\n", ROOM, true);
        queue.put("never read\n", ROOM, true);
        queue.flush(Duration::from_secs(60));
        assert_eq!(queue.state().waiting_bytes, 0);
        assert_eq!(*written.lock().unwrap(), "abcdefg\n");
    }
}
