//! Rows of named columns, as CSV and JSON: what experiments and batches come to.

use std::fmt;

use crate::catalogue;
use crate::fault::Fault;
use crate::session::fit_record::Verdict;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde::ser::{Serialize, SerializeMap, Serializer};

/// One entry of a row.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// A count.
    Integer(i64),
    /// A figure, finite.
    Number(f64),
    /// A name.
    Text(String),
    /// Nothing was or could be measured.
    Missing(()),
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        if value.is_finite() {
            Value::Number(value)
        } else {
            Value::Missing(())
        }
    }
}

impl From<Option<f64>> for Value {
    fn from(value: Option<f64>) -> Self {
        value.map_or(Value::Missing(()), Value::from)
    }
}

macro_rules! integers {
    ($($t:ty),*) => {
        $(impl From<$t> for Value {
            fn from(value: $t) -> Self {
                i64::try_from(value).map_or(Value::Missing(()), Value::Integer)
            }
        })*
    };
}
integers!(usize, u32, i64, u64);

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Value::Text(value.to_owned())
    }
}

impl From<String> for Value {
    fn from(value: String) -> Self {
        Value::Text(value)
    }
}

/// Values by column, in the order in which they were added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row(Vec<(String, Value)>);

impl Row {
    /// Without columns.
    pub fn new() -> Self {
        Self::default()
    }

    /// With one column more. A figure that is not finite is missing.
    #[must_use]
    pub fn with(mut self, column: impl Into<String>, value: impl Into<Value>) -> Self {
        self.0.push((column.into(), value.into()));
        self
    }

    /// The columns of `other` behind its own.
    #[must_use]
    pub fn and(mut self, other: Row) -> Self {
        self.0.extend(other.0);
        self
    }

    /// The value of a column.
    pub fn get(&self, column: &str) -> Option<&Value> {
        let found = self.0.iter().find(|(name, _)| name == column);
        found.map(|(_, value)| value)
    }

    /// The figure or count in a column, if there is one.
    pub fn number(&self, column: &str) -> Option<f64> {
        match self.get(column)? {
            Value::Number(value) => Some(*value),
            Value::Integer(value) => Some(*value as f64),
            _ => None,
        }
    }

    /// The text in a column; empty if there is none.
    pub fn text(&self, column: &str) -> &str {
        match self.get(column) {
            Some(Value::Text(text)) => text,
            _ => "",
        }
    }
}

impl Serialize for Row {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (column, value) in &self.0 {
            map.serialize_entry(column, value)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Row {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Columns;
        impl<'de> Visitor<'de> for Columns {
            type Value = Row;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a row of columns")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Row, A::Error> {
                let mut row = Row::new();
                while let Some(entry) = map.next_entry()? {
                    row.0.push(entry);
                }
                Ok(row)
            }
        }
        deserializer.deserialize_map(Columns)
    }
}

/// The rows of a run, in the order of its cases.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// The rows.
    pub rows: Vec<Row>,
}

impl Table {
    /// All columns, in the order in which they first appear.
    pub fn columns(&self) -> Vec<&str> {
        let mut columns: Vec<&str> = Vec::new();
        for (name, _) in self.rows.iter().flat_map(|row| &row.0) {
            if !columns.contains(&name.as_str()) {
                columns.push(name);
            }
        }
        columns
    }

    /// The distinct texts of a column, in the order in which they first appear.
    pub fn texts(&self, column: &str) -> Vec<&str> {
        let mut texts: Vec<&str> = Vec::new();
        for text in self.rows.iter().map(|row| row.text(column)) {
            if !text.is_empty() && !texts.contains(&text) {
                texts.push(text);
            }
        }
        texts
    }

    /// The distinct figures of a column, ascending.
    pub fn numbers(&self, column: &str) -> Vec<f64> {
        let mut numbers: Vec<f64> = self.rows.iter().filter_map(|r| r.number(column)).collect();
        numbers.sort_by(f64::total_cmp);
        numbers.dedup();
        numbers
    }

    /// The figures of `column` in the rows that `keep` chooses.
    pub fn figures(&self, column: &str, keep: impl Fn(&Row) -> bool) -> Vec<f64> {
        let kept = self.rows.iter().filter(|row| keep(row));
        kept.filter_map(|row| row.number(column)).collect()
    }

    /// RFC 4180 with a header; a missing value is an empty field. Figures are written
    /// as in JSON.
    pub fn to_csv(&self) -> String {
        let columns = self.columns();
        let mut writer = csv::Writer::from_writer(Vec::new());
        // Writing records of one length into memory cannot fail.
        let mut write = |record: Vec<String>| {
            let written = writer.write_record(record);
            debug_assert!(written.is_ok());
        };
        write(columns.iter().map(|&column| column.to_owned()).collect());
        for row in &self.rows {
            let field = |column: &&str| match row.get(column) {
                Some(Value::Text(text)) => text.clone(),
                Some(Value::Missing(())) | None => String::new(),
                Some(value) => serde_json::to_string(value).unwrap_or_default(),
            };
            write(columns.iter().map(field).collect());
        }
        let bytes = writer.into_inner().unwrap_or_default();
        String::from_utf8(bytes).unwrap_or_default()
    }
}

/// A session of a catalogue; the figures are those of its latest fit.
pub fn of_session(row: &catalogue::Row) -> Row {
    let text = |text: &Option<String>| text.clone().unwrap_or_default();
    let yes = |is| if is { "yes" } else { "no" };
    let fit = row.latest();
    let fault = |fault: &Option<Fault>| fault.as_ref().map(|fault| fault.error.clone());
    let fit_fault = fit.and_then(|fit| fault(&fit.error));
    Row::new()
        .with("session", row.name.as_str())
        .with("sample", text(&row.sample))
        .with("material", text(&row.material))
        .with("true_material", text(&row.true_material))
        .with("comment", text(&row.comment))
        .with("began_utc", text(&row.began))
        .with("lights", row.lights)
        .with("lights_finished", row.lights_finished)
        .with("frames", row.frames)
        .with("bytes", row.bytes)
        .with("complete", yes(row.complete))
        .with("simulated", yes(row.simulated))
        .with("suspect", yes(row.suspect))
        .with("fit", fit.map_or("", |fit| &fit.name))
        .with(
            "dictionary",
            fit.map_or(String::new(), |fit| text(&fit.dictionary)),
        )
        .with(
            "verdict",
            fit.and_then(|fit| fit.verdict).map_or("", Verdict::name),
        )
        .with("worst_chi2", fit.and_then(|fit| fit.chi2))
        .with(
            "environment_error",
            fit.and_then(|fit| fit.environment_error),
        )
        .with("error", fault(&row.error).or(fit_fault).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_survive_json_to_the_bit_and_keep_their_order() {
        let row = Row::new()
            .with("z", "a, \"b\"")
            .with("error", 0.1 + 0.2)
            .with("small", 3.5e-18)
            .with("whole", 2.0)
            .with("lights", 4usize)
            .with("none", f64::NAN);
        let json = serde_json::to_string(&row).unwrap();
        let read: Row = serde_json::from_str(&json).unwrap();
        assert_eq!(read, row);
        assert!(json.starts_with("{\"z\""));
        let table = Table {
            rows: vec![row, Row::new().with("lights", 1usize)],
        };
        assert_eq!(
            table.to_csv(),
            "z,error,small,whole,lights,none\n\
             \"a, \"\"b\"\"\",0.30000000000000004,3.5e-18,2.0,4,\n,,,,1,\n"
        );
        assert_eq!(table.numbers("lights"), [1.0, 4.0]);
    }
}
