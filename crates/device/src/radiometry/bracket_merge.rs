//! From the files of a bracket to a radiance image on disk, in bands of rows, so that
//! neither frames nor image stand in memory whole.

use std::io;
use std::path::{Path, PathBuf};

use super::adopted_exposures::{UsedExposure, adopt};
use super::agreement::ExposureAgreement;
use super::bracket_files::{BracketError, BracketFile, FrameReader};
use super::filter_order::{FilterDoubt, FilterOrder};
use super::frame_file::{FrameFile, Tone};
use super::merge::FrameRole;
use super::mosaic::Mosaic;
use super::plane::MergedPlane;
use super::response::Response;
use super::sensor::SensorNoise;
use super::stack::{Band, Bands, ResponseBands, Stack, StackError};
use crate::progress::Progress;
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{self, ExrError};

/// How counts become radiance.
#[derive(Clone, Debug)]
pub enum CountModel {
    /// Raw counts, proportional to light, of a sensor with this noise.
    Linear(Box<SensorNoise>),
    /// The same with other noise in each colour: red, green, blue.
    Colours(Box<[SensorNoise; 3]>),
    /// 8-bit counts through a response curve per channel.
    Response(Vec<Response>),
}

impl CountModel {
    /// Red's sensor, or the only one; `None` with response curves.
    fn noise(&self) -> Option<&SensorNoise> {
        match self {
            Self::Linear(noise) => Some(noise),
            Self::Colours(noise) => noise.first(),
            Self::Response(_) => None,
        }
    }
}

/// A merge to be done.
#[derive(Clone, Debug)]
pub struct MergeRequest<'a> {
    /// The frames, at least one.
    pub files: &'a [BracketFile],
    /// What counts mean.
    pub model: &'a CountModel,
    /// Colour filters over the sensor; [`Mosaic::None`] with response curves.
    pub mosaic: Mosaic,
    /// Whether a mosaic keeps its resolution: colours that a pixel did not measure are then
    /// means of its nearest neighbours; else a cell of 2 × 2 becomes one pixel.
    pub full_resolution: bool,
    /// Whether the exposures that the frames show replace the stated ones, the shortest apart.
    pub measured_exposures: bool,
    /// The radiance image to be written (OpenEXR). The frames wait in its folder.
    pub out: &'a Path,
}

/// A merged bracket.
#[derive(Clone, Debug)]
pub struct Merged {
    /// Pixels per row, rows.
    pub size: [usize; 2],
    /// Pixels without a valid value: clipped in every exposure, hot, or moving.
    pub masked_pixels: usize,
    /// How the exposures agree, per channel of the frames or colour of the mosaic, shortest
    /// first.
    pub agreement: Vec<Vec<ExposureAgreement>>,
    /// The exposures in use, shortest first, where measured ones were asked for.
    pub exposures: Vec<UsedExposure>,
    /// What speaks against the stated order of colour filters.
    pub filter_doubt: Option<FilterDoubt>,
}

/// Why a bracket cannot be merged.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum BracketMergeError {
    /// Files that do not make a bracket.
    #[error(transparent)]
    Files(#[from] BracketError),
    #[error("{} has {channels} channels, but a mosaic is one grey channel", path.display())]
    ColouredMosaic { path: PathBuf, channels: usize },
    #[error("the sensor is described for red, green and blue, but {} is grey", path.display())]
    NoColours { path: PathBuf },
    /// Raw counts are asked of a format that bends them.
    #[error("{} is a JPEG, whose counts are not proportional to light", path.display())]
    Jpeg { path: PathBuf },
    #[error("the response has {curves} channels of 8 bits, but {} has {channels} of {bits} bits", path.display())]
    OtherResponse {
        path: PathBuf,
        curves: usize,
        channels: usize,
        bits: u32,
    },
    #[error("{} has a count of {count}, but {bits} bits end at {full_scale}", path.display())]
    Count {
        path: PathBuf,
        count: u16,
        bits: u32,
        full_scale: u16,
    },
    #[error("the frames have neither one channel nor three")]
    Channels,
    /// The frames cannot be kept on disk.
    #[error(transparent)]
    Disk(StackError),
    /// The frames cannot be merged.
    #[error(transparent)]
    Merge(StackError),
    /// Frames that are each an image by itself, and the images would have one name.
    #[error("{} and {} would both become {}", frames[0].display(), frames[1].display(), out.display())]
    OneName { frames: [PathBuf; 2], out: PathBuf },
    /// The image cannot be written.
    #[error(transparent)]
    Image(#[from] ExrError),
}

/// Merges a bracket and writes its radiance image; the steps of its progress are frames, then
/// rows of pixels.
pub fn merge(request: &MergeRequest, progress: &dyn Progress) -> Result<Merged, BracketMergeError> {
    progress.begin("reading frames", Some(request.files.len()));
    let Gathered {
        mut stack,
        size: [width, height],
        filters,
    } = gather(request, progress)?;
    let exposures = match request.measured_exposures {
        true => {
            progress.begin("measuring exposures", None);
            adopt(&mut stack, |stack| survey(stack, request))?
        }
        false => Vec::new(),
    };
    let size = match request.mosaic {
        _ if request.full_resolution => [width, height],
        Mosaic::None => [width, height],
        _ => [width / 2, height / 2],
    };
    progress.begin("merging", Some(size[1]));
    let mut masked_pixels = 0;
    let mut work = Work::new(&stack, request);
    exr::write_rows(request.out, size[0], size[1], || {
        let no_more = || io::Error::from(io::ErrorKind::UnexpectedEof).into();
        let band = work.next_band()?;
        let band = band.ok_or_else(|| BracketMergeError::Merge(no_more()))?;
        let image = image_of(request, &band)?;
        progress.advance(image.height);
        masked_pixels += image.valid.iter().filter(|&&valid| !valid).count();
        Ok::<_, BracketMergeError>(image)
    })?;
    Ok(Merged {
        size,
        masked_pixels,
        agreement: work.agreement(),
        exposures,
        filter_doubt: filters.and_then(|filters| filters.doubt(request.mosaic)),
    })
}

/// The bands of a merge.
enum Work<'a> {
    Linear(Bands<'a>),
    Response(ResponseBands<'a>),
}

impl<'a> Work<'a> {
    fn new(stack: &'a Stack, request: &MergeRequest<'a>) -> Self {
        let margin = usize::from(request.full_resolution);
        let bands = |noise| stack.bands(noise, request.mosaic, margin);
        match request.model {
            CountModel::Linear(noise) => Self::Linear(bands(noise)),
            CountModel::Colours(noise) => Self::Linear(bands(&noise[0]).of_colours(noise)),
            CountModel::Response(responses) => Self::Response(stack.response_bands(responses)),
        }
    }

    fn next_band(&mut self) -> Result<Option<Band>, BracketMergeError> {
        match self {
            Self::Linear(bands) => bands.next_band(),
            Self::Response(bands) => bands.next_band(),
        }
        .map_err(BracketMergeError::Merge)
    }

    fn agreement(&self) -> Vec<Vec<ExposureAgreement>> {
        match self {
            Self::Linear(bands) => bands.agreement(),
            Self::Response(bands) => bands.agreement(),
        }
    }
}

/// How the exposures of a stack agree.
fn survey(
    stack: &Stack,
    request: &MergeRequest,
) -> Result<Vec<Vec<ExposureAgreement>>, BracketMergeError> {
    let mut work = Work::new(stack, request);
    while work.next_band()?.is_some() {}
    Ok(work.agreement())
}

/// Whether a frame can be merged with this mosaic.
///
/// # Errors
/// [`BracketMergeError::ColouredMosaic`].
pub fn check_mosaic(
    path: &Path,
    frame: &FrameFile,
    mosaic: Mosaic,
) -> Result<(), BracketMergeError> {
    match (mosaic, frame.planes.len()) {
        (Mosaic::None, _) | (_, 1) => Ok(()),
        (_, channels) => Err(BracketMergeError::ColouredMosaic {
            path: path.to_owned(),
            channels,
        }),
    }
}

/// Whether a frame's counts can be proportional to light.
///
/// # Errors
/// [`BracketMergeError::Jpeg`].
pub fn check_linear(path: &Path, frame: &FrameFile) -> Result<(), BracketMergeError> {
    match frame.tone {
        Tone::Jpeg => Err(BracketMergeError::Jpeg {
            path: path.to_owned(),
        }),
        Tone::Gamma | Tone::Unstated => Ok(()),
    }
}

/// All frames, checked, on disk.
struct Gathered {
    stack: Stack,
    /// Pixels per row, rows.
    size: [usize; 2],
    /// What the frames say of the colour filters, where they are of one channel.
    filters: Option<FilterOrder>,
}

fn gather(request: &MergeRequest, progress: &dyn Progress) -> Result<Gathered, BracketMergeError> {
    let folder = request.out.parent();
    let folder = folder.filter(|p| !p.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let mut reader = FrameReader::default();
    let mut gathered: Option<Gathered> = None;
    let noise = request.model.noise();
    let (black_dn, ceiling) = noise.map_or((0.0, f64::from(u8::MAX)), |noise| {
        (noise.black_level_dn, noise.ceiling_dn())
    });
    for BracketFile {
        path,
        role,
        exposure_s,
    } in request.files
    {
        let frame = reader.read(path)?;
        let Gathered { stack, filters, .. } = match &mut gathered {
            Some(gathered) => gathered,
            None => {
                check_first(request, path, &frame)?;
                let (size, channels) = ([frame.width, frame.height], frame.planes.len());
                let stack = Stack::new(folder, size[0], size[1], channels);
                gathered.insert(Gathered {
                    stack: stack.map_err(BracketMergeError::Disk)?,
                    size,
                    filters: (channels == 1).then(FilterOrder::default),
                })
            }
        };
        let bits = noise.map_or(frame.bits, |noise| noise.bit_depth);
        let full_scale = ((1u32 << bits) - 1) as u16;
        let count = frame.planes.iter().flatten().max().copied().unwrap_or(0);
        if count > full_scale {
            return Err(BracketMergeError::Count {
                path: path.clone(),
                count,
                bits,
                full_scale,
            });
        }
        if let (FrameRole::Light, [grey], Some(filters)) = (role, &*frame.planes, filters) {
            filters.add(grey, frame.width, black_dn, ceiling);
        }
        stack
            .add(*role, *exposure_s, &frame.planes)
            .map_err(BracketMergeError::Disk)?;
        progress.advance(1);
    }
    gathered.ok_or(BracketMergeError::Channels)
}

fn check_first(
    request: &MergeRequest,
    path: &Path,
    frame: &FrameFile,
) -> Result<(), BracketMergeError> {
    check_mosaic(path, frame, request.mosaic)?;
    let channels = frame.planes.len();
    match request.model {
        CountModel::Response(curves) if frame.bits != 8 || curves.len() != channels => {
            Err(BracketMergeError::OtherResponse {
                path: path.to_owned(),
                curves: curves.len(),
                channels,
                bits: frame.bits,
            })
        }
        CountModel::Colours(_) if channels != 3 && request.mosaic == Mosaic::None => {
            Err(BracketMergeError::NoColours {
                path: path.to_owned(),
            })
        }
        _ => Ok(()),
    }
}

/// The image of a band without its margins.
fn image_of(request: &MergeRequest, band: &Band) -> Result<RadianceImage, BracketMergeError> {
    let image = match band.planes.as_slice() {
        [grey] if request.full_resolution => grey.demosaiced(request.mosaic),
        [grey] => grey.binned(request.mosaic),
        planes => to_image(planes)?,
    };
    if !request.full_resolution {
        return Ok(image);
    }
    Ok(image.rows(band.above..band.above + band.rows))
}

fn to_image(planes: &[MergedPlane]) -> Result<RadianceImage, BracketMergeError> {
    let image = match planes {
        [red, green, blue] => MergedPlane::to_rgb([red, green, blue]),
        [grey] => Some(grey.to_grey()),
        _ => None,
    };
    image.ok_or(BracketMergeError::Channels)
}
