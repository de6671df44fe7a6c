//! The sensor of `rig merge`: a rig's records and the options, which take precedence.

use std::str::FromStr;

use super::rig_choice::RigArg;
use super::{CliError, Context, HintExt};
use crate::calibration::noise::{FrameNoiseError, noise_of_frames};
use crate::radiometry::bracket_merge::CountModel;
use crate::radiometry::frame_file::FrameFile;
use crate::radiometry::sensor::SensorNoise;

/// One value for all pixels, or those of red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PerColour {
    All(f64),
    Each([f64; 3]),
}

impl FromStr for PerColour {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers = text.split(',').map(|part| part.trim().parse::<f64>());
        match numbers.collect::<Result<Vec<f64>, _>>().as_deref() {
            Ok(&[all]) => Ok(Self::All(all)),
            Ok(&[red, green, blue]) => Ok(Self::Each([red, green, blue])),
            _ => Err("must be a number, or three for red, green and blue: 1,1.2,1.5".to_owned()),
        }
    }
}

impl PerColour {
    fn of(self, colour: usize) -> f64 {
        match self {
            Self::All(value) => value,
            Self::Each(values) => values[colour],
        }
    }
}

/// The sensor, each value for all pixels or, as `R,G,B`, for each colour.
#[derive(clap::Args, Debug)]
pub(super) struct SensorArgs {
    /// System gain K (DN per electron; > 0); of each colour as R,G,B, such as 1,1.2,1.5 for
    /// counts whose white was balanced
    #[arg(long, value_name = "K", allow_hyphen_values = true)]
    gain: Option<PerColour>,
    /// Read noise, standard deviation (electrons; >= 0; or R,G,B)
    #[arg(long, value_name = "E", allow_hyphen_values = true)]
    read_noise: Option<PerColour>,
    /// Count without light (DN; or R,G,B): -0.5 where counts were cut to fewer bits after their
    /// black level was subtracted
    #[arg(long, value_name = "DN", allow_hyphen_values = true)]
    black_level: Option<PerColour>,
    /// Counts at or above this are clipped (DN; or R,G,B; default full scale)
    #[arg(long, value_name = "DN", allow_hyphen_values = true)]
    saturation: Option<PerColour>,
    /// Significant bits of a count (1 to 16; default the file's 8 or 16)
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(1..=16))]
    bit_depth: Option<u32>,
    /// Dark current (electrons per second; or R,G,B; default 0), used without dark or ambient
    /// frames
    #[arg(long, value_name = "RATE", allow_hyphen_values = true)]
    dark_current: Option<PerColour>,
    /// Electrons per second for unit radiance (or R,G,B; default 1: the image is in electrons per
    /// second)
    #[arg(long, value_name = "R", allow_hyphen_values = true)]
    responsivity: Option<PerColour>,
}

const SENSOR_HINT: &str =
    "--gain, --read-noise, --black-level, --saturation and --bit-depth describe the sensor";

impl SensorArgs {
    /// The sensor from the rig's records where --rig is given, and the options.
    pub fn model(
        &self,
        rig: &RigArg,
        context: &Context,
        frame: &FrameFile,
    ) -> Result<CountModel, CliError> {
        let base = match rig.rig {
            Some(_) => recorded_noise(rig, context, frame)?,
            None => self.described_noise(frame)?,
        };
        let noise = |colour| -> Result<SensorNoise, CliError> {
            let noise = self.applied_to(base.clone(), colour);
            noise.check(frame.width * frame.height).hint(SENSOR_HINT)?;
            Ok(noise)
        };
        let options = [
            self.gain,
            self.read_noise,
            self.black_level,
            self.saturation,
            self.dark_current,
            self.responsivity,
        ];
        let of_colours = |option: &PerColour| matches!(option, PerColour::Each(_));
        Ok(match options.iter().flatten().any(of_colours) {
            true => CountModel::Colours(Box::new([noise(0)?, noise(1)?, noise(2)?])),
            false => CountModel::Linear(Box::new(noise(0)?)),
        })
    }

    /// A sensor of which the options say everything.
    fn described_noise(&self, frame: &FrameFile) -> Result<SensorNoise, CliError> {
        let need = |value: Option<PerColour>, option: &str| {
            value.map(|value| value.of(0)).ok_or_else(|| {
                CliError::new(format!("the sensor is unknown: {option} is missing")).hint(
                    "give --gain, --read-noise and --black-level, or --rig for a rig with a sensor record",
                )
            })
        };
        Ok(SensorNoise::ideal(
            need(self.gain, "--gain")?,
            need(self.read_noise, "--read-noise")?,
            need(self.black_level, "--black-level")?,
            self.bit_depth.unwrap_or(frame.bits),
        ))
    }

    fn applied_to(&self, mut noise: SensorNoise, colour: usize) -> SensorNoise {
        let set = |target: &mut f64, value: Option<PerColour>| {
            if let Some(value) = value {
                *target = value.of(colour);
            }
        };
        set(&mut noise.gain_dn_per_e, self.gain);
        set(&mut noise.read_noise_e, self.read_noise);
        set(&mut noise.black_level_dn, self.black_level);
        set(&mut noise.dark_current_e_s, self.dark_current);
        set(&mut noise.responsivity_e_s, self.responsivity);
        set(&mut noise.saturation_dn, self.saturation);
        set(&mut noise.linear_max_dn, self.saturation);
        noise.bit_depth = self.bit_depth.unwrap_or(noise.bit_depth);
        noise
    }
}

fn recorded_noise(
    rig: &RigArg,
    context: &Context,
    frame: &FrameFile,
) -> Result<SensorNoise, CliError> {
    let size = [frame.width as u32, frame.height as u32];
    let found = noise_of_frames(&rig.resolve(context)?, size);
    found.map_err(|error| match error {
        FrameNoiseError::NoSensor { .. } => CliError::from(error)
            .hint("run `rig calibrate sensor`, or describe the sensor by options"),
        FrameNoiseError::OtherSize { .. } => CliError::from(error)
            .hint("choose the rig that took the frames, or describe the sensor by options"),
        error => error.into(),
    })
}
