//! `rig calibrate sensor`: photon transfer.

use super::light::attendant;
use super::target::{CommonArgs, noted};
use crate::calibrating::SensorRequest;
use crate::calibration::procedure::ProcedureOptions;
#[cfg(feature = "reports")]
use crate::calibration::record::Kind;
use crate::cli::{CliError, Context, open};
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

pub(super) fn run(args: &SensorArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let mut place = args.common.place(&rig, context)?;
    let request = SensorRequest {
        rig: &rig.config,
        frames: args.frames,
        open: &open::of_port()?,
    };
    let measured = request.measure(attendant(args.common.events, context)?.as_ref())?;
    let fit = &measured.fit;
    let kept = noted(measured.keep(&mut place)?, context);
    #[cfg(feature = "reports")]
    {
        let info = &measured.info;
        let page = SensorPage {
            camera: format!("{} {}", info.model, info.serial).trim().to_owned(),
            simulated: rig.config.is_simulated(),
            record: place.measurement.id(Kind::Sensor),
            method: measured.method.clone(),
            date: place.measurement.date.to_string(),
            settings: place.measurement.settings,
            fit,
            figures: &measured.emva1288,
        };
        if let Some(path) = place.write_plot(&kept, "html", page.render()?.as_bytes())? {
            context.note(format_args!("EMVA 1288 figures: {}", path.display()));
        }
    }
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
    args.common.show(&kept, &measured.report())
}
