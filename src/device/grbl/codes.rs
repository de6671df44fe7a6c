//! What the alarm and error numbers of GRBL 1.1 (`alarm_codes_en_US.csv` and
//! `error_codes_en_US.csv` of its documentation) and of grblHAL (`alarms.h` and
//! `errors.h` of its core) mean, in our words.

/// An alarm with its meaning.
pub fn alarm(code: u16) -> String {
    let meaning = match code {
        1 => "a limit switch was hit in motion",
        2 => "the target is beyond the machine's travel (soft limit)",
        3 => "reset in motion, steps may be lost",
        4 => "the probe was not in its initial state",
        5 => "the probe made no contact",
        6 => "homing was reset",
        7 => "the safety door opened while homing",
        8 => "homing could not get off the limit switch",
        9 => "homing did not find the limit switch",
        10 => {
            "homing did not find the second limit switch of a dual axis, or, of grblHAL, \
             the emergency stop is active"
        }
        11 => "homing is required",
        12 => "a limit switch is closed",
        13 => "the probe's protection was triggered",
        14 => "the spindle did not reach its speed",
        15 => "homing did not find the second limit switch of an auto-squared axis",
        16 => "the self-test at power-on failed",
        17 => "a motor driver reports a fault",
        18 => "homing failed",
        _ => "not in GRBL's list",
    };
    format!("alarm {code}: {meaning}")
}

/// An error with its meaning.
pub fn error(code: u16) -> String {
    let meaning = match code {
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
    };
    format!("error {code}: {meaning}")
}
