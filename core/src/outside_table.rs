//! Tables as spreadsheets and scripts write them: fields (RFC 4180) between commas, semicolons
//! or tabs, and numbers with a point or a comma.

use csv::{ReaderBuilder, StringRecord};

use crate::shown::excerpt;

/// A line of a table that says something.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Its line in the text, from 1.
    pub line: usize,
    /// Its fields without the blanks around them; empty ones at the end are left out.
    pub fields: Vec<String>,
}

impl Row {
    /// The field of a column, empty where the row ends before it.
    pub fn field(&self, column: usize) -> &str {
        self.fields.get(column).map_or("", String::as_str)
    }

    /// The column of this name in a first row, whatever its case.
    pub fn column(&self, name: &str) -> Option<usize> {
        let is_it = |field: &String| field.eq_ignore_ascii_case(name);
        self.fields.iter().position(is_it)
    }

    /// The column of this name.
    ///
    /// # Errors
    /// In words: there is none.
    pub fn needed_column(&self, name: &str) -> Result<usize, String> {
        self.column(name).ok_or_else(|| format!("no column {name}"))
    }
}

/// A field in double quotes that its line does not end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: a double quote has no partner")]
pub struct Unclosed {
    /// The line, from 1.
    pub line: usize,
}

/// The rows of a table. Empty lines and lines that begin with `#` are left out. The fields stand
/// between the character that Excel's first line `sep=;` names, else between tabs where the first
/// row has one, else semicolons, else commas.
///
/// # Errors
/// A line with an odd number of double quotes.
pub fn rows(text: &str) -> Result<Vec<Row>, Unclosed> {
    let mut separator = None;
    let mut rows = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}');
        if line.trim().is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        if rows.is_empty()
            && let Some(&[stated]) = line.trim().strip_prefix("sep=").map(str::as_bytes)
        {
            separator = Some(stated);
            continue;
        }
        if line.matches('"').count() % 2 == 1 {
            return Err(Unclosed { line: index + 1 });
        }
        let separator = *separator.get_or_insert_with(|| separator_of(line));
        let fields = fields(line, separator);
        if !fields.is_empty() {
            let line = index + 1;
            rows.push(Row { line, fields });
        }
    }
    Ok(rows)
}

/// The first row, which names the columns, and the rows below it.
///
/// # Errors
/// In words: as [`rows`], or there is no row.
pub fn with_header(text: &str) -> Result<(Row, Vec<Row>), String> {
    let mut rows = rows(text).map_err(|error| error.to_string())?;
    match rows.is_empty() {
        true => Err("the file is empty".to_owned()),
        false => Ok((rows.remove(0), rows)),
    }
}

fn separator_of(line: &str) -> u8 {
    let mut inside = false;
    let bare = line.bytes().filter(|&byte| {
        inside ^= byte == b'"';
        !inside
    });
    let bare: Vec<u8> = bare.collect();
    let found = [b'\t', b';'].into_iter().find(|byte| bare.contains(byte));
    found.unwrap_or(b',')
}

fn fields(line: &str, separator: u8) -> Vec<String> {
    let line = without_blanks_after(line, separator.into());
    let mut record = StringRecord::new();
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .delimiter(separator)
        .from_reader(line.as_bytes());
    // A string is UTF-8, and one record has no other's length.
    let _ = reader.read_record(&mut record);
    let mut fields: Vec<String> = record.iter().map(|f| f.trim().to_owned()).collect();
    while fields.last().is_some_and(String::is_empty) {
        fields.pop();
    }
    fields
}

/// A line whose fields begin where they do: a quote after a blank begins no quoted field in RFC
/// 4180, but does by every hand.
fn without_blanks_after(line: &str, separator: char) -> String {
    let (mut inside, mut begins) = (false, true);
    let kept = |c: &char| {
        inside ^= *c == '"';
        let blank = !inside && begins && *c == ' ';
        begins = blank || !inside && *c == separator;
        !blank
    };
    line.chars().filter(kept).collect()
}

/// A field that is not one finite number.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum NotNumber {
    /// None, or one beyond all bounds.
    #[error("\"{}\" is no number", excerpt(.0))]
    Other(String),
    /// With a comma that separates decimals or thousands.
    #[error("\"{}\" is {} or {}", excerpt(.text), .readings[0], .readings[1])]
    Several { text: String, readings: [f64; 2] },
}

/// The number in a field, written with a decimal point or comma.
///
/// # Errors
/// None, or one that could be either of two.
pub fn number(text: &str) -> Result<f64, NotNumber> {
    match readings(text)[..] {
        [one] => Ok(one),
        [one, other] => Err(NotNumber::Several {
            text: text.to_owned(),
            readings: [one, other],
        }),
        _ => Err(NotNumber::Other(text.to_owned())),
    }
}

/// The finite numbers that a text may mean: none, one, or two where a comma may separate
/// decimals or thousands, as in `1,250`.
pub fn readings(text: &str) -> Vec<f64> {
    let text = text.trim().replace('\u{2212}', "-");
    let finite = |text: &str| text.parse().ok().filter(|value: &f64| value.is_finite());
    if !text.contains(',') {
        return finite(&text).into_iter().collect();
    }
    let digits = text.trim_start_matches(['+', '-']);
    let decimal = match digits.split_once('.') {
        None => finite(&text.replacen(',', ".", 1)),
        // 1.234,5
        Some((_, after)) if after.contains(',') => thousands(digits.split(',').next(), '.')
            .and_then(|()| finite(&text.replace('.', "").replacen(',', ".", 1))),
        Some(_) => None,
    };
    // 1,234 and 1,234.5
    let grouped =
        thousands(digits.split('.').next(), ',').and_then(|()| finite(&text.replace(',', "")));
    decimal.into_iter().chain(grouped).collect()
}

/// Whether an integer is written in groups of three digits.
fn thousands(integer: Option<&str>, separator: char) -> Option<()> {
    let integer = integer.filter(|integer| integer.contains(separator))?;
    let mut groups = integer.split(separator);
    let first = groups.next()?;
    let all_digits = |group: &str| group.bytes().all(|b| b.is_ascii_digit());
    let begins = (1..=3).contains(&first.len()) && all_digits(first) && !first.starts_with('0');
    (begins && groups.all(|group| group.len() == 3 && all_digits(group))).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn one_table_in_every_dialect() {
        let expected = [["file", "exposure_s"], ["a b.png", "0,02"]];
        for text in [
            "file;exposure_s\na b.png;0,02\n",
            "sep=;\r\nfile;exposure_s\r\n\"a b.png\";0,02;;\r\n;;\r\n\r\n",
            "# by hand\n\n  # too\nfile\texposure_s\na b.png\t 0,02\n",
            "\"file\",\"exposure_s\"\n\"a b.png\",\"0,02\"\n",
            "file , exposure_s\n\"a b.png\" , \"0,02\"\n",
        ] {
            let rows = rows(text).unwrap();
            let fields: Vec<_> = rows.iter().map(|row| row.fields.clone()).collect();
            assert_eq!(fields, expected, "{text}");
        }
        let second = &rows("x,y\n\n\"p,\"\"q\"\"\",1\n").unwrap()[1];
        assert_eq!((second.line, second.field(0)), (3, "p,\"q\""));
        assert_eq!(rows("a\n\"b,1\nc\n"), Err(Unclosed { line: 2 }));
    }

    #[test]
    fn numbers_have_points_or_commas() {
        for (text, value) in [
            ("0.02", 0.02),
            (" 0,02 ", 0.02),
            ("-1,5", -1.5),
            ("\u{2212}1.5", -1.5),
            ("1e-3", 1e-3),
            ("2,5e-3", 2.5e-3),
            ("0,125", 0.125),
            ("1.234,5", 1234.5),
            ("1,234.5", 1234.5),
            ("1,234,567", 1_234_567.0),
            ("1.250", 1.25),
        ] {
            assert_eq!(number(text), Ok(value), "{text}");
        }
        assert_eq!(readings("1,250"), [1.25, 1250.0]);
        for text in ["", "x", "inf", "NaN", "1,2,3", "1.2.3", "0,1.5", "1e999"] {
            assert!(number(text).is_err(), "{text}: {:?}", number(text));
        }
    }

    proptest! {
        #[test]
        fn any_text_is_rows_or_an_error(text in "[a1,;\"\t\n\r# .=sep-]{0,40}") {
            if let Ok(rows) = rows(&text) {
                prop_assert!(rows.iter().all(|row| !row.fields.is_empty()));
                for row in &rows {
                    let _ = number(row.field(0));
                }
            }
        }
    }
}
