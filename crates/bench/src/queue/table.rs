//! Samples as a table names them: typed, scanned from labels, or saved by a spreadsheet.

use std::fmt::Write;

use crate::session::layout::is_sample_name;
use rig_core::outside_table::{self, Row, Unclosed};

/// A table that names no samples; facts only.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum TableError {
    #[error(transparent)]
    Unclosed(#[from] Unclosed),
    #[error("no sample is named")]
    Empty,
    #[error("{name:?} is no name of a sample")]
    Name { name: String },
    #[error("{name}: {repeats:?} is no number of repeats")]
    Repeats { name: String, repeats: String },
}

/// The text of a [`SampleList`](super::SampleList) for a table's samples, which may have sessions
/// from before if `again`. Its columns stand between commas, semicolons or tabs; a first row may
/// name them `name` or `sample`, `material`, `comment` and `repeats`, else they stand in this order.
///
/// # Errors
/// An open quote, no sample, or a name or number that is none. A name that
/// occurs twice and a note that is too long are found when the list is read.
pub fn list_of_table(text: &str, again: bool) -> Result<String, TableError> {
    let mut rows = outside_table::rows(text)?;
    let mut columns = [Some(0), Some(1), Some(2), Some(3)];
    if let Some(head) = rows.first()
        && let Some(name) = head.column("name").or_else(|| head.column("sample"))
    {
        let [material, comment, repeats] =
            ["material", "comment", "repeats"].map(|name| head.column(name));
        columns = [Some(name), material, comment, repeats];
        rows.remove(0);
    }
    let field = |row: &Row, column: Option<usize>| {
        column.map_or(String::new(), |column| row.field(column).trim().to_owned())
    };
    let mut list = String::new();
    for row in &rows {
        let [name, material, comment, repeats] = columns.map(|column| field(row, column));
        if name.is_empty() {
            continue;
        }
        if !is_sample_name(&name) {
            return Err(TableError::Name { name });
        }
        let gap = if list.is_empty() { "" } else { "\n" };
        let _ = writeln!(list, "{gap}[[sample]]\nname = \"{name}\"");
        for (key, value) in [("material", material), ("comment", comment)] {
            if !value.is_empty() {
                let _ = writeln!(list, "{key} = {}", toml::Value::String(value));
            }
        }
        if !repeats.is_empty() {
            let Ok(repeats) = repeats.parse::<u8>() else {
                return Err(TableError::Repeats { name, repeats });
            };
            let _ = writeln!(list, "repeats = {repeats}");
        }
        if again {
            list += "again = true\n";
        }
    }
    if list.is_empty() {
        return Err(TableError::Empty);
    }
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_or_a_scanner_names_samples() {
        for (table, expected) in [
            ("cup", "[[sample]]; name = \"cup\"; again = true"),
            (
                "a,red paint,matte,3\nbowl-7\n",
                "[[sample]]; name = \"a\"; material = \"red paint\"; comment = \"matte\"; repeats = 3; again = true; ; \
                 [[sample]]; name = \"bowl-7\"; again = true",
            ),
            (
                "Comment;Name;Repeats\nx;cup;2\n;;\n",
                "[[sample]]; name = \"cup\"; comment = \"x\"; repeats = 2; again = true",
            ),
            (
                "sample\tmaterial\ncup\t\"red, new\"\n",
                "[[sample]]; name = \"cup\"; material = \"red, new\"; again = true",
            ),
        ] {
            let list = list_of_table(table, true).unwrap();
            assert_eq!(list.trim().replace('\n', "; "), expected);
        }
        for bad in ["", "name\n", "a b", "-x", "cup,,,many", "../x"] {
            assert!(list_of_table(bad, false).is_err(), "{bad}");
        }
    }
}
