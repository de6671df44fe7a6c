//! `rig calibrate`: the sensor and the flat field, from frames of a steady,
//! uniform light.

use std::io::{BufRead, IsTerminal};
use std::path::PathBuf;
use std::sync::Arc;

use clap::Subcommand;
use indicatif::ProgressBar;
use jiff::Timestamp;
use mock_devices::bench::{Bench as SimulatedBench, BenchConfig};
use mock_devices::camera::{CameraConfig as MockCameraConfig, SimulatedCamera as MockCamera};
use mock_devices::clock::Clock;
use mock_devices::sensor::{SensorConfig, SensorModel};
use mock_devices::{Illumination, RadianceSource};
use serde::Serialize;

use super::output::{write_json, write_stderr};
use super::rig_choice::RigArg;
use super::{CliError, Context, HintExt};
use crate::calibration::flat::to_map;
use crate::calibration::noise::sensor_noise;
use crate::calibration::procedure::{Bench, ProcedureOptions};
use crate::calibration::record::{
    FlatValues, Kind, Measured, Record, ScaleValues, SensorValues, Settings, Values,
};
use crate::calibration::sensor::TransferPoint;
use crate::calibration::{Library, Loaded};
use crate::config::{CameraConfig, RigConfig};
use crate::device::Camera;
use crate::device::simulated_camera::SimulatedCamera;
use crate::out;
use crate::random::{Purpose, stream};

/// Measures the bench and keeps what it finds as records
#[derive(clap::Args, Debug)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Measures gain, read noise, black level, dark current, full well and hot pixels, by
    /// photon transfer
    ///
    /// The camera looks at a steady, uniform light (an integrating sphere, or a lit
    /// diffuser in front of the lens).
    Sensor(SensorArgs),
    /// Measures the relative response of each pixel; with a light of known radiance also the scale
    ///
    /// Needs a sensor record. The camera looks at a steady, uniform light.
    Flat(FlatArgs),
}

#[derive(clap::Args, Debug)]
struct CommonArgs {
    #[command(flatten)]
    rig: RigArg,
    /// Folder of the rig's records; the record goes into its folder of that kind
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Name of the record; the date and the kind if not given
    #[arg(long, value_name = "ID")]
    id: Option<String>,
    /// Time of the measurement (UTC, RFC 3339); now if not given
    #[arg(long, value_name = "TIME", hide = true)]
    date: Option<Timestamp>,
    /// What was found, as JSON
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args, Debug)]
struct SensorArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Frames at each exposure (2 to 4096); the gain's uncertainty falls with its root
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(2..=4096))]
    frames: u32,
}

#[derive(clap::Args, Debug)]
struct FlatArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Flats and dark frames, each (1 to 65536); the map's noise falls with their root
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    frames: u32,
    /// Radiance of the light by its certificate, W/(m² sr): makes a scale record too
    #[arg(long, value_name = "L", requires = "radiance_std")]
    radiance: Option<f64>,
    /// Standard uncertainty of that radiance, W/(m² sr)
    #[arg(long, value_name = "U", requires = "radiance")]
    radiance_std: Option<f64>,
}

/// `rig calibrate`.
pub fn run(args: &CalibrateArgs, context: &Context) -> Result<(), CliError> {
    match &args.what {
        What::Sensor(args) => calibrate_sensor(args, context),
        What::Flat(args) => calibrate_flat(args, context),
    }
}

#[derive(Serialize)]
struct SensorReport<'a> {
    record: String,
    values: &'a SensorValues,
    reduced_chi2: f64,
    curve: Vec<CurvePoint>,
}

#[derive(Serialize)]
struct CurvePoint {
    exposure_s: f64,
    signal_dn: f64,
    variance_dn2: f64,
    variance_std_dn2: f64,
    fitted: bool,
}

impl From<&TransferPoint> for CurvePoint {
    fn from(point: &TransferPoint) -> Self {
        Self {
            exposure_s: point.exposure_s,
            signal_dn: point.signal_dn,
            variance_dn2: point.variance_dn2,
            variance_std_dn2: point.variance_std_dn2,
            fitted: point.fitted,
        }
    }
}

fn calibrate_sensor(args: &SensorArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context);
    let options = procedure_options(&rig.config.camera, args.frames);
    let mut camera = open_camera(&rig.config, UNIFORM_RADIANCE)?;
    let bit_depth = camera.info().bit_depth;
    let width = camera.info().resolution_px[0] as usize;
    let bar = progress(context, Bench::photon_transfer_frames(&options));
    let transfer = Bench::new(camera.as_mut(), options, &mut ask_to_cover, &mut || {
        bar.inc(1);
    })
    .photon_transfer()
    .hint(LIGHT_HINT)?;
    bar.finish_and_clear();
    let fit = transfer.solve(width, bit_depth).hint(LIGHT_HINT)?;
    let levels = fit.curve.len();
    let method = format!(
        "photon transfer (EMVA 1288), {levels} exposures of {} frames, reduced chi-square {:.3}",
        args.frames, fit.reduced_chi2
    );
    let path = target.add(fit.values.clone(), &method, &[])?;
    let v = &fit.values;
    context.note(format_args!(
        "gain {:.4} ± {:.4} DN/e⁻, read noise {:.3} ± {:.3} e⁻, black level {:.2} DN, \
         dark current {:.2} e⁻/s, full well {:.0} e⁻, linear within {:.2}%, {} hot pixels",
        v.gain_dn_per_e.value,
        v.gain_dn_per_e.std,
        v.read_noise_e.value,
        v.read_noise_e.std,
        v.black_level_dn.value,
        v.dark_current_e_s.value,
        v.full_well_e.value,
        100.0 * v.linearity_error,
        v.hot_pixels.len(),
    ));
    if !args.common.json {
        return out!("{}", path.display());
    }
    write_json(&SensorReport {
        record: path.display().to_string(),
        values: v,
        reduced_chi2: fit.reduced_chi2,
        curve: fit.curve.iter().map(CurvePoint::from).collect(),
    })
}

#[derive(Serialize)]
struct FlatReport {
    flat: String,
    scale: Option<String>,
    std: f64,
    nonuniformity: f64,
    responsivity_e_s: Option<Measured>,
}

fn calibrate_flat(args: &FlatArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let library = Library::of_rig(&rig);
    let target = Target::new(&rig.config, library.clone(), &args.common, context);
    let pinned = rig.config.calibration.sensor.as_deref();
    // A record measured just before into --out counts.
    let measured = target.library.load::<SensorValues>(None)?;
    let sensor: Loaded<SensorValues> = match measured {
        Some(sensor) => sensor,
        None => library
            .load(pinned)?
            .ok_or_else(|| {
                CliError::new(format!("there is no sensor record in {}", library.place()))
            })
            .hint("run `rig calibrate sensor` first")?,
    };
    let resolution_px = rig.config.camera.resolution_px;
    let noise = sensor_noise(&sensor.record.values, None, None, resolution_px)?;
    let options = procedure_options(&rig.config.camera, args.frames);
    let certified = args.radiance.zip(args.radiance_std);
    let true_radiance = certified.map_or(UNIFORM_RADIANCE, |(radiance, std)| {
        // A simulated light differs from its certificate as a real one does.
        let seed = rig.config.simulation.as_ref().map_or(0, |s| s.seed);
        radiance + std * stream(seed, Purpose::BenchPerturbation, u64::MAX, 0, 0).normal()
    });
    let mut camera = open_camera(&rig.config, true_radiance)?;
    let bar = progress(context, 2 * args.frames);
    let (flat, rate_e_s) = Bench::new(camera.as_mut(), options, &mut ask_to_cover, &mut || {
        bar.inc(1);
    })
    .flat_field(&noise)
    .hint(LIGHT_HINT)?;
    bar.finish_and_clear();

    let map_file = format!("{}.png", target.id(Kind::Flat));
    let (values, png) = to_map(&flat, resolution_px[0] as usize, &map_file)?;
    let std = values.std;
    let method = format!("mean of {0} flats less {0} dark frames", args.frames);
    let path = target.add::<FlatValues>(values, &method, &[(&map_file, &png)])?;

    let gain = sensor.record.values.gain_dn_per_e;
    let responsivity_e_s = certified.map(|(radiance, radiance_std)| Measured {
        value: rate_e_s / radiance,
        std: rate_e_s / radiance * (radiance_std / radiance).hypot(gain.std / gain.value),
    });
    let scale = match responsivity_e_s {
        None => None,
        Some(responsivity_e_s) => {
            let method = "mean rate under a light of certified radiance";
            Some(target.add(ScaleValues { responsivity_e_s }, method, &[])?)
        }
    };
    let variance = flat.response.iter().map(|&r| f64::from(r - 1.0).powi(2));
    let nonuniformity = (variance.sum::<f64>() / flat.response.len().max(1) as f64).sqrt();
    context.note(format_args!(
        "response varies by {:.2}% between pixels, known to {:.3}%",
        100.0 * nonuniformity,
        100.0 * std
    ));
    if args.common.json {
        return write_json(&FlatReport {
            flat: path.display().to_string(),
            scale: scale.map(|path| path.display().to_string()),
            std,
            nonuniformity,
            responsivity_e_s,
        });
    }
    out!("{}", path.display())?;
    match scale {
        Some(path) => out!("{}", path.display()),
        None => Ok(()),
    }
}

/// Radiance of the simulated uniform light, W/(m² sr), where none is stated.
const UNIFORM_RADIANCE: f64 = 0.4;

const LIGHT_HINT: &str = "point the camera at a steady, uniform light that saturates it within two \
    seconds but not in its shortest exposure; nothing was kept";

/// Where the records of one calibration go, and what they have in common.
struct Target<'a> {
    rig: &'a RigConfig,
    library: Library,
    id: Option<&'a str>,
    date: Timestamp,
    device_serial: String,
}

impl<'a> Target<'a> {
    fn new(rig: &'a RigConfig, library: Library, args: &'a CommonArgs, context: &Context) -> Self {
        let library = match (&args.out, library) {
            (Some(folder), _) => Library::Folder(folder.clone()),
            (None, Library::BuiltIn(_)) => {
                let folder = PathBuf::from("calibration").join(&rig.name);
                context.note(format_args!(
                    "built-in records stay as they are: writing to {}",
                    folder.display()
                ));
                Library::Folder(folder)
            }
            (None, folder) => folder,
        };
        Self {
            rig,
            library,
            id: args.id.as_deref(),
            date: args.date.unwrap_or_else(Timestamp::now),
            device_serial: rig.camera.serial.clone().unwrap_or_default(),
        }
    }

    fn id(&self, kind: Kind) -> String {
        match self.id {
            Some(id) => id.to_owned(),
            None => format!("{}-{}", self.date.strftime("%Y%m%dT%H%M%SZ"), kind.folder()),
        }
    }

    fn add<V: Values>(
        &self,
        values: V,
        method: &str,
        maps: &[(&str, &[u8])],
    ) -> Result<PathBuf, CliError> {
        let source = if self.rig.is_simulated() {
            "rig calibrate, on the simulated bench"
        } else {
            "rig calibrate"
        };
        let record = Record {
            id: self.id(V::KIND),
            kind: V::KIND,
            rig: self.rig.name.clone(),
            device_serial: self.device_serial.clone(),
            date: self.date.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
            valid_until: None,
            method: method.to_owned(),
            source: source.to_owned(),
            settings: Settings {
                gain: Some(self.rig.camera.gain),
                bit_depth: Some(self.rig.camera.bit_depth),
                resolution_px: Some(self.rig.camera.resolution_px),
            },
            values,
        };
        self.library
            .add(&record, maps)?
            .ok_or_else(|| CliError::new("the built-in records cannot be added to"))
    }
}

fn procedure_options(camera: &CameraConfig, frames: u32) -> ProcedureOptions {
    ProcedureOptions {
        gain: camera.gain,
        frames,
        discard: camera.settings_latency_frames + 1,
        ..ProcedureOptions::default()
    }
}

fn progress(context: &Context, frames: u32) -> ProgressBar {
    if context.shows_progress() {
        ProgressBar::new(u64::from(frames))
    } else {
        ProgressBar::hidden()
    }
}

/// Asks the operator where the camera has no shutter; without a terminal there
/// is nobody to ask.
fn ask_to_cover(cover: bool) -> bool {
    if !std::io::stdin().is_terminal() {
        return false;
    }
    let what = if cover { "Cover" } else { "Uncover" };
    write_stderr(&format!("{what} the lens, then press Enter: "));
    std::io::stdin()
        .lock()
        .lines()
        .next()
        .is_some_and(|line| line.is_ok())
}

/// The rig's camera; a simulated one sees an even light of this radiance.
fn open_camera(rig: &RigConfig, radiance: f64) -> Result<Box<dyn Camera>, CliError> {
    match simulated_sensor(rig) {
        Some(sensor) => Ok(uniformly_lit(&rig.camera, sensor, radiance)),
        None => super::open::open_real_camera(rig),
    }
}

/// The true sensor of a simulated rig: calibration and capture must see the same one.
pub fn simulated_sensor(rig: &RigConfig) -> Option<SensorConfig> {
    Some(rig.simulation.as_ref()?.sensor.clone())
}

/// The simulated camera in front of an integrating sphere.
fn uniformly_lit(camera: &CameraConfig, sensor: SensorConfig, radiance: f64) -> Box<dyn Camera> {
    struct Sphere {
        resolution_px: [u32; 2],
        radiance: Arc<Vec<f32>>,
    }
    impl RadianceSource for Sphere {
        fn resolution_px(&self) -> [u32; 2] {
            self.resolution_px
        }
        fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
            self.radiance.clone()
        }
    }
    let [width, height] = camera.resolution_px.map(|n| n as usize);
    let sphere = Sphere {
        resolution_px: camera.resolution_px,
        radiance: Arc::new(vec![radiance as f32; width * height]),
    };
    let config = MockCameraConfig {
        exposure_range_s: camera.exposure_range.map(|s| s.0),
        exposure_step_s: camera.exposure_step.0,
        settings_latency_frames: camera.settings_latency_frames,
        has_shutter: true,
        // Frames of a calibration and of a capture must not share their noise.
        noise_seed: sensor.seed ^ 0x6361_6c69_6272_6174,
        ..MockCameraConfig::default()
    };
    let bench = SimulatedBench::new(BenchConfig::default(), Clock::instant());
    let mock = MockCamera::new(config, bench, SensorModel::new(sensor), Arc::new(sphere));
    let serial = camera.serial.clone().unwrap_or_default();
    Box::new(SimulatedCamera::new(mock, serial, camera.mosaic))
}
