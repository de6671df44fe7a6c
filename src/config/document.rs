//! A TOML document as a tree of values that know their lines.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::RangeInclusive;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::shown::{MESSAGE, shortened};

/// The longest piece of a value that is shown.
const SHOWN_CHARS: usize = 48;

/// The most items of a list that are shown.
const SHOWN_ITEMS: usize = 8;

/// A value and where it stands.
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// Line, from 1.
    pub line: usize,
    /// The value.
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

/// Parses a document; on failure the line, from 1, and what the parser says.
pub(super) fn parse(text: &str) -> Result<BTreeMap<String, Node>, (usize, String)> {
    let text = Lined::new(text);
    let table = DeTable::parse(text.text).map_err(|error| {
        let start = error.span().map_or(0, |span| span.start);
        let message = shortened(error.message(), MESSAGE);
        (text.line_at(start), message.into_owned())
    })?;
    Ok(entries(table.get_ref(), &text))
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

fn entries(table: &DeTable<'_>, text: &Lined<'_>) -> BTreeMap<String, Node> {
    table
        .iter()
        .map(|(key, value)| (key.get_ref().to_string(), node(value, text)))
        .collect()
}

fn node(value: &Spanned<DeValue<'_>>, text: &Lined<'_>) -> Node {
    let quoted = || text.text[value.span()].to_owned();
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
            Value::List(values.iter().map(|value| node(value, text)).collect())
        }
        DeValue::Table(table) => Value::Table(entries(table, text)),
    };
    Node {
        line: text.line_at(value.span().start),
        value: converted,
    }
}

/// A text and where its lines begin.
struct Lined<'a> {
    text: &'a str,
    ends: Vec<usize>,
}

impl<'a> Lined<'a> {
    fn new(text: &'a str) -> Self {
        let ends = text.match_indices('\n').map(|(at, _)| at).collect();
        Self { text, ends }
    }

    /// Line of a byte, from 1.
    fn line_at(&self, byte: usize) -> usize {
        1 + self.ends.partition_point(|&end| end < byte)
    }
}
