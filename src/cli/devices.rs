//! `rig devices`: what is connected, and whether it may be used.

use std::path::Path;

use super::context::Context;
use super::error::CliError;
use super::output::write_json;
use crate::device::discovery::{DeviceKind, FoundDevice, ReservedFor, find_devices};
use crate::out;

/// Lists cameras and serial ports, also those without permission, and why
///
/// Nothing is opened: opening a port resets many controllers.
#[derive(clap::Args, Debug)]
pub struct DevicesArgs {
    /// The list as JSON
    #[arg(long)]
    json: bool,
}

/// `rig devices`.
pub fn run(args: &DevicesArgs, context: &Context) -> Result<(), CliError> {
    let found: Vec<Listed> = find_devices(Path::new("/"))
        .into_iter()
        .map(|device| Listed {
            remedy: remedy(&device),
            device,
        })
        .collect();
    if args.json {
        return write_json(&found);
    }
    if found.is_empty() {
        context.note("no camera and no USB serial port is connected");
    }
    found.iter().try_for_each(print)
}

/// A device, and what to do where it cannot be used.
#[derive(serde::Serialize)]
struct Listed {
    #[serde(flatten)]
    device: FoundDevice,
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<String>,
}

fn remedy(device: &FoundDevice) -> Option<String> {
    if let Some(holder) = &device.in_use_by {
        return Some(format!("end process {} first", holder.pid));
    }
    device.problem.as_ref()?;
    Some(match &device.reserved_for {
        Some(ReservedFor::Group(group)) => {
            format!("`sudo usermod -aG {group} $USER`, then log in again")
        }
        Some(ReservedFor::Owner) => {
            let (subsystem, group) = match device.kind {
                DeviceKind::Camera => ("video4linux", "video"),
                DeviceKind::Serial => ("tty", "dialout"),
            };
            format!(
                "a udev rule such as SUBSYSTEM==\"{subsystem}\", GROUP=\"{group}\", MODE=\"0660\" (docs/cameras.md)"
            )
        }
        None => "unplug it and plug it in again, then look at `dmesg`".to_owned(),
    })
}

fn print(listed: &Listed) -> Result<(), CliError> {
    let device = &listed.device;
    let kind = match device.kind {
        DeviceKind::Camera => "camera",
        DeviceKind::Serial => "serial",
    };
    let mut line = format!("{kind}  {}", device.path.display());
    if device.path != device.node {
        line += &format!(" -> {}", device.node.display());
    }
    if !device.model.is_empty() {
        line += &format!("  {}", device.model);
    }
    if !device.serial.is_empty() {
        line += &format!("  serial number {}", device.serial);
    }
    out!("{line}")?;
    if let Some(first) = &device.first_node {
        let first = first.display();
        out!("        a further node of the camera {first}, mostly without images")?;
    }
    if let Some(problem) = &device.problem {
        out!("        cannot be opened: {problem}")?;
    }
    if let Some(holder) = &device.in_use_by {
        out!("        in use by {holder}")?;
    }
    match &listed.remedy {
        Some(remedy) => out!("        -> {remedy}"),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::discovery::Holder;

    #[test]
    fn each_reason_has_its_remedy() {
        let device = |problem: Option<&str>, reserved_for, in_use_by| FoundDevice {
            kind: DeviceKind::Camera,
            path: "/dev/video0".into(),
            node: "/dev/video0".into(),
            model: String::new(),
            serial: String::new(),
            first_node: None,
            usb: true,
            accessible: problem.is_none(),
            problem: problem.map(str::to_owned),
            reserved_for,
            in_use_by,
        };
        let denied = Some("permission denied");
        let group = ReservedFor::Group("video".to_owned());
        let said = |device| remedy(&device).unwrap_or_default();
        assert_eq!(said(device(None, None, None)), "");
        assert!(said(device(denied, Some(group), None)).contains("usermod -aG video"));
        assert!(said(device(denied, Some(ReservedFor::Owner), None)).contains("video4linux"));
        assert!(said(device(denied, None, None)).contains("dmesg"));
        let holder = Holder {
            pid: 77,
            name: "cheese".to_owned(),
        };
        let busy = device(None, None, Some(holder));
        assert!(said(busy.clone()).contains("process 77"));
        let listed = Listed {
            remedy: remedy(&busy),
            device: busy,
        };
        let json = serde_json::to_value(listed).unwrap();
        assert_eq!(json["in_use_by"]["name"], "cheese");
        assert_eq!(json["remedy"], "end process 77 first");
    }
}
