//! `rig devices`: what is connected, and whether it may be used.

use std::path::Path;

use super::context::Context;
use super::error::CliError;
use super::hints;
use super::output::write_json;
use crate::device::described::{Driver, FoundCamera};
use crate::device::described_drivers::DRIVERS;
use crate::device::discovery::{DeviceKind, FoundDevice, ReservedFor, find_devices};
use crate::out;

/// Lists cameras and serial ports, also those without permission, and why
///
/// Nothing is opened, because opening a port resets many controllers. Cameras on a network and
/// still cameras are listed by the drivers that are installed.
#[derive(clap::Args, Debug)]
pub struct DevicesArgs {
    /// The list as JSON
    #[arg(long)]
    json: bool,
}

/// `rig devices`.
pub fn run(args: &DevicesArgs, context: &Context) -> Result<(), CliError> {
    let nodes = find_devices(Path::new("/"))
        .into_iter()
        .map(|device| Listed::Node(ListedNode::from(device)));
    let mut listed: Vec<Listed> = nodes.collect();
    for driver in DRIVERS {
        match (driver.find)() {
            Ok(found) => listed.extend(
                found
                    .into_iter()
                    .map(|camera| Listed::Camera(ListedCamera::new(driver, camera))),
            ),
            Err(error) => context.warn(format!(
                "cameras of the driver {} could not be listed: {error}",
                driver.name
            )),
        }
    }
    if args.json {
        return write_json(&listed);
    }
    if listed.is_empty() {
        context.note("no camera and no USB serial port is connected");
    }
    listed.iter().try_for_each(|listed| match listed {
        Listed::Node(node) => print_node(node),
        Listed::Camera(camera) => print_camera(camera),
    })
}

/// A line of the list.
#[derive(serde::Serialize)]
#[serde(untagged)]
enum Listed {
    Node(ListedNode),
    Camera(ListedCamera),
}

/// A camera that has no device file of its own, as its driver lists it.
#[derive(serde::Serialize)]
struct ListedCamera {
    kind: DeviceKind,
    driver: &'static str,
    /// Value of the driver's key in a rig file.
    address: String,
    model: String,
    serial: String,
    #[serde(skip)]
    key: &'static str,
    accessible: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<String>,
}

impl ListedCamera {
    fn new(driver: &Driver, camera: FoundCamera) -> Self {
        let problem = camera.problem.as_ref();
        Self {
            kind: DeviceKind::Camera,
            driver: driver.name,
            key: driver.key,
            accessible: problem.is_none(),
            remedy: problem.and_then(|problem| hints::for_error(problem)),
            problem: problem.map(ToString::to_string),
            address: camera.address,
            model: camera.model,
            serial: camera.serial,
        }
    }
}

fn print_camera(camera: &ListedCamera) -> Result<(), CliError> {
    let mut line = format!("camera  {}  {}", camera.driver, camera.model);
    if !camera.serial.is_empty() {
        line += &format!("  serial number {}", camera.serial);
    }
    out!("{line}")?;
    let ListedCamera {
        driver,
        key,
        address,
        ..
    } = camera;
    out!("        driver = \"{driver}\", {key} = \"{address}\"")?;
    if let Some(problem) = &camera.problem {
        out!("        cannot be opened: {problem}")?;
    }
    match &camera.remedy {
        Some(remedy) => out!("        -> {remedy}"),
        None => Ok(()),
    }
}

/// A device, and what to do where it cannot be used.
#[derive(serde::Serialize)]
struct ListedNode {
    #[serde(flatten)]
    device: FoundDevice,
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<String>,
}

impl From<FoundDevice> for ListedNode {
    fn from(device: FoundDevice) -> Self {
        Self {
            remedy: remedy(&device),
            device,
        }
    }
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

fn print_node(listed: &ListedNode) -> Result<(), CliError> {
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
        let json = serde_json::to_value(ListedNode::from(busy)).unwrap();
        assert_eq!(json["in_use_by"]["name"], "cheese");
        assert_eq!(json["remedy"], "end process 77 first");
    }
}
