//! Advice for typed errors. The library states facts; here is what to do about them: a row
//! for each kind, by the floor that states it. `tests/source/hints.rs` holds every row to a test
//! that runs the program.

#[cfg(feature = "reports")]
mod batch;
mod calibrate;
mod capture;
mod device;
#[cfg(feature = "experiments")]
mod evaluate;
mod many;
mod session;
mod workflow;

use std::error::Error;

use rustix::io::Errno;

#[cfg(feature = "reports")]
use batch::for_batch;
use calibrate::for_calibrating;
use capture::{for_open, for_prepare};
use device::for_device;
#[cfg(feature = "experiments")]
use evaluate::for_evaluate;
use many::{for_queue, for_reproducibility};
#[cfg(feature = "reports")]
use session::for_loading;
use session::{for_archive, for_capture, for_fit_record, for_record, for_session};
use workflow::for_workflow;

use crate::brdf::BrdfError;
use crate::brdf::rgl::RglFault;
use crate::cells::AverageError;
use crate::cluster::LineBreak;
use crate::config::BuildError;
use crate::config::{ConfigError, Slip};
use crate::export::ExportError;
use crate::geometry::MeshError;
use crate::geometry::mesh_error::Content;
use crate::inverse::FitError;
use crate::outside_file::ends_in;
use crate::parametric::FitError as ModelFitError;
use crate::plausibility::Implausible;
use crate::radiance_image::exr::{self, ExrError};
use crate::radiometry::frame_file::FrameFileError;
#[cfg(feature = "reports")]
use crate::report::ReportError;
use crate::transport::cache::CacheError;

/// What remains when nothing better is known.
pub const FALLBACK: &str = "run it again with --verbose to see what led to it";

/// The advice for the first error in the chain that has some.
pub fn for_error(error: &(dyn Error + 'static)) -> Option<String> {
    let mut link = Some(error);
    while let Some(error) = link {
        let hint = ADVICE.iter().find_map(|advise| advise(error));
        if hint.is_some() {
            return hint;
        }
        link = error.source();
    }
    None
}

/// Advice where a file cannot be written.
pub const ANOTHER_FILE: &str = "choose a file in a folder that exists and can be written";

/// What to do where a file cannot be written.
pub fn unwritable(error: &std::io::Error) -> String {
    let hint = for_error(error).filter(|_| error.kind() != std::io::ErrorKind::NotFound);
    hint.unwrap_or_else(|| ANOTHER_FILE.to_owned())
}

/// Advice on one type of error; `None` for any other, and where there is none.
type Advice = fn(&(dyn Error + 'static)) -> Option<String>;

/// All types with advice. Wrappers whose text is their inner error's hide it from the chain of
/// sources: their functions unwrap them.
const ADVICE: &[Advice] = &[
    |error| of_type(error, for_workflow),
    |error| of_type(error, for_device),
    #[cfg(feature = "console")]
    |error| of_type(error, for_unstopped),
    #[cfg(feature = "console")]
    |error| of_type(error, for_not_stopped),
    #[cfg(feature = "console")]
    |error| of_type(error, for_disobeyed),
    |error| of_type(error, for_queue),
    |error| of_type(error, for_reproducibility),
    |error| of_type(error, for_config),
    |error| of_type(error, for_record),
    |error| of_type(error, for_calibrating),
    |error| of_type(error, for_session),
    |error| of_type(error, for_archive),
    |error| of_type(error, for_images),
    |error| of_type(error, for_capture),
    |error| of_type(error, for_open),
    |error| of_type(error, for_prepare),
    #[cfg(feature = "reports")]
    |error| of_type(error, for_batch),
    #[cfg(feature = "reports")]
    |error| of_type(error, for_report),
    #[cfg(feature = "reports")]
    |error| of_type(error, for_loading),
    |error| of_type(error, for_fit_record),
    |error| of_type(error, for_brdf),
    |error| of_type(error, for_build),
    |error| of_type(error, for_fit),
    #[cfg(feature = "experiments")]
    |error| of_type(error, for_evaluate),
    |error| of_type(error, for_export),
    |error| of_type(error, for_exr),
    |error| of_type(error, for_mesh),
    |error| of_type(error, for_line_break),
    |error| of_type(error, for_io),
];

fn of_type<E: Error + 'static, A: Into<Option<String>>>(
    error: &(dyn Error + 'static),
    advise: impl Fn(&E) -> A,
) -> Option<String> {
    advise(error.downcast_ref()?).into()
}

/// The error is of a device, and its own advice would be the wrong one.
#[cfg(feature = "console")]
fn for_unstopped(_: &crate::console::held_devices::Unstopped) -> String {
    "stop the stage at its supply or by its emergency stop: it may still move, and its lamp be lit"
        .to_owned()
}

#[cfg(feature = "console")]
fn for_not_stopped(_: &crate::console::held_devices::NotStopped) -> String {
    "if it moves or is lit, end the program that has the stage (Ctrl-C in its terminal), or press the emergency stop"
        .to_owned()
}

/// The error is of a device, and its own advice would be the wrong one.
#[cfg(feature = "console")]
fn for_disobeyed(_: &crate::console::held_devices::LampDisobeyed) -> String {
    "look at the lamp: if it is still lit, turn it off at its supply or by the emergency stop; correct the commands of [[stage.lamp]] and lamp_off in the rig file, and home the stage before the next move"
        .to_owned()
}

const EXPLAINED: &str =
    "correct the file; rig-configs/simulated.toml explains every key with its unit and range";

fn for_config(error: &ConfigError) -> String {
    use ConfigError::*;
    match error {
        Read { source, .. } if source.kind() == std::io::ErrorKind::InvalidData => {
            "rig files and scenes are TOML (https://toml.io), which is UTF-8: save the text in that encoding".into()
        }
        Read { source, .. } => match for_io(source) {
            Some(hint) if source.kind() != std::io::ErrorKind::NotFound => hint,
            _ => "check the path: it starts at the folder in which the command runs".into(),
        },
        Syntax { slip: Some(slip), .. } => for_slip(*slip),
        ControlCharacter { .. } => for_slip(Slip::Backslash),
        Syntax { .. } => "the file is TOML (https://toml.io): `key = value`, texts in double quotes, `[table]`".into(),
        UnknownKey { key, known, .. } => {
            let last = key.rsplit('.').next().unwrap_or(key);
            match nearest(last, known) {
                Some(near) => format!("did you mean `{near}`?"),
                None => "rig-configs/simulated.toml explains every key".into(),
            }
        }
        Missing { key, unread, .. } => {
            let last = key.rsplit('.').next().unwrap_or(key);
            match nearest(last, unread) {
                Some(near) => format!("is `{near}` meant to be it?"),
                None => EXPLAINED.into(),
            }
        }
        Invalid { .. } => EXPLAINED.into(),
        UnknownRig { name, known } => match nearest(name, known) {
            Some(near) => format!("did you mean `{near}`? A file is named with its path or its ending .toml"),
            None => "a file is named with its path or its ending .toml".into(),
        },
        FallbackRefused { .. } => {
            "name the rig with --rig, RIG_CONFIG or ./rig.toml; for the simulated one, --rig simulated".into()
        }
    }
}

fn for_slip(slip: Slip) -> String {
    match slip {
        Slip::Quote(_) => {
            "write texts in straight quotes, \"…\", and turn off smart quotes in the editor".into()
        }
        Slip::Minus(_) => "write the minus of the keyboard, -".into(),
        Slip::Blank(_) => "delete it, or write an ordinary blank in its place".into(),
        Slip::Lookalike(_, ascii) => format!("write {ascii} in its place"),
        Slip::Backslash => {
            "write the path with / as this system has it; in single quotes a backslash is an ordinary character".into()
        }
        Slip::DecimalComma => "write numbers with a decimal point".into(),
    }
}

fn for_brdf(error: &BrdfError) -> Option<String> {
    use BrdfError::*;
    match error {
        UnknownSource { .. } => Some("a file needs its path; names are listed above".into()),
        Io { source, .. } => for_io(source),
        RglKind {
            kind: RglFault::Spectral { .. },
            ..
        } => Some(
            "the database has each material in RGB as well, named …_rgb.bsdf; `rig export --format rgl` writes that".into(),
        ),
        RglKind {
            kind: RglFault::OtherKind(_),
            ..
        } => Some(
            "its samples cannot be read: take the material as a tensor file of the RGL database, or as a MERL .binary".into(),
        ),
        RglKind { .. } => Some("take an isotropic material: such files have one azimuth of incidence".into()),
        File { path, .. } if ["toml", "json"].into_iter().any(|ending| ends_in(path, ending)) => Some(
            "a dictionary is a list `atoms`, such as [{ type = \"ggx\", alpha = 0.1, eta = 1.5 }]"
                .into(),
        ),
        File { .. } | Table { .. } => {
            Some("the file is cut short, damaged, or of another kind than its ending states: get it again, or write it as that format has it".into())
        }
        Dictionary { .. } | Weights { .. } => None,
    }
}

fn for_line_break(_: &LineBreak) -> String {
    "name files and folders without line breaks".to_owned()
}

fn for_export(error: &ExportError) -> Option<String> {
    match error {
        ExportError::Brdf(error) => for_brdf(error),
        ExportError::NothingConstrained => Some(
            "capture the sample under more lights; `rig report SESSION` shows what the images constrain"
                .into(),
        ),
        ExportError::Io { source, .. } => Some(unwritable(source)),
        // The command gives the session to formats that need it.
        ExportError::NeedsSession { .. } => None,
        // No reader hands such values on.
        ExportError::Model(ModelFitError::NotFinite) => None,
        ExportError::Model(ModelFitError::Black) => Some(
            "a black material needs no file: set the base colour to 0 and the index of refraction to 1 in the program".into(),
        ),
        #[cfg(feature = "figures")]
        ExportError::Picture(_) => None,
    }
}

fn for_exr(error: &ExrError) -> Option<String> {
    use ExrError::*;
    match error {
        Io { source, .. } => for_io(source),
        OtherKind {
            found: exr::OtherKind::Radiance(_),
            ..
        } => Some(
            "convert it to OpenEXR in linear 32-bit floats, for instance `oiiotool IN -d float -o OUT.exr`; add variances where they are known".into(),
        ),
        OtherKind {
            found: exr::OtherKind::Frame(_),
            ..
        } => Some(
            "a frame is no radiance: merge the exposures of each light first, `rig merge FRAMES --out IMAGE.exr`".into(),
        ),
        Format { .. } | Size { .. } => {
            Some("the image is damaged or no OpenEXR file: render or merge it again".into())
        }
        CutShort { .. } => Some("copy it again, or render or merge it again".into()),
        OtherSize { .. } => Some(
            "give an image that this camera took, whole and not resampled, one for each light; or correct resolution_px if the camera has another".into(),
        ),
        Layers { file, .. } => Some(format!(
            "name the one that holds radiance after a colon: {}:NAME",
            file.display()
        )),
        NoSuchLayer { .. } => Some("take one of these names, or leave it out where there is one".into()),
        Windows { .. } => Some(
            "the display window is the image: save it without cropping, in the camera's frame".into(),
        ),
        Kind { .. } => Some(
            "save it as a flat image with the channels R, G, B at full resolution, with ZIP compression".into(),
        ),
        Channels { .. } => {
            Some("images need the channels R, G, B, and where known var.R, var.G, var.B".into())
        }
        _ => None,
    }
}

/// What to do with a camera's raw files.
pub(super) const FOR_CAMERA_RAW: &str = "write its counts as 16-bit TIFFs first: `dcraw -D -4 -T FILE` or LibRaw's `unprocessed_raw -T FILE`; then merge those with --mosaic, the order of the camera's colour filters";

/// What to do with a file that is no frame.
pub(super) fn for_frame_file(error: &FrameFileError) -> &'static str {
    use FrameFileError::*;
    match error {
        CameraRaw(_) => FOR_CAMERA_RAW,
        Samples(what) if what.contains("and alpha") => {
            "write it without alpha: `convert IN -alpha off OUT`"
        }
        Samples(what) if what.contains("floating-point") || what.contains("32-bit") => {
            "frames are counts: write them as whole numbers of 16 bits, without scaling; an image of radiance is an EXR"
        }
        Samples(_) => {
            "write the camera's counts as they are: grey (also of a colour mosaic) or RGB, whole numbers of 8 or 16 bits"
        }
        Compression(_) => "write it without compression, or with LZW, Deflate or PackBits",
        Pages { .. } => {
            "write each image to a file of its own (`convert IN frame_%d.tif`) and state the exposures in a table, --exposures"
        }
        Size { .. } => "give an image of this camera at its full size",
        Format(_) | TooLarge(_) | Damaged(_) => {
            "frames are PNG, TIFF or JPEG files of 8 or 16 bits, grey or RGB"
        }
    }
}

fn for_build(error: &BuildError) -> Option<String> {
    match error {
        BuildError::Mesh(error) => for_mesh(error),
        BuildError::Brdf(error) => for_brdf(error),
        BuildError::ColouredBody { .. } => Some(
            "paint it grey or black and give it equal values for all channels in the rig file"
                .into(),
        ),
    }
}

fn for_fit(error: &FitError) -> Option<String> {
    use FitError::*;
    match error {
        Average(error) => for_images(error),
        NothingToCompare { .. } => {
            Some("check that the scene's camera and sample are those of the images".into())
        }
        Cache(CacheError::ColouredBody { .. }) => Some(
            "give the [[body]] equal values for all channels, or leave it out of the scene".into(),
        ),
        Cache(_) => None,
        Simplex(_) | Projection(_) => Some(
            "the equations of the fit hold no finite numbers: check the images for values far beyond the others, or follow more paths (--spp)"
                .into(),
        ),
    }
}

/// What to do where nothing of an image is valid.
pub(super) const FOR_INVALID_IMAGES: &str = "infinite values, NaN, pixels whose mask channel is 0 and what --mask leaves out are not compared, and here nothing else is left: check exposures, the program that wrote the image, and its number format";

/// What to do where images cannot be averaged over a scene's cells.
fn for_images(error: &AverageError) -> Option<String> {
    use AverageError::*;
    let hint = match error {
        ImageCount { .. } => "give one image for each light of the scene, in its order",
        TooManyLights { .. } => return None,
        ImageSize { .. } => "the scene's resolution_px must be the images' width and height",
        NothingSeen => {
            "the sample is too small in the image, or its pose too uncertain ([uncertainty]), for anything to be left between its edges"
        }
        NothingValid { .. } => FOR_INVALID_IMAGES,
    };
    Some(hint.to_owned())
}

/// What to look at where images cannot be those of the scene.
pub(super) fn for_implausible(error: &Implausible) -> &'static str {
    use Implausible::*;
    match error {
        Irradiance { .. } => {
            "state what the light brings (irradiance of a directional light, intensity of a point light, one value or one for each channel), or leave light and image out"
        }
        NotLit { .. } => {
            "directions point from the sample to the light: to_light = [0, 0, 1] is above it; check the signs, and that the mesh is not inside out"
        }
        NoLight { .. } => {
            "check that the lamp was lit and the lens uncovered, that the image is in the radiance unit of the scene's irradiance, and that its var.* channels hold variances of the mean"
        }
        TooBright { channel: None, .. } => {
            "state the irradiance in the unit of the images, in which a white sample shows irradiance/π: a merge's scale is arbitrary (`rig merge` gives electrons per second unless --responsivity states how many of them unit radiance makes); `rig calibrate white` measures it"
        }
        TooBright { .. } => {
            "check that channel's irradiance; if the other channels are in another unit as well, state the irradiance in the unit of the images (`rig calibrate white` measures it)"
        }
        Negative { .. } => {
            "check what was subtracted: dark frames of a longer exposure, or an ambient frame with the lamp on"
        }
        Constant { .. } => {
            "give the image of the sample; a saturated or uniform one contains no information"
        }
        OnePixel { .. } => {
            "mask hot pixels (a mask channel, or --mask), and check that the sample is in the image"
        }
        NoVariance { .. } => {
            "leave the var.* channels out where the noise is not known: a relative noise of 0.5% is assumed then"
        }
        Repeated { .. } => "give each light its own image, in the order of the scene's lights",
    }
}

fn for_mesh(error: &MeshError) -> Option<String> {
    use MeshError::*;
    let hint = match error {
        InFile { error, .. } => return for_mesh(error),
        Io { source, .. } => return for_io(source),
        Kind { .. } => {
            "give PLY, OBJ or STL: CAD programs, MeshLab and Blender export them, `rig shape` writes all three"
        }
        OtherKind { found, .. } => match found {
            Content::Mesh(name) => {
                return Some(format!(
                    "rename the file to end in .{}",
                    name.to_lowercase()
                ));
            }
            Content::Packed(_) => "unpack it; what is inside must be PLY, OBJ or STL",
            Content::WebPage => {
                "the download gave a page in place of the file: get the file itself"
            }
            Content::LfsPointer => "`git lfs pull` brings the file itself",
            Content::Other(_) => {
                "export it as PLY, OBJ or STL, from the CAD program, MeshLab or Blender"
            }
        },
        Format { .. } => {
            "export the mesh again; if another program reads the file, let it write a binary PLY"
        }
        Number { .. } => {
            "three numbers with decimal points stand there in such a file: export the mesh again, or correct that line"
        }
        DecimalComma { .. } => {
            "export the mesh again with the locale that has decimal points (LC_NUMERIC=C, or the program's language set to English), or as a binary file, which has none"
        }
        CutShort { .. } => "copy or export the file again: it is not whole",
        Empty { vertices: 0 } => "the file holds no surface: export the body itself, as a mesh",
        Empty { .. } => {
            "a cloud of points is no surface: make facets of it first (in MeshLab: Remeshing, Screened Poisson)"
        }
        TooLarge { .. } => {
            "reduce it (in MeshLab: Simplification): a pixel need not see many facets"
        }
        NotFinite { .. } => {
            "the program that wrote the mesh had no position for that vertex: remove the facets around it and export again"
        }
        TooFar { .. } => {
            "the mesh is in another unit or in far-off axes: `rig shape --inspect FILE` suggests mesh_unit and mesh_to_sample"
        }
        NoSuchVertex { .. } => {
            "the file is damaged or was put together from parts: export the mesh again, and transfer it as binary"
        }
        // Of meshes that no file made.
        Normal { .. } | Degenerate { .. } => return None,
        NoArea { .. } => {
            "the export lost the shape to rounding: write more digits, a larger unit, or a binary file"
        }
    };
    Some(hint.into())
}

/// The known word that differs least, if it differs little.
fn nearest<'a>(word: &str, known: &'a [String]) -> Option<&'a str> {
    known
        .iter()
        .map(|other| (strsim::levenshtein(word, other), other))
        .filter(|(distance, other)| *distance * 3 <= word.len().max(other.len()))
        .min()
        .map(|(_, other)| other.as_str())
}

#[cfg(feature = "reports")]
fn for_report(error: &ReportError) -> Option<String> {
    match error {
        ReportError::Load(error) => for_loading(error),
        ReportError::Session(error) => for_session(error),
        ReportError::Io { source, .. } => for_io(source),
        ReportError::Plot(_) | ReportError::Template(_) => None,
    }
}

fn for_io(error: &std::io::Error) -> Option<String> {
    use std::io::ErrorKind::*;
    let hint = match error.kind() {
        NotFound => "check the path's spelling and the folder the command runs in",
        PermissionDenied => "check who owns the file and the folder, and their permissions",
        StorageFull => {
            "free some space, or choose another folder with --out; where `df` shows some, `df -i` may show that no more files can be made; nothing already written is lost"
        }
        QuotaExceeded => {
            "remove some of your files there (`quota` lists what counts), or choose another folder; nothing already written is lost"
        }
        NotADirectory => "choose another folder: a part of this path is a file",
        InvalidFilename => "shorten the name: most file systems take at most 255 bytes",
        // The system's own, of a name that FAT and exFAT don't take.
        InvalidInput if error.raw_os_error().is_some() => {
            "the file system there may not take this name: on FAT, exFAT and most shares leave out \" * : < > ? \\ | and a dot or space at the end"
        }
        InvalidInput => {
            "name a regular file: pipes, sockets and devices are neither read nor replaced"
        }
        FileTooLarge => {
            "give a file of that size at most; where one is written, the shell's limit (`ulimit -f`) and the file system (FAT: 4 GB) must allow it"
        }
        ReadOnlyFilesystem => "choose a folder that can be written",
        _ if Errno::from_io_error(error) == Some(Errno::IO) => {
            "the disk or the connection to it fails (see `dmesg`): choose another, and try again"
        }
        _ => return None,
    };
    Some(hint.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::CaptureError;
    use crate::device::{AlarmCause, DeviceError};
    use crate::session::SessionError;

    #[derive(Debug, thiserror::Error)]
    #[error("capture failed")]
    struct Wrapper(#[source] DeviceError);

    #[test]
    fn the_hint_is_found_behind_a_wrapper() {
        let error = Wrapper(DeviceError::NotHomed {
            device: "arm".into(),
            since: "a reset".into(),
        });
        assert!(for_error(&error).unwrap().contains("rig stage home"));
    }

    /// A wrapper that is transparent hides the inner error from the chain.
    #[test]
    fn the_hint_is_found_inside_a_transparent_wrapper() {
        let alarm = DeviceError::Alarm {
            device: "arm".into(),
            cause: AlarmCause::Other,
            reason: "hard limit".into(),
        };
        let hint = for_error(&CaptureError::Device(alarm)).unwrap();
        assert!(hint.contains("rig stage home"), "{hint}");
        let full = SessionError::DiskFull {
            path: "raw".into(),
            operation: "write",
        };
        let hint = for_error(&CaptureError::Session(full)).unwrap();
        assert!(hint.contains("free some space"), "{hint}");
    }

    #[test]
    fn a_slip_of_the_pen_is_recognised() {
        let known = ["radius_mm".to_owned(), "segments".to_owned()];
        assert_eq!(nearest("segmets", &known), Some("segments"));
        assert_eq!(nearest("raduis_mm", &known), Some("radius_mm"));
        assert_eq!(nearest("colour", &known), None);
    }

    #[test]
    fn unknown_errors_have_none() {
        assert_eq!(for_error(&std::fmt::Error), None);
    }
}
