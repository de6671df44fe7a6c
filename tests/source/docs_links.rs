//! Every link, anchor and picture of the documents exists; every page of the site is in its
//! table of contents; documents that the source names exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Folders of what is built, captured or installed.
const NOT_OURS: [&str; 3] = ["node_modules", "sessions", "target"];

/// Files below `folder` whose names end in one of `endings`, without built or unpacked ones.
fn files(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && !name.starts_with('.') && !NOT_OURS.contains(&name.as_str()) {
            files(&path, endings, found);
        } else if path.is_file() && endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
}

/// The text without fenced and inline code.
fn prose(text: &str) -> String {
    let mut fenced = false;
    let mut out = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            let outside = line.split('`').step_by(2);
            out += &outside.collect::<Vec<_>>().join("`");
            out.push('\n');
        }
    }
    out
}

/// The anchors of a page's headings, as GitHub and mdBook make them.
fn anchors(page: &Path) -> BTreeSet<String> {
    let kept = |c: char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
    let text = fs::read_to_string(page).unwrap();
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let mut found = BTreeSet::new();
    for heading in headings {
        let name = heading.trim_start_matches('#').trim().to_lowercase();
        found.insert(name.replace(|c| !kept(c), "").replace(' ', "-"));
    }
    found
}

#[test]
fn links_lead_somewhere_and_pages_are_listed() {
    let docs = root().join("docs").canonicalize().unwrap();
    let (mut pages, mut wrong) = (Vec::new(), Vec::new());
    files(docs.parent().unwrap(), &[".md"], &mut pages);
    let contents = fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
    for page in &pages {
        let text = fs::read_to_string(page).unwrap();
        let shown = page.strip_prefix(docs.parent().unwrap()).unwrap().display();
        let in_site = page.strip_prefix(&docs);
        if let Ok(name) = in_site
            && !name.ends_with("SUMMARY.md")
            && !contents.contains(&format!("]({})", name.display()))
        {
            wrong.push(format!("{shown} is not in docs/SUMMARY.md"));
        }
        for rest in prose(&text).split("](").skip(1) {
            let link = rest.split(')').next().unwrap();
            if link.contains("://") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() {
                page.clone()
            } else {
                page.with_file_name(file)
            };
            let Ok(target) = target.canonicalize() else {
                wrong.push(format!("{shown}: {link} does not exist"));
                continue;
            };
            if in_site.is_ok() && !target.starts_with(&docs) {
                wrong.push(format!("{shown}: {link} is not in the site"));
            } else if !anchor.is_empty() && !anchors(&target).contains(anchor) {
                wrong.push(format!("{shown}: {link} has no such heading"));
            }
        }
    }
    assert!(pages.len() > 50 && wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn documents_that_the_source_names_exist() {
    let (mut sources, mut records, mut wrong) = (Vec::new(), Vec::new(), Vec::new());
    files(root(), &[".rs", ".toml", ".json", ".py"], &mut sources);
    files(&root().join("docs/adr"), &[".md"], &mut records);
    for source in &sources {
        let text = String::from_utf8_lossy(&fs::read(source).unwrap()).into_owned();
        for rest in text.split("docs/").skip(1) {
            let named = |c: char| !(c.is_ascii_alphanumeric() || "/_-.".contains(c));
            let name = rest.split(named).next().unwrap().trim_end_matches('.');
            let name = format!("docs/{name}");
            let record = |r: &PathBuf| r.to_string_lossy().contains(&format!("{name}-"));
            if !root().join(&name).exists() && !records.iter().any(record) {
                wrong.push(format!("{}: {name}", source.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Each `file.rs` `item` of the page on the statistical model, an item of that file.
#[test]
fn items_that_the_model_names_exist() {
    let text = fs::read_to_string(root().join("docs/model.md")).unwrap();
    let (mut found, mut wrong) = (0, Vec::new());
    let code: Vec<&str> = text.split('`').collect();
    for pair in code.windows(3).skip(1).step_by(2) {
        let [file, between, item] = pair else {
            continue;
        };
        if !file.ends_with(".rs") || !between.trim().is_empty() {
            continue;
        }
        found += 1;
        let in_folder = |folder: &str| fs::read_to_string(root().join(folder).join(file));
        let source = in_folder("core/src/inverse").or_else(|_| in_folder("core/src"));
        let source = source.unwrap_or_default();
        let defined = ["fn", "struct", "enum", "const"].iter().any(|kind| {
            let start = format!("{kind} {item}");
            source.match_indices(&start).any(|(at, _)| {
                let next = source[at + start.len()..].chars().next();
                next.is_some_and(|c| !c.is_alphanumeric() && c != '_')
            })
        });
        if !defined {
            wrong.push(format!("{file}: {item}"));
        }
    }
    assert!(
        found > 30 && wrong.is_empty(),
        "{found}: {}",
        wrong.join("\n")
    );
}
