//! Cameras that can be seen, without taking control of any.

use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use aravis::{GvInterface, InterfaceExt, UvInterface};
use rustix::fs::{Access, AtFlags, CWD, accessat};

use super::features::CONTROL_PRIVILEGE;
use crate::device::DeviceError;
use crate::device::described::FoundCamera;

/// UDP port of GigE Vision's control protocol.
const GVCP_PORT: u16 = 3956;
/// How long a camera may take to report who controls it.
const REPLY: Duration = Duration::from_millis(300);
/// Status of an answer: the memory may not even be read, because control is exclusive.
const ACCESS_DENIED: [u8; 2] = [0x80, 0x06];

/// Aravis' lists of interfaces and cameras are the process' own.
static LISTS: Mutex<()> = Mutex::new(());

pub(super) fn lists() -> MutexGuard<'static, ()> {
    LISTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A camera as Aravis lists it.
pub(super) struct Listed {
    /// By which Aravis opens it.
    pub id: String,
    /// Of the network; empty on USB.
    pub address: String,
    serial: String,
    model: String,
}

impl Listed {
    /// Whether this name, serial number or address means it.
    pub fn is_called(&self, name: &str) -> bool {
        [&self.id, &self.serial, &self.address]
            .into_iter()
            .any(|own| own == name)
    }
}

/// The cameras that the system shows and that answer on its networks.
pub fn find() -> Result<Vec<FoundCamera>, DeviceError> {
    let listed = {
        let _lists = lists();
        listed()
    };
    let seen = listed.into_iter().map(|camera| FoundCamera {
        problem: is_controlled(&camera.address).then(|| DeviceError::Controlled {
            device: camera.id.clone(),
        }),
        address: camera.id,
        model: camera.model,
        serial: camera.serial,
    });
    let denied = usb_cameras(Path::new("/"), &may_open).into_iter();
    let denied = denied.map(|camera| FoundCamera {
        problem: Some(DeviceError::PermissionDenied {
            device: camera.node.display().to_string(),
        }),
        address: camera.serial.clone(),
        model: camera.model,
        serial: camera.serial,
    });
    Ok(seen.chain(denied).collect())
}

/// As [`find`]; the caller has [`lists`].
pub(super) fn listed() -> Vec<Listed> {
    let mut found = Vec::new();
    let interfaces = [GvInterface::instance(), UvInterface::instance()];
    for interface in interfaces.into_iter().flatten() {
        interface.update_device_list();
        for index in 0..interface.n_devices() {
            let Some(id) = interface.device_id(index) else {
                continue;
            };
            let address = interface.device_address(index).unwrap_or_default();
            let is_network = address.parse::<Ipv4Addr>().is_ok();
            found.push(Listed {
                id: id.into(),
                address: if is_network {
                    address.into()
                } else {
                    String::new()
                },
                serial: interface
                    .device_serial_nbr(index)
                    .unwrap_or_default()
                    .into(),
                model: interface.device_model(index).unwrap_or_default().into(),
            });
        }
    }
    found
}

/// Whether a program controls the GigE Vision camera at this address, by one read of the
/// register that states it.
pub(super) fn is_controlled(address: &str) -> bool {
    let read = || -> std::io::Result<bool> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_read_timeout(Some(REPLY))?;
        let [high, low] = (CONTROL_PRIVILEGE as u16).to_be_bytes();
        // Read one register (0x0080) of four bytes, request 1, an answer is wanted.
        let request = [0x42, 1, 0, 0x80, 0, 4, 0, 1, 0, 0, high, low];
        socket.send_to(&request, (address, GVCP_PORT))?;
        let mut answer = [0; 64];
        let (count, _) = socket.recv_from(&mut answer)?;
        let is_read = count >= 12 && answer[..2] == [0, 0];
        Ok(answer[..2] == ACCESS_DENIED || is_read && answer[11] & 0b11 != 0)
    };
    address.parse::<Ipv4Addr>().is_ok() && read().unwrap_or(false)
}

/// A USB3 Vision camera that the system does not let this user open.
#[derive(Debug, PartialEq, Eq)]
struct DeniedCamera {
    node: PathBuf,
    model: String,
    serial: String,
}

/// The device file of a USB3 Vision camera of this name or serial number, if this user may
/// not open it.
pub(super) fn usb_without_permission(name: &str) -> Option<String> {
    let all = usb_cameras(Path::new("/"), &may_open);
    let camera = all
        .into_iter()
        .find(|camera| !camera.serial.is_empty() && name.ends_with(&camera.serial))?;
    Some(camera.node.display().to_string())
}

fn may_open(node: &Path) -> bool {
    let wanted = Access::READ_OK | Access::WRITE_OK;
    accessat(CWD, node, wanted, AtFlags::EACCESS).is_ok()
}

/// USB3 Vision cameras below `root` that may not be opened: devices with an interface of the
/// class for it (miscellaneous, USB3 Vision, device control: 0xEF, 0x05, 0x00), which Aravis
/// leaves out of its list.
fn usb_cameras(root: &Path, may_open: &dyn Fn(&Path) -> bool) -> Vec<DeniedCamera> {
    let devices = root.join("sys/bus/usb/devices");
    let read = |folder: &Path, name: &str| {
        let text = std::fs::read_to_string(folder.join(name)).unwrap_or_default();
        text.trim().to_owned()
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(&devices).into_iter().flatten().flatten() {
        let interface = entry.path();
        let class = [
            "bInterfaceClass",
            "bInterfaceSubClass",
            "bInterfaceProtocol",
        ]
        .map(|name| read(&interface, name));
        // An interface is called 1-2:1.0, its device 1-2.
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some((device, _)) = name.split_once(':') else {
            continue;
        };
        let device = devices.join(device);
        let number = |name: &str| read(&device, name).parse::<u32>().ok();
        let (Some(bus), Some(address)) = (number("busnum"), number("devnum")) else {
            continue;
        };
        let node = root.join(format!("dev/bus/usb/{bus:03}/{address:03}"));
        if class == ["ef", "05", "00"] && !may_open(&node) {
            found.push(DeniedCamera {
                node,
                model: read(&device, "product"),
                serial: read(&device, "serial"),
            });
        }
    }
    found.sort_by(|a, b| a.node.cmp(&b.node));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_usb_camera_without_permission_is_listed_with_its_node() {
        let folder = tempfile::tempdir().unwrap();
        let devices = folder.path().join("sys/bus/usb/devices");
        let write = |path: &str, text: &str| {
            let file = devices.join(path);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, text).unwrap();
        };
        for (file, text) in [
            ("busnum", "2\n"),
            ("devnum", "5\n"),
            ("product", "acA1920\n"),
            ("serial", "4711\n"),
        ] {
            write(&format!("2-1/{file}"), text);
        }
        for (interface, protocol) in [("2-1:1.0", "00\n"), ("2-1:1.1", "02\n")] {
            write(&format!("{interface}/bInterfaceClass"), "ef\n");
            write(&format!("{interface}/bInterfaceSubClass"), "05\n");
            write(&format!("{interface}/bInterfaceProtocol"), protocol);
        }
        let expected = DeniedCamera {
            node: folder.path().join("dev/bus/usb/002/005"),
            model: "acA1920".to_owned(),
            serial: "4711".to_owned(),
        };
        assert_eq!(usb_cameras(folder.path(), &|_| false), [expected]);
        assert_eq!(usb_cameras(folder.path(), &|_| true), []);
    }
}
