//! `rig calibrate sensor`: photon transfer.

use serde::Serialize;

use super::light::{LIGHT_HINT, UNIFORM_RADIANCE, ask_to_cover, open_camera};
use super::target::{CommonArgs, Target};
use super::{procedure_options, progress};
use crate::calibration::Library;
#[cfg(feature = "figures")]
use crate::calibration::figures;
use crate::calibration::procedure::{Bench, ProcedureOptions};
use crate::calibration::record::{Kind, SensorValues};
use crate::calibration::sensor::TransferPoint;
use crate::calibration::sensor::emva1288::Emva1288;
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, HintExt};
#[cfg(feature = "reports")]
use crate::report::sensor_page::SensorPage;

#[derive(clap::Args, Debug)]
pub(super) struct SensorArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Frames at each exposure (2 to 4096); the gain's uncertainty falls with its root
    #[arg(long, value_name = "N", default_value_t = ProcedureOptions::FRAMES, value_parser = clap::value_parser!(u32).range(2..=4096))]
    frames: u32,
}

#[derive(Serialize)]
struct SensorReport<'a> {
    record: String,
    values: &'a SensorValues,
    reduced_chi2: f64,
    emva1288: &'a Emva1288,
    curve: Vec<CurvePoint>,
}

#[derive(Serialize)]
struct CurvePoint {
    exposure_s: f64,
    counted_dn: f64,
    signal_dn: f64,
    variance_dn2: f64,
    variance_std_dn2: f64,
    fitted: bool,
}

impl From<&TransferPoint> for CurvePoint {
    fn from(point: &TransferPoint) -> Self {
        Self {
            exposure_s: point.exposure_s,
            counted_dn: point.counted_dn,
            signal_dn: point.signal_dn,
            variance_dn2: point.variance_dn2,
            variance_std_dn2: point.variance_std_dn2,
            fitted: point.fitted,
        }
    }
}

pub(super) fn run(args: &SensorArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let mut target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context)?;
    let options = procedure_options(&rig.config.camera, args.frames);
    let mut camera = open_camera(&rig.config, UNIFORM_RADIANCE)?;
    let info = camera.info().clone();
    let bit_depth = info.bit_depth;
    let width = info.resolution_px[0] as usize;
    let bar = progress(context, Bench::photon_transfer_frames(&options));
    let transfer = Bench::new(camera.as_mut(), options, &mut ask_to_cover, &mut || {
        bar.inc(1);
    })
    .photon_transfer()
    .hint(LIGHT_HINT)?;
    bar.finish_and_clear();
    target.measurement.settings.sensor_c = camera.temperature_c();
    let fit = transfer.solve(width, bit_depth).hint(LIGHT_HINT)?;
    let levels = fit.curve.len();
    let method = format!(
        "photon transfer (EMVA 1288), {levels} exposures of {} frames, reduced chi-square {:.3}",
        args.frames, fit.reduced_chi2
    );
    let id = target.measurement.id(Kind::Sensor);
    let (dark, maps) = fit.dark.to_values(width, &id)?;
    let values = SensorValues {
        dark_pattern: Some(dark),
        ..fit.values.clone()
    };
    let maps = maps
        .each_ref()
        .map(|(file, bytes)| (file.as_str(), bytes.as_slice()));
    let path = target.add(values, &method, &maps)?;
    #[cfg(feature = "figures")]
    target.draw(&figures::photon_transfer(&fit), &path, context)?;
    let emva1288 = transfer.emva1288(&fit, rig.config.camera.mosaic);
    #[cfg(feature = "reports")]
    target.put_page(
        &SensorPage {
            camera: format!("{} {}", info.model, info.serial).trim().to_owned(),
            simulated: rig.config.is_simulated(),
            record: id,
            method,
            date: target.measurement.date.to_string(),
            settings: target.measurement.settings,
            fit: &fit,
            figures: &emva1288,
        }
        .render()?,
        &path,
        context,
    )?;
    let v = &fit.values;
    context.note(format_args!(
        "gain {:.4} ± {:.4} DN/e⁻, read noise {:.3} ± {:.3} e⁻, black level {:.2} DN, \
         dark current {:.2} e⁻/s, full well {:.0} e⁻, \
         linear within {:.2}%, corrected within {:.2}%, {} hot pixels",
        v.gain_dn_per_e.value,
        v.gain_dn_per_e.std,
        v.read_noise_e.value,
        v.read_noise_e.std,
        v.black_level_dn.value,
        v.dark_current_e_s.value,
        v.full_well_e.value,
        100.0 * v.linearity_error,
        100.0 * v.linearity_residual.unwrap_or(v.linearity_error),
        v.hot_pixels.len(),
    ));
    if !args.common.json {
        return write_path(&path);
    }
    write_json(&SensorReport {
        record: path.display().to_string(),
        values: v,
        reduced_chi2: fit.reduced_chi2,
        emva1288: &emva1288,
        curve: fit.curve.iter().map(CurvePoint::from).collect(),
    })
}
