//! Which cameras and serial ports there are, without opening any: opening a
//! port resets many boards.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use rustix::fs::{Access, AtFlags, CWD, accessat};
use serde::Serialize;

/// What a device file is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceKind {
    /// A Video4Linux node.
    Camera,
    /// A serial port.
    Serial,
}

/// A device file and what the system reports of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FoundDevice {
    /// Camera or serial port.
    pub kind: DeviceKind,
    /// The name to use: below `/dev/serial/by-id` or `/dev/v4l/by-id` where
    /// there is one, because it survives replugging; else the node.
    pub path: PathBuf,
    /// The node itself, e.g. `/dev/ttyUSB0`.
    pub node: PathBuf,
    /// What it is, as the device or the driver reports; empty if neither does.
    pub model: String,
    /// The device's own serial number; empty if it has none.
    pub serial: String,
    /// The first node of the same camera, where this is a further one: most of these give
    /// no images but what accompanies them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_node: Option<PathBuf>,
    /// Whether it hangs on USB, as what belongs to a bench does.
    pub usb: bool,
    /// Whether this user may open it.
    pub accessible: bool,
    /// Why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// Who may open it, where this user may not.
    #[serde(skip)]
    pub reserved_for: Option<ReservedFor>,
    /// A process that has it open, as far as this user may see.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub in_use_by: Option<Holder>,
}

/// Who may open a device file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReservedFor {
    /// Members of this group.
    Group(String),
    /// The owner alone.
    Owner,
}

/// A process that has a file open.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Holder {
    /// Its number.
    pub pid: u32,
    /// Its program's name; empty if that cannot be read.
    pub name: String,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.name.as_str() {
            "" => write!(out, "process {}", self.pid),
            name => write!(out, "process {} ({name})", self.pid),
        }
    }
}

/// The process that has `file`, or what it links to, open.
pub fn holder(file: &Path) -> Option<Holder> {
    let file = std::fs::canonicalize(file).ok()?;
    let processes = std::fs::read_dir("/proc").ok()?;
    processes.flatten().find_map(|process| {
        let pid: u32 = process.file_name().to_str()?.parse().ok()?;
        let mut open = std::fs::read_dir(process.path().join("fd")).ok()?.flatten();
        open.any(|fd| std::fs::read_link(fd.path()).is_ok_and(|target| target == file))
            .then(|| Holder {
                pid,
                name: read_text(&process.path().join("comm")).unwrap_or_default(),
            })
    })
}

/// Nodes of the cameras and serial ports that hang on USB.
pub fn usb_devices(root: &Path) -> Vec<String> {
    let found = find_devices(root).into_iter();
    let found = found.filter(|device| device.usb && device.first_node.is_none());
    found
        .map(|device| device.node.display().to_string())
        .collect()
}

/// The devices below `root` (`/`, or a copy of its `dev`, `sys` and `etc`):
/// cameras first, each kind by node.
pub fn find_devices(root: &Path) -> Vec<FoundDevice> {
    find_with(root, &|node| {
        let wanted = Access::READ_OK | Access::WRITE_OK;
        accessat(CWD, node, wanted, AtFlags::EACCESS).map_err(std::io::Error::from)
    })
}

/// How `access` is asked is a parameter, because the superuser may open everything.
fn find_with(root: &Path, access: &dyn Fn(&Path) -> std::io::Result<()>) -> Vec<FoundDevice> {
    let dev = root.join("dev");
    let groups = group_names(root);
    let kinds = [
        (
            DeviceKind::Camera,
            &["video"][..],
            "v4l/by-id",
            "video4linux",
        ),
        (
            DeviceKind::Serial,
            &["ttyUSB", "ttyACM"][..],
            "serial/by-id",
            "tty",
        ),
    ];
    let mut found = Vec::new();
    for (kind, prefixes, by_id, class) in kinds {
        let names = lasting_names(&dev.join(by_id));
        for node in nodes(&dev, prefixes) {
            let file_name = node.file_name().unwrap_or_default();
            let system = root.join("sys/class").join(class).join(file_name);
            let denied = access(&node).err();
            let reserved = denied.as_ref().and_then(|_| {
                let meta = std::fs::metadata(&node).ok()?;
                Some((reserved_for(&meta, &groups), meta.mode() & 0o777))
            });
            let problem = denied.map(|error| match &reserved {
                Some((ReservedFor::Group(group), mode)) => {
                    format!("{error}: it is for the group {group} (mode {mode:04o})")
                }
                Some((ReservedFor::Owner, mode)) => {
                    format!("{error}: it is for its owner alone (mode {mode:04o})")
                }
                None => error.to_string(),
            });
            let usb = |attribute| attribute_above(&system, attribute);
            let model = usb("product").or_else(|| read_text(&system.join("name")));
            found.push(FoundDevice {
                kind,
                path: names.get(&node).cloned().unwrap_or_else(|| node.clone()),
                model: model.unwrap_or_default(),
                serial: usb("serial").unwrap_or_default(),
                first_node: first_node(root, &node),
                usb: usb_device(&system).is_some(),
                accessible: problem.is_none(),
                problem,
                reserved_for: reserved.map(|(reserved_for, _)| reserved_for),
                in_use_by: holder(&node),
                node,
            });
        }
    }
    found
}

/// The serial number of the USB device behind a node or a link to one, from
/// `root/sys`; `None` if it has none.
pub fn serial_of_camera(root: &Path, path: &Path) -> Option<String> {
    let node = std::fs::canonicalize(path).ok()?;
    let system = root.join("sys/class/video4linux").join(node.file_name()?);
    attribute_above(&system, "serial")
}

/// The first node of the camera that a node, or a link to one, is a further one of, by
/// `root/sys`; by its lasting name where there is one. `None` for a first node.
pub fn first_node(root: &Path, path: &Path) -> Option<PathBuf> {
    let node = std::fs::canonicalize(path).ok()?;
    let class = root.join("sys/class/video4linux");
    let index = |name: &std::ffi::OsStr| -> Option<u32> {
        read_text(&class.join(name).join("index"))?.parse().ok()
    };
    let name = node.file_name()?;
    index(name).filter(|&index| index > 0)?;
    let device = |name: &std::ffi::OsStr| {
        let of_class = class.join(name);
        let usb = std::fs::canonicalize(of_class.join("device")).ok();
        usb.map(PathBuf::into_os_string)
            .or_else(|| read_text(&of_class.join("name")).map(Into::into))
    };
    let dev = root.join("dev");
    let first = nodes(&dev, &["video"]).into_iter().find(|other| {
        let other = other.file_name().unwrap_or_default();
        index(other) == Some(0) && device(other) == device(name)
    })?;
    let names = lasting_names(&dev.join("v4l/by-id"));
    Some(names.get(&first).cloned().unwrap_or(first))
}

/// Nodes whose names are a prefix and a number, in the order of prefix and number.
fn nodes(dev: &Path, prefixes: &[&str]) -> Vec<PathBuf> {
    let mut nodes: Vec<(usize, u32, PathBuf)> = std::fs::read_dir(dev)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| {
            let name = entry.file_name();
            let name = name.to_str()?;
            prefixes.iter().enumerate().find_map(|(order, prefix)| {
                let number = name.strip_prefix(prefix)?.parse().ok()?;
                Some((order, number, entry.path()))
            })
        })
        .collect();
    nodes.sort();
    nodes.into_iter().map(|(_, _, path)| path).collect()
}

/// From nodes to the links that name them. A camera with several nodes has a
/// link for each; of several links to one node the first by name.
fn lasting_names(folder: &Path) -> BTreeMap<PathBuf, PathBuf> {
    let mut links: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .collect();
    links.sort();
    let mut names = BTreeMap::new();
    for link in links {
        let Ok(target) = std::fs::read_link(&link) else {
            continue;
        };
        // `../../ttyUSB0`: only the last part matters, the nodes are all in dev.
        let dev = folder.parent().and_then(Path::parent);
        if let (Some(dev), Some(name)) = (dev, target.file_name()) {
            names.entry(dev.join(name)).or_insert(link);
        }
    }
    names
}

/// The folder of the USB device that a node belongs to, a few levels above it:
/// a USB interface, its device, its hub.
fn usb_device(system: &Path) -> Option<PathBuf> {
    let device = std::fs::canonicalize(system.join("device")).ok()?;
    let mut above = device.ancestors().take(4);
    let found = above.find(|folder| folder.join("idVendor").exists());
    found.map(Path::to_owned)
}

fn attribute_above(system: &Path, attribute: &str) -> Option<String> {
    read_text(&usb_device(system)?.join(attribute))
}

fn read_text(file: &Path) -> Option<String> {
    let bytes = std::fs::read(file).ok()?;
    let text = String::from_utf8_lossy(&bytes).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

fn group_names(root: &Path) -> BTreeMap<u32, String> {
    let text = std::fs::read_to_string(root.join("etc/group")).unwrap_or_default();
    text.lines()
        .filter_map(|line| {
            let mut fields = line.split(':');
            let name = fields.next()?;
            Some((fields.nth(1)?.parse().ok()?, name.to_owned()))
        })
        .collect()
}

fn reserved_for(meta: &Metadata, groups: &BTreeMap<u32, String>) -> ReservedFor {
    if meta.mode() & 0o060 != 0o060 {
        return ReservedFor::Owner;
    }
    let name = groups.get(&meta.gid()).cloned();
    ReservedFor::Group(name.unwrap_or_else(|| meta.gid().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    fn write(file: &Path, text: &str) {
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text).unwrap();
    }

    fn link(target: &str, at: &Path) {
        std::fs::create_dir_all(at.parent().unwrap()).unwrap();
        symlink(target, at).unwrap();
    }

    /// Two USB serial ports (one of them without a lasting name), a USB camera
    /// with two nodes, and things that are neither.
    fn tree() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        for node in [
            "ttyUSB0", "ttyUSB10", "ttyACM0", "ttyS0", "video0", "video1", "videotex",
        ] {
            write(&root.join("dev").join(node), "");
        }
        let usb = root.join("sys/devices/usb1");
        write(&usb.join("1-1/idVendor"), "1a86\n");
        write(&usb.join("1-1/product"), "USB Serial\n");
        write(&usb.join("1-1/1-1:1.0/ttyUSB0/tty/ttyUSB0/dev"), "");
        link(
            "../../ttyUSB0",
            &root.join("dev/serial/by-id/usb-1a86_USB_Serial-if00-port0"),
        );
        link(
            "../../../devices/usb1/1-1/1-1:1.0/ttyUSB0",
            &root.join("sys/class/tty/ttyUSB0/device"),
        );
        write(&usb.join("1-2/idVendor"), "2a0b\n");
        write(&usb.join("1-2/serial"), "C4711\n");
        write(&usb.join("1-2/1-2:1.0/x"), "");
        for (node, index) in [("video0", 0), ("video1", 1)] {
            let class = root.join("sys/class/video4linux").join(node);
            write(&class.join("name"), "Mono camera\n");
            write(&class.join("index"), &format!("{index}\n"));
            link("../../../devices/usb1/1-2/1-2:1.0", &class.join("device"));
            let name = format!("dev/v4l/by-id/usb-Mono_C4711-video-index{index}");
            link(&format!("../../{node}"), &root.join(name));
        }
        write(&root.join("etc/group"), "root:x:0:\ndialout:x:20:\n");
        folder
    }

    #[test]
    fn devices_are_listed_by_their_lasting_names() {
        let folder = tree();
        let found = find_with(folder.path(), &|_| Ok(()));
        let dev = folder.path().join("dev");
        let names: Vec<_> = found
            .iter()
            .map(|device| {
                let short = |path: &Path| path.strip_prefix(&dev).unwrap().display().to_string();
                (device.kind, short(&device.node), short(&device.path))
            })
            .collect();
        let expected = [
            (
                DeviceKind::Camera,
                "video0",
                "v4l/by-id/usb-Mono_C4711-video-index0",
            ),
            (
                DeviceKind::Camera,
                "video1",
                "v4l/by-id/usb-Mono_C4711-video-index1",
            ),
            (
                DeviceKind::Serial,
                "ttyUSB0",
                "serial/by-id/usb-1a86_USB_Serial-if00-port0",
            ),
            (DeviceKind::Serial, "ttyUSB10", "ttyUSB10"),
            (DeviceKind::Serial, "ttyACM0", "ttyACM0"),
        ];
        let expected = expected.map(|(kind, node, path)| (kind, node.to_owned(), path.to_owned()));
        assert_eq!(names, expected);
        assert_eq!(
            (found[0].model.as_str(), found[0].serial.as_str()),
            ("Mono camera", "C4711")
        );
        assert_eq!(
            (found[2].model.as_str(), found[2].serial.as_str()),
            ("USB Serial", "")
        );
        assert!(found.iter().all(|device| device.accessible));
        let first = found[1].first_node.as_ref().unwrap();
        assert!(first.ends_with("usb-Mono_C4711-video-index0"), "{first:?}");
        let further = found.iter().filter(|device| device.first_node.is_some());
        assert_eq!(further.count(), 1);
        // The last port has no device behind it in the tree.
        assert!(
            found[..3]
                .iter()
                .all(|device| device.usb && device.in_use_by.is_none())
        );
        let usb = usb_devices(folder.path());
        assert!(usb[0].ends_with("/dev/video0"), "{usb:?}");
        let open = std::fs::File::open(&found[0].node).unwrap();
        let again = find_devices(folder.path());
        let holder = again[0].in_use_by.as_ref().map(|holder| holder.pid);
        assert_eq!(holder, Some(std::process::id()));
        drop(open);
        let by_link = serial_of_camera(folder.path(), &found[1].path);
        assert_eq!(by_link.as_deref(), Some("C4711"));
    }

    #[test]
    fn what_may_not_be_opened_is_listed_with_the_reason() {
        let folder = tree();
        let port = folder.path().join("dev/ttyUSB0");
        std::fs::set_permissions(&port, PermissionsExt::from_mode(0o660)).unwrap();
        let group = std::fs::metadata(&port).unwrap().gid();
        write(
            &folder.path().join("etc/group"),
            &format!("dialout:x:{group}:\n"),
        );
        let denied = |_: &Path| Err(std::io::ErrorKind::PermissionDenied.into());
        let found = find_with(folder.path(), &denied);
        let device = found.iter().find(|device| device.node == port).unwrap();
        assert!(!device.accessible);
        assert_eq!(
            device.problem.as_deref(),
            Some("permission denied: it is for the group dialout (mode 0660)")
        );
        assert_eq!(
            device.reserved_for,
            Some(ReservedFor::Group("dialout".to_owned()))
        );
        let json = serde_json::to_value(device).unwrap();
        assert_eq!(json["kind"], "serial");
        assert_eq!(json["accessible"], false);
    }

    #[test]
    fn no_devices_at_all_is_an_empty_list() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(find_devices(folder.path()), []);
        std::fs::create_dir_all(folder.path().join("dev")).unwrap();
        assert_eq!(find_devices(folder.path()), []);
    }
}
