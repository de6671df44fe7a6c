//! `rig calibrate lamp`: warm-up, drift and flicker.

use std::time::Duration;

use serde::Serialize;

use super::light::lamp_bench;
use super::target::{CommonArgs, Target};
use crate::calibration::Library;
#[cfg(feature = "figures")]
use crate::calibration::figures;
use crate::calibration::lamp::LampFit;
use crate::calibration::lamp_watch::{Watch, WatchOptions};
use crate::calibration::record::LampValues;
use crate::capture::open::open_devices;
use crate::cli::output::{write_json, write_path};
use crate::cli::{CliError, Context, HintExt, open};
use crate::device::{LampChannel, LampState};

#[derive(clap::Args, Debug)]
pub(super) struct LampArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// How long the lamp is watched (minutes; 2 to 240)
    #[arg(long, value_name = "MIN", default_value_t = WatchOptions::MINUTES)]
    minutes: f64,
    /// Time between two levels (seconds; 0.1 to 60)
    #[arg(long, value_name = "S", default_value_t = WatchOptions::INTERVAL_S)]
    interval: f64,
    /// Which channel of the lamp
    #[arg(long, value_name = "N", default_value_t = 0)]
    channel: u8,
    /// Frames in quick succession at each of four exposures, for flicker (16 to 4096)
    #[arg(long, value_name = "N", default_value_t = WatchOptions::BURST, value_parser = clap::value_parser!(u32).range(16..=4096))]
    burst: u32,
}

#[derive(Serialize)]
struct LampReport<'a> {
    record: String,
    values: &'a LampValues,
    levels: Vec<[f64; 2]>,
}

const SCENE_HINT: &str = "let the lamp cool, put a white card where it is lit evenly, cover other \
    light, and touch nothing; nothing was kept";

pub(super) fn run(args: &LampArgs, context: &Context) -> Result<(), CliError> {
    for (option, value, low, high) in [
        ("--minutes", args.minutes, 2.0, 240.0),
        ("--interval", args.interval, 0.1, 60.0),
    ] {
        if !(low..=high).contains(&value) {
            return Err(CliError::new(format!("{option} is {value}"))
                .hint(format!("it must be a number from {low} to {high}")));
        }
    }
    // The rig, and where the record goes.
    let rig = args.common.rig.resolve(context)?;
    let config = &rig.config;
    let channels = config.stage.measures.len();
    if usize::from(args.channel) >= channels {
        return Err(
            CliError::new(format!("the lamp has no channel {}", args.channel)).hint(format!(
                "its channels are 0 to {}",
                channels.saturating_sub(1)
            )),
        );
    }
    let mut target = Target::new(config, Library::of_rig(&rig), &args.common, context)?;
    let options = WatchOptions {
        gain: config.camera.gain,
        watch_s: 60.0 * args.minutes,
        interval_s: args.interval,
        burst: args.burst,
        discard: config.camera.settings_latency_frames + 1,
    };
    // The lamp, watched.
    let bar = super::progress(context, 1000);
    let mut progress = |part: f64| bar.set_position((1000.0 * part) as u64);
    let fit: LampFit = match lamp_bench(config, args.channel) {
        Some(mut bench) => {
            let mut wait = |seconds| bench.clock.advance(seconds);
            let mut watch = Watch::new(
                bench.camera.as_mut(),
                bench.switch.as_mut(),
                &mut wait,
                &mut progress,
            );
            let fit = watch.run(&options).hint(SCENE_HINT)?;
            target.measurement.settings.sensor_c = bench.camera.temperature_c();
            fit
        }
        None => {
            context.note(
                "a white card where the lamp lights it evenly, no other light, the lamp cold",
            );
            let devices = open_devices(config, &open::options(config)?)?;
            let (mut stage, mut camera) = (devices.stage, devices.camera);
            let watchdog = stage.watchdog();
            let mut switch = |on: bool| {
                let state = match on {
                    true => LampState::On(LampChannel(args.channel)),
                    false => LampState::Off,
                };
                stage.set_lamp(state).map(|_| ())
            };
            let mut wait = |seconds: f64| {
                watchdog.wait(Duration::try_from_secs_f64(seconds).unwrap_or_default());
            };
            let mut watch = Watch::new(camera.as_mut(), &mut switch, &mut wait, &mut progress);
            let fit = watch.run(&options).hint(SCENE_HINT)?;
            target.measurement.settings.sensor_c = camera.temperature_c();
            target.measurement.settings.lamp_c = stage.temperature_c();
            fit
        }
    };
    bar.finish_and_clear();
    // The record.
    let method = format!(
        "levels every {} s for {} min after switching on, bursts of {} frames, channel {}",
        args.interval, args.minutes, args.burst, args.channel
    );
    let path = target.add(fit.values.clone(), &method, &[])?;
    #[cfg(feature = "figures")]
    target.draw(&figures::lamp(&fit), &path, context)?;
    // What was found.
    let v = &fit.values;
    context.note(format_args!(
        "let it warm up for {:.0} s (capture.lamp_warm_up_s = {:.0}); then it drifts by {:.2} ± \
         {:.2} % per hour",
        v.warm_up_time_s,
        v.warm_up_time_s.ceil(),
        100.0 * v.drift_per_hour.value,
        100.0 * v.drift_per_hour.std
    ));
    match v.steady_from_s {
        Some(s) => context.note(format_args!(
            "no harmful flicker in exposures of {s} s or more"
        )),
        None => context.warn(
            "it flickers at every exposure that was tried: drive it with direct current or at \
             full duty, or average many frames",
        ),
    }
    if args.common.json {
        return write_json(&LampReport {
            record: path.display().to_string(),
            values: v,
            levels: fit.levels.iter().map(|l| [l.time_s, l.level]).collect(),
        });
    }
    write_path(&path)
}
