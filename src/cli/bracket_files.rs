//! Advice on the files of a bracket.

use std::path::{Path, PathBuf};

use super::{CliError, Context, hints};
use crate::radiometry::bracket_files::{self, Bracket, BracketError, BracketFile, Problem};

/// The frames that `paths` (files, or folders of frames) name, with their exposures; notes
/// frames of a turned camera and, of frames that are not `raw`, warns of what the camera did to
/// them by itself.
pub(super) fn find(
    paths: &[PathBuf],
    table: Option<&Path>,
    raw: bool,
    context: &Context,
) -> Result<Vec<BracketFile>, CliError> {
    checked(bracket_files::find(paths, table), raw, context)
}

/// As [`find`], of frames that are each an image by itself.
pub(super) fn find_single(
    paths: &[PathBuf],
    table: Option<&Path>,
    raw: bool,
    context: &Context,
) -> Result<Vec<BracketFile>, CliError> {
    checked(bracket_files::find_single(paths, table), raw, context)
}

fn checked(
    bracket: Result<Bracket, BracketError>,
    raw: bool,
    context: &Context,
) -> Result<Vec<BracketFile>, CliError> {
    let bracket = bracket.map_err(advised)?;
    if let Some((path, orientation)) = &bracket.turned {
        context.note(format_args!(
            "{}: its EXIF data say orientation {orientation}; frames are not turned, because \
             the camera's calibration holds for the sensor as it is",
            path.display()
        ));
    }
    if let Some(path) = bracket.automatic_white_balance.filter(|_| !raw) {
        context.warn(format_args!(
            "{}: its EXIF data say automatic white balance: the camera may have scaled the \
             channels of each frame otherwise, and colours are then wrong; set it by hand",
            path.display()
        ));
    }
    if let Some((path, how)) = bracket.processed.filter(|_| !raw) {
        context.warn(format_args!(
            "{}: its EXIF data say that it is {how}: such a frame has no one response; switch \
             that off",
            path.display()
        ));
    }
    Ok(bracket.files)
}

/// What to do about files that do not make a bracket.
pub(super) fn advised(error: BracketError) -> CliError {
    use Problem::*;
    let hint = match &error.problem {
        Unreadable => "check the path's spelling and the file's permissions",
        Folder => "check the folder's permissions",
        NoFrames => "frames are files that end in .png, .tif, .tiff, .jpg or .jpeg",
        CameraRaw => hints::FOR_CAMERA_RAW,
        NotAFrame(error) => hints::for_frame_file(error),
        SameFrame => "leave one of them out: the noise of a copy is not independent",
        OtherKind => "a bracket is taken by one camera with one setting; leave the odd frame out",
        OtherSetting => "a bracket varies the exposure time alone; leave the odd frame out",
        UnclearExposure => "state the exposures in a table, --exposures",
        AmbiguousName => {
            "name the file so that it can be read in one way, such as scene_20ms.png, or state the exposures in a table, --exposures"
        }
        NoExposure => {
            "name a table with --exposures, or put the exposure into the name: scene_20ms.png"
        }
        UnreadableTable => "--exposures names a CSV file with lines `file,exposure_s`",
        Table { is_repeated: true } => "each file has one line: remove the one that is wrong",
        Table { is_repeated: false } => {
            "each line is `file,exposure_s` or `file,exposure_s,light|ambient|dark`, or a first line names these columns; semicolons and tabs separate as well"
        }
        NoRow => "add a line `file,exposure_s` for it, or leave the frame out",
        TwoRows => {
            "name the frame in the table with as many of its folders as distinguish it from the other"
        }
    };
    CliError::new(&error).hint(hint)
}
