//! stderr, through a queue with a thread of its own: nothing that happens to
//! stderr holds the thread that drives a bench. Where it takes nothing, progress is dropped
//! first and remarks last, and the number of lost messages is reported once there is room.

use std::io::{self, Write};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use indicatif::TermLike;

use crate::shown;
pub use crate::write_queue::LAST_WORDS;
use crate::write_queue::WriteQueue;

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

/// The queue of this process, with its thread; `None` where no thread can be had.
fn queue() -> Option<&'static WriteQueue> {
    static QUEUE: OnceLock<Option<&'static WriteQueue>> = OnceLock::new();
    *QUEUE.get_or_init(|| {
        let lost_text = |lost| format!("{lost} messages were lost: stderr took none\n");
        WriteQueue::start("stderr", io::stderr(), lost_text).ok()
    })
}

/// Clears the line of the cursor.
const CLEAR_LINE: &str = "\r\x1b[2K";
/// Whether the last line of the terminal is a bar, which a message must clear first.
static BAR_IS_SHOWN: Mutex<bool> = Mutex::new(false);

/// Writes a message, in place of a bar that stands there (the next drawing follows the
/// message). Never waits; a closed stderr is ignored.
pub fn write(text: &str, worth: Worth) {
    // Held until the text is queued, so that no drawing comes in between.
    let mut bar = BAR_IS_SHOWN.lock().unwrap_or_else(PoisonError::into_inner);
    match std::mem::replace(&mut *bar, worth == Worth::Progress && leaves_a_line(text)) {
        true if worth != Worth::Progress => put(&format!("{CLEAR_LINE}{text}"), worth),
        _ => put(text, worth),
    }
}

/// Whether the last line of a bar's drawing still shows something when it is done.
fn leaves_a_line(drawing: &str) -> bool {
    let last = drawing.rsplit(CLEAR_LINE).next();
    last.is_some_and(|last| !last.trim().is_empty())
}

fn put(text: &str, worth: Worth) {
    match queue() {
        _ if text.is_empty() => {}
        Some(queue) => queue.put(text, worth.waiting_bytes(), worth != Worth::Progress),
        None => drop(io::stderr().write_all(text.as_bytes())),
    }
}

/// Waits until everything is written, this long at most.
pub fn flush(longest: Duration) {
    if let Some(queue) = queue() {
        queue.flush(longest);
    }
}

/// Clears a bar, then waits shortly until stderr has taken all messages, unless it takes none.
pub fn flush_in_order() {
    write("", Worth::Remark);
    if let Some(queue) = queue() {
        queue.flush_unless_stuck(IN_ORDER);
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

/// The terminal as a progress bar sees it: each redraw of the bar is one text in the queue.
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

/// Columns that a bar leaves free: a terminal shows Ctrl-C as `^C` where the cursor is, and
/// beyond its last column on a line of its own.
const FREE_COLUMNS: u16 = 4;

impl TermLike for Drawing {
    fn width(&self) -> u16 {
        let columns = match rustix::termios::tcgetwinsize(io::stderr()) {
            Ok(size) if size.ws_col > 0 => size.ws_col,
            _ => 80,
        };
        columns.saturating_sub(FREE_COLUMNS).max(1)
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
        self.add(CLEAR_LINE)
    }

    fn flush(&self) -> io::Result<()> {
        let drawn = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        // The blanks that fill the line were cleared before.
        let drawn = drawn.trim_end_matches(' ');
        if !drawn.is_empty() {
            write(drawn, Worth::Progress);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_is_one_text_and_moves_by_what_is_asked() {
        let drawing = Drawing::default();
        drawing.move_cursor_up(0).unwrap();
        drawing.clear_line().unwrap();
        drawing.write_str("half").unwrap();
        drawing.move_cursor_up(2).unwrap();
        assert_eq!(*drawing.0.lock().unwrap(), "\r\x1b[2Khalf\x1b[2A");
        for (drawing, remains) in [
            ("", false),
            ("\r\x1b[2K", false),
            ("\r\x1b[2K██ 96%", true),
            ("██ 96%\r\x1b[2K", false),
        ] {
            assert_eq!(leaves_a_line(drawing), remains, "{drawing:?}");
        }
    }
}
