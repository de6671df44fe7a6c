//! Tables for people: columns of text, as wide as they must be.

use super::error::CliError;
use crate::out;
use crate::shown::{escaped, shortened};

/// Characters of a cell at most; a session's name has up to 88.
const WIDEST: usize = 100;

/// A table with a line of headings.
pub struct Table {
    right: Vec<bool>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// With these columns; a heading that begins with a space aligns its column to the right.
    pub fn new(headings: &[&str]) -> Self {
        Self {
            right: headings.iter().map(|text| text.starts_with(' ')).collect(),
            rows: vec![headings.iter().map(|text| text.trim().to_owned()).collect()],
        }
    }

    /// One more line, a text for each column, of which no more than [`WIDEST`] characters are
    /// shown.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let shown = cells.into_iter().map(|cell| {
            let cell = escaped(&cell);
            shortened(&cell, WIDEST).into_owned()
        });
        self.rows.push(shown.collect());
    }

    /// The lines, without columns in which no line has anything.
    fn lines(&self) -> Vec<String> {
        let (headings, rows) = self.rows.split_at(1);
        let width = |column: usize, rows: &[Vec<String>]| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let used = (0..headings[0].len()).filter(|&column| width(column, rows) > 0);
        let columns: Vec<(usize, usize)> = used.map(|at| (at, width(at, &self.rows))).collect();
        let line = |row: &Vec<String>| {
            let cells = columns.iter().map(|&(column, width)| {
                let cell = row.get(column).map_or("", String::as_str);
                match self.right[column] {
                    true => format!("{cell:>width$}"),
                    false => format!("{cell:<width$}"),
                }
            });
            cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        self.rows.iter().map(line).collect()
    }

    /// Prints it to stdout.
    ///
    /// # Errors
    /// stdout takes nothing.
    pub fn print(&self) -> Result<(), CliError> {
        self.lines().iter().try_for_each(|line| out!("{line}"))
    }
}

pub use crate::units::{percent, size};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_and_empty_ones_left_out() {
        let mut table = Table::new(&["sample", "material", " size"]);
        table.row(["cup".to_owned(), String::new(), size(1_234_000)]);
        table.row(["bowl é".to_owned(), String::new(), size(56_700_000_000)]);
        assert_eq!(
            table.lines(),
            ["sample    size", "cup     1.2 MB", "bowl é   57 GB"]
        );
        let mut long = Table::new(&["a", "b"]);
        long.row(["é".repeat(66_000), "b".to_owned()]);
        let shown = format!("{}…  b", "é".repeat(WIDEST));
        assert_eq!(long.lines()[1], shown);
        let empty = Table::new(&["a", "b"]);
        assert_eq!(empty.lines(), [""]);
    }
}
