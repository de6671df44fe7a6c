//! The table that says which frame of a bracket had which exposure: CSV with
//! the columns file, exposure in seconds, and optionally role.

use std::collections::HashSet;

use super::merge::FrameRole;
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
}

/// Parses `file,exposure_s[,role]` lines; an exposure may be a fraction, `1/250`. Empty lines and lines that begin with
/// `#` are skipped, as is a first line whose second column is `exposure_s`. A
/// file in double quotes may hold commas; `""` inside is one quote.
///
/// # Errors
/// The first line that is wrong; a file named twice.
pub fn parse_bracket_table(text: &str) -> Result<Vec<BracketRow>, TableError> {
    let mut rows: Vec<BracketRow> = Vec::new();
    let mut seen = HashSet::new();
    for (index, line) in text.lines().enumerate() {
        let error = |problem: String| TableError {
            line: index + 1,
            problem,
        };
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let (file, rest) =
            first_field(line).ok_or_else(|| error("the quotes of the file never close".into()))?;
        let mut fields = rest.split(',').map(str::trim);
        let exposure = fields.next().unwrap_or("");
        if exposure == "exposure_s" && rows.is_empty() {
            continue;
        }
        let exposure_s = seconds(exposure).ok_or_else(|| {
            error(format!(
                "the exposure is {:?}, and must be a number of seconds above 0",
                excerpt(exposure)
            ))
        })?;
        let role = match fields.next() {
            None | Some("" | "light") => FrameRole::Light,
            Some("ambient") => FrameRole::Ambient,
            Some("dark") => FrameRole::Dark,
            Some(other) => {
                return Err(error(format!(
                    "the role is {:?}, and must be light, ambient or dark",
                    excerpt(other)
                )));
            }
        };
        if let Some(extra) = fields.next() {
            return Err(error(format!(
                "there is a fourth column, {:?}",
                excerpt(extra)
            )));
        }
        if file.is_empty() {
            return Err(error("the file is empty".into()));
        }
        if !seen.insert(file.clone()) {
            return Err(error(format!("{} appears twice", excerpt(&file))));
        }
        rows.push(BracketRow {
            file,
            exposure_s,
            role,
        });
    }
    Ok(rows)
}

/// A number or a fraction of two, finite and > 0.
fn seconds(text: &str) -> Option<f64> {
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let seconds = match text.split_once('/') {
        Some((above, below)) => number(above)? / number(below)?,
        None => number(text)?,
    };
    (seconds.is_finite() && seconds > 0.0).then_some(seconds)
}

/// The first field and what follows its comma.
fn first_field(line: &str) -> Option<(String, &str)> {
    let Some(quoted) = line.strip_prefix('"') else {
        let (file, rest) = line.split_once(',').unwrap_or((line, ""));
        return Some((file.trim().to_owned(), rest));
    };
    let mut file = String::new();
    let mut rest = quoted;
    loop {
        let (part, after) = rest.split_once('"')?;
        file += part;
        match after.strip_prefix('"') {
            Some(after) => {
                file.push('"');
                rest = after;
            }
            None => {
                let after = after.trim_start();
                return Some((file, after.strip_prefix(',').unwrap_or(after)));
            }
        }
    }
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
    fn wrong_lines_are_named() {
        for (text, line, part) in [
            ("a.png,0\n", 1, "\"0\""),
            ("a.png,1\nb.png\n", 2, "\"\""),
            ("a.png,1\na.png,2\n", 2, "a.png appears twice"),
            ("a.png,inf\n", 1, "\"inf\""),
            ("a.png,1/0\n", 1, "\"1/0\""),
            ("a.png,1/2/4\n", 1, "\"1/2/4\""),
            ("a.png,1,bright\n", 1, "\"bright\""),
            ("a.png,1,dark,x\n", 1, "fourth"),
            ("\"a.png,1\n", 1, "quotes"),
            (",1\n", 1, "empty"),
        ] {
            let error = parse_bracket_table(text).unwrap_err();
            assert_eq!(error.line, line, "{text}");
            assert!(error.problem.contains(part), "{text}: {error}");
        }
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
