//! A TOML document as a tree of values that know their lines.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::RangeInclusive;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::slip::{self, Slip};

/// The longest piece of a value that is shown.
const SHOWN_CHARS: usize = 48;

/// The most items of a list that are shown.
const SHOWN_ITEMS: usize = 8;

/// A value and where it stands.
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// Line, from 1.
    pub line: usize,
    pub value: Value,
}

/// A value of the document.
#[derive(Clone, Debug)]
pub(super) enum Value {
    Text(String),
    Integer(i64),
    Number(f64),
    Flag(bool),
    List(Vec<Node>),
    Table(BTreeMap<String, Node>),
    /// Valid TOML that no key takes: dates, integers beyond 64 bits.
    Other(String),
}

/// Why a text is no document, and where.
#[derive(Debug)]
pub(super) struct Fault {
    /// Line, from 1.
    pub line: usize,
    /// Character of the line, from 1.
    pub column: usize,
    pub problem: String,
    /// What made it so, where that is known.
    pub slip: Option<Slip>,
}

/// Parses a document.
///
/// # Errors
/// The place at which it is no TOML.
pub(super) fn parse(text: &str) -> Result<BTreeMap<String, Node>, Fault> {
    let table = DeTable::parse(text).map_err(|error| {
        let start = error.span().map_or(0, |span| span.start);
        let found = slip::find(text, start, error.message());
        let at = text.floor_char_boundary(found.map_or(start, |(at, _)| at));
        let line_start = text[..at].rfind('\n').map_or(0, |end| end + 1);
        Fault {
            line: line_at(text, at),
            column: 1 + text[line_start..at].chars().count(),
            problem: match found {
                Some((_, slip)) => slip.to_string(),
                None => error.message().to_owned(),
            },
            slip: found.map(|(_, slip)| slip),
        }
    })?;
    let source = Source {
        text,
        breaks: text.match_indices('\n').map(|(at, _)| at).collect(),
    };
    Ok(source.entries(table.get_ref()))
}

impl Value {
    /// A finite number in the range.
    pub fn number(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        let number = match self {
            Value::Integer(n) => *n as f64,
            Value::Number(x) => *x,
            _ => return None,
        };
        (number.is_finite() && range.contains(&number)).then_some(number)
    }

    /// `N` finite numbers in the range.
    pub fn numbers<const N: usize>(&self, range: &RangeInclusive<f64>) -> Option<[f64; N]> {
        let Value::List(nodes) = self else {
            return None;
        };
        let numbers = nodes.iter().map(|node| node.value.number(range));
        numbers.collect::<Option<Vec<f64>>>()?.try_into().ok()
    }
}

/// The value as an error shows it, shortened.
impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Value::Text(text) => format!("{text:?}"),
            Value::Integer(n) => n.to_string(),
            Value::Number(x) => x.to_string(),
            Value::Flag(flag) => flag.to_string(),
            Value::Other(text) => text.clone(),
            Value::Table(_) => "a table".to_owned(),
            Value::List(nodes) => {
                let items = nodes.iter().take(SHOWN_ITEMS);
                let items: Vec<_> = items.map(|node| node.value.to_string()).collect();
                format!("[{}]", items.join(", "))
            }
        };
        match text.char_indices().nth(SHOWN_CHARS) {
            None => out.write_str(&text),
            Some((end, _)) => write!(out, "{}…", &text[..end]),
        }
    }
}

/// The text with the places of its line breaks, so that a value's line costs a search
/// among them and not a count from the top.
struct Source<'a> {
    text: &'a str,
    /// Byte offsets, ascending.
    breaks: Vec<usize>,
}

impl Source<'_> {
    fn entries(&self, table: &DeTable<'_>) -> BTreeMap<String, Node> {
        table
            .iter()
            .map(|(key, value)| (key.get_ref().to_string(), self.node(value)))
            .collect()
    }

    fn node(&self, value: &Spanned<DeValue<'_>>) -> Node {
        let quoted = || self.text[value.span()].to_owned();
        let converted = match value.get_ref() {
            DeValue::String(s) => Value::Text(s.to_string()),
            DeValue::Integer(n) => i64::from_str_radix(n.as_str(), n.radix())
                .map_or_else(|_| Value::Other(quoted()), Value::Integer),
            DeValue::Float(x) => x
                .as_str()
                .parse()
                .map_or_else(|_| Value::Other(quoted()), Value::Number),
            DeValue::Boolean(flag) => Value::Flag(*flag),
            DeValue::Datetime(date) => Value::Other(date.to_string()),
            DeValue::Array(values) => {
                Value::List(values.iter().map(|value| self.node(value)).collect())
            }
            DeValue::Table(table) => Value::Table(self.entries(table)),
        };
        let start = value.span().start;
        Node {
            line: 1 + self.breaks.partition_point(|&at| at < start),
            value: converted,
        }
    }
}

/// The line of a byte, from 1.
fn line_at(text: &str, byte: usize) -> usize {
    1 + text.bytes().take(byte).filter(|&b| b == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_know_their_lines() {
        let tree = parse("a = 1\n\n[b]\nc = [\n  2,\n  3 ]\nd = 4").unwrap();
        assert_eq!(tree["a"].line, 1);
        let Value::Table(b) = &tree["b"].value else {
            panic!("{tree:?}");
        };
        let Value::List(c) = &b["c"].value else {
            panic!("{b:?}");
        };
        assert_eq!(
            (b["c"].line, c[0].line, c[1].line, b["d"].line),
            (4, 5, 6, 7)
        );
    }
}
