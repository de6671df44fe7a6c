//! Cameras and serial ports that are connected, as choices.

use std::path::Path;

use super::question::Choice;
use crate::config::camera::V4L;
use crate::device::DeviceError;
use crate::device::described::{Driver, FoundCamera};
use crate::device::described_drivers::DRIVERS;
use crate::device::discovery::{DeviceKind, FoundDevice, find_devices};

/// What a camera for practice alone is marked by.
pub(super) const NO_MEASUREMENT: &str = "8 bits, not for measurement";

/// What is connected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Cameras.
    pub cameras: Vec<FoundChoice>,
    /// Serial ports.
    pub ports: Vec<Choice>,
}

/// A camera that is connected.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundChoice {
    /// `driver address`, and what a person reads.
    pub choice: Choice,
    /// Its serial number; empty where none shows before it is opened.
    pub serial: String,
}

impl Found {
    /// Looks for devices below `/` and by every driver, without opening any. Drivers whose
    /// cameras cannot be listed are given with the reason.
    pub fn look() -> (Self, Vec<(&'static str, DeviceError)>) {
        let mut found = Self::of_nodes(find_devices(Path::new("/")));
        let mut failed = Vec::new();
        for driver in DRIVERS {
            match (driver.find)() {
                Ok(cameras) => {
                    let listed = cameras.into_iter().map(|camera| listed(driver, camera));
                    found.cameras.extend(listed);
                }
                Err(error) => failed.push((driver.name, error)),
            }
        }
        (found, failed)
    }

    fn of_nodes(nodes: Vec<FoundDevice>) -> Self {
        let mut found = Self::default();
        for node in nodes {
            let path = node.path.display().to_string();
            let problem = match (&node.problem, &node.in_use_by) {
                (Some(problem), _) => format!(" (cannot be opened: {problem})"),
                (None, Some(holder)) => format!(" (in use by {holder})"),
                (None, None) => String::new(),
            };
            let model = match node.model.as_str() {
                "" => String::new(),
                model => format!("{model}, "),
            };
            match node.kind {
                DeviceKind::Camera if node.first_node.is_none() => {
                    found.cameras.push(FoundChoice {
                        choice: Choice {
                            value: format!("{} {path}", V4L.name),
                            label: format!("{model}Video4Linux, {path}{problem}"),
                        },
                        serial: node.serial,
                    })
                }
                DeviceKind::Camera => {}
                DeviceKind::Serial => found.ports.push(Choice {
                    label: format!("{model}{path}{problem}"),
                    value: path,
                }),
            }
        }
        found
    }

    /// Serial number of a camera that is connected and shows one.
    pub fn serial_of(&self, camera: &str) -> Option<&str> {
        let found = self
            .cameras
            .iter()
            .find(|found| found.choice.value == camera);
        found
            .map(|found| found.serial.as_str())
            .filter(|serial| !serial.is_empty())
    }
}

fn listed(driver: &Driver, camera: FoundCamera) -> FoundChoice {
    let FoundCamera {
        address,
        model,
        serial,
        problem,
    } = camera;
    let problem = problem.map_or(String::new(), |problem| {
        format!(" (cannot be opened: {problem})")
    });
    let name = driver.name;
    let label = format!("{model}, {name}, {address}");
    FoundChoice {
        choice: Choice {
            label: marked(&label, driver.only_practice) + &problem,
            value: format!("{name} {address}"),
        },
        serial,
    }
}

/// How a camera is offered.
pub(super) fn marked(offer: &str, only_practice: bool) -> String {
    match only_practice {
        true => format!("{offer}: for practice, {NO_MEASUREMENT}"),
        false => offer.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(kind: DeviceKind, path: &str, first_node: Option<&str>) -> FoundDevice {
        FoundDevice {
            kind,
            path: path.into(),
            node: path.into(),
            model: "Mono".to_owned(),
            serial: "C4711".to_owned(),
            first_node: first_node.map(Into::into),
            usb: true,
            accessible: true,
            problem: None,
            reserved_for: None,
            in_use_by: None,
        }
    }

    #[test]
    fn a_further_node_of_a_camera_is_no_choice() {
        let found = Found::of_nodes(vec![
            node(DeviceKind::Camera, "/dev/video0", None),
            node(DeviceKind::Camera, "/dev/video1", Some("/dev/video0")),
            node(DeviceKind::Serial, "/dev/ttyACM0", None),
        ]);
        let [camera] = found.cameras.as_slice() else {
            panic!("{found:?}");
        };
        assert_eq!(camera.choice.value, "v4l /dev/video0");
        assert_eq!(found.serial_of("v4l /dev/video0"), Some("C4711"));
        assert_eq!(found.serial_of("v4l /dev/video1"), None);
        assert_eq!(found.ports[0].value, "/dev/ttyACM0");
    }
}
