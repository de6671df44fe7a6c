//! What the alarm and error numbers of GRBL 1.1 (`alarm_codes_en_US.csv` and
//! `error_codes_en_US.csv` of its documentation), of grblHAL (`alarms.h` and
//! `errors.h` of its core) and of FluidNC (`Protocol.h` and `Error.h`) mean, in
//! our words. FluidNC counts otherwise than the others from 10 (alarms) and 18
//! (errors) on.

use super::protocol::{Code, Dialect};
use crate::device::AlarmCause;

/// An alarm by kind, and with its meaning.
pub fn alarm(dialect: Dialect, code: &Code) -> (AlarmCause, String) {
    let number = match code {
        Code::Number(number) => *number,
        Code::Text(text) => return (cause_in_words(text), format!("alarm: {text}")),
    };
    let (cause, meaning) = match dialect {
        Dialect::FluidNc if number >= 10 => alarm_of_fluidnc(number),
        _ => alarm_of_grbl(number),
    };
    (cause, format!("alarm {number}: {meaning}"))
}

fn alarm_of_grbl(code: u16) -> (AlarmCause, &'static str) {
    use AlarmCause::*;
    match code {
        1 => (LimitSwitch, "a limit switch was hit in motion"),
        2 => (
            SoftLimit,
            "the target is beyond the machine's travel (soft limit)",
        ),
        3 => (Other, "reset in motion, steps may be lost"),
        4 => (Other, "the probe was not in its initial state"),
        5 => (Other, "the probe made no contact"),
        6 => (Other, "homing was reset"),
        7 => (Other, "the safety door opened while homing"),
        8 => (Homing, "homing could not get off the limit switch"),
        9 => (Homing, "homing did not find the limit switch"),
        10 => (
            EmergencyStop,
            "homing did not find the second limit switch of a dual axis, or, of grblHAL, \
             the emergency stop is active",
        ),
        11 => (HomingRequired, "homing is required"),
        12 => (LimitSwitch, "a limit switch is closed"),
        13 => (Other, "the probe's protection was triggered"),
        14 => (Other, "the spindle did not reach its speed"),
        15 => (
            Homing,
            "homing did not find the second limit switch of an auto-squared axis",
        ),
        16 => (Other, "the self-test at power-on failed"),
        17 => (Other, "a motor driver reports a fault"),
        18 => (Homing, "homing failed"),
        _ => (Other, "not in GRBL's list"),
    }
}

fn alarm_of_fluidnc(code: u16) -> (AlarmCause, &'static str) {
    use AlarmCause::*;
    match code {
        10 => (Other, "the spindle does not answer"),
        11 => (EmergencyStop, "a control or limit input is active"),
        12 => (Homing, "both limit switches of an axis are closed"),
        13 => (LimitSwitch, "a limit switch was hit in motion (hard stop)"),
        14 => (HomingRequired, "homing is required"),
        15 => (HomingRequired, "it has just started"),
        16 => (Other, "the input/output expander has restarted"),
        17 => (Other, "a G-code command failed"),
        18 => (LimitSwitch, "a limit switch was hit while probing"),
        _ => (Other, "not in FluidNC's list"),
    }
}

/// Older and verbose builds say it in words.
fn cause_in_words(text: &str) -> AlarmCause {
    let text = text.to_ascii_lowercase();
    let says = |word| text.contains(word);
    match () {
        () if says("soft limit") => AlarmCause::SoftLimit,
        () if says("homing") => AlarmCause::Homing,
        () if says("limit") => AlarmCause::LimitSwitch,
        () if says("unhomed") => AlarmCause::HomingRequired,
        () if says("stop") => AlarmCause::EmergencyStop,
        () => AlarmCause::Other,
    }
}

/// An error with its meaning.
pub fn error(dialect: Dialect, code: &Code) -> String {
    match code {
        Code::Text(text) => format!("error: {text}"),
        Code::Number(number) => {
            let of_fluidnc = match dialect {
                Dialect::FluidNc => error_of_fluidnc(*number),
                Dialect::Grbl => None,
            };
            let meaning = of_fluidnc.unwrap_or_else(|| error_of_grbl(*number));
            format!("error {number}: {meaning}")
        }
    }
}

fn error_of_fluidnc(code: u16) -> Option<&'static str> {
    Some(match code {
        18 => "no axis has a homing cycle in the configuration",
        19 => "axes cannot be homed one by one",
        40 => "a control input is active",
        60..=70 | 82 | 83 => "the file system of the controller fails",
        80 | 81 => "the value is not allowed for this setting",
        110 => "a password is needed",
        120 => "the controller is used over another connection",
        130 => "the jog was cancelled",
        150..=152 => "the configuration file is faulty; the messages at its start name the place",
        41..=255 => "not in FluidNC's list",
        _ => return None,
    })
}

fn error_of_grbl(code: u16) -> &'static str {
    match code {
        1 => "a letter was expected",
        2 => "a number is malformed",
        3 => "no such $ command",
        4 => "a negative value where only positive ones are allowed",
        5 => "homing is not enabled ($22=0)",
        6 => "the step pulse is shorter than 3 µs",
        7 => "the settings memory was unreadable and has been reset",
        8 => "not possible unless the machine is idle",
        9 => "locked out by an alarm or a jog",
        10 => "soft limits need homing ($22)",
        11 => "the line is too long",
        12 => "the step rate is too high",
        13 => "the safety door is open",
        14 => "the line is too long to be stored",
        15 => "the jog's target is beyond the machine's travel",
        16 => "the jog is malformed",
        17 => "laser mode needs PWM output",
        18 => "a reset is needed",
        19 => "the value must be positive",
        20 => "a G-code command that this build does not support",
        21 => "two G-code commands of the same modal group",
        22 => "no feed rate is set",
        23 => "a G-code command needs an integer",
        24 => "two G-code commands need axis words",
        25 => "a G-code word is repeated",
        26 => "axis words are missing",
        27 => "the line number is invalid",
        28 => "a value word is missing",
        29 => "the work coordinate system is not supported",
        30 => "G53 needs G0 or G1",
        31 => "axis words without a command that uses them",
        32 => "an arc without axis words in its plane",
        33 => "the target is invalid",
        34 => "the arc's radius is impossible",
        35 => "an arc without offsets in its plane",
        36 => "words that no command uses",
        37 => "the tool length offset is not for this axis",
        38 => "the tool number is too large",
        39 => "a value is out of range",
        45 => "a limit switch is closed, so only homing is possible",
        46 => "homing is required",
        49 => "the self-test at power-on failed",
        50 => "the emergency stop is active",
        51 => "a motor driver reports a fault",
        79 => "not possible while a critical event is active",
        _ => "not in GRBL's list",
    }
}
