//! The page of a batch: one HTML file with a link to each session's report.

use std::path::{Component, Path, PathBuf};

use minijinja::value::Value as View;
use minijinja::{Environment, UndefinedBehavior, context};

use super::{Batch, BatchError, Job};
use crate::brdf::sphere::srgb8;
use crate::result_table::{Row, Table};
use crate::session::layout::REPORT_FILE;

/// How a job stands, as a reader sees it: key, sign, in words.
const STANDINGS: [(&str, &str, &str); 5] = [
    ("good", "✓", "explains its images"),
    ("doubtful", "!", "with reservations"),
    ("bad", "✗", "not to be trusted"),
    ("failed", "–", "failed"),
    ("open", "…", "open"),
];

/// Of a row, as its place in [`STANDINGS`].
fn standing(row: &Row) -> usize {
    match (row.text("status"), row.text("verdict")) {
        ("done", "explains") => 0,
        ("done", "reservations") => 1,
        ("done", _) => 2,
        ("failed", _) => 3,
        _ => 4,
    }
}

/// The page of the jobs as `table` has them.
pub(super) fn render(batch: &Batch, table: &Table) -> Result<String, BatchError> {
    let folder = batch.folder.canonicalize();
    let folder = folder.map_err(BatchError::io(&batch.folder))?;
    let count = |at: usize| table.rows.iter().filter(|row| standing(row) == at).count();
    let counts = (0..).zip(STANDINGS).map(|(at, (key, sign, words))| {
        context! { key, sign, words, count => count(at) }
    });
    let rows = batch.jobs.iter().zip(&table.rows);
    let page = context! {
        name => folder.file_name().unwrap_or_default().to_string_lossy(),
        jobs => batch.jobs.len(),
        counts => counts.collect::<Vec<_>>(),
        simulated => table.rows.iter().any(|row| row.text("simulated") == "yes"),
        has_error => table.rows.iter().any(|row| row.number("environment_error").is_some()),
        rows => rows.map(|(job, row)| row_view(&folder, job, row)).collect::<Vec<_>>(),
        version => env!("CARGO_PKG_VERSION"),
        kernel => batch.kernel.to_string(),
    };
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.add_template("batch.html", include_str!("page.html.j2"))?;
    Ok(environment.get_template("batch.html")?.render(page)?)
}

fn row_view(folder: &Path, job: &Job, row: &Row) -> View {
    let (key, sign, words) = STANDINGS[standing(row)];
    let number = |column: &str, digits: usize| {
        let number = row.number(column);
        number.map_or(String::new(), |number| format!("{number:.digits$}"))
    };
    let reflectance = ["r", "g", "b"].map(|c| row.number(&format!("reflectance_8_{c}")));
    let swatch = match reflectance {
        [Some(r), Some(g), Some(b)] => {
            let [r, g, b] = [r, g, b].map(|value| srgb8(value as f32));
            format!("rgb({r} {g} {b})")
        }
        _ => String::new(),
    };
    let report = relative(&job.session.join(REPORT_FILE), folder);
    context! {
        job => job.number,
        sample => row.text("sample"),
        session => row.text("session"),
        report => if row.text("status") == "done" { address(&report) } else { String::new() },
        key, sign, words, swatch,
        chi_square => number("worst_chi_square", 2),
        reflectance => reflectance.map(|r| r.map_or(String::new(), |r| format!("{r:.3}"))),
        constrained => row.number("constrained_share").map_or(String::new(), |s| format!("{:.0}%", 100.0 * s)),
        error => row.number("environment_error").map_or(String::new(), |e| format!("{:.1}%", 100.0 * e)),
        options => row.text("options"),
        warnings => row.number("warnings").unwrap_or_default() as u64,
        reason => row.text("reason"),
    }
}

/// A path as seen from a folder; both are absolute.
fn relative(path: &Path, folder: &Path) -> PathBuf {
    let shared = path
        .components()
        .zip(folder.components())
        .take_while(|(a, b)| a == b)
        .count();
    let up = folder
        .components()
        .skip(shared)
        .map(|_| Component::ParentDir);
    up.chain(path.components().skip(shared)).collect()
}

/// A relative path as a page's link, per RFC 3986.
fn address(path: &Path) -> String {
    let mut address = String::new();
    for &byte in path.as_os_str().as_encoded_bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte) {
            address.push(char::from(byte));
        } else {
            address += &format!("%{byte:02X}");
        }
    }
    address
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_are_linked_from_where_the_page_lies() {
        for (path, folder, expected) in [
            ("/a/s/x/report.html", "/a/batch", "../s/x/report.html"),
            ("/a/batch/s/report.html", "/a/batch", "s/report.html"),
            ("/a/ü b/report.html", "/c", "../a/%C3%BC%20b/report.html"),
        ] {
            let found = address(&relative(Path::new(path), Path::new(folder)));
            assert_eq!(found, expected);
        }
    }
}
