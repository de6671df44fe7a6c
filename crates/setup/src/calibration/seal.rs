//! A record's checksum of its own content, by which a change after the measurement is noticed.
//!
//! The first line of a record is `checksum = "…"`: SHA-256 of all that follows, as values and
//! not as text, so that comments and blanks may change. It is no signature: whoever changes a
//! record on purpose removes that line.

use crate::checksum::sha256_hex;

const BEGIN: &str = "checksum = \"";

/// Whether a record's checksum holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seal {
    /// The values are those that were measured.
    Whole,
    /// The values are others than the checksum's.
    Broken,
    /// There is no checksum: the record is of an older version, or made by hand.
    Missing,
}

/// The text of a record with its checksum before it.
pub(super) fn sealed(text: &str) -> Result<String, toml::de::Error> {
    Ok(format!("{BEGIN}{}\"\n{text}", checksum(text)?))
}

/// The checksum that a record states, and the text without it. The line end stays, so that
/// errors name the right line.
pub(super) fn split(text: &str) -> (Option<&str>, &str) {
    let stated = text
        .strip_prefix(BEGIN)
        .and_then(|rest| rest.split_once('"'));
    match stated {
        Some((stated, rest)) if rest.is_empty() || rest.starts_with(['\n', '\r']) => {
            (Some(stated), rest)
        }
        _ => (None, text),
    }
}

impl Seal {
    /// Of a record that states this checksum and has this text.
    pub(super) fn of(stated: Option<&str>, text: &str) -> Result<Self, toml::de::Error> {
        let Some(stated) = stated else {
            return Ok(Seal::Missing);
        };
        Ok(match checksum(text)?.eq_ignore_ascii_case(stated) {
            true => Seal::Whole,
            false => Seal::Broken,
        })
    }
}

/// SHA-256 of the values, in the order of their keys.
fn checksum(text: &str) -> Result<String, toml::de::Error> {
    let values: toml::Table = toml::from_str(text)?;
    let mut canonical = String::new();
    write_table(&values, &mut canonical);
    Ok(sha256_hex(canonical.as_bytes()))
}

fn write_table(table: &toml::Table, out: &mut String) {
    let mut entries: Vec<_> = table.iter().collect();
    entries.sort_by_key(|(key, _)| *key);
    for (key, value) in entries {
        out.push_str(&format!("{key:?}="));
        write_value(value, out);
    }
}

fn write_value(value: &toml::Value, out: &mut String) {
    match value {
        toml::Value::Table(table) => {
            out.push('{');
            write_table(table, out);
            out.push('}');
        }
        toml::Value::Array(values) => {
            out.push('[');
            values.iter().for_each(|value| write_value(value, out));
            out.push(']');
        }
        toml::Value::String(text) => out.push_str(&format!("{text:?}")),
        toml::Value::Integer(number) => out.push_str(&number.to_string()),
        // To the last bit.
        toml::Value::Float(number) => out.push_str(&format!("{number:?}")),
        toml::Value::Boolean(flag) => out.push_str(&flag.to_string()),
        toml::Value::Datetime(date) => out.push_str(&date.to_string()),
    }
    out.push(';');
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECORD: &str = "id = \"a\"\n\n[values.gain]\nvalue = 0.38\nstd = 0.001\n";

    #[test]
    fn a_changed_value_is_seen_and_a_changed_text_is_not() {
        let text = sealed(RECORD).unwrap();
        let seal = |text: &str| {
            let (stated, text) = split(text);
            Seal::of(stated, text).unwrap()
        };
        assert_eq!(split(&text).1, format!("\n{RECORD}"));
        for (from, to, expected) in [
            ("value = 0.38", "value = 0.9", Seal::Broken),
            ("std = 0.001", "std = 0.0010000000000000002", Seal::Broken),
            ("value", "valve", Seal::Broken),
            ("std = 0.001\n", "", Seal::Broken),
            ("\"a\"", "\"b\"", Seal::Broken),
            (
                "value = 0.38",
                "value=3.8e-1 # as on the sheet",
                Seal::Whole,
            ),
            (
                "value = 0.38\nstd = 0.001",
                "std = 0.001\nvalue = 0.38",
                Seal::Whole,
            ),
            ("checksum = \"", "# \"", Seal::Missing),
        ] {
            assert!(text.contains(from));
            assert_eq!(
                seal(&text.replacen(from, to, 1)),
                expected,
                "{from} -> {to}"
            );
        }
        let digits = text.replacen("checksum = \"", "checksum = \"0", 1);
        assert_eq!(seal(&digits), Seal::Broken);
        assert_eq!(seal(RECORD), Seal::Missing);
        assert_eq!(seal(&text.replace('\n', "\r\n")), Seal::Whole);
    }
}
