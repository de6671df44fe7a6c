//! `rig calibrate glare`: the light that the lens scatters, from black traps on a white card.

use std::path::PathBuf;
use std::sync::Arc;

use mock_devices::bench::{Bench as SimulatedBench, BenchConfig};
use mock_devices::clock::Clock;
use mock_devices::{Illumination, RadianceSource};
use serde::Serialize;

use super::light::{LIGHT_HINT, UNIFORM_RADIANCE, ask_to_cover, simulated_camera};
use super::target::{CommonArgs, Target};
use super::white::parse_region;
use super::{focus, procedure_options, progress};
use crate::calibration::Library;
use crate::calibration::glare::{GlareRequest, GlareValues, measure};
use crate::calibration::mirror_sphere::Grey;
use crate::calibration::procedure::{Bench, ProcedureOptions};
use crate::calibration::record::Measured;
use crate::calibration::white::Region;
use crate::capture::open::open_real_camera;
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, HintExt};
use crate::config::RigConfig;
use crate::device::Camera;
use crate::random::{Purpose, stream};
use crate::simulation::glare_card;

#[derive(clap::Args, Debug)]
pub(super) struct GlareArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// Radiance image of the card (OpenEXR, by `rig merge`) or session captured with it in place
    /// of the sample; if not given, the camera takes frames now
    #[arg(value_name = "EXR|SESSION")]
    input: Option<PathBuf>,
    /// A part of the image inside a trap, away from its edge (pixels); once for each trap. The
    /// simulated card has two, which need not be named
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_region)]
    trap: Vec<Region>,
    /// What the traps reflect over what the card does
    #[arg(long, value_name = "R", default_value_t = GlareRequest::TRAP_REFLECTANCE, value_parser = share)]
    trap_reflectance: f64,
    /// Standard uncertainty of that
    #[arg(long, value_name = "U", default_value_t = GlareRequest::TRAP_REFLECTANCE_STD, value_parser = share)]
    trap_reflectance_std: f64,
    /// Which light's image of a session is used
    #[arg(long, value_name = "N", default_value_t = 0)]
    light: usize,
    /// Frames of the card and dark frames, each (1 to 65536)
    #[arg(long, value_name = "N", default_value_t = ProcedureOptions::FLAT_FRAMES, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    frames: u32,
}

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.trim().parse().map_err(|_| "not a number".to_owned())?;
    match (0.0..=0.1).contains(&value) {
        true => Ok(value),
        false => Err("not in 0 to 0.1".to_owned()),
    }
}

#[derive(Serialize)]
struct GlareReport<'a> {
    record: String,
    #[serde(flatten)]
    values: &'a GlareValues,
}

const TRAP_HINT: &str = "put a deep box, black inside, behind a hole in a white card that fills the image, and name with \
    --trap a part of the image inside the hole, away from its edge; nothing was kept";

pub(super) fn run(args: &GlareArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.common.rig.resolve(context)?;
    let mut target = Target::new(&rig.config, Library::of_rig(&rig), &args.common, context)?;
    let trap_reflectance = Measured {
        value: args.trap_reflectance,
        std: args.trap_reflectance_std,
    };
    let mut traps = args.trap.clone();
    // The card, from files or from frames.
    let (image, source) = match &args.input {
        Some(path) => {
            let image = focus::read(path, args.light, &rig.config.name)?;
            (Grey::of(&image), path.display().to_string())
        }
        None => {
            let (mut camera, simulated) = open(&rig.config, trap_reflectance)?;
            if traps.is_empty() {
                traps = simulated;
            }
            let bar = progress(context, 2 * args.frames);
            let mut step = || bar.inc(1);
            let mut cover = ask_to_cover;
            let options = procedure_options(&rig.config.camera, args.frames);
            let mut bench = Bench::new(camera.as_mut(), options, &mut cover, &mut step);
            let picture = bench.picture().hint(LIGHT_HINT)?;
            bar.finish_and_clear();
            (picture, target.measurement.source.clone())
        }
    };
    let values = measure(&GlareRequest {
        image: &image,
        traps: &traps,
        trap_reflectance,
    })
    .hint(TRAP_HINT)?;
    // The record.
    target = target.measured_from(source, rig.config.camera.resolution_px);
    let method = format!("{} black trap(s) on a white card", traps.len());
    let path = target.add(values, &method, &[])?;
    for (what, share) in [
        ("evenly", values.uniform),
        ("into a halo", values.halo),
        ("in all", values.total()),
    ] {
        context.note(format_args!(
            "the lens scatters {:.3} ± {:.3}% of the light {what}",
            100.0 * share.value,
            100.0 * share.std
        ));
    }
    if args.common.json {
        return write_json(&GlareReport {
            record: path.display().to_string(),
            values: &values,
        });
    }
    write_path(&path)
}

/// The rig's camera; a simulated one sees a card with traps, which are named.
fn open(
    rig: &RigConfig,
    trap_reflectance: Measured,
) -> Result<(Box<dyn Camera>, Vec<Region>), CliError> {
    struct Card {
        resolution_px: [u32; 2],
        radiance: Arc<Vec<f32>>,
    }
    impl RadianceSource for Card {
        fn resolution_px(&self) -> [u32; 2] {
            self.resolution_px
        }
        fn radiance(&self, _: &Illumination) -> Arc<Vec<f32>> {
            self.radiance.clone()
        }
    }
    let Some(simulation) = &rig.simulation else {
        let camera = open_real_camera(rig, &crate::cli::open::of_port()?)?;
        return Ok((camera, Vec::new()));
    };
    // The simulated traps differ from what is stated as real ones do.
    let purpose = Purpose::BenchPerturbation;
    let error = stream(simulation.seed, purpose, u64::MAX, 1, 0).normal();
    let true_reflectance = (trap_reflectance.value + trap_reflectance.std * error).max(0.0);
    let resolution_px = rig.camera.resolution_px;
    let (card, traps) = glare_card::card(
        resolution_px.map(|n| n as usize),
        [UNIFORM_RADIANCE, true_reflectance],
        simulation.glare,
    );
    let source = Card {
        resolution_px,
        radiance: Arc::new(card),
    };
    let bench = SimulatedBench::new(BenchConfig::default(), Clock::instant());
    let sensor = simulation.sensor.clone();
    let camera = simulated_camera(&rig.camera, sensor, bench, Arc::new(source));
    let region = |[x, y, width, height]: [usize; 4]| Region {
        x,
        y,
        width,
        height,
    };
    Ok((camera, traps.map(region).to_vec()))
}
