//! A Video4Linux device's controls through the kernel's requests.
//!
//! The crate's own `query_controls` panics on unknown types and odd menu texts.

use std::io;

use v4l::Device;
use v4l::v4l_sys::{v4l2_control, v4l2_queryctrl};
use v4l::v4l2::vidioc;

use crate::device::controls::{ControlInfo, ControlKind, ControlPort};

/// `V4L2_CTRL_FLAG_*`.
const DISABLED: u32 = 0x0001;
const READ_ONLY: u32 = 0x0004;
const INACTIVE: u32 = 0x0010;
const NEXT: u32 = 0x8000_0000;
/// EINVAL: no such control.
const INVALID: i32 = 22;
/// ERANGE: the value is outside the control's range.
const OUT_OF_RANGE: i32 = 34;

impl ControlPort for Device {
    fn query(&self, id: u32) -> io::Result<Option<ControlInfo>> {
        let found = query(self, id)?;
        Ok(found.filter(|query| query.flags & DISABLED == 0).map(info))
    }

    fn query_after(&self, id: u32) -> io::Result<Option<ControlInfo>> {
        let mut last = id;
        while let Some(found) = query(self, last | NEXT)? {
            if found.id <= last {
                break;
            }
            if found.flags & DISABLED == 0 {
                return Ok(Some(info(found)));
            }
            last = found.id;
        }
        Ok(None)
    }

    fn get(&self, id: u32) -> io::Result<i64> {
        let mut control = v4l2_control { id, value: 0 };
        // SAFETY: VIDIOC_G_CTRL reads and writes exactly this structure.
        unsafe {
            v4l::v4l2::ioctl(
                self.handle().fd(),
                vidioc::VIDIOC_G_CTRL,
                (&raw mut control).cast(),
            )
        }?;
        Ok(i64::from(control.value))
    }

    fn set(&self, id: u32, value: i64) -> io::Result<()> {
        let value = i32::try_from(value).map_err(|_| io::Error::from_raw_os_error(OUT_OF_RANGE))?;
        let mut control = v4l2_control { id, value };
        // SAFETY: VIDIOC_S_CTRL reads and writes exactly this structure.
        unsafe {
            v4l::v4l2::ioctl(
                self.handle().fd(),
                vidioc::VIDIOC_S_CTRL,
                (&raw mut control).cast(),
            )
        }
    }
}

fn query(device: &Device, id: u32) -> io::Result<Option<v4l2_queryctrl>> {
    let mut query = v4l2_queryctrl {
        id,
        // SAFETY: plain numbers and arrays of them, for which zero is valid.
        ..unsafe { std::mem::zeroed::<v4l2_queryctrl>() }
    };
    // SAFETY: VIDIOC_QUERYCTRL reads and writes exactly this structure.
    let asked = unsafe {
        v4l::v4l2::ioctl(
            device.handle().fd(),
            vidioc::VIDIOC_QUERYCTRL,
            (&raw mut query).cast(),
        )
    };
    match asked {
        Ok(()) => Ok(Some(query)),
        Err(error) if error.raw_os_error() == Some(INVALID) => Ok(None),
        Err(error) => Err(error),
    }
}

fn info(query: v4l2_queryctrl) -> ControlInfo {
    let letters = query.name.iter().copied();
    let label: Vec<u8> = letters.take_while(|&byte| byte != 0).collect();
    ControlInfo {
        id: query.id,
        label: String::from_utf8_lossy(&label).into_owned(),
        kind: match query.type_ {
            1 => ControlKind::Integer,
            2 => ControlKind::Boolean,
            3 | 9 => ControlKind::Menu,
            8 => ControlKind::Bitmask,
            _ => ControlKind::Other,
        },
        minimum: i64::from(query.minimum),
        maximum: i64::from(query.maximum),
        step: i64::from(query.step).max(1),
        default: i64::from(query.default_value),
        value: None,
        read_only: query.flags & READ_ONLY != 0,
        inactive: query.flags & INACTIVE != 0,
    }
}
