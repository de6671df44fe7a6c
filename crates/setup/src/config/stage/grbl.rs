//! The keys of a stage with a GRBL controller.

use super::axes;
use super::lamp;
use super::{LinkTimes, Measures};
use crate::config::ConfigError;
use crate::config::reader::Section;
use crate::device::grbl::GrblConfig;

/// GRBL's own.
const DEFAULT_BAUD: u64 = 115_200;

/// Reads the `[stage]` table of a GRBL controller; a simulated one has no port.
pub fn read(
    table: &mut Section,
    simulated: bool,
) -> Result<(GrblConfig, Vec<Measures>), ConfigError> {
    let (port, baud) = if simulated {
        (String::new(), DEFAULT_BAUD)
    } else {
        super::read_port(table, DEFAULT_BAUD)?
    };
    let (kinematics, axes) = axes::read(table, axis_letter)?;
    let (measures, lamp_on) = lamp::read(table, |channel| {
        channel.parsed("on", COMMANDS, commands)?.required()
    })?;
    let times = LinkTimes::read(table)?;
    let config = GrblConfig {
        port,
        baud: baud as u32,
        axes,
        kinematics,
        feed_per_min: table.number("feed_per_min", 1.0..=1e5)?.or(3000.0),
        lamp_off: table.parsed("lamp_off", COMMANDS, commands)?.required()?,
        lamp_on,
        connect_timeout: times.connect,
        reply_timeout: times.reply,
        homing_timeout: times.homing,
        position_tolerance_deg: times.position_tolerance_deg,
    };
    Ok((config, measures))
}

fn axis_letter(axis: &mut Section) -> Result<char, ConfigError> {
    let letter = |text: &str| match text {
        "X" | "Y" | "Z" | "A" | "B" | "C" => text.chars().next(),
        _ => None,
    };
    axis.parsed("axis", "one of X, Y, Z, A, B, C", letter)?
        .required()
}

const COMMANDS: &str = "controller commands separated by `;`, printable ASCII, at most 80 each";

/// `"M5; M9"` as its commands. Real-time characters would act out of turn and are refused.
fn commands(text: &str) -> Option<Vec<String>> {
    let commands: Vec<_> = text
        .split(';')
        .map(|command| command.trim().to_owned())
        .collect();
    let valid = |command: &String| {
        !command.is_empty()
            && command.len() <= 80
            && command
                .bytes()
                .all(|b| (b' '..=b'~').contains(&b) && !b"?!~$".contains(&b))
    };
    commands.iter().all(valid).then_some(commands)
}
