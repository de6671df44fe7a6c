//! What Zaber's warning flags and rejections mean (ASCII protocol manual,
//! firmware 7), in our words.

/// What a flag says about the stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// The position holds.
    Sound,
    /// The position is unknown or not to be trusted.
    Unknown,
    /// The device has stopped with a fault; the position is not to be trusted.
    Fault,
}

/// How far the position is to be trusted under a flag. Flags that nobody knows
/// count by their first letter: F is a fault, W makes the position unknown.
pub fn trust(flag: &str) -> Trust {
    match flag {
        // Voltage and temperature leave the position as it is.
        "WV" | "WT" | "WP" => Trust::Sound,
        _ if flag.starts_with('F') => Trust::Fault,
        _ if flag.starts_with('W') => Trust::Unknown,
        _ => Trust::Sound,
    }
}

/// A flag with its meaning.
pub fn warning(flag: &str) -> String {
    let meaning = match flag {
        "FF" => "critical system error",
        "FN" => "the peripheral is not supported",
        "FZ" => "the peripheral is inactive",
        "FH" => "the hardware emergency stop has disabled the driver",
        "FV" => "over- or undervoltage has disabled the driver",
        "FO" => "the driver is disabled, without a fault",
        "FC" => "current inrush",
        "FM" => "the motor is too hot",
        "FD" => "the driver is disabled",
        "FQ" => "encoder error",
        "FI" => "encoder index error",
        "FA" => "the analogue encoder is out of step",
        "FR" => "the overdrive limit was exceeded",
        "FS" => "stalled and stopped",
        "FB" => "a stream left its bounds",
        "FP" => "the interpolated path was left",
        "FE" => "limit sensor error",
        "FT" => "excessive twist",
        "WL" => "an unexpected limit sensor was triggered",
        "WV" => "the supply voltage is out of range",
        "WT" => "the controller is hot",
        "WS" => "stalled with recovery",
        "WM" => "displaced while it stood still",
        "WP" => "the calibration does not fit the sensor",
        "WR" => "no reference position",
        "WH" => "not homed",
        "NC" => "under manual control",
        "NI" => "a movement was interrupted",
        _ => "a flag that this program does not know",
    };
    format!("{meaning} ({flag})")
}

/// A rejection with its meaning.
pub fn rejection(reason: &str) -> String {
    let meaning = match reason {
        "AGAIN" => "cannot be processed now",
        "BADAXIS" => "the device has no such axis",
        "BADCOMMAND" => "the device does not know this command or setting",
        "BADDATA" => "a value is malformed or out of range",
        "BADMESSAGEID" => "the message id is malformed",
        "DENIED" => "access denied",
        "DEVICEONLY" => "the command is for the device, not for an axis",
        "DRIVERDISABLED" => "the motor's driver is disabled",
        "FULL" => "the device's queue is full",
        "INACTIVE" => "the axis is inactive",
        "LOCKSTEP" => "the axis is locked to another",
        "NOACCESS" => "a higher access level is needed",
        "PARKED" => "the axis is parked",
        "REMOTE" => "the device is controlled over another connection",
        "STATUSBUSY" => "not possible while the axis moves",
        _ => "a reason that this program does not know",
    };
    format!("{meaning} ({reason})")
}
