//! `rig calibrate flat`: the relative response of each pixel, and the scale.

use std::sync::atomic::Ordering;

use serde::Serialize;

use super::light::{
    LIGHT_HINT, UNIFORM_RADIANCE, ask_to_cover, ask_to_switch, open_switched_camera,
};
use super::target::{CommonArgs, Target};
use super::{procedure_options, progress};
use crate::calibration::flat::to_map;
use crate::calibration::noise::sensor_noise;
use crate::calibration::procedure::{Bench, ProcedureOptions};
use crate::calibration::record::{FlatValues, Kind, Measured, ScaleValues, SensorValues};
use crate::calibration::{Library, Loaded};
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, HintExt};
use crate::random::{Purpose, stream};

#[derive(clap::Args, Debug)]
pub(super) struct FlatArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Flats and dark frames, each (1 to 65536); the map's noise falls with their root
    #[arg(long, value_name = "N", default_value_t = ProcedureOptions::FLAT_FRAMES, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    frames: u32,
    /// Subtract frames with the light switched off and the room as it is, instead of dark ones
    #[arg(long)]
    ambient: bool,
    /// Radiance of the light by its certificate, W/(m² sr): makes a scale record too
    #[arg(long, value_name = "L", requires = "radiance_std")]
    radiance: Option<f64>,
    /// Standard uncertainty of that radiance, W/(m² sr)
    #[arg(long, value_name = "U", requires = "radiance")]
    radiance_std: Option<f64>,
}

#[derive(Serialize)]
struct FlatReport {
    flat: String,
    scale: Option<String>,
    std: f64,
    nonuniformity: f64,
    responsivity_e_s: Option<Measured>,
    ambient: Option<Measured>,
}

pub(super) fn run(args: &FlatArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let library = Library::of_rig(&rig);
    let mut target = Target::new(&rig.config, library.clone(), &args.common, context)?;
    let pinned = rig.config.calibration.sensor.as_deref();
    // A record measured just before into --out counts.
    let gain = rig.config.camera.gain;
    let measured = target.library.load_for::<SensorValues>(None, gain)?;
    let sensor: Loaded<SensorValues> = match measured {
        Some(sensor) => sensor,
        None => library
            .load_for(pinned, gain)?
            .ok_or_else(|| {
                CliError::new(format!("there is no sensor record in {}", library.place()))
            })
            .hint("run `rig calibrate sensor` first")?,
    };
    // The sensor's noise.
    let serial = rig.config.camera.serial.as_deref().unwrap_or_default();
    sensor.check_camera(serial, &rig.config.camera)?;
    let resolution_px = rig.config.camera.resolution_px;
    let noise = sensor_noise(&sensor, None, None, resolution_px)?;
    let options = procedure_options(&rig.config.camera, args.frames);
    // The light, real or simulated, and the frames under it.
    let certified = args.radiance.zip(args.radiance_std);
    let true_radiance = certified.map_or(UNIFORM_RADIANCE, |(radiance, std)| {
        // A simulated light differs from its certificate as a real one does.
        let seed = rig.config.simulation.as_ref().map_or(0, |s| s.seed);
        radiance + std * stream(seed, Purpose::BenchPerturbation, u64::MAX, 0, 0).normal()
    });
    let room = rig.config.simulation.as_ref().map(|s| s.ambient_w_m2_sr);
    let other = room.filter(|_| args.ambient).unwrap_or(0.0);
    let (mut camera, simulated_switch) = open_switched_camera(&rig.config, true_radiance, other)?;
    let mut switch = |on: bool| match &simulated_switch {
        Some(light) => {
            light.store(on, Ordering::Relaxed);
            true
        }
        None => ask_to_switch(on),
    };
    let bar = progress(context, 2 * args.frames);
    let mut step = || bar.inc(1);
    let mut cover = ask_to_cover;
    let bench = Bench::new(camera.as_mut(), options, &mut cover, &mut step);
    let mut bench = match args.ambient {
        true => bench.with_switch(&mut switch),
        false => bench,
    };
    let fit = bench.flat_field(&noise).hint(LIGHT_HINT)?;
    let ambient = fit.ambient;
    bar.finish_and_clear();
    target.measurement.settings.sensor_c = camera.temperature_c();

    // The records.
    let map_file = format!("{}.png", target.measurement.id(Kind::Flat));
    let (values, png) = to_map(&fit.flat, resolution_px[0] as usize, &map_file)?;
    let values = FlatValues { ambient, ..values };
    let std = values.std;
    let unlit = if args.ambient { "ambient" } else { "dark" };
    let method = format!("mean of {0} flats less {0} {unlit} frames", args.frames);
    let path = target.add::<FlatValues>(values, &method, &[(&map_file, &png)])?;

    let gain = sensor.record.values.gain_dn_per_e;
    let responsivity_e_s =
        certified.map(|(value, std)| fit.responsivity_e_s(Measured { value, std }, gain));
    let scale = match responsivity_e_s {
        None => None,
        Some(responsivity_e_s) => {
            let method = "mean rate under a light of certified radiance";
            Some(target.add(ScaleValues { responsivity_e_s }, method, &[])?)
        }
    };
    // What was found.
    let nonuniformity = fit.nonuniformity();
    context.note(format_args!(
        "response varies by {:.2}% between pixels, known to {:.3}%",
        100.0 * nonuniformity,
        100.0 * std
    ));
    if let Some(ambient) = ambient {
        context.note(format_args!(
            "the room adds {:.2}% of the light, which was subtracted",
            100.0 * ambient.value
        ));
    }
    if args.common.json {
        return write_json(&FlatReport {
            ambient,
            flat: path.display().to_string(),
            scale: scale.map(|path| path.display().to_string()),
            std,
            nonuniformity,
            responsivity_e_s,
        });
    }
    write_path(&path)?;
    match scale {
        Some(path) => write_path(&path),
        None => Ok(()),
    }
}
