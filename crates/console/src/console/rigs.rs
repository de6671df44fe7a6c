//! The rig files of the console's folder: which there are, their text, and which one the console
//! works with.
//!
//! What a page writes into one names no program, and no file or folder outside the folder, that
//! the file did not name before.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Json;
use axum::Router;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::routing::{get, post};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::blocking::blocking;
use super::control::Controlled;
use super::jobs::Jobs;
use super::refusal::{Accepted, Refusal, accepted};
use super::request::Asked;
use crate::beneath;
use crate::checksum::sha256_hex;
use crate::config::{REHEARSAL, ResolvedRig, RigConfig, Surroundings, is_rehearsal, resolve_rig};
use crate::units::StageAngles;
use rig_core::{outside_file, whole_file};

/// A rig file is at most so long (bytes); what a page sends is.
const LONGEST: u64 = 60 << 10;
/// So many rig files are listed.
const MOST: usize = 100;
/// The simulated benches that are built in: names, and as `--rig` takes them. That of the
/// rehearsals begins before an even light.
const SIMULATED: [[&str; 2]; 2] = [["simulated", "simulated"], [REHEARSAL, "rehearsal-flat"]];

/// Called with the bench that the console is to work with from now on, and its name as `--rig`
/// takes it. Returns at once.
pub type Choose = Arc<dyn Fn(String, ResolvedRig) + Send + Sync>;

/// What the addresses of rig files need.
#[derive(Clone)]
pub struct Rigs {
    folder: PathBuf,
    named: String,
    rig: ResolvedRig,
    jobs: Jobs,
    choose: Choose,
}

/// A bench that the console may work with.
#[derive(Debug, Serialize)]
struct Entry {
    /// As `--rig` takes it.
    rig: String,
    name: Option<String>,
    error: Option<String>,
    in_use: bool,
    /// Its file differs from what the console read.
    changed: bool,
    can_edit: bool,
}

impl Rigs {
    /// Of a console in `folder` that works with `rig`, `named` as `--rig` takes it.
    pub fn new(folder: &Path, named: &str, rig: &ResolvedRig, jobs: Jobs, choose: Choose) -> Self {
        Self {
            folder: folder.to_owned(),
            named: named.to_owned(),
            rig: rig.clone(),
            jobs,
            choose,
        }
    }

    /// The benches: the simulated one, those with a file in the folder, and the one in use.
    fn list(&self) -> Vec<Entry> {
        let files = std::fs::read_dir(&self.folder).into_iter().flatten();
        let files = files.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut files: Vec<_> = files.filter(|file| is_rig_file(file)).take(MOST).collect();
        files.sort();
        let mut all: Vec<_> = SIMULATED
            .map(|[name, rig]| self.simulated(name, rig))
            .into();
        all.extend(files.into_iter().filter_map(|file| self.entry(file)));
        if all.iter().all(|entry| !entry.in_use) {
            let text = outside_file::read_text(Path::new(&self.rig.file), LONGEST);
            all.push(Entry {
                rig: self.named.clone(),
                name: Some(self.rig.config.name.clone()),
                error: None,
                in_use: true,
                changed: text.is_ok_and(|text| text != self.rig.config.text),
                can_edit: false,
            });
        }
        all
    }

    /// One that is built in.
    fn simulated(&self, name: &str, rig: &str) -> Entry {
        // A rehearsal of the same bench may be in use.
        let in_use = self.named == rig
            || is_rehearsal(&self.named) && is_rehearsal(rig) && self.rig.config.name == name;
        Entry {
            rig: if in_use { &self.named } else { rig }.to_owned(),
            name: Some(name.to_owned()),
            error: None,
            in_use,
            changed: false,
            can_edit: false,
        }
    }

    /// What is known of a file; `None` if it is no rig file.
    fn entry(&self, file: String) -> Option<Entry> {
        let text = self.text(&file).ok()?;
        let in_use = plain(&self.named) == file;
        let (name, error) = match RigConfig::parse(&file, &self.folder, &text) {
            Ok(rig) => (Some(rig.name), None),
            Err(_) if !in_use && !text.lines().any(|line| line.trim() == "[stage]") => return None,
            Err(error) => (None, Some(error.to_string())),
        };
        Some(Entry {
            changed: in_use && text != self.rig.config.text,
            rig: file,
            name,
            error,
            in_use,
            can_edit: true,
        })
    }

    /// The text of a rig file in the folder.
    fn text(&self, file: &str) -> Result<String, Refusal> {
        if !is_rig_file(file) {
            return Err(Refusal::missing("there is no such rig file"));
        }
        let refused = |error: beneath::BeneathError| match error.is_missing() {
            true => Refusal::missing("there is no such rig file"),
            false => Refusal::conflict(error.to_string()),
        };
        let bytes = beneath::read(&self.folder, file, LONGEST).map_err(refused)?;
        String::from_utf8(bytes).map_err(|_| Refusal::conflict(format!("{file} is not UTF-8")))
    }

    /// A rig file as a page edits it.
    fn opened(&self, file: &str) -> Result<Value, Refusal> {
        let text = self.text(file)?;
        let parsed = RigConfig::parse(file, &self.folder, &text);
        let camera = parsed.as_ref().ok().and_then(camera_direction);
        Ok(json!({
            "rig": file,
            "sum": sha256_hex(text.as_bytes()),
            "error": parsed.err().map(|error| error.to_string()),
            "camera_direction": camera,
            "text": text,
        }))
    }

    /// Writes the text in place of what `sum` is of; that stays next to it as `FILE.before`.
    fn save(&self, form: &Edited) -> Result<Value, Refusal> {
        let Edited {
            rig: file,
            text,
            sum,
        } = form;
        let before = self.text(file)?;
        if sha256_hex(before.as_bytes()) != *sum {
            let hint = "open it again; what you typed is still on this page".to_owned();
            let fact = format!("{file} was changed by somebody else meanwhile");
            return Err(Refusal::conflict(fact).hint(hint));
        }
        let unfit = |fact: String| Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, fact);
        RigConfig::parse(file, &self.folder, text).map_err(|error| unfit(error.to_string()))?;
        if let Some(key) = led_elsewhere(&before, text, &self.folder) {
            let fact = format!(
                "{key}: a page may not name another program, nor a file or folder outside the console's folder"
            );
            let hint = "change this key in an editor at this computer".to_owned();
            return Err(unfit(fact).hint(hint));
        }
        let path = self.folder.join(file);
        let write = |path: &Path, text: &str| {
            whole_file::replace(path, |out| out.write_all(text.as_bytes()))
                .map_err(|error| Refusal::failed(format!("{}: {error}", path.display())))
        };
        write(&path.with_extension("toml.before"), &before)?;
        write(&path, text)?;
        self.opened(file)
    }

    /// The bench that the console is to work with.
    fn chosen(&self, named: &str) -> Result<ResolvedRig, Refusal> {
        let known = self.list();
        if !is_rehearsal(named) && !known.iter().any(|entry| entry.rig == named) {
            return Err(Refusal::missing("there is no such bench"));
        }
        if let Some(kind) = self.jobs.running() {
            return Err(Refusal::conflict(format!("{} is running", kind.what())));
        }
        let surroundings = Surroundings::of_process();
        resolve_rig(Some(named), &surroundings, Vec::new)
            .map_err(|error| Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string()))
    }
}

/// Without the `./` that may stand before it.
fn plain(named: &str) -> &str {
    named.strip_prefix("./").unwrap_or(named)
}

/// Whether this names a file of the folder that may be a rig file.
fn is_rig_file(file: &str) -> bool {
    file.ends_with(".toml") && !file.starts_with('.') && !file.contains(['/', '\\'])
}

fn camera_direction(rig: &RigConfig) -> Option<StageAngles> {
    let to_camera = rig.geometry.coaxial();
    (to_camera != DVec3::ZERO).then(|| StageAngles::from_direction(to_camera))
}

/// The first key by which `text` names a program that `before` did not name, or a file or folder
/// that is not below `folder`.
fn led_elsewhere(before: &str, text: &str, folder: &Path) -> Option<String> {
    let before = before.parse::<toml::Table>().unwrap_or_default();
    let after = text.parse::<toml::Table>().ok()?;
    let (before, after) = (toml::Value::Table(before), toml::Value::Table(after));
    let mut found = None;
    each_text(&after, "", &mut |key, value| {
        let leads = leads_elsewhere(key, value, folder) && at(&before, key) != Some(value);
        if leads && found.is_none() {
            found = Some(key.to_owned());
        }
    });
    found
}

/// Keys whose texts may have a slash: a device's name or setting, and words about the laboratory.
const NO_PATHS: &[&str] = &["device", "port", "body", "format", "controls"];

fn leads_elsewhere(key: &str, value: &str, folder: &Path) -> bool {
    let last = key.rsplit('.').next().unwrap_or(key);
    if last == "command" {
        return true;
    }
    if NO_PATHS.contains(&last) || key.starts_with("lab.") {
        return false;
    }
    let is_there = folder.join(value).symlink_metadata().is_ok();
    let is_below =
        || beneath::open(folder, value).is_ok() || beneath::check_folder(folder, value).is_ok();
    (is_there || value.contains(['/', '\\'])) && !is_below()
}

/// Calls `f` with each text of a document and its key (`stage.lamp.0.on`).
fn each_text(value: &toml::Value, key: &str, f: &mut dyn FnMut(&str, &str)) {
    let below = |part: &str| match key {
        "" => part.to_owned(),
        key => format!("{key}.{part}"),
    };
    match value {
        toml::Value::String(text) => f(key, text),
        toml::Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                each_text(item, &below(&i.to_string()), f);
            }
        }
        toml::Value::Table(table) => {
            for (part, item) in table {
                each_text(item, &below(part), f);
            }
        }
        _ => {}
    }
}

/// The text of this key.
fn at<'a>(value: &'a toml::Value, key: &str) -> Option<&'a str> {
    let mut found = value;
    for part in key.split('.') {
        found = match found {
            toml::Value::Array(items) => items.get(part.parse::<usize>().ok()?)?,
            other => other.get(part)?,
        };
    }
    found.as_str()
}

/// The addresses of rig files.
pub fn routes(rigs: Rigs) -> Router {
    Router::new()
        .route("/api/rigs", get(list))
        .route("/api/rigs/text", get(open))
        .route("/api/rigs/save", post(save))
        .route("/api/rigs/use", post(choose))
        .with_state(rigs)
}

type Shown = Result<Json<Value>, Refusal>;

async fn list(State(rigs): State<Rigs>) -> Shown {
    let all = blocking(move || rigs.list()).await?;
    Ok(Json(json!({"rigs": all})))
}

#[derive(Deserialize)]
struct Named {
    rig: String,
}

async fn open(State(rigs): State<Rigs>, Query(which): Query<Named>) -> Shown {
    Ok(Json(blocking(move || rigs.opened(&which.rig)).await??))
}

#[derive(Deserialize)]
struct Edited {
    rig: String,
    text: String,
    /// SHA-256 of the text that was opened.
    sum: String,
}

async fn save(State(rigs): State<Rigs>, _: Controlled, Asked(form): Asked<Edited>) -> Shown {
    Ok(Json(blocking(move || rigs.save(&form)).await??))
}

async fn choose(State(rigs): State<Rigs>, _: Controlled, Asked(form): Asked<Named>) -> Accepted {
    let (own, named) = (rigs.clone(), form.rig.clone());
    let rig = blocking(move || own.chosen(&named)).await??;
    (rigs.choose)(form.rig, rig);
    accepted(json!({}))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a page may change in a rig file, and what not.
    #[test]
    fn an_edit_leads_nowhere_else() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("own.ply"), "").unwrap();
        std::fs::create_dir(folder.path().join("frames")).unwrap();
        std::os::unix::fs::symlink("/tmp", folder.path().join("linked")).unwrap();
        let before =
            "[camera]\ncommand = \"./photo.sh\"\nfolder = \"/old\"\n[[stage.lamp]]\non = \"M7\"\n";
        let key = |more: &str| led_elsewhere(before, &format!("{more}\n"), folder.path());
        for good in [
            before,
            "camera.command = \"./photo.sh\"",
            "camera.folder = \"frames\"",
            "geometry.sample.mesh = \"own.ply\"",
            "camera.device = \"/dev/video0\"\nstage.port = \"/dev/ttyUSB0\"",
            "lab.contact = \"https://example.org/x\"",
            "[[stage.lamp]]\non = \"M3 S1000\"",
            "camera.body = \"f-number = f/8\"",
        ] {
            assert_eq!(key(good), None, "{good}");
        }
        for (bad, named) in [
            ("camera.command = \"touch pwned\"", "camera.command"),
            ("camera.folder = \"/tmp\"", "camera.folder"),
            ("camera.folder = \"linked\"", "camera.folder"),
            ("calibration.folder = \"..\"", "calibration.folder"),
            (
                "geometry.sample.mesh = \"/etc/passwd\"",
                "geometry.sample.mesh",
            ),
            (
                "geometry.sample.mesh = \"frames/none.ply\"",
                "geometry.sample.mesh",
            ),
            ("a = [{ table = \"../x.csv\" }]", "a.0.table"),
        ] {
            assert_eq!(key(bad).as_deref(), Some(named), "{bad}");
        }
    }
}
