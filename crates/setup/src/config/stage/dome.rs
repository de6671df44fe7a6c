//! The keys of stages with fixed lights: domes, and those moved by hand.

use super::Measures;
use super::lamp;
use crate::config::ConfigError;
use crate::config::reader::Section;
use crate::device::dome::DomeConfig;
use crate::device::kinematics::FixedLights;
use crate::device::manual::ManualConfig;
use crate::units::{Seconds, StageAngles};

/// Reads the `[stage]` table of a stage that is moved by hand.
pub fn read_manual(table: &mut Section) -> Result<(ManualConfig, Vec<Measures>), ConfigError> {
    let (lights, _) = read_lights(table, false)?;
    let (measures, channels) = read_channels(table)?;
    Ok((ManualConfig { lights, channels }, measures))
}

/// Reads the `[stage]` table of a dome on DMX.
pub fn read(table: &mut Section) -> Result<(DomeConfig, Vec<Measures>), ConfigError> {
    // A DMX USB Pro sets its own rate; any does.
    let (port, baud) = super::read_port(table, 115_200)?;
    let (lights, addresses) = read_lights(table, true)?;
    let (measures, channels) = read_channels(table)?;
    let last = addresses.iter().copied().max().unwrap_or(0);
    if usize::from(last) + usize::from(channels) > 513 {
        let allowed = "addresses whose last channel is at most 512";
        return Err(table.conflict("light", last, allowed));
    }
    let config = DomeConfig {
        port,
        baud: baud as u32,
        lights,
        addresses,
        channels,
        level: table.integer("level", 1..=255)?.or(255) as u8,
        connect_timeout: Seconds(table.number("connect_timeout_s", 0.1..=60.0)?.or(5.0)),
    };
    Ok((config, measures))
}

/// The directions, and the DMX address of each.
fn read_lights(table: &mut Section, dmx: bool) -> Result<(FixedLights, Vec<u16>), ConfigError> {
    let mut directions = Vec::new();
    let mut addresses = Vec::new();
    for mut light in table.sections("light")?.required()? {
        directions.push(StageAngles::new(
            light.number("azimuth_deg", -360.0..=360.0)?.required()?,
            light.number("elevation_deg", -90.0..=90.0)?.required()?,
        ));
        if dmx {
            addresses.push(light.integer("dmx_address", 1..=512)?.required()? as u16);
        }
        light.finish()?;
    }
    let lights = FixedLights {
        directions,
        tolerance_deg: table.number("tolerance_deg", 1e-3..=10.0)?.or(0.5),
    };
    Ok((lights, addresses))
}

/// What each channel measures, and how many there are: the lamp's channels are
/// the lights', in their order.
fn read_channels(table: &mut Section) -> Result<(Vec<Measures>, u8), ConfigError> {
    let (measures, slots) = lamp::read(table, |channel| {
        channel.integer("channel", 0..=2)?.required()
    })?;
    if slots.iter().enumerate().any(|(n, &slot)| slot != n as u64) {
        let given: Vec<_> = slots.iter().map(u64::to_string).collect();
        let allowed = "0, 1, 2 in the order of the tables";
        return Err(table.conflict("lamp", given.join(", "), allowed));
    }
    Ok((measures, slots.len() as u8))
}
