//! The keys of a stage on Zaber devices.

use super::axes;
use super::lamp;
use super::{LinkTimes, Measures};
use crate::config::ConfigError;
use crate::config::reader::Section;
use crate::device::zaber::{AxisAddress, LampSwitch, ZaberConfig};

/// That of Zaber's ASCII protocol.
const DEFAULT_BAUD: u64 = 115_200;

/// Reads the `[stage]` table of a Zaber chain.
pub fn read(table: &mut Section) -> Result<(ZaberConfig, Vec<Measures>), ConfigError> {
    let (port, baud) = super::read_port(table, DEFAULT_BAUD)?;
    let (kinematics, axes) = axes::read(table, |axis| {
        axis.parsed("axis", ADDRESS, address)?.required()
    })?;
    let (measures, lamp) = lamp::read(table, |channel| {
        channel.parsed("on", SWITCH, switch)?.required()
    })?;
    let times = LinkTimes::read(table)?;
    let config = ZaberConfig {
        port,
        baud: baud as u32,
        axes,
        kinematics,
        speed_per_s: table.number("speed_per_s", 1e-3..=1e4)?.or(20.0),
        lamp,
        connect_timeout: times.connect,
        reply_timeout: times.reply,
        homing_timeout: times.homing,
        position_tolerance_deg: times.position_tolerance_deg,
    };
    Ok((config, measures))
}

const ADDRESS: &str = "\"device/axis\", numbers from 1 to 99 and from 1 to 9";

fn address(text: &str) -> Option<AxisAddress> {
    let (device, axis) = text.split_once('/')?;
    let address = AxisAddress {
        device: device.parse().ok()?,
        axis: axis.parse().ok()?,
    };
    let valid = (1..=99).contains(&address.device) && (1..=9).contains(&address.axis);
    valid.then_some(address)
}

const SWITCH: &str = "\"output device/number\" or \"lamp device/axis\"";

fn switch(text: &str) -> Option<LampSwitch> {
    let (kind, place) = text.split_once(' ')?;
    let place = address(place)?;
    match kind {
        "output" => Some(LampSwitch::Output {
            device: place.device,
            output: place.axis,
        }),
        "lamp" => Some(LampSwitch::Illuminator(place)),
        _ => None,
    }
}
