//! Images of a session and its fits as PNG: `fits/<n>/residual_L000.png`,
//! `fits/<n>/rendered_L000.png`, `fits/<n>/spheres.png`, `derived/radiance_L000.png` and, small,
//! `derived/thumbnail.png`. There are no such files: they are made of the `.exr` files, and of
//! the fitted material.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde::Serialize;

use super::served::FileError;
use crate::beneath;
use crate::brdf::Brdf;
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::source;
use crate::brdf::sphere::{GreyCard, sphere_images};
use crate::catalogue::row::read_fit;
use crate::plot::Picture;
use crate::plot::radiance::{RESIDUAL_RANGE, residual, white_balanced, white_level, white_of};
use crate::radiance_image::{RadianceImage, exr};
use crate::session::Session;
use crate::session::layout::{self, DERIVED_FOLDER, FITS_FOLDER};
use crate::session::validation::{self, LightScore, Validation};
use crate::shown::nth;
use crate::workflow::white_radiance;

/// Pixels a side of a sphere.
const SPHERE_PX: usize = 128;
/// Pixels of a thumbnail's longer side.
const THUMBNAIL_PX: usize = 160;
/// Between the parts of a picture, pixels.
const GAP_PX: usize = 4;

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureOf {
    /// The merged radiance under the first light, small.
    Thumbnail,
    /// The merged radiance under a light.
    Radiance(u32),
    /// A fit's image of a light, as rendered from it.
    Rendered {
        /// Number of the fit.
        fit: u32,
        /// Index of the light.
        light: u32,
    },
    /// Captured less rendered, in standard deviations; R, G and B next to each other.
    Residual {
        /// Number of the fit.
        fit: u32,
        /// Index of the light.
        light: u32,
    },
    /// Spheres of a fit's material under environment maps; those of the true material below
    /// them, where it is known.
    Spheres {
        /// Number of the fit.
        fit: u32,
    },
}

/// A picture for a page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Named {
    /// Its path inside the session.
    pub name: String,
    /// What it shows.
    pub caption: String,
}

impl PictureOf {
    /// By its path inside the session.
    pub fn parse(file: &str) -> Option<Self> {
        let found = Self::read(file)?;
        // Numbers have one spelling.
        (found.file() == file).then_some(found)
    }

    fn read(file: &str) -> Option<Self> {
        let (folder, name) = file.strip_suffix(".png")?.rsplit_once('/')?;
        let light = |prefix: &str| name.strip_prefix(prefix)?.parse::<u32>().ok();
        if folder == DERIVED_FOLDER && name == "thumbnail" {
            return Some(Self::Thumbnail);
        }
        if folder == DERIVED_FOLDER {
            return light("radiance_L").map(Self::Radiance);
        }
        let fit = folder.strip_prefix(FITS_FOLDER)?.strip_prefix('/')?;
        let fit = fit.parse().ok()?;
        if name == "spheres" {
            return Some(Self::Spheres { fit });
        }
        if let Some(light) = light("residual_L") {
            return Some(Self::Residual { fit, light });
        }
        let light = light("rendered_L")?;
        Some(Self::Rendered { fit, light })
    }

    /// Its path inside the session.
    pub fn file(self) -> String {
        match self {
            Self::Spheres { fit } => format!("{FITS_FOLDER}/{fit}/spheres.png"),
            Self::Thumbnail => format!("{DERIVED_FOLDER}/thumbnail.png"),
            _ => self.source().replace(".exr", ".png"),
        }
    }

    /// The journalled image that it is made of; for spheres the fit's record.
    fn source(self) -> String {
        match self {
            Self::Thumbnail => layout::radiance_file(0),
            Self::Radiance(light) => layout::radiance_file(light),
            Self::Rendered { fit, light } => {
                format!("{FITS_FOLDER}/{fit}/rendered_L{light:03}.exr")
            }
            Self::Residual { fit, light } => {
                format!("{FITS_FOLDER}/{fit}/residual_L{light:03}.exr")
            }
            Self::Spheres { fit } => format!("{FITS_FOLDER}/{fit}/fit.toml"),
        }
    }

    fn caption(self) -> String {
        match self {
            Self::Thumbnail => "The sample".to_owned(),
            Self::Radiance(light) => format!("{light}: captured radiance", light = nth("Light", light)),
            Self::Rendered { light, .. } => format!("{light}: rendered from the fit", light = nth("Light", light)),
            Self::Residual { light, .. } => format!(
                "{light}: captured less rendered in R, G and B, full colour at ±{RESIDUAL_RANGE} standard deviations", light = nth("Light", light)
            ),
            Self::Spheres { .. } => {
                "Spheres of the material under environment maps; below them the true material, where it is known, and 18% grey".to_owned()
            }
        }
    }

    fn named(self) -> Named {
        Named {
            name: self.file(),
            caption: self.caption(),
        }
    }
}

/// The pictures of a session's captured images.
pub fn of_session(session: &Session) -> Vec<Named> {
    let lights = 0..session.record().plan.lights.len() as u32;
    let pictures = lights.map(PictureOf::Radiance);
    let there = pictures.filter(|picture| session.vouches_for(&picture.source()));
    there.map(PictureOf::named).collect()
}

/// The pictures of one of its fits: spheres, then residual and rendered image of each light.
pub fn of_fit(session: &Session, fit: u32) -> Vec<Named> {
    let lights = 0..session.record().plan.lights.len() as u32;
    let of_light = |light| {
        [
            PictureOf::Residual { fit, light },
            PictureOf::Rendered { fit, light },
        ]
    };
    let pictures = std::iter::once(PictureOf::Spheres { fit }).chain(lights.flat_map(of_light));
    let there = pictures.filter(|picture| session.vouches_for(&picture.source()));
    there.map(PictureOf::named).collect()
}

/// The pictures of a validation, which are files of the session.
pub fn of_validation(session: &Session, number: u32, record: &Validation) -> Vec<Named> {
    let picture = |score: &LightScore| {
        let name = validation::inside(number, &validation::picture_file(score.light));
        let image = record.images.get(score.light).map_or("", String::as_str);
        let caption = format!("{}, {image}", nth("Light", score.light));
        session
            .vouches_for(&name)
            .then_some(Named { name, caption })
    };
    record.lights.iter().filter_map(picture).collect()
}

/// The picture as PNG.
///
/// # Errors
/// The session has no such image, or it is damaged.
pub fn png(session: &Session, of: PictureOf) -> Result<Vec<u8>, FileError> {
    let source = of.source();
    if !session.vouches_for(&source) {
        return Err(FileError::NoPicture { file: of.file() });
    }
    let picture = match of {
        PictureOf::Spheres { fit } => spheres(session, fit)?,
        _ => {
            beneath::open(session.root(), &source)?;
            let file = session.open_file(&source)?;
            let image = exr::read_opened(file, &session.root().join(&source), None)?.image;
            match of {
                PictureOf::Residual { .. } => {
                    let channels = [0, 1, 2].map(|channel| residual(&image, channel));
                    in_a_row(&channels)
                }
                PictureOf::Thumbnail => thumbnail(&exposed(session, &image)),
                _ => exposed(session, &image),
            }
        }
    };
    encode(&picture).map_err(|source| FileError::Encode {
        file: of.file(),
        source,
    })
}

/// The image in the exposure in which a white diffuser that faces the lamp is white, so that
/// materials look as dark and as coloured as they are.
fn exposed(session: &Session, image: &RadianceImage) -> Picture {
    let white = white_radiance(session).ok();
    white_balanced(image, white_of(white, white_level(image)))
}

fn spheres(session: &Session, fit: u32) -> Result<Picture, FileError> {
    let estimate = read_fit(session, fit)?
        .material()
        .map_err(FileError::Brdf)?;
    // A true material that this version cannot evaluate only takes the comparison away.
    let truth = session.record().true_material.as_deref();
    let truth = truth.and_then(|name| source::load(name).ok());
    let brdfs: Vec<_> = std::iter::once(&*estimate)
        .chain(truth.as_deref())
        .chain(std::iter::once(&GreyCard as &dyn Brdf))
        .collect();
    let images = sphere_images(&brdfs, &EnvironmentMap::all(), SPHERE_PX);
    let rows: Vec<Picture> = (0..brdfs.len())
        .map(|row| {
            let spheres = images.iter().map(|under| {
                let exposure = under[brdfs.len() - 1].neutral_exposure();
                Picture::opaque(SPHERE_PX, under[row].to_srgb(exposure))
            });
            in_a_row(&spheres.collect::<Vec<_>>())
        })
        .collect();
    Ok(in_a_column(&rows))
}

/// The picture within [`THUMBNAIL_PX`] a side, as the mean of the pixels behind each of its own.
fn thumbnail(picture: &Picture) -> Picture {
    let longest = picture.width.max(picture.height);
    if longest <= THUMBNAIL_PX {
        return picture.clone();
    }
    let side = |length: usize| (length * THUMBNAIL_PX / longest).max(1);
    let (width, height) = (side(picture.width), side(picture.height));
    Picture::from_fn(width, height, |x, y| {
        let columns = x * picture.width / width..(x + 1) * picture.width / width;
        let rows = y * picture.height / height..(y + 1) * picture.height / height;
        let pixels = rows.flat_map(|row| {
            columns
                .clone()
                .map(move |column| picture.pixels[row * picture.width + column])
        });
        let (mut sum, mut count) = ([0u32; 4], 0u32);
        for pixel in pixels {
            count += 1;
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += u32::from(value);
            }
        }
        sum.map(|sum| (sum / count.max(1)) as u8)
    })
}

/// Pictures of one height next to each other.
fn in_a_row(pictures: &[Picture]) -> Picture {
    let width = pictures.iter().map(|picture| picture.width + GAP_PX).sum();
    let height = pictures.iter().map(|picture| picture.height).max();
    let mut all = blank(width, height.unwrap_or(0));
    let mut left = 0;
    for picture in pictures {
        put(&mut all, picture, left, 0);
        left += picture.width + GAP_PX;
    }
    all
}

/// Pictures below each other.
fn in_a_column(pictures: &[Picture]) -> Picture {
    let width = pictures.iter().map(|picture| picture.width).max();
    let height = pictures.iter().map(|picture| picture.height + GAP_PX).sum();
    let mut all = blank(width.unwrap_or(0), height);
    let mut top = 0;
    for picture in pictures {
        put(&mut all, picture, 0, top);
        top += picture.height + GAP_PX;
    }
    all
}

fn blank(width: usize, height: usize) -> Picture {
    Picture::from_fn(width, height, |_, _| [0; 4])
}

fn put(all: &mut Picture, part: &Picture, left: usize, top: usize) {
    for (row, pixels) in part.pixels.chunks_exact(part.width.max(1)).enumerate() {
        let start = (top + row) * all.width + left;
        all.pixels[start..start + part.width].copy_from_slice(pixels);
    }
}

fn encode(picture: &Picture) -> Result<Vec<u8>, image::ImageError> {
    let mut png = Vec::new();
    PngEncoder::new_with_quality(
        Cursor::new(&mut png),
        CompressionType::Fast,
        FilterType::Adaptive,
    )
    .write_image(
        picture.pixels.as_flattened(),
        picture.width as u32,
        picture.height as u32,
        ExtendedColorType::Rgba8,
    )?;
    Ok(png)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_one_name() {
        for of in [
            PictureOf::Thumbnail,
            PictureOf::Radiance(3),
            PictureOf::Rendered { fit: 0, light: 12 },
            PictureOf::Residual { fit: 4, light: 0 },
            PictureOf::Spheres { fit: 1 },
        ] {
            assert_eq!(PictureOf::parse(&of.file()), Some(of));
        }
        for other in [
            "fits/0/residual_L0.png",
            "fits/00/residual_L000.png",
            "fits/+1/spheres.png",
            "fits/0/residual_L000.exr",
            "derived/radiance_L-01.png",
            "raw/L000_E00_R00_light.png",
        ] {
            assert_eq!(PictureOf::parse(other), None, "{other}");
        }
    }

    #[test]
    fn a_thumbnail_is_small_and_keeps_shape_and_mean() {
        let picture = Picture::from_fn(640, 321, |x, _| [(x % 2 * 100) as u8; 4]);
        let small = thumbnail(&picture);
        assert_eq!((small.width, small.height), (160, 80));
        assert!(small.pixels.iter().all(|pixel| *pixel == [50; 4]));
        assert_eq!(thumbnail(&small).pixels, small.pixels);
    }

    #[test]
    fn parts_stand_next_to_each_other() {
        let part = |value: u8| Picture::from_fn(2, 1, |_, _| [value; 4]);
        let row = in_a_row(&[part(1), part(2)]);
        assert_eq!((row.width, row.height), (2 * (2 + GAP_PX), 1));
        assert_eq!((row.pixels[1], row.pixels[2 + GAP_PX]), ([1; 4], [2; 4]));
        let column = in_a_column(&[part(1), part(2)]);
        assert_eq!((column.width, column.height), (2, 2 * (1 + GAP_PX)));
        assert_eq!(column.pixels[2 * (1 + GAP_PX)], [2; 4]);
        assert_eq!(in_a_column(&[]).pixels.len(), 0);
    }
}
