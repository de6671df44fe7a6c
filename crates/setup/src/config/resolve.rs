//! Which rig a command works on.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::{ConfigError, RigConfig};
use crate::outside_file::ends_in;

/// Rig files of the folder `rig-configs`, by name.
macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        &[$((
            $name,
            include_str!(concat!("../../../../rig-configs/", $name, ".toml")),
        )),*]
    };
}

/// The rig files that are built into the program, by name.
pub const BUILT_IN: &[(&str, &str)] = shipped![
    "simulated",
    "grbl-arm-v4l2",
    "dmx-dome-v4l2",
    "zaber-gantry-v4l2",
    "simulated-5mp-bayer",
    "simulated-tilted",
    "simulated-ball",
    "grbl-arm-tilted",
];

/// Simulated benches on which calibrations and the bench of a torch are rehearsed, built into the
/// program as well (docs/calibration.md, docs/tutorial-torch.md).
const REHEARSALS: &[(&str, &str)] = shipped![
    "rehearsal-flat",
    "rehearsal-ball",
    "rehearsal-board",
    "rehearsal-corner",
    "rehearsal-edge",
    "rehearsal-tile",
    "rehearsal-torch",
];

/// The bench of which all rehearsals of calibrations are.
pub const REHEARSAL: &str = "rehearsal";

/// Whether a rehearsal has this name.
pub fn is_rehearsal(name: &str) -> bool {
    REHEARSALS.iter().any(|(known, _)| *known == name)
}

/// The folder that is searched for rigs by name.
const FOLDER: &str = "rig-configs";

/// A rig, and why it is this one.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedRig {
    /// The rig.
    pub config: RigConfig,
    /// Why this one.
    pub origin: Origin,
    /// Where its text came from, as errors call it.
    pub file: String,
    /// The folder of the file; `None` if it is built in.
    pub folder: Option<PathBuf>,
}

/// The rig file of the working folder, which needs no naming.
pub const RIG_FILE: &str = "rig.toml";

/// Why a rig was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// `--rig` named it.
    Argument,
    /// The environment variable RIG_CONFIG named it.
    Environment,
    /// It is ./rig.toml.
    WorkingFolder,
    /// Nobody named one: the simulated rig stands in.
    Fallback,
}

/// Where to look, besides the request.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// The value of RIG_CONFIG; empty counts as absent.
    pub environment: Option<OsString>,
    /// The folder that `rig.toml` and `rig-configs/` are looked for in.
    pub folder: PathBuf,
}

impl Surroundings {
    /// The process's own.
    pub fn of_process() -> Self {
        Self {
            environment: std::env::var_os("RIG_CONFIG"),
            folder: PathBuf::new(),
        }
    }
}

/// The rig that was requested; else RIG_CONFIG's; else `./rig.toml`; else the
/// simulated one, unless `real_devices` finds any.
///
/// `asked` is a file (it has a `/` or ends in `.toml`) or a name in
/// `rig-configs/` or among the built-in ones. A rig that was named and fails is
/// an error, never a reason to take another.
pub fn resolve_rig(
    asked: Option<&str>,
    surroundings: &Surroundings,
    real_devices: impl FnOnce() -> Vec<String>,
) -> Result<ResolvedRig, ConfigError> {
    let environment = surroundings.environment.as_ref();
    let environment = environment.map(|value| value.to_string_lossy());
    let environment = environment.filter(|value| !value.is_empty());
    let folder = &surroundings.folder;
    if let Some(asked) = asked {
        return named(asked, folder, Origin::Argument);
    }
    if let Some(named_there) = environment {
        return named(&named_there, folder, Origin::Environment);
    }
    let local = folder.join(RIG_FILE);
    if local.exists() {
        return from_file(&local, Origin::WorkingFolder);
    }
    let devices = real_devices();
    if !devices.is_empty() {
        return Err(ConfigError::FallbackRefused { devices });
    }
    built_in("simulated", Origin::Fallback).unwrap_or_else(|| {
        Err(ConfigError::UnknownRig {
            name: "simulated".into(),
            known: known(folder),
        })
    })
}

fn named(asked: &str, folder: &Path, origin: Origin) -> Result<ResolvedRig, ConfigError> {
    if asked.contains('/') || ends_in(Path::new(asked), "toml") {
        return from_file(&folder.join(asked), origin);
    }
    let local = folder.join(FOLDER).join(format!("{asked}.toml"));
    if local.exists() {
        return from_file(&local, origin);
    }
    built_in(asked, origin).unwrap_or_else(|| {
        Err(ConfigError::UnknownRig {
            name: asked.to_owned(),
            known: known(folder),
        })
    })
}

fn from_file(path: &Path, origin: Origin) -> Result<ResolvedRig, ConfigError> {
    Ok(ResolvedRig {
        config: RigConfig::load(path)?,
        origin,
        file: path.display().to_string(),
        folder: path.parent().map(Path::to_owned),
    })
}

fn built_in(name: &str, origin: Origin) -> Option<Result<ResolvedRig, ConfigError>> {
    let mut all = BUILT_IN.iter().chain(REHEARSALS);
    let (_, text) = all.find(|(known, _)| *known == name)?;
    let file = format!("built-in {name}.toml");
    Some(
        RigConfig::parse(&file, Path::new(""), text).map(|config| ResolvedRig {
            config,
            origin,
            file,
            folder: None,
        }),
    )
}

/// Names of all rigs that `--rig NAME` would find.
fn known(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = BUILT_IN
        .iter()
        .chain(REHEARSALS)
        .map(|(name, _)| (*name).to_owned())
        .collect();
    let entries = std::fs::read_dir(folder.join(FOLDER)).into_iter().flatten();
    for path in entries.flatten().map(|entry| entry.path()) {
        if path
            .extension()
            .is_some_and(|extension| extension == "toml")
            && let Some(name) = path.file_stem()
        {
            names.push(name.to_string_lossy().into_owned());
        }
    }
    names.sort();
    names.dedup();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    fn simulated_named(name: &str) -> String {
        let text = BUILT_IN[0].1;
        text.replacen("name = \"simulated\"", &format!("name = \"{name}\""), 1)
    }

    /// Each layer wins over those below it, and only with none of them the
    /// simulated rig stands in.
    #[test]
    fn layers() {
        let folder = tempfile::tempdir().unwrap();
        let write = |path: &str, name: &str| {
            let path = folder.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, simulated_named(name)).unwrap();
        };
        let resolve = |asked: Option<&str>, environment: Option<&str>, devices: &[&str]| {
            let surroundings = Surroundings {
                environment: environment.map(OsString::from),
                folder: folder.path().to_owned(),
            };
            let devices: Vec<_> = devices.iter().map(|device| (*device).to_owned()).collect();
            resolve_rig(asked, &surroundings, || devices)
        };
        let fallback = resolve(None, None, &[]).unwrap();
        assert_eq!(fallback.origin, Origin::Fallback);
        assert!(fallback.config.is_simulated());
        assert!(matches!(
            resolve(None, Some(""), &["/dev/ttyUSB0"]),
            Err(ConfigError::FallbackRefused { devices }) if devices == ["/dev/ttyUSB0"]
        ));
        assert!(resolve(Some("simulated"), None, &["/dev/ttyUSB0"]).is_ok());

        write("rig.toml", "here");
        write("elsewhere.toml", "elsewhere");
        write("rig-configs/arm.toml", "arm");
        let name = |asked, environment| {
            resolve(asked, environment, &["/dev/ttyUSB0"])
                .unwrap()
                .config
                .name
        };
        assert_eq!(name(None, None), "here");
        assert_eq!(name(None, Some("elsewhere.toml")), "elsewhere");
        assert_eq!(name(Some("arm"), Some("elsewhere.toml")), "arm");
        assert!(matches!(
            resolve(Some("amr"), None, &[]),
            Err(ConfigError::UnknownRig { known, .. }) if known == ["arm", "dmx-dome-v4l2", "grbl-arm-tilted", "grbl-arm-v4l2", "rehearsal-ball", "rehearsal-board", "rehearsal-corner", "rehearsal-edge", "rehearsal-flat", "rehearsal-tile", "rehearsal-torch", "simulated", "simulated-5mp-bayer", "simulated-ball", "simulated-tilted", "zaber-gantry-v4l2"]
        ));
        std::fs::write(folder.path().join("rig.toml"), "broken").unwrap();
        assert!(matches!(
            resolve(None, None, &[]),
            Err(ConfigError::Syntax { .. })
        ));
        assert!(matches!(
            resolve(Some("none.toml"), None, &[]),
            Err(ConfigError::Read { .. })
        ));
    }

    #[test]
    fn built_in_rigs_are_valid() {
        for (name, text) in BUILT_IN.iter().chain(REHEARSALS) {
            RigConfig::parse(name, Path::new(""), text).unwrap_or_else(|error| panic!("{error}"));
        }
    }
}
