//! Features of a GenICam camera: set, and read back as the camera has them.

use aravis::glib;
use aravis::glib::object::{Cast, ObjectExt};
use aravis::{
    Device, DeviceExt, GcBoolean, GcEnumeration, GcFloat, GcFloatExt, GcInteger, GvDevice,
};

use crate::device::DeviceError;

/// Register of a GigE Vision device that states whether a program controls it.
pub const CONTROL_PRIVILEGE: u64 = 0x0a00;

/// A camera's features with the name by which errors call it.
pub struct Features {
    /// The device.
    pub device: Device,
    /// For messages.
    pub name: String,
}

impl Features {
    /// Whether the camera has it, now.
    pub fn has(&self, feature: &str) -> bool {
        let implemented = self.device.is_feature_available(feature);
        implemented.unwrap_or(false)
    }

    /// Whether it is a GigE Vision camera.
    pub fn is_on_network(&self) -> bool {
        self.device.is::<GvDevice>()
    }

    /// An error that the camera or its link gives to `command`.
    pub fn refused(&self, command: &str, reason: impl ToString) -> DeviceError {
        DeviceError::Refused {
            device: self.name.clone(),
            command: command.to_owned(),
            reason: reason.to_string(),
        }
    }

    /// What an error of Aravis means: the device is gone or belongs to another program, or
    /// it refuses the command.
    pub fn failed(&self, command: &str, error: &glib::Error) -> DeviceError {
        use aravis::DeviceError as Kind;
        let device = self.name.clone();
        match error.kind::<Kind>() {
            Some(Kind::NotConnected | Kind::Timeout | Kind::TransferError) => {
                DeviceError::Disconnected { device }
            }
            // Control is lost after a pause longer than the heartbeat time-out; the capture
            // then opens the camera anew.
            Some(Kind::NotController | Kind::ProtocolErrorAccessDenied) if !self.has_control() => {
                DeviceError::Disconnected { device }
            }
            _ => self.refused(command, error),
        }
    }

    /// Whether this process controls the camera, as the camera reports it. On USB the
    /// process that has claimed the interface does.
    pub fn has_control(&self) -> bool {
        let Some(network) = self.device.downcast_ref::<GvDevice>() else {
            return true;
        };
        let register = self.device.read_register(CONTROL_PRIVILEGE);
        let privilege = register.map_or(0, |(_, value)| value);
        network.is_controller() && privilege & 0b11 != 0
    }

    /// Executes a command.
    ///
    /// # Errors
    /// It was not taken.
    pub fn execute(&self, command: &str) -> Result<(), DeviceError> {
        let done = self.device.execute_command(command);
        done.map_err(|error| self.failed(command, &error))
    }

    /// Sets an enumeration and reads it back. `Ok(false)`: the camera does not have it.
    ///
    /// # Errors
    /// It is refused, or another value stays.
    pub fn choose(&self, feature: &str, value: &str) -> Result<bool, DeviceError> {
        if !self.has(feature) {
            return Ok(false);
        }
        let failed = |error| self.failed(&format!("{feature} = {value}"), &error);
        let device = &self.device;
        device
            .set_string_feature_value(feature, value)
            .map_err(failed)?;
        let is = device.string_feature_value(feature).map_err(failed)?;
        match is == value {
            true => Ok(true),
            false => Err(self.not_applied(feature, is, value)),
        }
    }

    /// Switches a feature off and reads it back; one that the camera does not have is off.
    ///
    /// # Errors
    /// It is refused, or stays on.
    pub fn switch_off(&self, feature: &str) -> Result<(), DeviceError> {
        if !self.has(feature) {
            return Ok(());
        }
        let failed = |error| self.failed(&format!("{feature} = false"), &error);
        let device = &self.device;
        device
            .set_boolean_feature_value(feature, false)
            .map_err(failed)?;
        match device.boolean_feature_value(feature).map_err(failed)? {
            false => Ok(()),
            true => Err(self.not_applied(feature, "on", "off")),
        }
    }

    /// A float.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn float(&self, feature: &str) -> Result<f64, DeviceError> {
        let read = self.device.float_feature_value(feature);
        read.map_err(|error| self.failed(feature, &error))
    }

    /// Sets a float, within its range, and returns what the camera makes of it.
    ///
    /// # Errors
    /// It is refused or cannot be read back.
    pub fn set_float(&self, feature: &str, value: f64) -> Result<f64, DeviceError> {
        let [low, high] = self.bounds(feature)?;
        let value = value.max(low).min(high);
        let set = self.device.set_float_feature_value(feature, value);
        set.map_err(|error| self.failed(&format!("{feature} = {value}"), &error))?;
        self.float(feature)
    }

    /// Sets an integer to its least value and reads it back.
    ///
    /// # Errors
    /// It is refused, or another value stays.
    pub fn set_lowest(&self, feature: &str) -> Result<(), DeviceError> {
        let failed = |error| self.failed(feature, &error);
        let (lowest, _) = self
            .device
            .integer_feature_bounds(feature)
            .map_err(failed)?;
        let set = self.device.set_integer_feature_value(feature, lowest);
        set.map_err(failed)?;
        match self.integer(feature)? {
            is if is == lowest => Ok(()),
            is => Err(self.not_applied(feature, is, &lowest.to_string())),
        }
    }

    /// Least and greatest value of a float.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn bounds(&self, feature: &str) -> Result<[f64; 2], DeviceError> {
        let read = self.device.float_feature_bounds(feature);
        let (low, high) = read.map_err(|error| self.failed(feature, &error))?;
        Ok([low, high])
    }

    /// Step of a float, where the camera states one.
    pub fn step(&self, feature: &str) -> Option<f64> {
        let read = self.device.float_feature_increment(feature).ok()?;
        (read.is_finite() && read > 1e-9).then_some(read)
    }

    /// Unit of a float, empty where none is stated.
    pub fn unit(&self, feature: &str) -> String {
        let node = self.device.feature(feature);
        let float = node.and_then(|node| node.dynamic_cast::<GcFloat>().ok());
        let unit = float.and_then(|float| float.unit());
        unit.map(|unit| unit.to_string()).unwrap_or_default()
    }

    /// An integer.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn integer(&self, feature: &str) -> Result<i64, DeviceError> {
        let read = self.device.integer_feature_value(feature);
        read.map_err(|error| self.failed(feature, &error))
    }

    /// Sets a feature of any type to a value of the rig file and reads it back.
    ///
    /// # Errors
    /// The camera does not have it, it is refused, or a value stays that differs by more than
    /// the feature's step.
    pub fn set(&self, feature: &str, value: &str) -> Result<(), DeviceError> {
        let command = format!("{feature} = {value}");
        let node = self.device.feature(feature).filter(|_| self.has(feature));
        let Some(node) = node else {
            return Err(self.refused(&command, "the camera has no such feature now"));
        };
        let no_value = |wanted: &str| self.refused(&command, format!("it needs {wanted}"));
        let failed = |error| self.failed(&command, &error);
        if node.is::<GcEnumeration>() {
            self.choose(feature, value)?;
        } else if node.is::<GcBoolean>() {
            let wanted = value.parse().map_err(|_| no_value("true or false"))?;
            let set = self.device.set_boolean_feature_value(feature, wanted);
            set.map_err(failed)?;
            let is = self.device.boolean_feature_value(feature).map_err(failed)?;
            if is != wanted {
                return Err(self.not_applied(feature, is, value));
            }
        } else if node.is::<GcFloat>() {
            let wanted = value.parse().map_err(|_| no_value("a number"))?;
            let set = self.device.set_float_feature_value(feature, wanted);
            set.map_err(failed)?;
            let is = self.float(feature)?;
            let step = self.step(feature).unwrap_or(0.0);
            if (is - wanted).abs() > step.max(1e-6 * wanted.abs()) {
                return Err(self.not_applied(feature, is, value));
            }
        } else if node.is::<GcInteger>() {
            let wanted: i64 = value.parse().map_err(|_| no_value("a whole number"))?;
            let set = self.device.set_integer_feature_value(feature, wanted);
            set.map_err(failed)?;
            let is = self.integer(feature)?;
            let step = self.device.integer_feature_increment(feature).unwrap_or(1);
            if is.abs_diff(wanted) >= step.max(1).unsigned_abs() {
                return Err(self.not_applied(feature, is, value));
            }
        } else {
            return Err(self.refused(&command, "it is neither a number nor a choice"));
        }
        Ok(())
    }

    /// A text, empty where it cannot be read.
    pub fn text(&self, feature: &str) -> String {
        let read = self.device.string_feature_value(feature);
        read.map(|text| text.to_string()).unwrap_or_default()
    }

    /// Names of an enumeration's values that can be chosen now.
    pub fn choices(&self, feature: &str) -> Vec<String> {
        let names = self
            .device
            .dup_available_enumeration_feature_values_as_strings(feature);
        let names = names.unwrap_or_default();
        names.iter().map(|name| name.to_string()).collect()
    }

    /// Another value stays than the one that was set.
    pub fn not_applied(&self, what: &str, is: impl ToString, wanted: &str) -> DeviceError {
        DeviceError::NotApplied {
            device: self.name.clone(),
            what: what.to_owned(),
            is: is.to_string(),
            wanted: wanted.to_owned(),
        }
    }
}
