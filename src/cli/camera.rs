//! `rig camera`: the camera by hand.

use std::path::{Path, PathBuf};

use super::context::Context;
use super::error::CliError;
use super::number::within;
use super::output::{write_json, write_path};
use super::rig_choice::RigArg;
use super::{camera_preview, hints, open};
use crate::capture::open::open_camera_for_a_look;
use crate::config::{CameraDriver, ResolvedRig};
use crate::device::controls::{ControlInfo, name_of};
use crate::device::frame_figures::FrameFigures;
use crate::device::pixel_format::{FORMAT_NAME, fourcc_of_name};
use crate::device::retake::{Retakes, grab_right};
use crate::device::{Camera, CameraInfo, CameraSettings, FrameKey, FrameKind, RawFrame, Stated};
use crate::out;
use crate::session::frame::encode_png;
use crate::units::Seconds;
use crate::whole_file;

/// Controls the camera directly
#[derive(clap::Args, Debug)]
pub struct CameraArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    /// Says what the camera is and can do
    Info(Which),
    /// Takes one raw frame
    Grab {
        #[command(flatten)]
        which: Which,
        /// The 16-bit PNG to write: raw counts, row 0 at the top
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Exposure (ms)
        #[arg(long, value_name = "MS", default_value_t = 10.0, value_parser = within(1e-6, 1e9))]
        exposure_ms: f64,
        /// Analogue gain, a factor; 1 is the camera's lowest
        #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = within(1e-6, 1e9))]
        gain: f64,
        /// Frames to let pass after the change of settings
        #[arg(long, value_name = "FRAMES", default_value_t = 3)]
        discard: u32,
    },
    /// Lists every control with its range and value
    Controls(Which),
    /// Shows live pictures on a page for this machine alone, to focus and frame
    ///
    /// stdout's line is the page's address, whose last part is a secret: whoever has it sees
    /// the page. With --json one frame's figures instead.
    Preview {
        #[command(flatten)]
        which: Which,
        /// Exposure (ms)
        #[arg(long, value_name = "MS", default_value_t = 10.0, value_parser = within(1e-6, 1e9))]
        exposure_ms: f64,
        /// Analogue gain, a factor; 1 is the camera's lowest
        #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = within(1e-6, 1e9))]
        gain: f64,
        /// Port of the page on 127.0.0.1; 0 takes a free one
        #[arg(long, value_name = "PORT", default_value_t = 0)]
        port: u16,
        /// Frames to let pass before the one that --json measures
        #[arg(long, value_name = "FRAMES", default_value_t = 3)]
        discard: u32,
    },
}

/// Which camera.
#[derive(clap::Args, Debug, Clone)]
struct Which {
    #[command(flatten)]
    rig: RigArg,
    /// A Video4Linux device without a rig file
    #[arg(long, value_name = "PATH", conflicts_with = "rig")]
    device: Option<String>,
    /// Pixel format on --device, such as Y12, RG16 or Y16-BE; the deepest raw one if not given
    #[arg(long, value_name = "CODE", requires = "device", value_parser = format_code)]
    format: Option<[u8; 4]>,
    /// The result as JSON
    #[arg(long)]
    json: bool,
}

fn format_code(name: &str) -> Result<[u8; 4], String> {
    fourcc_of_name(name).ok_or_else(|| FORMAT_NAME.to_owned())
}

/// `rig camera`.
pub fn run(args: &CameraArgs, context: &Context) -> Result<(), CliError> {
    match &args.action {
        Action::Info(which) => {
            let camera = which.open(context, false)?;
            let info = camera.info();
            if which.json {
                return write_json(info);
            }
            print_info(info)
        }
        Action::Grab {
            which,
            out,
            exposure_ms,
            gain,
            discard,
        } => {
            let mut camera = which.open(context, false)?;
            let settings =
                camera.configure(CameraSettings::new(Seconds(exposure_ms * 1e-3), *gain))?;
            warn_of_other(*exposure_ms, *gain, settings, context);
            let mut retakes = Retakes::default();
            let frame = grab(&mut *camera, *discard, &mut retakes)?;
            let stated = camera.stated_with_frame();
            if let Some(path) = out {
                write_png(path, &frame)?;
            }
            let taken = Taken {
                settings: stated.settings(settings),
                frame: &frame,
                retakes,
                stated,
            };
            report(which, out.as_deref(), camera.info(), &taken)
        }
        Action::Controls(which) => controls(which, context),
        Action::Preview {
            which,
            exposure_ms,
            gain,
            port,
            discard,
        } => {
            let wanted = CameraSettings::new(Seconds(exposure_ms * 1e-3), *gain);
            let mut camera = which.open(context, true)?;
            let settings = camera.configure(wanted)?;
            warn_of_other(*exposure_ms, *gain, settings, context);
            if which.json {
                return measure(&mut *camera, settings, *discard);
            }
            let (of, quiet) = (which.clone(), context.clone());
            let shown = camera_preview::Shown {
                camera,
                reopen: Box::new(move || of.open(&quiet, true)),
                rig: which.resolved(context)?,
                settings: wanted,
            };
            camera_preview::serve(shown, *port, context)
        }
    }
}

/// One frame's figures as JSON on stdout.
fn measure(
    camera: &mut dyn Camera,
    settings: CameraSettings,
    discard: u32,
) -> Result<(), CliError> {
    let frame = grab(camera, discard, &mut Retakes::default())?;
    write_json(&FrameFigures::of(&frame, camera.info(), settings))
}

/// Says where the camera applies other settings than were requested, beyond its steps.
fn warn_of_other(exposure_ms: f64, gain: f64, applied: CameraSettings, context: &Context) {
    let differs = |asked: f64, is: f64| (is / asked - 1.0).abs() > 0.01;
    let asked = Seconds(exposure_ms * 1e-3);
    if differs(asked.0, applied.exposure.0) || differs(gain, applied.gain) {
        context.warn(format!(
            "the camera applies {} and gain {} where {asked} and gain {gain} were requested",
            applied.exposure, applied.gain
        ));
    }
}

fn controls(which: &Which, context: &Context) -> Result<(), CliError> {
    let device = match &which.device {
        Some(device) => device.clone(),
        None => match which.rig.resolve(context)?.config.camera.driver {
            CameraDriver::V4l { device, .. } => device,
            _ => {
                return Err(CliError::new("only Video4Linux cameras have controls")
                    .hint("name one with --device, or a rig file whose camera.driver is \"v4l\""));
            }
        },
    };
    let controls = controls_of(&device)?;
    if which.json {
        return write_json(&controls);
    }
    for control in &controls {
        let value = control
            .value
            .map_or("-".to_owned(), |value| value.to_string());
        let state = match (control.read_only, control.inactive) {
            (true, _) => "  read-only",
            (_, true) => "  inactive",
            _ => "",
        };
        out!(
            "{:<27} {:<34} {value:>7}  of {} to {} in steps of {}, default {}{state}",
            name_of(control.id),
            control.label,
            control.minimum,
            control.maximum,
            control.step,
            control.default
        )?;
    }
    Ok(())
}

/// A frame and how it came about.
struct Taken<'a> {
    settings: CameraSettings,
    frame: &'a RawFrame,
    retakes: Retakes,
    stated: Stated,
}

fn grab(
    camera: &mut dyn Camera,
    discard: u32,
    retakes: &mut Retakes,
) -> Result<RawFrame, CliError> {
    let key = |repeat| FrameKey {
        light: 0,
        exposure: 0,
        repeat,
        kind: FrameKind::Ambient,
    };
    for repeat in 0..discard {
        grab_right(camera, key(repeat), retakes)?;
    }
    Ok(grab_right(camera, key(discard), retakes)?)
}

fn write_png(path: &Path, frame: &RawFrame) -> Result<(), CliError> {
    let png = encode_png(frame).map_err(CliError::new)?;
    whole_file::create(path, &png).map_err(|error| {
        let hint = match error.kind() {
            std::io::ErrorKind::AlreadyExists => None,
            _ => hints::for_error(&error),
        };
        let exists =
            || "name a file that does not exist yet, in a folder that can be written".into();
        CliError::new(format!("{}: {error}", path.display())).hint(hint.unwrap_or_else(exists))
    })
}

fn print_info(info: &CameraInfo) -> Result<(), CliError> {
    let [width, height] = info.resolution_px;
    let [shortest, longest] = info.exposure_range;
    out!("camera    {} ({})", info.model, info.driver)?;
    out!("serial    {}", info.serial)?;
    out!(
        "frame     {width} x {height} pixels, {} bits, colour filters {}",
        info.bit_depth,
        info.mosaic
    )?;
    if shortest.0.is_nan() {
        return out!("exposure  cannot be set");
    }
    out!(
        "exposure  {shortest} to {longest} in steps of {}",
        info.exposure_step
    )
}

fn report(
    which: &Which,
    file: Option<&Path>,
    info: &CameraInfo,
    taken: &Taken<'_>,
) -> Result<(), CliError> {
    let Taken {
        settings,
        frame,
        retakes,
        stated,
    } = taken;
    let saturation = ((1_u32 << info.bit_depth.min(16)) - 1) as u16;
    let saturated = frame.counts.iter().filter(|&&c| c >= saturation).count();
    let least = frame.counts.iter().min().copied().unwrap_or(0);
    let most = frame.counts.iter().max().copied().unwrap_or(0);
    let sum: f64 = frame.counts.iter().map(|&count| f64::from(count)).sum();
    let mean = sum / frame.counts.len().max(1) as f64;
    if which.json {
        return write_json(&serde_json::json!({
            "file": file.map(|file| file.to_string_lossy()),
            "settings": settings,
            "width": frame.width,
            "height": frame.height,
            "sequence": frame.sequence,
            "minimum_dn": least,
            "mean_dn": mean,
            "maximum_dn": most,
            "saturated_pixels": saturated,
            "retakes": retakes,
            "serial": stated.serial,
            "sensor_c": stated.sensor_c,
        }));
    }
    let exposure = match settings.exposure {
        unknown if unknown.0.is_nan() => "the exposure cannot be set".to_owned(),
        exposure => exposure.to_string(),
    };
    out!("settings  {exposure}, gain {}", settings.gain)?;
    out!("counts    {least} to {most}, mean {mean:.1} DN, {saturated} pixels saturated")?;
    if let Some(serial) = &stated.serial {
        out!("camera    serial number {serial}")?;
    }
    if let Some(sensor_c) = stated.sensor_c {
        out!("sensor    {sensor_c:.1} °C")?;
    }
    if !retakes.is_none() {
        out!("retaken   frames {retakes}")?;
    }
    match file {
        Some(path) => write_path(path),
        None => Ok(()),
    }
}

impl Which {
    /// The rig whose camera it is; `None` for a device without one.
    fn resolved(&self, context: &Context) -> Result<Option<ResolvedRig>, CliError> {
        match self.device {
            Some(_) => Ok(None),
            None => self.rig.resolve(context).map(Some),
        }
    }

    /// With `preview` also in a format that is good for nothing else.
    fn open(&self, context: &Context, preview: bool) -> Result<Box<dyn Camera>, CliError> {
        if let Some(device) = &self.device {
            return open_device(device, self.format, preview);
        }
        let rig = self.rig.resolve(context)?.config;
        Ok(open_camera_for_a_look(&rig, &open::of_port()?)?)
    }
}

#[cfg(feature = "v4l")]
fn controls_of(device: &str) -> Result<Vec<ControlInfo>, CliError> {
    Ok(crate::device::v4l::controls_of(device)?)
}

#[cfg(not(feature = "v4l"))]
fn controls_of(_: &str) -> Result<Vec<ControlInfo>, CliError> {
    Err(without_v4l())
}

#[cfg(feature = "v4l")]
fn open_device(
    device: &str,
    format: Option<[u8; 4]>,
    preview: bool,
) -> Result<Box<dyn Camera>, CliError> {
    use crate::device::v4l::{V4lCamera, V4lConfig};
    let camera = V4lCamera::open(V4lConfig {
        format,
        preview,
        any_exposure: true,
        ..V4lConfig::of_device(device)
    })?;
    Ok(Box::new(camera))
}

#[cfg(not(feature = "v4l"))]
fn open_device(_: &str, _: Option<[u8; 4]>, _: bool) -> Result<Box<dyn Camera>, CliError> {
    Err(without_v4l())
}

#[cfg(not(feature = "v4l"))]
fn without_v4l() -> CliError {
    crate::capture::open::OpenError::NoVideo4Linux.into()
}
