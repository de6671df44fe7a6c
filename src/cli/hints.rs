//! Advice for typed errors. The library states facts; here is what to do about them.

use std::error::Error;

use crate::brdf::BrdfError;
use crate::calibration::RecordError;
use crate::calibration::procedure::ProcedureError;
use crate::capture::CaptureError;
use crate::config::ConfigError;
use crate::config::build::BuildError;
use crate::device::DeviceError;
use crate::evaluate::experiment::EvaluateError;
use crate::evaluate::lab::materials;
use crate::export::ExportError;
use crate::geometry::MeshError;
use crate::inverse::cells::AverageError;
use crate::inverse::fit::FitError;
use crate::inverse::plausibility::Implausible;
use crate::radiance_image::exr::ExrError;
use crate::radiometry::exposure::PlanError;
use crate::report::load::LoadError;
use crate::session::SessionError;
use crate::session::fit_record::FitRecordError;
use crate::transport::cache::CacheError;

/// What remains when nothing better is known.
pub const FALLBACK: &str = "run it again with --verbose to see what led to it";

/// The advice for the first error in the chain that has some.
pub fn for_error(error: &(dyn Error + 'static)) -> Option<String> {
    let mut link = Some(error);
    while let Some(error) = link {
        if let Some(hint) = for_one(error) {
            return Some(hint);
        }
        link = error.source();
    }
    None
}

/// A wrapper that shows its inner error as its own hides it from the chain, so
/// such wrappers are unwrapped here.
fn for_one(error: &(dyn Error + 'static)) -> Option<String> {
    if let Some(error) = error.downcast_ref() {
        return Some(for_device(error));
    }
    if let Some(error) = error.downcast_ref() {
        return Some(for_config(error));
    }
    if let Some(error) = error.downcast_ref() {
        return Some(for_record(error));
    }
    if let Some(error) = error.downcast_ref() {
        return for_session(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_images(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_capture(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_loading(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_fit_record(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_brdf(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_build(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_fit(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_evaluate(error);
    }
    if let Some(error) = error.downcast_ref() {
        return match error {
            ExportError::Brdf(error) => for_brdf(error),
            ExportError::Io { source, .. } => for_io(source).map(str::to_owned),
        };
    }
    if let Some(ProcedureError::Device(error)) = error.downcast_ref() {
        return Some(for_device(error));
    }
    if let Some(error) = error.downcast_ref() {
        return for_exr(error);
    }
    if let Some(error) = error.downcast_ref() {
        return for_mesh(error);
    }
    if let Some(error) = error.downcast_ref::<std::io::Error>() {
        return for_io(error).map(str::to_owned);
    }
    None
}

fn for_device(error: &DeviceError) -> String {
    use DeviceError::*;
    match error {
        NotFound { .. } => "run `rig devices` to see what is connected; name ports by /dev/serial/by-id, which survives replugging".into(),
        PermissionDenied { device } => format!(
            "add yourself to the group that owns {device} (`sudo usermod -aG dialout,video $USER`), then log in again; `rig doctor` checks it"
        ),
        Busy { device } => format!("`fuser -v {device}` names the process that holds it; end that one first"),
        NoReply { .. } => "check power, cable and baud rate; `rig devices` shows whether it is still there; a slow camera needs a longer camera.frame_timeout_s".into(),
        Garbled { .. } => "check the baud rate and that the port belongs to this device (`rig devices`)".into(),
        BadFrame { .. } => "check the cable and that nothing else shares its USB bus; resolution_px and bit_depth in the rig file must be the camera's (`rig camera info`)".into(),
        Refused { .. } => "check the rig file against what the device accepts: `rig stage status`, `rig camera info` and `rig camera controls` ask it".into(),
        Alarm { .. } => "find out what the stage hit or lost, then `rig stage home`".into(),
        NotHomed { .. } => "run `rig stage home` first".into(),
        OutOfReach { .. } => "choose fewer or other lights, or correct the limits in the rig file's [stage] table".into(),
        NotApplied { .. } => "the device has another range or step; `rig camera info` and `rig stage status` show what it accepts".into(),
        Disconnected { .. } => "check the cable and the USB hub's power, then `rig doctor`; an interrupted capture continues with `rig capture --resume`".into(),
        TemporaryFolder { .. } => "the variable TMPDIR names that folder (without it, it is /tmp): name one that exists and can be written".into(),
        Relieved { .. } => "find out what stopped the program or kept it from running (`kill -STOP`, a debugger, too little memory): its guardian says whether the lamp went off; Ctrl-Z pauses a capture, and an interrupted one continues with `rig capture --resume`".into(),
        Unguarded { .. } => "leave the process `rig guardian` alone, which turns the lamp off where this program cannot; an interrupted capture continues with `rig capture --resume`".into(),
        Io { .. } => "run `rig doctor`".into(),
    }
}

const EXPLAINED: &str =
    "correct the file; rig-configs/simulated.toml explains every key with its unit and range";

fn for_config(error: &ConfigError) -> String {
    use ConfigError::*;
    match error {
        Read { source, .. } if source.kind() == std::io::ErrorKind::InvalidData => {
            "the file is no text: rig files and scenes are TOML (https://toml.io)".into()
        }
        Read { source, .. } => match for_io(source) {
            Some(hint) if source.kind() != std::io::ErrorKind::NotFound => hint.into(),
            _ => "check the path; a bare name is looked for in rig-configs/ and among the built-in rigs".into(),
        },
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

fn for_record(error: &RecordError) -> String {
    use RecordError::*;
    match error {
        Io { .. } => "check the path and the permissions of the calibration folder".into(),
        NotFound { .. } => "correct the id in the rig file's [calibration] table, or remove it to use the newest record".into(),
        Syntax { .. } | Invalid { .. } | Checksum { .. } => {
            "the record was changed or damaged: restore it from a backup, or calibrate anew and remove it".into()
        }
        Mismatch { kind, .. } => format!(
            "run `rig calibrate {}` with this device at these settings, or name a record that belongs to them in the rig file's [calibration] table",
            kind.command()
        ),
        Exists { .. } => "give the new record another id".into(),
    }
}

fn for_session(error: &SessionError) -> Option<String> {
    use SessionError::*;
    Some(match error {
        Exists { .. } => "nothing was overwritten; choose another folder or name".into(),
        NotASession { .. } => "name the session's own folder, the one with session.toml in it".into(),
        DiskFull { .. } => {
            "nothing that was journalled is lost; free some space and try again".into()
        }
        Io { source, .. } if source.kind() != std::io::ErrorKind::InvalidInput => return for_io(source).map(str::to_owned),
        Link { .. } => {
            "put a copy of what it leads to in the link's place, so that the session holds its own files: `rig session verify` then checks them".into()
        }
        NotCaptured { .. } => "`rig capture --resume SESSION` captures the rest; then fit".into(),
        Value { .. } => "the plan was changed since it was written: restore session.toml from a backup, or start a new session".into(),
        Io { .. } | Checksum { .. } | Length { .. } | Missing { .. } | Malformed { .. } | CorruptJournal { .. } => {
            "the session was changed or damaged: `rig session verify` lists every such file; restore them from a backup".into()
        }
        Locked { .. } => "wait until the other capture has ended, or end it".into(),
        SampleName { .. } => "choose a name such as `red-plastic_01`".into(),
        FrameTaken { .. } => "start a new session, or `rig capture --resume` this one".into(),
    })
}

fn for_capture(error: &CaptureError) -> Option<String> {
    use CaptureError::*;
    Some(match error {
        Device(error) => for_device(error),
        Session(error) => return for_session(error),
        Exposure(PlanError::OutOfRange { .. }) => EXPLAINED.into(),
        Exposure(PlanError::TooBright { .. }) => "dim the lamp or close the aperture, or lower capture.shortest_ms in the rig file if the camera can do less".into(),
        LightOutOfReach { .. } => "choose fewer or other lights, or correct the limits in the rig file's [stage] table".into(),
        LightBlocked { .. } => "take a direction that is free (`--lights N` plans only such), or correct [geometry.camera] body in the rig file; leave `body` out where the light comes through the lens or a beam splitter".into(),
        TooManyLights { reachable: 0, .. } => "correct [geometry.camera] body, or the limits in the rig file's [stage] table".into(),
        TooManyLights { reachable, .. } => format!("ask for at most {reachable}, or `--lights all`"),
        Empty { .. } => "ask for at least one light, e.g. `--lights 4`".into(),
        NotEnoughSpace { .. } => "free some space, choose another disk with --out, or ask for fewer lights".into(),
        LowDisk { .. } => "nothing that was journalled is lost; free some space".into(),
        LampDrift { .. } => "let the lamp warm up (capture.lamp_warm_up_s in the rig file) and check its supply; if it doesn't come back to what it was, start a new session".into(),
        LightMoved { .. } | NotAsBefore { .. } => "resume once more, which homes the stage again; `rig stage repeatability` shows how well it finds its switches; if the sample was touched or the stage repeats no better, start a new session".into(),
        TooHot { .. } => "let it cool down (the lamp is off) and resume; improve the cooling, or correct the [limits] in a new session's rig file".into(),
        OtherCamera { .. } => "connect the camera that the session was begun with, or start a new session".into(),
        ExposureNotApplied { .. } => "raise camera.settings_latency_frames in the rig file; check that the camera is in manual mode and the lamp doesn't flicker".into(),
        NoLight { .. } => "check the lamp's power and cable, the lens cap, and that the stage points at the sample".into(),
        AllSaturated { .. } => "dim the lamp or close the aperture; a camera that ignores its exposure does the same: compare `rig camera grab` at two exposures".into(),
        OtherFrame { .. } => "the session was changed since it was captured; start a new one".into(),
        NotStopped { .. } => "use the emergency stop and look whether the lamp is on; check the stage's cable and power".into(),
        Interrupted | StoppedNow => "`rig capture --resume SESSION` continues it".into(),
        Merge { reason, .. } if reason.contains("no space left") => {
            "free some space on the disk of the session; the frames taken so far are safe".into()
        }
        Merge { .. } | Thread(_) | WorkerGone { .. } => return None,
    })
}

fn for_loading(error: &LoadError) -> Option<String> {
    use LoadError::*;
    match error {
        Session(error) => for_session(error),
        Fit(error) => for_fit_record(error),
        Brdf(error) => for_brdf(error),
        Image(error) => for_exr(error),
        Sidecar { .. } => Some("`rig session verify` lists every damaged file".into()),
        NoSuchFit { .. } => {
            Some("`rig fit SESSION` makes one; without --fit the newest is taken".into())
        }
    }
}

fn for_fit_record(error: &FitRecordError) -> Option<String> {
    use FitRecordError::*;
    match error {
        Io { source, .. } => for_io(source).map(str::to_owned),
        Exists { .. } => Some("nothing was overwritten; choose another folder".into()),
        Syntax { .. } | Value { .. } => {
            Some("the fit was changed by hand or damaged; fit again".into())
        }
        NotVouchedFor { .. } => Some("`rig fit SESSION` makes a fit that is journalled".into()),
        Session(error) => for_session(error),
        Image(error) => for_exr(error),
    }
}

fn for_brdf(error: &BrdfError) -> Option<String> {
    use BrdfError::*;
    match error {
        UnknownSource { .. } => Some("a file needs its path; names are listed above".into()),
        Io { source, .. } => for_io(source).map(str::to_owned),
        File { path, .. } if path.extension().is_some_and(|e| e == "toml" || e == "json") => Some(
            "a dictionary is a list `atoms`, such as [{ type = \"ggx\", alpha = 0.1, eta = 1.5 }]"
                .into(),
        ),
        File { .. } | Table { .. } => {
            Some("the file is not what its ending says, or it is damaged: get it again".into())
        }
        Dictionary { .. } | Weights { .. } => None,
    }
}

fn for_exr(error: &ExrError) -> Option<String> {
    use ExrError::*;
    match error {
        Io { source, .. } => for_io(source).map(str::to_owned),
        Format { .. } | Size { .. } => {
            Some("the image is damaged or no OpenEXR file: render or merge it again".into())
        }
        CutShort { .. } => Some("copy it again, or render or merge it again".into()),
        OtherSize { .. } => {
            Some("give an image of this camera, with the rig file's resolution_px".into())
        }
        Channels { .. } => {
            Some("images need the channels R, G, B, and where known var.R, var.G, var.B".into())
        }
        _ => None,
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
        TooBright { .. } => {
            "give image and irradiance in one unit: raw counts must be divided by exposure and calibration (`rig merge` does that)"
        }
        Negative { .. } => {
            "check what was subtracted: dark frames of a longer exposure, or an ambient frame with the lamp on"
        }
        Constant { .. } => "give the image of the sample; a saturated or filled one tells nothing",
        OnePixel { .. } => {
            "mask hot pixels (a mask channel, or --mask), and check that the sample is in the image"
        }
        NoVariance { .. } => {
            "leave the var.* channels out where the noise is not known: a relative noise of 0.5% is assumed then"
        }
        Repeated { .. } => "give each light its own image, in the order of the scene's lights",
    }
}

fn for_evaluate(error: &EvaluateError) -> Option<String> {
    use EvaluateError::*;
    let advice = match error {
        UnknownExperiment { name, known } => {
            let known: Vec<String> = known.split(", ").map(str::to_owned).collect();
            return Some(match nearest(name, &known) {
                Some(near) => {
                    format!("did you mean `{near}`? `rig evaluate --list` says what each shows")
                }
                None => "`rig evaluate --list` says what each shows".into(),
            });
        }
        UnknownMaterial { spec, .. } => return Some(for_material(spec)),
        Unused { .. } => "leave the option out: this experiment has nothing that it could change",
        SettingsChanged { .. } => {
            "give the earlier settings or another --out, or start anew with --restart"
        }
        ForeignFolder { .. } => "give a folder that is empty or does not exist",
        Locked { .. } => "wait for it, or give another --out",
        Journal { .. } => "start anew with --restart",
        NoSuchCase { .. } => {
            "names are made of the material, the shape and the like, as the first is"
        }
        NoMaterial { .. } => "name one with --materials",
        SameName { .. } => "name each material once; files of one name need another",
        Io { source, .. } => return for_io(source).map(str::to_owned),
        // Those with a source of their own are asked for it; these have it folded in.
        Brdf(error) => return for_brdf(error),
        Fit(error) => return for_fit(error),
        Mesh(error) => return for_mesh(error),
        _ => return None,
    };
    Some(advice.into())
}

/// What a misspelt material may have meant: a name without its kind, or one that differs little.
fn for_material(spec: &str) -> String {
    let known = materials::specs();
    let bare = known.iter().find(|other| {
        let name = other.split_once(':').map_or("", |(_, name)| name);
        name == spec
    });
    match bare.map(String::as_str).or_else(|| nearest(spec, &known)) {
        Some(near) => format!("did you mean `{near}`? A file needs its path"),
        None => {
            "a file needs its path and the ending of its kind; the names are listed above".into()
        }
    }
}

fn for_mesh(error: &MeshError) -> Option<String> {
    use MeshError::*;
    let hint = match error {
        InFile { error, .. } => return for_mesh(error),
        Io { source, .. } => return for_io(source).map(str::to_owned),
        Kind { .. } => {
            "give PLY, OBJ or STL: CAD programs, MeshLab and Blender export them, `rig shape` writes all three"
        }
        OtherKind { found, .. } => match *found {
            "PLY" => "rename the file to end in .ply",
            "STL" => "rename the file to end in .stl",
            "compressed by gzip" | "a ZIP archive (3MF and others)" | "a 7z archive" => {
                "unpack it; what is inside must be PLY, OBJ or STL"
            }
            "a web page" => "the download gave a page in place of the file: get the file itself",
            "a pointer of Git LFS" => "`git lfs pull` brings the file itself",
            _ => "export it as PLY, OBJ or STL, from the CAD program, MeshLab or Blender",
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
            "the program that wrote the mesh had no place for that vertex: remove the facets around it and export again"
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
        .map(|other| (distance(word, other), other))
        .filter(|(distance, other)| *distance * 3 <= word.len().max(other.len()))
        .min()
        .map(|(_, other)| other.as_str())
}

/// Levenshtein's distance in bytes.
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.bytes().enumerate() {
            let substituted = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

fn for_io(error: &std::io::Error) -> Option<&'static str> {
    use std::io::ErrorKind::*;
    match error.kind() {
        NotFound => Some("check the path's spelling and the folder the command runs in"),
        PermissionDenied => Some("check who owns the file and the folder, and their permissions"),
        StorageFull => Some(
            "free some space or choose another folder with --out; nothing already written is lost",
        ),
        InvalidInput => Some("name a regular file: pipes, sockets and devices are not read"),
        FileTooLarge => Some(
            "give a file of that size at most; where one is written, the shell's limit (`ulimit -f`) must allow it",
        ),
        ReadOnlyFilesystem => Some("choose a folder that can be written"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            reason: "hard limit".into(),
        };
        let hint = for_error(&CaptureError::Device(alarm)).unwrap();
        assert!(hint.contains("rig stage home"), "{hint}");
        let full = SessionError::DiskFull {
            path: "raw".into(),
            operation: "write",
        };
        let hint = for_error(&LoadError::Session(full)).unwrap();
        assert!(hint.contains("free some space"), "{hint}");
    }

    #[test]
    fn a_slip_of_the_pen_is_recognised() {
        let known = ["radius_mm".to_owned(), "segments".to_owned()];
        assert_eq!(nearest("segmets", &known), Some("segments"));
        assert_eq!(nearest("raduis_mm", &known), Some("radius_mm"));
        assert_eq!(nearest("colour", &known), None);
        assert_eq!(distance("kitten", "sitting"), 3);
    }

    #[test]
    fn unknown_errors_have_none() {
        assert_eq!(for_error(&std::fmt::Error), None);
    }
}
