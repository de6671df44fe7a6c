//! A job's newest lines, as its terminal would show them.

use std::collections::VecDeque;

/// Lines that are kept.
const MOST_LINES: usize = 200;
/// A line is at most so long (characters).
const LONGEST_LINE: usize = 2000;

/// Text in pieces of any length becomes lines. A carriage return begins a line anew.
#[derive(Clone, Debug, Default)]
pub struct Log {
    lines: VecDeque<String>,
    /// Bytes after the last line end.
    open: Vec<u8>,
    /// The last line ended with a carriage return: the next one takes its position.
    is_redrawn: bool,
}

impl Log {
    /// Adds a piece.
    pub fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            match byte {
                b'\n' => self.end_line(false),
                b'\r' => self.end_line(true),
                // Whatever is longer than any text that rig writes is cut off.
                _ if self.open.len() < 4 * LONGEST_LINE => self.open.push(byte),
                _ => {}
            }
        }
    }

    /// The last line, if its end is missing.
    pub fn finish(&mut self) {
        self.end_line(false);
    }

    /// Oldest first.
    pub fn lines(&self) -> impl Iterator<Item = &str> {
        self.lines.iter().map(String::as_str)
    }

    fn end_line(&mut self, redrawn: bool) {
        let text = plain(&String::from_utf8_lossy(&std::mem::take(&mut self.open)));
        if !text.trim().is_empty() {
            if self.is_redrawn {
                self.lines.pop_back();
            }
            if self.lines.len() == MOST_LINES {
                self.lines.pop_front();
            }
            self.lines.push_back(text);
            self.is_redrawn = redrawn;
        } else if !redrawn {
            // A line end after a drawing makes it final.
            self.is_redrawn = false;
        }
    }
}

/// Without escape sequences (ECMA-48) and other control characters.
fn plain(text: &str) -> String {
    let mut kept = String::new();
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        if c != '\x1b' {
            if !c.is_control() || c == '\t' {
                kept.push(c);
            }
            continue;
        }
        match chars.next() {
            // Control sequences end with one of @ to ~.
            Some('[') => drop(chars.by_ref().find(|c| ('@'..='~').contains(c))),
            // Commands of the terminal end with BEL or ESC \.
            Some(']') => {
                let end = chars.by_ref().find(|c| matches!(c, '\x07' | '\x1b'));
                if end == Some('\x1b') {
                    chars.next_if_eq(&'\\');
                }
            }
            _ => {}
        }
    }
    kept.chars().take(LONGEST_LINE).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(pieces: &[&[u8]]) -> Vec<String> {
        let mut log = Log::default();
        pieces.iter().for_each(|piece| log.add(piece));
        log.finish();
        log.lines().map(str::to_owned).collect()
    }

    #[test]
    fn pieces_become_lines_without_what_a_terminal_obeys() {
        let lines = log(&[
            b"warning: \x1b[1;33mthe la",
            b"mp\x1b[0m\nsecond\xff\n\n\x1b]0;title\x07third\x07\x1b]2;t\x1b\\!",
        ]);
        assert_eq!(lines, ["warning: the lamp", "second\u{fffd}", "third!"]);
    }

    #[test]
    fn a_bar_is_one_line_and_the_newest_lines_are_kept() {
        let lines = log(&[b"\r\x1b[2K10%\r\x1b[2K20%\r\x1b[2K30%\ndone\n"]);
        assert_eq!(lines, ["30%", "done"]);
        let many: String = (0..1000).map(|n| format!("line {n}\n")).collect();
        let lines = log(&[many.as_bytes()]);
        assert_eq!(lines.len(), MOST_LINES);
        assert_eq!(lines[199], "line 999");
        let endless = log(&[&[b'x'; 100_000]]);
        assert_eq!(endless[0].len(), LONGEST_LINE);
    }
}
