//! `rig stage`: the light stage by hand.

use std::sync::atomic::AtomicBool;

use super::context::Context;
use super::error::CliError;
use super::number::within;
use super::open;
use super::output::write_json;
use super::rig_choice::RigArg;
use super::{interrupt, repeatability};
use crate::capture::open::{PortDriver, Stage, open_port, open_stage, stop_port, stop_stage};
use crate::device::by_hand;
use crate::device::{DeviceError, LampChannel, LampState, LightStage, StageActivity, StageStatus};
use crate::interrupt::Interrupt;
use crate::out;
use crate::units::StageAngles;
use crate::workflow::measure_repeatability;

/// Controls the light stage directly
///
/// Every command opens the port anew, and a stage whose port was opened doesn't
/// know where it is until it is homed. Ctrl-C stops motion and lamp at once.
#[derive(clap::Args, Debug)]
pub struct StageArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    /// Finds the reference switches
    Home(Which),
    /// Homes, then moves to these angles
    Move {
        #[command(flatten)]
        which: Which,
        /// Rotation about the stage's +z (degrees)
        #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
        azimuth: f64,
        /// Height above the stage's plane; 90 is straight above the sample (degrees)
        #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
        elevation: f64,
    },
    /// Lights one channel of the lamp until Ctrl-C, or turns the lamp off
    Lamp {
        #[command(flatten)]
        which: Which,
        /// Channel, counted from 0 in the order of the rig file, or `off`
        #[arg(value_name = "CHANNEL", value_parser = lamp_state)]
        lamp: LampState,
        /// Off after this long (s)
        #[arg(long, value_name = "SECONDS", value_parser = within(0.0, 86_400.0))]
        seconds: Option<f64>,
        /// Homes first: a controller that is locked until it is homed switches no lamp
        #[arg(long)]
        home: bool,
        /// Homes and moves there first: a dome lights the light of a direction (degrees)
        #[arg(
            long,
            value_name = "DEGREES",
            allow_negative_numbers = true,
            requires = "elevation"
        )]
        azimuth: Option<f64>,
        /// As --azimuth (degrees)
        #[arg(
            long,
            value_name = "DEGREES",
            allow_negative_numbers = true,
            requires = "azimuth"
        )]
        elevation: Option<f64>,
    },
    /// Homes repeatedly and reports how well the switches are found
    ///
    /// After each homing the stage drives away and back to its switches with the
    /// steps counted; where they are found differs by the errors of two homings,
    /// and by steps lost in between.
    Repeatability {
        #[command(flatten)]
        which: Which,
        /// How often
        #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=1000))]
        cycles: u32,
    },
    /// Reports what the stage is doing
    Status(Which),
    /// Stops motion and lamp now
    Stop(Which),
}

/// Which stage.
#[derive(clap::Args, Debug)]
struct Which {
    #[command(flatten)]
    rig: RigArg,
    /// Serial port of a stage without a rig file
    #[arg(long, value_name = "PATH", conflicts_with = "rig")]
    port: Option<String>,
    /// Protocol of the controller on --port
    #[arg(long, value_parser = open::port_driver(), default_value = "grbl", requires = "port")]
    driver: PortDriver,
    /// Bits per second on --port
    #[arg(long, default_value_t = 115_200, requires = "port")]
    baud: u32,
    /// The result as JSON
    #[arg(long)]
    json: bool,
}

fn lamp_state(text: &str) -> Result<LampState, String> {
    match text {
        "off" => Ok(LampState::Off),
        channel => match channel.parse() {
            Ok(channel) => Ok(LampState::On(LampChannel(channel))),
            Err(_) => Err("a channel's number, from 0, or `off`".to_owned()),
        },
    }
}

/// `rig stage`.
pub fn run(args: &StageArgs, context: &Context) -> Result<(), CliError> {
    match &args.action {
        Action::Home(which) => {
            let mut open = which.open(context)?.guarded()?;
            let status = stoppable(&mut *open.stage, |stage, _| Ok(stage.home()?))?;
            which.report(&*open.stage, &status, Some(LampState::Off))
        }
        Action::Move {
            which,
            azimuth,
            elevation,
        } => {
            let target = StageAngles::new(*azimuth, *elevation);
            let mut open = which.open_to_reach(target, context)?.guarded()?;
            context.note("homing first: the position is unknown after connecting");
            let status = stoppable(&mut *open.stage, |stage, _| {
                stage.home()?;
                stage.move_to(target)?;
                Ok(stage.status()?)
            })?;
            which.report(&*open.stage, &status, Some(LampState::Off))
        }
        Action::Lamp {
            which,
            lamp,
            seconds,
            home,
            azimuth,
            elevation,
        } => {
            let target = azimuth.zip(*elevation);
            let target = target.map(|(azimuth_deg, elevation_deg)| StageAngles {
                azimuth_deg,
                elevation_deg,
            });
            light(which, *lamp, *seconds, *home, target, context)
        }
        Action::Repeatability { which, cycles } => repeat_homing(which, *cycles, context),
        Action::Status(which) => {
            let mut open = which.open(context)?;
            let status = open.stage.status()?;
            which.report(&*open.stage, &status, None)
        }
        Action::Stop(which) => stop(which, context),
    }
}

/// Switches the lamp and keeps it lit as long as wanted.
fn light(
    which: &Which,
    lamp: LampState,
    seconds: Option<f64>,
    home: bool,
    target: Option<StageAngles>,
    context: &Context,
) -> Result<(), CliError> {
    let mut open = match target {
        Some(target) => which.open_to_reach(target, context)?,
        None => which.open(context)?,
    }
    .guarded()?;
    let status = stoppable(&mut *open.stage, |stage, wishes| {
        if home || target.is_some() {
            stage.home()?;
        }
        if let Some(target) = target {
            stage.move_to(target)?;
        }
        stage.set_lamp(lamp).map_err(while_lit)?;
        if lamp != LampState::Off {
            context.note(match seconds {
                Some(seconds) => format!("lit for {seconds} s or until Ctrl-C"),
                None => "lit until Ctrl-C".to_owned(),
            });
            let Wishes { stopped, interrupt } = *wishes;
            let lit = by_hand::keep_lit(stage, lamp, seconds, stopped, interrupt);
            if !lit.map_err(while_lit)? {
                let port = &stage.info().port;
                return Err(CliError::new(format!("{port}: the lamp is no longer lit")).hint(
                    "the controller may have restarted, or it was stopped: check its supply and `rig stage status`",
                ));
            }
            stage.set_lamp(LampState::Off).map_err(while_lit)?;
            if wishes.interrupt.take_pause() {
                suspend_dark(stage.reports_lamp(), context);
            }
        }
        Ok(stage.status()?)
    });
    match status {
        Err(error) if error.fact().contains("locked") => {
            Err(error.hint("make sure that the stage is free to move, then add --home"))
        }
        status => which.report(&*open.stage, &status?, Some(LampState::Off)),
    }
}

/// Measures how well the reference switches are found.
fn repeat_homing(which: &Which, cycles: u32, context: &Context) -> Result<(), CliError> {
    if which.port.is_some() {
        return Err(
            CliError::new("--port does not say how far the stage may move")
                .hint("describe the stage in a rig file and name it with --rig"),
        );
    }
    let rig = which.rig.resolve(context)?.config;
    let kinematics = rig.stage.kinematics();
    let mut open = open_stage(&rig, &open::options(&rig)?)?.guarded()?;
    let found = stoppable(&mut *open.stage, |stage, wishes| {
        let stopped = wishes.stopped;
        Ok(measure_repeatability(
            stage,
            &kinematics,
            cycles,
            stopped,
            context,
        )?)
    })?;
    let found = found.ok_or_else(|| {
        let driver = &open.stage.info().driver;
        CliError::new(format!(
            "a {driver} stage cannot tell where it finds its switches"
        ))
        .hint("Zaber stages can; for others, compare images of a mark after each `rig stage home`")
    })?;
    repeatability::report(&found, open.stage.info(), &kinematics, which.json)
}

fn stop(which: &Which, context: &Context) -> Result<(), CliError> {
    let outcome = match &which.port {
        Some(port) => open::stopped(stop_port(which.driver, port, which.baud))?,
        None => {
            let rig = which.rig.resolve(context)?.config;
            if rig.is_simulated() {
                "nothing: a simulated stage runs only as long as the command that uses it"
            } else {
                open::stopped(stop_stage(&rig))?
            }
        }
    };
    if which.json {
        return write_json(&serde_json::json!({ "stopped": true, "outcome": outcome }));
    }
    out!("stopped; {outcome}")
}

impl Which {
    fn open(&self, context: &Context) -> Result<Stage, CliError> {
        match &self.port {
            Some(port) => Ok(open_port(self.driver, port, self.baud, &open::of_port()?)?),
            None => {
                let rig = self.rig.resolve(context)?.config;
                Ok(open_stage(&rig, &open::options(&rig)?)?)
            }
        }
    }

    /// The same, where it can move to this direction: refused before anything moves.
    fn open_to_reach(&self, target: StageAngles, context: &Context) -> Result<Stage, CliError> {
        if self.port.is_some() {
            return Err(
                CliError::new("--port does not say how the stage's axes map to angles")
                    .hint("describe the stage in a rig file and name it with --rig"),
            );
        }
        let rig = self.rig.resolve(context)?;
        let kinematics = rig.config.stage.kinematics();
        kinematics.reach(&rig.config.name, target)?;
        Ok(open_stage(&rig.config, &open::options(&rig.config)?)?)
    }

    /// `sent`: the state of the lamp that was last commanded, shown where the stage does not
    /// report its lamp.
    fn report(
        &self,
        stage: &dyn LightStage,
        status: &StageStatus,
        sent: Option<LampState>,
    ) -> Result<(), CliError> {
        let info = stage.info();
        let sent = sent.filter(|_| !stage.reports_lamp());
        if self.json {
            let mut found = serde_json::json!({ "stage": info, "status": status });
            if let Some(sent) = sent {
                found["lamp_sent"] = serde_json::json!(sent);
            }
            return write_json(&found);
        }
        let activity = match status.activity {
            StageActivity::Idle => "idle",
            StageActivity::Moving => "moving",
            StageActivity::Homing => "homing",
            StageActivity::Held => "held",
            StageActivity::Alarm => "locked until it is homed",
        };
        out!(
            "stage     {} {} on {}",
            info.driver,
            info.firmware,
            info.port
        )?;
        out!("state     {activity}")?;
        match status.position {
            Some(angles) => out!("position  {angles}")?,
            None => out!("position  unknown until it is homed")?,
        }
        match (status.lamp, sent) {
            (_, Some(LampState::Off)) => out!("lamp      off: {SENT}"),
            (Some(LampState::Off), _) => out!("lamp      off"),
            (Some(LampState::On(LampChannel(channel))), _) => out!("lamp      channel {channel}"),
            (None, _) => out!("lamp      not reported"),
        }
    }
}

/// Of the lamp of a stage that does not report it.
const SENT: &str = "sent, not verified; this stage does not report its lamp: look at it";

/// Runs `act` while another thread waits for a signal, to stop the stage then.
fn stoppable<T>(
    stage: &mut dyn LightStage,
    act: impl FnOnce(&mut dyn LightStage, &Wishes) -> Result<T, CliError>,
) -> Result<T, CliError> {
    let interrupt = &interrupt::listen()?;
    let reports_lamp = stage.reports_lamp();
    let ran = by_hand::stoppable(stage, interrupt, |stage, stopped| {
        act(stage, &Wishes { stopped, interrupt })
    })?;
    match (ran.stop, interrupt.signal()) {
        (Some(Ok(())), Some(signal)) => Err(CliError::interrupted(
            signal,
            match reports_lamp {
                true => "stopped: motion ended, lamp off, position unknown".to_owned(),
                false => format!("stopped: motion ended, position unknown; lamp off: {SENT}"),
            },
        )),
        (Some(Err(error)), _) => Err(CliError::from(error)
            .hint("use the emergency stop: the stage did not confirm that it stopped")),
        _ => ran.outcome,
    }
}

/// What was requested by signals.
struct Wishes<'a> {
    /// The stage was stopped.
    stopped: &'a AtomicBool,
    /// Knows of a request to pause, which nothing else handles.
    interrupt: &'a Interrupt,
}

/// An error of a stage whose lamp was, or was being, switched on.
fn while_lit(error: DeviceError) -> CliError {
    match error {
        error @ DeviceError::Disconnected { .. } => CliError::from(error).hint(
            "the lamp may still be lit: turn it off at its supply or by the emergency stop, then check the cable",
        ),
        error => error.into(),
    }
}

/// Suspends this process with the lamp off, and leaves it off afterwards: nobody may
/// be at the bench when it goes on.
fn suspend_dark(reports_lamp: bool, context: &Context) {
    context.note(match reports_lamp {
        true => "suspended: the lamp is off".to_owned(),
        false => format!("suspended; lamp off: {SENT}"),
    });
    interrupt::suspend();
    context.note("going on: the lamp stays off; run the command again to light it");
}
