//! The table of the exposures of a bracket's frames: CSV with
//! the columns file, exposure, and optionally role (what was lit).

use std::collections::HashSet;
use std::path::Path;

use unicode_normalization::UnicodeNormalization;

use super::merge::FrameRole;
use super::written_time::seconds;
use crate::outside_table::{Row, rows};
use crate::shown::excerpt;

/// A line of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct BracketRow {
    /// File as the table names it.
    pub file: String,
    /// Exposure, seconds; finite and > 0.
    pub exposure_s: f64,
    /// `light` (default), `ambient` or `dark`.
    pub role: FrameRole,
}

/// A table that cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct TableError {
    /// From 1.
    pub line: usize,
    /// What is wrong, with the value.
    pub problem: String,
    /// Whether the line is sound and its file had one before.
    pub is_repeated: bool,
}

/// Names of the column of files.
const FILE_NAMES: [&str; 5] = ["file", "filename", "name", "image", "frame"];
/// Names of the column of exposures, and their units in seconds.
const EXPOSURE_NAMES: [(&str, f64); 3] = [
    ("exposure_s", 1.0),
    ("exposure_ms", 1e-3),
    ("exposure_us", 1e-6),
];

/// Name of the column of roles.
const ROLE_NAME: &str = "role";

/// Names of columns for people.
const REMARK_NAMES: [&str; 5] = ["note", "notes", "comment", "comments", "remark"];

/// Where a table has what.
struct Columns {
    file: usize,
    exposure: usize,
    unit_s: f64,
    role: usize,
    /// Columns without a name.
    most: usize,
}

/// Parses the rows `file,exposure_s[,role]`, or those below a first row that names its columns. An exposure is a number of seconds, a fraction (`1/250`) or
/// has a unit (`4 ms`).
///
/// # Errors
/// The first row that is wrong; a column of another name; a file named twice.
pub fn parse_bracket_table(text: &str) -> Result<Vec<BracketRow>, TableError> {
    let table = rows(text).map_err(|unclosed| TableError {
        line: unclosed.line,
        problem: "a double quote has no partner".into(),
        is_repeated: false,
    })?;
    let named = match table
        .first()
        .and_then(|row| Some((row, named_columns(row)?)))
    {
        Some((_, Ok(columns))) => Some(columns),
        Some((row, Err(problem))) => {
            return Err(TableError {
                line: row.line,
                problem,
                is_repeated: false,
            });
        }
        None => None,
    };
    let first = usize::from(named.is_some());
    let columns = named.unwrap_or(Columns {
        file: 0,
        exposure: 1,
        unit_s: 1.0,
        role: 2,
        most: 3,
    });
    let mut seen = HashSet::new();
    let mut parsed = Vec::new();
    for row in &table[first.min(table.len())..] {
        let error = |problem: String| TableError {
            line: row.line,
            problem,
            is_repeated: false,
        };
        let bracket_row = bracket_row(row, &columns).map_err(error)?;
        if !seen.insert(key(&bracket_row.file)) {
            let file = excerpt(&bracket_row.file);
            return Err(TableError {
                is_repeated: true,
                ..error(format!("{file} appears twice"))
            });
        }
        parsed.push(bracket_row);
    }
    Ok(parsed)
}

/// The columns of a first row that names them; or the one that is not known, which might say
/// what else a frame is.
fn named_columns(row: &Row) -> Option<Result<Columns, String>> {
    let (exposure, unit_s) = EXPOSURE_NAMES
        .iter()
        .find_map(|(name, unit_s)| Some((row.column(name)?, *unit_s)))?;
    let file = FILE_NAMES.iter().find_map(|name| row.column(name));
    let role = row.column(ROLE_NAME);
    // `exposure_s` in the second column was enough of a name.
    let file = file.unwrap_or(0);
    let known = [Some(file), Some(exposure), role];
    let is_known = |at: usize, name: &str| {
        let is_remark = || REMARK_NAMES.iter().any(|n| n.eq_ignore_ascii_case(name));
        name.is_empty() || known.contains(&Some(at)) || is_remark()
    };
    let mut others = row.fields.iter().enumerate();
    if let Some((_, name)) = others.find(|(at, name)| !is_known(*at, name)) {
        return Some(Err(format!(
            "the column {:?} is not known: there are {} (also {}), exposure_s (exposure_ms, \
             exposure_us), {ROLE_NAME} (light, ambient or dark) and {}, which is not read",
            excerpt(name),
            FILE_NAMES[0],
            FILE_NAMES[1..].join(", "),
            REMARK_NAMES[0]
        )));
    }
    Some(Ok(Columns {
        file,
        exposure,
        unit_s,
        role: role.unwrap_or(usize::MAX),
        most: usize::MAX,
    }))
}

fn bracket_row(row: &Row, columns: &Columns) -> Result<BracketRow, String> {
    let file = row.field(columns.file);
    let exposure = row.field(columns.exposure);
    let role = row.field(columns.role).to_ascii_lowercase();
    if !role.is_empty() && role.bytes().all(|b| b.is_ascii_digit()) {
        return Err(format!(
            "the exposure is {:?} and the role {:?}: a decimal comma needs quotes, or semicolons between the columns",
            excerpt(exposure),
            excerpt(&role)
        ));
    }
    let exposure_s = seconds(exposure, columns.unit_s)
        .map_err(|problem| format!("the exposure is {:?}, {problem}", excerpt(exposure)))?;
    let role = match role.as_str() {
        "" | "light" => FrameRole::Light,
        "ambient" => FrameRole::Ambient,
        "dark" => FrameRole::Dark,
        other => {
            return Err(format!(
                "the role is {:?}, and must be light, ambient or dark",
                excerpt(other)
            ));
        }
    };
    if row.fields.len() > columns.most {
        let extra = excerpt(row.field(columns.most));
        return Err(format!("there is a fourth column, {extra:?}"));
    }
    if file.is_empty() {
        return Err("the file is empty".into());
    }
    Ok(BracketRow {
        file: file.to_owned(),
        exposure_s,
        role,
    })
}

/// The row for a frame: the one whose path agrees with the frame's in most of its last parts.
/// Compared are Unicode's composed forms, `\` is `/`, and case counts only where it decides.
///
/// # Errors
/// No row has the frame's name, or several with different exposures.
pub fn row_of<'a>(rows: &'a [BracketRow], frame: &Path) -> Result<&'a BracketRow, NoRow> {
    let frame = key(&frame.to_string_lossy());
    let folded = frame.to_lowercase();
    let exact = |row: &BracketRow| common_parts(&key(&row.file), &frame);
    let any_case = |row: &BracketRow| common_parts(&key(&row.file).to_lowercase(), &folded);
    for agreement in [&exact as &dyn Fn(&BracketRow) -> usize, &any_case] {
        let most = rows.iter().map(agreement).max().unwrap_or(0);
        if most == 0 {
            continue;
        }
        let mut best = rows.iter().filter(|row| agreement(row) == most);
        let first = best.next().ok_or(NoRow::None)?;
        let same = |row: &BracketRow| (row.exposure_s, row.role) == (first.exposure_s, first.role);
        return match best.find(|row| !same(row)) {
            None => Ok(first),
            Some(other) => Err(NoRow::Several([first.file.clone(), other.file.clone()])),
        };
    }
    Err(NoRow::None)
}

/// Why a table has no exposure for a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum NoRow {
    /// Nothing has its name.
    None,
    /// Two rows have its name, in other folders than its own, and differ.
    Several([String; 2]),
}

/// A path by which names are compared.
fn key(path: &str) -> String {
    path.nfc().collect::<String>().replace('\\', "/")
}

/// How many parts two paths have in common, from the last on.
fn common_parts(one: &str, other: &str) -> usize {
    let parts = |path: &str| -> Vec<String> {
        let parts = path
            .split('/')
            .rev()
            .filter(|part| !["", "."].contains(part));
        parts.map(str::to_owned).collect()
    };
    let (one, other) = (parts(one), parts(other));
    let pairs = one.iter().zip(&other);
    pairs.take_while(|(one, other)| one == other).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{prop_assert, proptest};

    #[test]
    fn a_table_with_header_comments_quotes_and_roles() {
        let rows = parse_bracket_table(
            "file,exposure_s,role\n# the lamp at 45 degrees\na.png, 0.01\n\n\"b, 2.png\",0.04,dark\r\nc.png,1e-3,ambient\nd.png, 1/250\n",
        )
        .unwrap();
        let files: Vec<_> = rows
            .iter()
            .map(|r| (r.file.as_str(), r.exposure_s, r.role))
            .collect();
        assert_eq!(
            files,
            [
                ("a.png", 0.01, FrameRole::Light),
                ("b, 2.png", 0.04, FrameRole::Dark),
                ("c.png", 1e-3, FrameRole::Ambient),
                ("d.png", 0.004, FrameRole::Light),
            ]
        );
    }

    #[test]
    fn columns_are_found_by_name_and_exposures_by_unit() {
        for text in [
            "exposure_ms;Note;File\n20;today;a.png\n",
            "\"File\",\"Exposure_s\"\n\"a.png\",\"0,02\"\n",
            "a.png,20 ms\n",
            "a.png;0,02;Light\n",
            "name\texposure_us\na.png\t20000\n",
        ] {
            let rows = parse_bracket_table(text).unwrap();
            let found = (rows.len(), rows[0].file.as_str(), rows[0].exposure_s);
            assert_eq!(found, (1, "a.png", 0.02), "{text}");
        }
    }

    #[test]
    fn wrong_lines_are_named() {
        for (text, line, part) in [
            ("a.png,0\n", 1, "\"0\""),
            ("a.png,1\nb.png\n", 2, "\"\""),
            ("a.png,1\na.png,2\n", 2, "a.png appears twice"),
            ("a.png,inf\n", 1, "\"inf\""),
            ("a.png,1/0\n", 1, "\"1/0\""),
            ("a.png,1/2/4\n", 1, "\"1/2/4\""),
            ("a.png,1,bright\n", 1, "\"bright\""),
            (
                "file,exposure_s,kind\na.png,1,dark\n",
                1,
                "\"kind\" is not known",
            ),
            (
                "# a\nDate;exposure_ms;File\n1;20;a.png\n",
                2,
                "role (light, ambient or dark)",
            ),
            ("a.png,0,02\n", 1, "decimal comma"),
            ("a.png;1,250\n", 1, "1.25 s or 1250 s"),
            ("a.png,1,dark,x\n", 1, "fourth"),
            ("\"a.png,1\n", 1, "double quote"),
            (",1\n", 1, "empty"),
        ] {
            let error = parse_bracket_table(text).unwrap_err();
            assert_eq!(error.line, line, "{text}");
            assert!(error.problem.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn names_agree_in_whatever_form_they_were_written() {
        let text = "Pr\u{fc}fling_1.png,1\nD:\\shots\\b.png,2\nday1/c.png,3\nday2/c.png,4\nD.PNG,5\nd2.png,6\nD2.PNG,7\n";
        let rows = parse_bracket_table(text).unwrap();
        let of = |frame: &str| row_of(&rows, Path::new(frame)).map(|row| row.exposure_s);
        assert_eq!(of("x/Pru\u{308}fling_1.png"), Ok(1.0));
        assert_eq!(of("./b.png"), Ok(2.0));
        assert_eq!(of("/data/day2/c.png"), Ok(4.0));
        assert_eq!(of("d.png"), Ok(5.0));
        assert_eq!(of("D2.PNG"), Ok(7.0));
        assert_eq!(of("missing.png"), Err(NoRow::None));
        let two = ["day1/c.png", "day2/c.png"].map(String::from);
        assert_eq!(of("c.png"), Err(NoRow::Several(two)));
    }

    proptest! {
        #[test]
        fn any_text_is_a_table_or_an_error(text in "([a-c\",.#01\\-\n\r\u{feff} é]|,light|,dark){0,60}") {
            if let Ok(rows) = parse_bracket_table(&text) {
                prop_assert!(rows.iter().all(|row| row.exposure_s > 0.0 && !row.file.is_empty()));
            }
        }
    }
}
