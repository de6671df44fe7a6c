//! What an editor, a keyboard or a habit puts into a TOML file, where the parser says only that
//! something else was expected.

/// Why a document is no TOML, where more is known than what the parser says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slip {
    /// A typographic quotation mark, where TOML has `"`.
    Quote(char),
    /// A dash or Unicode's minus sign, where TOML has `-`.
    Minus(char),
    /// A blank that is none for TOML.
    Blank(char),
    /// Another character that looks like the one in ASCII.
    Lookalike(char, char),
    /// A backslash in double quotes, as in a Windows path.
    Backslash,
    /// A comma in a number.
    DecimalComma,
}

impl std::fmt::Display for Slip {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::Quote(c) => write!(
                out,
                "{c} (U+{:04X}) is a typographic quotation mark, not \"",
                u32::from(c)
            ),
            Self::Minus(c) => write!(out, "{c} (U+{:04X}) is a dash, not -", u32::from(c)),
            Self::Blank(c) => write!(
                out,
                "U+{:04X} looks like a blank or like nothing, but is neither",
                u32::from(c)
            ),
            Self::Lookalike(c, ascii) => write!(out, "{c} (U+{:04X}) is not {ascii}", u32::from(c)),
            Self::Backslash => write!(
                out,
                "a backslash in double quotes begins an escape sequence, and this is none"
            ),
            Self::DecimalComma => write!(out, "a number has a decimal comma"),
        }
    }
}

/// The slip on the line of the text in which a parser stopped at byte `at`, and its byte.
pub(super) fn find(text: &str, at: usize, problem: &str) -> Option<(usize, Slip)> {
    let at = text.floor_char_boundary(at);
    let start = text[..at].rfind('\n').map_or(0, |end| end + 1);
    let line = text[start..].lines().next().unwrap_or("");
    if problem.contains("escape") || problem.contains("unicode") {
        let before = line.get(..at - start + 1).unwrap_or(line);
        let found = before.rfind('\\').or_else(|| line.find('\\'));
        return found.map(|column| (start + column, Slip::Backslash));
    }
    let outside = characters(line, false).find_map(slip_of);
    let found = outside.or_else(|| characters(line, true).find_map(slip_of));
    let found = found.or_else(|| Some((decimal_comma(line)?, Slip::DecimalComma)));
    found.map(|(column, slip)| (start + column, slip))
}

/// The characters of a line up to a comment, of what stands within straight quotes or without.
fn characters(line: &str, within: bool) -> impl Iterator<Item = (usize, char)> {
    let mut quote = None;
    let mut comment = false;
    line.char_indices().filter(move |&(_, c)| {
        match (quote, c) {
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), c) if open == c => quote = None,
            (None, '#') => comment = true,
            _ => {}
        }
        !comment && quote.is_some() == within
    })
}

fn slip_of((at, c): (usize, char)) -> Option<(usize, Slip)> {
    let slip = match c {
        ..='\u{7f}' => return None,
        '\u{ab}'
        | '\u{bb}'
        | '\u{2018}'..='\u{201f}'
        | '\u{2032}'..='\u{2036}'
        | '\u{2039}'
        | '\u{203a}'
        | '\u{301d}'..='\u{301f}' => Slip::Quote(c),
        '\u{2010}'..='\u{2015}' | '\u{2212}' | '\u{fe58}' | '\u{fe63}' => Slip::Minus(c),
        '\u{200b}'..='\u{200f}' | '\u{2028}' | '\u{2029}' | '\u{2060}' | '\u{feff}' | '\u{ad}' => {
            Slip::Blank(c)
        }
        c if c.is_whitespace() => Slip::Blank(c),
        // The full-width forms of East Asian keyboards, in ASCII's order.
        '\u{ff01}'..='\u{ff5e}' => {
            Slip::Lookalike(c, char::from_u32(u32::from(c) - 0xff01 + u32::from('!'))?)
        }
        _ => return None,
    };
    Some((at, slip))
}

/// Where a line `key = 10,5` has its comma.
fn decimal_comma(line: &str) -> Option<usize> {
    let (key, value) = line.split_once('=')?;
    let value = value.split('#').next().unwrap_or("");
    let number = value.trim();
    let is_number = number.starts_with(|c: char| c.is_ascii_digit() || "+-".contains(c))
        && number
            .chars()
            .all(|c| c.is_ascii_digit() || "+-.,eE_".contains(c));
    is_number.then(|| value.find(',').map(|at| key.len() + 1 + at))?
}

/// A control character in a text, as it is written in TOML.
pub(super) fn control(text: &str) -> Option<&'static str> {
    text.chars().find(|c| c.is_control()).map(|c| match c {
        '\u{8}' => "a backspace, written \\b",
        '\t' => "a tabulator, written \\t",
        '\n' => "a line end, written \\n",
        '\u{c}' => "a form feed, written \\f",
        '\r' => "a carriage return, written \\r",
        '\u{1b}' => "an escape character, written \\e",
        _ => "a control character",
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::document;

    #[test]
    fn slips_are_found_where_they_are() {
        for (text, line, column, slip) in [
            ("a = \u{201c}x\u{201d}\n", 1, 5, Slip::Quote('\u{201c}')),
            ("a = \"x\u{201d}\n", 1, 7, Slip::Quote('\u{201d}')),
            ("b = 1\na = [\u{2212}1]\n", 2, 6, Slip::Minus('\u{2212}')),
            ("a\u{a0}= 1\n", 1, 2, Slip::Blank('\u{a0}')),
            ("a = 1\u{200b}\n", 1, 6, Slip::Blank('\u{200b}')),
            ("a \u{ff1d} 1\n", 1, 3, Slip::Lookalike('\u{ff1d}', '=')),
            ("a = \"C:\\scans\"\n", 1, 8, Slip::Backslash),
            ("a = \"D:\\Users\\me\"\n", 1, 8, Slip::Backslash),
            ("a = 10,5 # mm\n", 1, 7, Slip::DecimalComma),
        ] {
            let error = document::parse(text).unwrap_err();
            assert_eq!(error.slip, Some(slip), "{text}");
            assert_eq!((error.line, error.column), (line, column), "{text}");
        }
        let error = document::parse("a = \"\u{201c}\" b\n").unwrap_err();
        assert_eq!(error.slip, Some(Slip::Quote('\u{201c}')));
        assert_eq!(
            document::parse("a = = 1 # \u{201c}\n").unwrap_err().slip,
            None
        );
    }
}
