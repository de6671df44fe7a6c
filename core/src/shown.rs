//! Text from outside (keys, names, what devices and programs say) as it may be shown: in
//! bounded length, and with nothing in it that a terminal obeys or that reorders a line.

use std::borrow::Cow;
use std::error::Error;

/// A number of things, as `1 job` or `3 jobs`.
///
/// ```
/// use rig_core::shown::count;
/// assert_eq!([count(1, "job"), count(3, "job")], ["1 job", "3 jobs"]);
/// ```
pub fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// A thing of this index as people read it, who count from 1 where data count from 0:
/// `nth("light", 2)` is "light 3".
pub fn nth(what: &str, index: impl TryInto<usize>) -> String {
    let index = index.try_into().unwrap_or(usize::MAX);
    format!("{what} {}", index.saturating_add(1))
}

/// Characters of a quoted piece of input: a word, a key, a name.
pub const PIECE: usize = 80;
/// Characters of another parser's message, which may quote its input.
pub const MESSAGE: usize = 400;
/// Characters of a whole line; longer ones lose their middle.
pub const LINE: usize = 16 << 10;

/// At most the first [`PIECE`] characters of a piece of input, then `…`.
pub fn excerpt(text: &str) -> Cow<'_, str> {
    shortened(text, PIECE)
}

/// At most the first `most` characters, then `…`.
pub fn shortened(text: &str, most: usize) -> Cow<'_, str> {
    match text.char_indices().nth(most) {
        None => Cow::Borrowed(text),
        Some((end, _)) => Cow::Owned(format!("{}…", &text[..end])),
    }
}

/// One line for a terminal: runs of blanks and line ends become one blank, what a terminal
/// would obey is shown [`escaped`], and of more than [`LINE`] characters the middle is left out.
pub fn line(text: &str) -> String {
    let mut joined = String::new();
    for word in text.split_whitespace() {
        if !joined.is_empty() {
            joined.push(' ');
        }
        joined.push_str(word);
    }
    without_middle(escaped(&joined)).into_owned()
}

/// The error and its causes as one [`line()`] each, outermost first, joined by `: `. A cause
/// that its parent already quotes is not repeated.
pub fn with_causes(error: &(dyn Error + 'static)) -> String {
    let mut text = line(&error.to_string());
    let mut cause = error.source();
    while let Some(error) = cause {
        let fact = line(&error.to_string());
        if !text.ends_with(&fact) {
            text = format!("{text}: {fact}");
        }
        cause = error.source();
    }
    text
}

/// Control characters, line and paragraph separators, and marks that reorder a line (bidi
/// overrides, isolates and marks), written as `\n` or `\u{1b}`.
pub fn escaped(text: &str) -> Cow<'_, str> {
    if !text.contains(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_obeyed(c) {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    Cow::Owned(shown)
}

/// A line of a log with its line end and its own colours, whose values the logger has escaped as
/// far as they could begin a terminal's command; here the rest.
pub fn traced(text: &str) -> Cow<'_, str> {
    let (line, end) = match text.strip_suffix('\n') {
        Some(line) => (line, "\n"),
        None => (text, ""),
    };
    let is_raw = |c: char| c != '\u{1b}' && is_obeyed(c);
    if !line.contains(is_raw) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in line.chars() {
        match is_raw(c) {
            true => shown.extend(c.escape_default()),
            false => shown.push(c),
        }
    }
    shown.push_str(end);
    Cow::Owned(shown)
}

/// Whether a terminal obeys the character instead of drawing it.
pub fn is_obeyed(c: char) -> bool {
    c.is_control()
        || matches!(
            c,
            '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
        )
}

fn without_middle(text: Cow<'_, str>) -> Cow<'_, str> {
    let count = match text.len() {
        0..=LINE => return text,
        _ => text.chars().count(),
    };
    if count <= LINE {
        return text;
    }
    let at = |n: usize| text.char_indices().nth(n).map_or(text.len(), |(at, _)| at);
    let (head, tail) = (at(LINE / 2), at(count - LINE / 4));
    let left_out = count - LINE / 2 - LINE / 4;
    Cow::Owned(format!(
        "{} … ({left_out} characters left out) … {}",
        &text[..head],
        &text[tail..]
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_a_terminal_would_obey_is_written_out() {
        for (raw, shown) in [
            ("plain ü 日本 …", "plain ü 日本 …"),
            ("a\x1b[31mb", "a\\u{1b}[31mb"),
            ("\x07\x7f\u{9b}2J", "\\u{7}\\u{7f}\\u{9b}2J"),
            ("gnp.\u{202e}exe", "gnp.\\u{202e}exe"),
            ("\u{2066}a\u{2069}\u{200f}", "\\u{2066}a\\u{2069}\\u{200f}"),
            ("a\nok  b\r\t", "a\\nok  b\\r\\t"),
        ] {
            assert_eq!(escaped(raw), shown);
        }
        assert_eq!(traced("\x1b[1ma\x1b[0m\n"), "\x1b[1ma\x1b[0m\n");
        assert_eq!(traced("a\nb\u{202e}\n"), "a\\nb\\u{202e}\n");
        assert_eq!(line(" a\n  b\u{85}c\x1b "), "a b c\\u{1b}");
    }

    #[test]
    fn long_input_is_cut() {
        let long = "é".repeat(1 << 20);
        assert_eq!(excerpt(&long).chars().count(), PIECE + 1);
        assert_eq!(excerpt("short"), "short");
        let text = line(&format!("begin {long} end"));
        assert!(text.starts_with("begin é") && text.ends_with("é end"));
        assert!(text.contains("characters left out") && text.chars().count() < LINE);
        let whole = "x".repeat(LINE);
        assert_eq!(line(&whole), whole);
    }

    proptest! {
        #[test]
        fn a_line_has_nothing_that_is_obeyed(text: String) {
            prop_assert!(!line(&text).contains(is_obeyed));
            prop_assert!(!escaped(&text).contains(is_obeyed));
        }
    }

    #[test]
    fn people_count_from_one() {
        assert_eq!(nth("light", 2_u32), "light 3");
        assert_eq!(nth("image", 0_usize), "image 1");
    }
}
