//! A camera's controls by their Video4Linux ids: what there is, manual modes
//! first, and every value read back.
//!
//! Ids and meanings after the kernel's `userspace-api/media/v4l/control`,
//! `ext-ctrls-camera` and `ext-ctrls-image-source`.

use std::io;

use serde::Serialize;

use super::DeviceError;

/// Ids of `linux/v4l2-controls.h`.
pub mod id {
    /// Count without light (deprecated by the kernel, still used).
    pub const BLACK_LEVEL: u32 = 0x0098_090b;
    /// Automatic white balance.
    pub const AUTO_WHITE_BALANCE: u32 = 0x0098_090c;
    /// Automatic gain.
    pub const AUTOGAIN: u32 = 0x0098_0912;
    /// Gain in the device's own unit.
    pub const GAIN: u32 = 0x0098_0913;
    /// Automatic brightness.
    pub const AUTOBRIGHTNESS: u32 = 0x0098_0920;
    /// 0 automatic, 1 manual, 2 shutter priority, 3 aperture priority.
    pub const EXPOSURE_AUTO: u32 = 0x009a_0901;
    /// Exposure in units of 100 µs.
    pub const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
    /// Whether the frame rate may change with the exposure.
    pub const EXPOSURE_AUTO_PRIORITY: u32 = 0x009a_0903;
    /// Automatic focus.
    pub const FOCUS_AUTO: u32 = 0x009a_090c;
    /// Gain before the converter.
    pub const ANALOGUE_GAIN: u32 = 0x009e_0903;
}

/// Controls that a rig file can name, in addition to any by its number.
const NAMES: &[(&str, u32)] = &[
    ("brightness", 0x0098_0900),
    ("contrast", 0x0098_0901),
    ("saturation", 0x0098_0902),
    ("black_level", id::BLACK_LEVEL),
    ("red_balance", 0x0098_090e),
    ("blue_balance", 0x0098_090f),
    ("gamma", 0x0098_0910),
    ("horizontal_flip", 0x0098_0914),
    ("vertical_flip", 0x0098_0915),
    ("power_line_frequency", 0x0098_0918),
    ("white_balance_temperature", 0x0098_091a),
    ("sharpness", 0x0098_091b),
    ("backlight_compensation", 0x0098_091c),
    ("focus_absolute", 0x009a_090a),
    ("zoom_absolute", 0x009a_090d),
    ("iris_absolute", 0x009a_0911),
    ("digital_gain", 0x009f_0905),
];

/// What `rig` sets itself, so that a rig file must not.
const OWN: [u32; 9] = [
    id::AUTO_WHITE_BALANCE,
    id::AUTOGAIN,
    id::GAIN,
    id::AUTOBRIGHTNESS,
    id::EXPOSURE_AUTO,
    id::EXPOSURE_ABSOLUTE,
    id::EXPOSURE_AUTO_PRIORITY,
    id::FOCUS_AUTO,
    id::ANALOGUE_GAIN,
];

/// Everything automatic and the value that switches it off, in this order: many
/// drivers refuse a value while its automatic is on.
const MANUAL: [(u32, &str, i64); 6] = [
    (id::EXPOSURE_AUTO, "manual exposure", 1),
    (id::EXPOSURE_AUTO_PRIORITY, "a fixed frame rate", 0),
    (id::AUTOGAIN, "manual gain", 0),
    (id::AUTO_WHITE_BALANCE, "manual white balance", 0),
    (id::FOCUS_AUTO, "manual focus", 0),
    (id::AUTOBRIGHTNESS, "manual brightness", 0),
];

/// The id behind a name or a number such as `0x009a090a`; `None` if it is
/// neither, or one that `rig` sets itself.
pub fn id_of(name: &str) -> Option<u32> {
    let number = || u32::from_str_radix(name.strip_prefix("0x")?, 16).ok();
    let named = NAMES.iter().find(|(known, _)| *known == name);
    named
        .map(|(_, id)| *id)
        .or_else(number)
        .filter(|id| !OWN.contains(id))
}

/// The name of an id in a rig file; its number where it has none.
pub fn name_of(id: u32) -> String {
    match NAMES.iter().find(|(_, known)| *known == id) {
        Some((name, _)) => (*name).to_owned(),
        None => format!("{id:#010x}"),
    }
}

/// What kind of value a control has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// A whole number.
    Integer,
    /// 0 or 1.
    Boolean,
    /// One of some choices, by number.
    Menu,
    /// Bits.
    Bitmask,
    /// An action without a value, a text, or something newer.
    Other,
}

/// A control and its range.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ControlInfo {
    /// `V4L2_CID_*`.
    pub id: u32,
    /// As the driver calls it.
    pub label: String,
    /// Kind of value.
    pub kind: ControlKind,
    /// Smallest value.
    pub minimum: i64,
    /// Largest value.
    pub maximum: i64,
    /// Step between values, at least 1.
    pub step: i64,
    /// Value after power-on.
    pub default: i64,
    /// Its value now, where it can be read.
    pub value: Option<i64>,
    /// It can only be read.
    pub read_only: bool,
    /// It has no effect now, because another control (an automatic) rules it.
    pub inactive: bool,
}

/// Access to a device's controls.
pub trait ControlPort {
    /// The control with this id, without its value; `None` if there is none.
    fn query(&self, id: u32) -> io::Result<Option<ControlInfo>>;
    /// The control with the next higher id.
    fn query_after(&self, id: u32) -> io::Result<Option<ControlInfo>>;
    /// Its value.
    fn get(&self, id: u32) -> io::Result<i64>;
    /// Sets its value.
    fn set(&self, id: u32, value: i64) -> io::Result<()>;
}

/// More controls than any driver has: a driver that counts in circles ends here.
const MOST: usize = 1024;

/// Every control with its value, by id.
pub fn list(port: &dyn ControlPort) -> io::Result<Vec<ControlInfo>> {
    let mut all: Vec<ControlInfo> = Vec::new();
    let mut last = 0;
    while let Some(mut control) = port.query_after(last)? {
        if control.id <= last || all.len() == MOST {
            break;
        }
        last = control.id;
        if control.kind != ControlKind::Other {
            control.value = port.get(control.id).ok();
        }
        all.push(control);
    }
    Ok(all)
}

/// The control that says a temperature. There is no standard one: drivers call it by names
/// and count in units of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct TemperatureControl {
    /// As the driver calls it, or its number such as `0x00980a01`.
    pub name: String,
    /// °C per count.
    pub unit_c: f64,
}

/// The control that the driver calls so, whatever the case of the letters, or that has
/// this number; only one that has a value.
pub fn find(port: &dyn ControlPort, name: &str) -> io::Result<Option<ControlInfo>> {
    let number = id_of(name);
    let is_meant = |control: &ControlInfo| {
        number == Some(control.id) || control.label.trim().eq_ignore_ascii_case(name.trim())
    };
    let has_value = |control: &ControlInfo| control.kind != ControlKind::Other;
    let all = list(port)?.into_iter();
    Ok(all.filter(has_value).find(is_meant))
}

/// Sets a control and returns what is read back.
pub fn set(port: &dyn ControlPort, id: u32, value: i64) -> io::Result<i64> {
    port.set(id, value)?;
    port.get(id)
}

/// Switches off whatever is automatic, and checks each by reading it back.
///
/// # Errors
/// [`DeviceError::NotApplied`] where one stays on; the port's own errors by way
/// of `failed`.
pub fn set_manual(
    port: &dyn ControlPort,
    device: &str,
    failed: &dyn Fn(io::Error) -> DeviceError,
) -> Result<(), DeviceError> {
    for (id, what, value) in MANUAL {
        match port.query(id).map_err(failed)? {
            Some(control) if !control.read_only => {
                set_exactly(port, device, id, what, value, failed)?;
            }
            // What cannot be changed is fine as long as it is off.
            Some(_) if port.get(id).map_err(failed)? != value => {
                return Err(not_applied(
                    device,
                    what,
                    "automatic and read-only",
                    "manual",
                ));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Sets the controls that a rig file requests, each within its range.
///
/// # Errors
/// [`DeviceError::Refused`] where the camera lacks one or its range does not
/// hold the value; [`DeviceError::NotApplied`] where another value is read back.
pub fn set_wanted(
    port: &dyn ControlPort,
    device: &str,
    wanted: &[(u32, i64)],
    failed: &dyn Fn(io::Error) -> DeviceError,
) -> Result<(), DeviceError> {
    for &(id, value) in wanted {
        let name = name_of(id);
        let refused = |reason: String| DeviceError::Refused {
            device: device.to_owned(),
            command: format!("{name} = {value}"),
            reason,
        };
        let Some(control) = port.query(id).map_err(failed)? else {
            return Err(refused("the camera has no such control".to_owned()));
        };
        let range = control.minimum..=control.maximum;
        if control.read_only || !range.contains(&value) {
            let reason = if control.read_only {
                "it can only be read".to_owned()
            } else {
                let (least, most) = range.into_inner();
                format!("it takes {least} to {most} in steps of {}", control.step)
            };
            return Err(refused(reason));
        }
        set_exactly(port, device, id, &name, value, failed)?;
    }
    Ok(())
}

fn set_exactly(
    port: &dyn ControlPort,
    device: &str,
    id: u32,
    what: &str,
    value: i64,
    failed: &dyn Fn(io::Error) -> DeviceError,
) -> Result<(), DeviceError> {
    let is = set(port, id, value).map_err(failed)?;
    if is == value {
        return Ok(());
    }
    Err(not_applied(
        device,
        what,
        &is.to_string(),
        &value.to_string(),
    ))
}

fn not_applied(device: &str, what: &str, is: &str, wanted: &str) -> DeviceError {
    DeviceError::NotApplied {
        device: device.to_owned(),
        what: what.to_owned(),
        is: is.to_owned(),
        wanted: wanted.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::collections::BTreeMap;

    /// A device in memory that refuses exposures while its automatic is on.
    struct Fake {
        controls: RefCell<BTreeMap<u32, ControlInfo>>,
        /// Accepts everything and applies nothing of this control.
        deaf: Option<u32>,
        log: RefCell<Vec<(u32, i64)>>,
    }

    fn control(id: u32, [minimum, maximum]: [i64; 2], value: i64) -> ControlInfo {
        ControlInfo {
            id,
            label: format!("{id}"),
            kind: ControlKind::Integer,
            minimum,
            maximum,
            step: 1,
            default: value,
            value: Some(value),
            read_only: false,
            inactive: false,
        }
    }

    fn fake(controls: &[ControlInfo]) -> Fake {
        Fake {
            controls: RefCell::new(controls.iter().map(|c| (c.id, c.clone())).collect()),
            deaf: None,
            log: RefCell::default(),
        }
    }

    impl ControlPort for Fake {
        fn query(&self, id: u32) -> io::Result<Option<ControlInfo>> {
            Ok(self.controls.borrow().get(&id).cloned())
        }
        fn query_after(&self, id: u32) -> io::Result<Option<ControlInfo>> {
            Ok(self
                .controls
                .borrow()
                .range(id + 1..)
                .next()
                .map(|(_, c)| c.clone()))
        }
        fn get(&self, id: u32) -> io::Result<i64> {
            let value = self.controls.borrow().get(&id).and_then(|c| c.value);
            value.ok_or_else(|| io::Error::from_raw_os_error(22))
        }
        fn set(&self, id: u32, value: i64) -> io::Result<()> {
            self.log.borrow_mut().push((id, value));
            let automatic = self.get(id::EXPOSURE_AUTO).is_ok_and(|mode| mode != 1);
            if id == id::EXPOSURE_ABSOLUTE && automatic {
                return Err(io::Error::from_raw_os_error(13));
            }
            if self.deaf != Some(id)
                && let Some(control) = self.controls.borrow_mut().get_mut(&id)
            {
                control.value = Some(value);
            }
            Ok(())
        }
    }

    fn failed(source: io::Error) -> DeviceError {
        DeviceError::Io {
            device: "camera".to_owned(),
            source,
        }
    }

    fn camera() -> Fake {
        fake(&[
            control(id::EXPOSURE_AUTO, [0, 3], 3),
            control(id::EXPOSURE_ABSOLUTE, [1, 5000], 150),
            control(id::AUTO_WHITE_BALANCE, [0, 1], 1),
            control(id::BLACK_LEVEL, [0, 255], 16),
        ])
    }

    #[test]
    fn automatics_go_first_and_missing_ones_are_no_harm() {
        let port = camera();
        assert!(set(&port, id::EXPOSURE_ABSOLUTE, 100).is_err());
        set_manual(&port, "camera", &failed).unwrap();
        assert_eq!(
            port.log.borrow()[1..],
            [(id::EXPOSURE_AUTO, 1), (id::AUTO_WHITE_BALANCE, 0)]
        );
        assert_eq!(set(&port, id::EXPOSURE_ABSOLUTE, 100).unwrap(), 100);
    }

    #[test]
    fn what_stays_automatic_is_an_error() {
        let mut port = camera();
        port.deaf = Some(id::AUTO_WHITE_BALANCE);
        let error = set_manual(&port, "camera", &failed).unwrap_err();
        assert_eq!(
            error.to_string(),
            "camera: manual white balance is 1 after 0 was commanded"
        );
        let fixed = |value| {
            let mut focus = control(id::FOCUS_AUTO, [0, 1], value);
            focus.read_only = true;
            set_manual(&fake(&[focus]), "camera", &failed)
        };
        assert!(fixed(0).is_ok());
        assert!(matches!(fixed(1), Err(DeviceError::NotApplied { .. })));
    }

    #[test]
    fn a_control_is_found_by_its_label_or_number() {
        let labelled = |id: u32, label: &str| ControlInfo {
            label: label.to_owned(),
            read_only: true,
            ..control(id, [-400, 1250], 415)
        };
        let mut button = labelled(0x0098_0f01, "Device Temperature");
        button.kind = ControlKind::Other;
        let port = fake(&[
            labelled(0x0098_091a, "White Balance Temperature"),
            button,
            labelled(0x0098_0f02, "Device Temperature"),
        ]);
        let found = |name| find(&port, name).unwrap().map(|control| control.id);
        assert_eq!(found("device temperature "), Some(0x0098_0f02));
        assert_eq!(found("0x00980f02"), Some(0x0098_0f02));
        assert_eq!(found("Temperature"), None);
        assert_eq!(found("0x00980f03"), None);
    }

    #[test]
    fn wanted_values_must_exist_fit_and_take() {
        let port = camera();
        let set = |id, value| set_wanted(&port, "camera", &[(id, value)], &failed);
        set(id::BLACK_LEVEL, 64).unwrap();
        assert_eq!(port.get(id::BLACK_LEVEL).unwrap(), 64);
        assert_eq!(
            set(id::BLACK_LEVEL, 300).unwrap_err().to_string(),
            "camera refused \"black_level = 300\": it takes 0 to 255 in steps of 1"
        );
        assert_eq!(
            set(0x009a_090a, 3).unwrap_err().to_string(),
            "camera refused \"focus_absolute = 3\": the camera has no such control"
        );
    }

    #[test]
    fn all_controls_are_listed_once_with_their_values() {
        let found = list(&camera()).unwrap();
        let ids: Vec<u32> = found.iter().map(|control| control.id).collect();
        let expected = [
            id::BLACK_LEVEL,
            id::AUTO_WHITE_BALANCE,
            id::EXPOSURE_AUTO,
            id::EXPOSURE_ABSOLUTE,
        ];
        assert_eq!(ids, expected);
        assert_eq!(found[0].value, Some(16));
    }

    #[test]
    fn names_are_unique_and_what_rig_sets_itself_has_none() {
        for (i, (name, id)) in NAMES.iter().enumerate() {
            let later = &NAMES[i + 1..];
            assert!(
                later
                    .iter()
                    .all(|(other, number)| other != name && number != id)
            );
            assert_eq!(id_of(name), Some(*id));
            assert_eq!(name_of(*id), *name);
        }
        assert_eq!(id_of("0x0098091a"), id_of("white_balance_temperature"));
        assert_eq!(id_of("0x009a0902"), None);
        assert_eq!(id_of("exposure"), None);
        assert_eq!(name_of(id::EXPOSURE_ABSOLUTE), "0x009a0902");
    }
}
