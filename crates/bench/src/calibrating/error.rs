//! Why a calibration made no record; facts only.

use std::path::PathBuf;

use crate::calibration::RecordError;
use crate::calibration::camera::CameraError;
use crate::calibration::flat::FlatError;
use crate::calibration::glare::GlareError;
use crate::calibration::lamp_watch::WatchError;
use crate::calibration::mirror_sphere::lights::DirectionsError;
use crate::calibration::noise::NoiseError;
use crate::calibration::pixel_map::MapError;
use crate::calibration::pose::PoseError;
use crate::calibration::procedure::ProcedureError;
use crate::calibration::rotation::RotationError;
use crate::calibration::sensor::SensorFitError;
use crate::calibration::slanted_edge::EdgeError;
use crate::calibration::white::{Region, WhiteError};
use crate::capture::open::OpenError;
use crate::config::BuildError;
use crate::radiance_image::exr::ExrError;
use crate::radiometry::bracket_files::BracketError;
use crate::radiometry::response::ResponseError;
use crate::shown::nth;
use crate::workflow::WorkflowError;

/// A calibration made no record. A wrapped error shows its own text and is the `source`.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum CalibratingError {
    /// No record can be kept in the folder.
    #[error("{}: {source}", folder.display())]
    Folder {
        folder: PathBuf,
        source: std::io::Error,
    },
    /// A figure or page cannot be written.
    #[error("{}: {source}", path.display())]
    File {
        path: PathBuf,
        source: std::io::Error,
    },
    /// The place of the records is in the program.
    #[error("the built-in records cannot be added to")]
    BuiltIn,
    /// A figure cannot be drawn.
    #[cfg(feature = "figures")]
    #[error("{0}")]
    Plot(#[from] crate::plot::PlotError),
    /// A record cannot be read or written.
    #[error("{0}")]
    Record(#[from] RecordError),
    /// A device cannot be opened.
    #[error("{0}")]
    Open(#[from] OpenError),
    /// A session cannot be read.
    #[error("{0}")]
    Session(#[from] WorkflowError),
    /// An image cannot be read.
    #[error("{0}")]
    Image(#[from] ExrError),
    /// Frames cannot be read.
    #[error("{0}")]
    Frames(#[from] BracketError),

    /// The frames of an even light cannot be taken.
    #[error("{0}")]
    Procedure(#[from] ProcedureError),
    /// Frames of an even light do not determine the sensor.
    #[error("{0}")]
    Sensor(#[from] SensorFitError),
    /// A map of what pixels do in the dark cannot be kept.
    #[error("{0}")]
    Map(#[from] MapError),
    /// A sensor record gives no noise.
    #[error("{0}")]
    Noise(#[from] NoiseError),
    /// A flat field cannot be kept.
    #[error("{0}")]
    Flat(#[from] FlatError),
    /// A flat field needs the sensor's noise.
    #[error("there is no sensor record in {place}")]
    NoSensor { place: String },

    /// The lamp cannot be watched.
    #[error("{0}")]
    Lamp(#[from] WatchError),
    #[error("the lamp has no channel {channel}")]
    NoChannel { channel: u8, channels: usize },

    /// A bracket gives no response.
    #[error("{0}")]
    Response(#[from] ResponseError),
    /// Frames of a linear camera.
    #[error("{} has {bits} bits, and a response is of 8", path.display())]
    Bits { path: PathBuf, bits: u32 },
    /// A part of the frames that they do not have.
    #[error(
        "the region of {} x {} pixels at ({}, {}) is empty or not inside the {} x {} frames",
        region.width, region.height, region.x, region.y, frame_px[0], frame_px[1]
    )]
    NotInside {
        region: Region,
        /// Columns and rows of the frames.
        frame_px: [usize; 2],
    },

    /// Traps on a card give no glare.
    #[error("{0}")]
    Glare(#[from] GlareError),

    /// Views of a board do not determine the lens.
    #[error("{0}")]
    Camera(#[from] CameraError),

    /// Spheres do not determine the lights.
    #[error("{0}")]
    Lights(#[from] DirectionsError),
    /// A standard gives no scale.
    #[error("{0}")]
    White(#[from] WhiteError),
    /// Edges do not determine the sharpness.
    #[error("{0}")]
    Focus(#[from] EdgeError),
    /// Images give no pose.
    #[error("{0}")]
    Pose(#[from] PoseError),
    /// Turns of a sample cannot be compared.
    #[error("{0}")]
    Rotation(#[from] RotationError),
    /// The scene cannot be built.
    #[error("{0}")]
    Scene(#[from] BuildError),

    /// A session of another bench.
    #[error("{} is of rig {of}, the record would be of rig {rig}", session.display())]
    OtherRig {
        session: PathBuf,
        of: String,
        rig: String,
    },
    /// A session without the light that is named, from 0.
    #[error("{} has {lights} lights, not {}", session.display(), nth("light", *light))]
    NoLight {
        session: PathBuf,
        lights: usize,
        light: usize,
    },
    #[error("images alone do not state the angles of a stage with axes")]
    NoAngles,
    #[error("{images} images were named, the rig has {lights} lights")]
    ImageCount { images: usize, lights: usize },
    /// A session that holds no image.
    #[error("{} has no images", session.display())]
    NoImages { session: PathBuf },
}
