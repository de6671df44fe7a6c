//! `--rig`, for every command that works on a bench.

use std::path::Path;

use super::{CliError, Context};
use crate::config::{Origin, ResolvedRig, Surroundings, resolve_rig};

/// Which bench.
#[derive(clap::Args, Debug, Clone)]
pub struct RigArg {
    /// Rig file, or a name in rig-configs/ or built in; else RIG_CONFIG, else ./rig.toml,
    /// else the simulated rig
    #[arg(long, value_name = "RIG")]
    pub rig: Option<String>,
}

impl RigArg {
    /// The rig; says so on stderr when the simulated one stands in.
    pub fn resolve(&self, context: &Context) -> Result<ResolvedRig, CliError> {
        let rig = resolve_rig(self.rig.as_deref(), &Surroundings::of_process(), || {
            connected_devices(Path::new("/sys/class"))
        })?;
        if rig.origin == Origin::Fallback {
            context.note(
                "no rig is configured (--rig, RIG_CONFIG, ./rig.toml): using the simulated rig",
            );
        }
        Ok(rig)
    }
}

/// USB cameras and USB serial devices, as the system lists them below `class`
/// (`/sys/class`).
pub fn connected_devices(class: &Path) -> Vec<String> {
    let list = |kind: &str, prefixes: &[&str]| {
        let entries = std::fs::read_dir(class.join(kind)).into_iter().flatten();
        let mut names: Vec<_> = entries
            .flatten()
            .filter_map(|entry| {
                let name = entry.file_name().into_string().ok()?;
                let device = std::fs::canonicalize(entry.path().join("device")).ok()?;
                let on_usb = device
                    .components()
                    .any(|part| part.as_os_str().to_string_lossy().starts_with("usb"));
                let is_one = prefixes.iter().any(|prefix| name.starts_with(prefix));
                (on_usb && is_one).then(|| format!("/dev/{name}"))
            })
            .collect();
        names.sort();
        names
    };
    let mut devices = list("video4linux", &["video"]);
    devices.extend(list("tty", &["ttyUSB", "ttyACM"]));
    devices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_usb_cameras_and_usb_serial_ports_count() {
        let root = tempfile::tempdir().unwrap();
        let class = root.path().join("class");
        let add = |kind: &str, name: &str, device: &str| {
            let device = root.path().join("devices").join(device);
            let entry = class.join(kind).join(name);
            std::fs::create_dir_all(&device).unwrap();
            std::fs::create_dir_all(&entry).unwrap();
            std::os::unix::fs::symlink(device, entry.join("device")).unwrap();
        };
        assert!(connected_devices(&class).is_empty());
        add("video4linux", "video0", "pci0/usb1/1-1/1-1:1.0");
        add("video4linux", "video1", "platform/codec");
        add("tty", "ttyACM3", "pci0/usb1/1-2/1-2:1.0");
        add("tty", "ttyS0", "pnp0");
        assert_eq!(connected_devices(&class), ["/dev/video0", "/dev/ttyACM3"]);
    }
}
