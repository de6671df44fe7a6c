//! What the console's bench needs from the command line: opening devices as `rig stage` and
//! `rig camera` do, and the advice on their errors.

use std::sync::Arc;

use super::error::CliError;
use super::{hints, open};
use crate::capture::open::open_devices;
use crate::config::ResolvedRig;
use crate::console::control::Control;
use crate::console::held_devices::{BenchPorts, Opened};
use crate::console::picture::levels::SensorRecords;
use crate::device::manual::{Operator, Request};
use crate::device::{CameraSettings, LampState};
use crate::fault::{Advisor, Fault};
use crate::units::Seconds;

/// Exposure of the live picture before a page has set another one, as far as the camera has
/// it: that of `rig camera preview`.
const FIRST_EXPOSURE: Seconds = Seconds(10e-3);

/// Stage and camera of a rig, with its guardian.
pub(super) fn of_rig(rig: &ResolvedRig, control: &Control) -> BenchPorts {
    let (config, records, control) = (rig.config.clone(), SensorRecords::of(rig), control.clone());
    let [shortest, longest] = config.camera.exposure_range;
    let exposure = Seconds(FIRST_EXPOSURE.0.min(longest.0).max(shortest.0));
    let gain = config.camera.gain;
    BenchPorts {
        open: Box::new(move || {
            let devices = open::options_for(&config, || Ok(Arc::new(HandsOff)))
                .and_then(|options| Ok(open_devices(&config, &options)?))
                .map_err(fault)?;
            Ok(Opened::Rig(devices))
        }),
        advisor: advisor(),
        levels: Box::new(move |gain| records.levels(gain)),
        settings: CameraSettings { exposure, gain },
        silence: Box::new(move || control.silence()),
    }
}

/// By hand nothing is placed or lit from the page between captures: the lamp is off.
struct HandsOff;

impl Operator for HandsOff {
    fn ask(&self, request: Request) -> bool {
        request == Request::Lamp(LampState::Off)
    }
    fn tell(&self, _: Request) {}
}

/// The advice that the command line gives.
pub(super) fn advisor() -> Advisor {
    Advisor::new(hints::for_error)
}

/// For a page.
pub(super) fn fault(error: CliError) -> Fault {
    Fault {
        error: error.fact().to_owned(),
        hint: error.advice().map(str::to_owned),
    }
}
