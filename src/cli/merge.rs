//! `rig merge`: any exposure bracket becomes a radiance image.

use std::path::{Path, PathBuf};

use super::rig_choice::RigArg;
use super::{CliError, Context, HintExt};
use crate::calibration::Library;
use crate::calibration::noise::sensor_noise;
use crate::calibration::record::{FlatValues, ScaleValues, SensorValues};
use crate::out;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr;
use crate::radiometry::bracket_table::{BracketRow, parse_bracket_table};
use crate::radiometry::frame_file::{FrameFile, decode_png};
use crate::radiometry::merge::{BracketMerge, MergedPlane};
use crate::radiometry::mosaic::Mosaic;
use crate::radiometry::sensor::SensorNoise;

/// Merges a bracket of linear PNG frames into a radiance image with variance and mask
///
/// Counts must be proportional to light (raw frames). The sensor is described by the records of
/// a rig (--rig) or by options, which take precedence.
#[derive(clap::Args, Debug)]
pub struct MergeArgs {
    /// Frames: PNG, grey (mono or Bayer) or RGB, 8 or 16 bits, all of one size
    #[arg(value_name = "FRAMES", required = true)]
    frames: Vec<PathBuf>,
    /// Table of exposures: CSV lines `file,exposure_s[,light|ambient|dark]`, files by path or name
    #[arg(long, value_name = "CSV")]
    exposures: PathBuf,
    /// The radiance image to write (OpenEXR)
    #[arg(long, value_name = "EXR", default_value = "radiance.exr")]
    out: PathBuf,
    /// Colour filters over the sensor: none, rggb, grbg, gbrg or bggr; cells become RGB pixels
    #[arg(long, value_name = "ORDER", default_value = "none", value_parser = parse_mosaic)]
    mosaic: Mosaic,
    /// Take the sensor from this rig's records
    #[command(flatten)]
    rig: RigArg,
    /// System gain K (DN per electron; > 0)
    #[arg(long, value_name = "K")]
    gain: Option<f64>,
    /// Read noise, standard deviation (electrons; >= 0)
    #[arg(long, value_name = "E")]
    read_noise: Option<f64>,
    /// Count without light (DN; >= 0)
    #[arg(long, value_name = "DN")]
    black_level: Option<f64>,
    /// Counts at or above this are clipped (DN; default full scale)
    #[arg(long, value_name = "DN")]
    saturation: Option<f64>,
    /// Significant bits of a count (1 to 16; default the file's 8 or 16)
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(1..=16))]
    bit_depth: Option<u32>,
    /// Dark current (electrons per second; default 0), used without dark or ambient frames
    #[arg(long, value_name = "RATE")]
    dark_current: Option<f64>,
    /// Electrons per second for unit radiance (default 1: the image is in electrons per second)
    #[arg(long, value_name = "R")]
    responsivity: Option<f64>,
}

fn parse_mosaic(text: &str) -> Result<Mosaic, String> {
    match text {
        "none" => Ok(Mosaic::None),
        "rggb" => Ok(Mosaic::Rggb),
        "grbg" => Ok(Mosaic::Grbg),
        "gbrg" => Ok(Mosaic::Gbrg),
        "bggr" => Ok(Mosaic::Bggr),
        _ => Err("none, rggb, grbg, gbrg or bggr".into()),
    }
}

/// `rig merge`.
pub fn run(args: &MergeArgs, context: &Context) -> Result<(), CliError> {
    let rows = read_table(&args.exposures)?;
    let frames = args
        .frames
        .iter()
        .map(|path| Ok((path.as_path(), row_of(&rows, path, &args.exposures)?)))
        .collect::<Result<Vec<_>, CliError>>()?;
    let (first_path, _) = frames[0];
    let first = read_frame(first_path)?;
    let (width, height) = (first.width, first.height);
    if args.mosaic != Mosaic::None && first.planes.len() != 1 {
        return Err(CliError::new(format!(
            "{} has {} channels, but a mosaic is one grey channel",
            first_path.display(),
            first.planes.len()
        ))
        .hint("leave --mosaic out for frames that are RGB already"));
    }
    let noise = args.noise(context, &first)?;
    noise.check(width * height).hint(
        "--gain, --read-noise, --black-level, --saturation and --bit-depth describe the sensor",
    )?;
    let mut merges = (0..first.planes.len())
        .map(|_| BracketMerge::new(&noise, args.mosaic, width, height))
        .collect::<Result<Vec<_>, _>>()?;

    let full_scale_dn = ((1u32 << noise.bit_depth) - 1) as u16;
    for &(path, row) in &frames {
        let frame = read_frame(path)?;
        let same = (frame.width, frame.height, frame.planes.len(), frame.bits)
            == (width, height, first.planes.len(), first.bits);
        if !same {
            return Err(CliError::new(format!(
                "{} is {}, but {} is {}",
                path.display(),
                describe(&frame),
                first_path.display(),
                describe(&first)
            ))
            .hint("a bracket is taken by one camera with one setting; leave the odd frame out"));
        }
        for (merge, counts) in merges.iter_mut().zip(&frame.planes) {
            if let Some(&count) = counts.iter().find(|&&count| count > full_scale_dn) {
                return Err(CliError::new(format!(
                    "{} has a count of {count}, but {} bits end at {full_scale_dn}",
                    path.display(),
                    noise.bit_depth
                ))
                .hint("set --bit-depth to the significant bits of a count"));
            }
            merge.add(row.role, row.exposure_s, counts)?;
        }
    }
    let planes = merges
        .into_iter()
        .map(BracketMerge::finish)
        .collect::<Result<Vec<_>, _>>()
        .hint("mark at least one frame as light in the table (the default)")?;
    for plane in &planes {
        report(plane, context);
    }
    let image = match planes.as_slice() {
        [red, green, blue] => MergedPlane::to_rgb([red, green, blue]),
        [grey] => Some(grey.binned(args.mosaic)),
        _ => None,
    };
    let image: RadianceImage =
        image.ok_or_else(|| CliError::new("the frames have neither one channel nor three"))?;
    exr::write(&args.out, &image)?;
    out!("{}", args.out.display())
}

fn read_table(path: &Path) -> Result<Vec<BracketRow>, CliError> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("--exposures names a CSV file with lines `file,exposure_s`")?;
    parse_bracket_table(&text)
        .map_err(|error| CliError::new(format!("{}, {error}", path.display())))
        .hint("each line is `file,exposure_s` or `file,exposure_s,light|ambient|dark`")
}

/// The table's line for a frame: by its path as given, else by its file name.
fn row_of<'a>(
    rows: &'a [BracketRow],
    path: &Path,
    table: &Path,
) -> Result<&'a BracketRow, CliError> {
    let by_path = rows.iter().find(|row| Path::new(&row.file) == path);
    let by_name = || {
        rows.iter()
            .find(|row| Path::new(&row.file).file_name() == path.file_name())
    };
    by_path.or_else(by_name).ok_or_else(|| {
        CliError::new(format!(
            "{} has no exposure for {}",
            table.display(),
            path.display()
        ))
        .hint("add a line `file,exposure_s` for it, or leave the frame out")
    })
}

fn read_frame(path: &Path) -> Result<FrameFile, CliError> {
    let bytes = std::fs::read(path)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("check the path's spelling and the file's permissions")?;
    decode_png(&bytes)
        .map_err(|error| CliError::new(format!("{}: {error}", path.display())))
        .hint("frames are PNG files of 8 or 16 bits, grey or RGB")
}

fn describe(frame: &FrameFile) -> String {
    let channels = if frame.planes.len() == 1 {
        "grey"
    } else {
        "RGB"
    };
    format!(
        "{} x {}, {}-bit {channels}",
        frame.width, frame.height, frame.bits
    )
}

/// A frame whose signal departs from the others' prediction by more than this
/// part is reported: a wrong exposure, or counts that are not linear.
const RATIO_WARNING: f64 = 0.01;

fn report(plane: &MergedPlane, context: &Context) {
    for step in &plane.agreement {
        let departs = (step.signal_ratio - 1.0).abs() > RATIO_WARNING;
        let significant = step.reduced_chi2 > 1.5 && step.pixels > 100;
        if departs && significant {
            context.warn(format_args!(
                "the exposure of {} s collected {:.3} times what the shorter ones predict: \
                 a wrong exposure time, or counts that are not proportional to light",
                step.exposure_s, step.signal_ratio
            ));
        }
    }
    let lost = plane.valid.iter().filter(|&&valid| !valid).count();
    if lost > 0 {
        context.note(format_args!(
            "{lost} of {} pixels are masked: clipped in every exposure, or hot",
            plane.valid.len()
        ));
    }
}

impl MergeArgs {
    /// The sensor from the rig's records where --rig is given, and the options.
    fn noise(&self, context: &Context, frame: &FrameFile) -> Result<SensorNoise, CliError> {
        let mut noise = if self.rig.rig.is_some() {
            self.recorded_noise(context, frame)?
        } else {
            let need = |value: Option<f64>, option: &str| {
                value.ok_or_else(|| {
                    CliError::new(format!("the sensor is unknown: {option} is missing")).hint(
                        "give --gain, --read-noise and --black-level, or --rig for a rig with a sensor record",
                    )
                })
            };
            SensorNoise::ideal(
                need(self.gain, "--gain")?,
                need(self.read_noise, "--read-noise")?,
                need(self.black_level, "--black-level")?,
                self.bit_depth.unwrap_or(frame.bits),
            )
        };
        let set = |target: &mut f64, value: Option<f64>| {
            if let Some(value) = value {
                *target = value;
            }
        };
        set(&mut noise.gain_dn_per_e, self.gain);
        set(&mut noise.read_noise_e, self.read_noise);
        set(&mut noise.black_level_dn, self.black_level);
        set(&mut noise.dark_current_e_s, self.dark_current);
        set(&mut noise.responsivity_e_s, self.responsivity);
        if let Some(saturation_dn) = self.saturation {
            noise.saturation_dn = saturation_dn;
            noise.linear_max_dn = saturation_dn;
        }
        noise.bit_depth = self.bit_depth.unwrap_or(noise.bit_depth);
        Ok(noise)
    }

    fn recorded_noise(
        &self,
        context: &Context,
        frame: &FrameFile,
    ) -> Result<SensorNoise, CliError> {
        let rig = self.rig.resolve(context)?;
        let library = Library::of_rig(&rig);
        let pins = &rig.config.calibration;
        let sensor = library
            .load::<SensorValues>(pins.sensor.as_deref())?
            .ok_or_else(|| {
                CliError::new(format!("there is no sensor record in {}", library.place()))
            })
            .hint("run `rig calibrate sensor`, or describe the sensor by options")?;
        let flat = library.load::<FlatValues>(pins.flat.as_deref())?;
        let scale = library.load::<ScaleValues>(pins.scale.as_deref())?;
        let resolution_px = [frame.width as u32, frame.height as u32];
        if resolution_px != rig.config.camera.resolution_px {
            let [width, height] = rig.config.camera.resolution_px;
            return Err(CliError::new(format!(
                "the frames have {} x {} pixels, the rig's camera {width} x {height}",
                frame.width, frame.height
            ))
            .hint("choose the rig that took the frames, or describe the sensor by options"));
        }
        let scale = scale.as_ref().map(|loaded| &loaded.record.values);
        Ok(sensor_noise(
            &sensor.record.values,
            flat.as_ref(),
            scale,
            resolution_px,
        )?)
    }
}
