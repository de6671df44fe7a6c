//! `rig calibrate lamp`: warm-up, drift and flicker.

use super::light::attendant;
use super::target::{CommonArgs, noted};
use crate::calibrating::LampRequest;
use crate::calibration::lamp_watch::WatchOptions;
use crate::cli::number::within;
use crate::cli::{CliError, Context, open};

#[derive(clap::Args, Debug)]
pub(super) struct LampArgs {
    #[command(flatten)]
    common: CommonArgs,
    /// How long the lamp is watched (minutes; 2 to 240)
    #[arg(long, value_name = "MIN", default_value_t = WatchOptions::MINUTES, value_parser = within(2.0, 240.0))]
    minutes: f64,
    /// Time between two levels (seconds; 0.1 to 60)
    #[arg(long, value_name = "S", default_value_t = WatchOptions::INTERVAL_S, value_parser = within(0.1, 60.0))]
    interval: f64,
    /// Which channel of the lamp
    #[arg(long, value_name = "N", default_value_t = 0)]
    channel: u8,
    /// Frames in quick succession at each of four exposures, for flicker (16 to 4096)
    #[arg(long, value_name = "N", default_value_t = WatchOptions::BURST, value_parser = clap::value_parser!(u32).range(16..=4096))]
    burst: u32,
}

pub(super) fn run(args: &LampArgs, context: &Context) -> Result<(), CliError> {
    // The rig, and where the record goes.
    let rig = args.common.rig.resolve(context)?;
    let request = LampRequest {
        rig: &rig.config,
        minutes: args.minutes,
        interval_s: args.interval,
        burst: args.burst,
        channel: args.channel,
    };
    request.check()?;
    let mut place = args.common.place(&rig, context)?;
    if !rig.config.is_simulated() {
        context.note("a white card where the lamp lights it evenly, no other light, the lamp cold");
    }
    let measured = request.measure(
        &open::options(&rig.config)?,
        attendant(args.common.events, context)?.as_ref(),
    )?;
    let kept = noted(measured.keep(&mut place)?, context);
    // What was found.
    let v = &measured.fit.values;
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
    args.common.show(&kept, &measured.fit)
}
