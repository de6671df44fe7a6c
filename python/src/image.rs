//! Radiance images, as Python's RadianceImage.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use rig_bench::workflow::NamedImage;
use rig_core::radiance_image::RadianceImage;
use rig_core::radiance_image::exr::{self, ExrRows, RadianceFile};

use crate::arrays;
use crate::errors::{Fault, check_room, input};
use crate::records::record;

/// Mean, variance and validity of a pixel.
pub const BYTES_PER_PIXEL: usize = 2 * size_of::<[f32; 3]>() + 1;
/// Most pixels a side.
const LARGEST_SIDE_PX: usize = 1 << 16;

/// Reads an OpenEXR file.
#[pyfunction]
pub fn read_exr(py: Python<'_>, path: PathBuf) -> PyResult<Py<PyAny>> {
    let file = read(py, &path)?;
    image_record(py, file.image, file.has_variance)
}

/// The image of a file, if there is room for it.
pub fn read(py: Python<'_>, path: &Path) -> PyResult<RadianceFile> {
    check_size_of(&ExrRows::open(path, None).map_err(Fault::from)?)?;
    Ok(py.detach(|| exr::read(path)).map_err(Fault::from)?)
}

/// Writes an OpenEXR file.
#[pyfunction]
pub fn write_exr(py: Python<'_>, path: PathBuf, image: &Bound<'_, PyAny>) -> PyResult<()> {
    let RadianceFile { image, .. } = image_of(image, "image")?;
    py.detach(|| exr::write(&path, &image))
        .map_err(Fault::from)?;
    Ok(())
}

/// Python's RadianceImage, which takes the pixels over.
pub fn image_record(
    py: Python<'_>,
    image: RadianceImage,
    has_variance: bool,
) -> PyResult<Py<PyAny>> {
    let size = [image.height, image.width];
    let variance = match has_variance {
        true => Some(arrays::triples(py, image.variance, &size)?),
        false => None,
    };
    record!(
        py,
        "RadianceImage",
        mean = arrays::triples(py, image.mean, &size)?,
        variance = variance,
        valid = arrays::array(py, image.valid, &size)?,
    )
}

/// Images for a fit: each a RadianceImage, an array of means, or a file.
pub fn images_of(images: &Bound<'_, PyAny>) -> PyResult<Vec<NamedImage>> {
    if images.extract::<PathBuf>().is_ok() {
        return Err(input("images is a single path; a list of them is needed").into());
    }
    let mut named = Vec::new();
    for (index, image) in images.try_iter()?.enumerate() {
        let image = image?;
        let name = format!("images[{index}]");
        if let Ok(path) = image.extract::<PathBuf>() {
            named.push(read_named(image.py(), &path)?);
        } else {
            let RadianceFile {
                image,
                has_variance,
            } = image_of(&image, &name)?;
            named.push(NamedImage {
                name,
                image,
                has_variance,
            });
        }
    }
    Ok(named)
}

/// Refuses the image of a file for which there is no room.
pub fn check_size_of(rows: &ExrRows) -> PyResult<()> {
    check_room(arrays::product(&rows.size()), 2 * BYTES_PER_PIXEL)
}

fn read_named(py: Python<'_>, path: &Path) -> PyResult<NamedImage> {
    let RadianceFile {
        image,
        has_variance,
    } = read(py, path)?;
    Ok(NamedImage {
        name: path.display().to_string(),
        image,
        has_variance,
    })
}

/// A RadianceImage, or an array of means.
fn image_of(image: &Bound<'_, PyAny>, name: &str) -> PyResult<RadianceFile> {
    let [mean, variance, valid] = parts_of(image)?;
    let masks = [&mean, &variance, &valid].map(arrays::masked);
    let (mean, [height, width]) = pixels_of(&mean, &format!("{name}: mean"))?;
    let variance = match variance.is_none() {
        true => None,
        false => {
            let name = format!("{name}: variance");
            let (variance, size) = pixels_of(&variance, &name)?;
            check_size(size, [height, width], &name)?;
            Some(variance)
        }
    };
    let mut valid = match valid.is_none() {
        true => vec![true; width * height],
        false => validity_of(&valid, [height, width], &format!("{name}: valid"))?,
    };
    // What is masked in any of them is not valid.
    for mask in masks {
        let Some(mask) = mask? else { continue };
        let mask = arrays::readable(&mask, name)?;
        let mask = mask.as_array();
        let per_pixel = (mask.len() / valid.len()).max(1);
        for (index, masked) in mask.iter().enumerate() {
            valid[index / per_pixel] &= !masked;
        }
    }
    let has_variance = variance.is_some();
    let mut image = RadianceImage {
        width,
        height,
        mean,
        variance: variance.unwrap_or_else(|| vec![[0.0; 3]; width * height]),
        valid,
    };
    check_values(&mut image, name)?;
    Ok(RadianceFile {
        image,
        has_variance,
    })
}

/// Mean, variance and validity; None for what an array of means leaves out.
fn parts_of<'py>(image: &Bound<'py, PyAny>) -> PyResult<[Bound<'py, PyAny>; 3]> {
    let py = image.py();
    let records = py.import("rig_reflectometry.records")?;
    if !image.is_instance(&records.getattr("RadianceImage")?)? {
        let nothing = || py.None().into_bound(py);
        return Ok([image.clone(), nothing(), nothing()]);
    }
    let [mean, variance, valid] = ["mean", "variance", "valid"].map(|name| image.getattr(name));
    Ok([mean?, variance?, valid?])
}

/// Pixels of shape (rows, columns, 3), or (rows, columns) for grey ones.
fn pixels_of(values: &Bound<'_, PyAny>, name: &str) -> PyResult<(Vec<[f32; 3]>, [usize; 2])> {
    let array = arrays::singles(values, name)?;
    let array = arrays::readable(&array, name)?;
    let array = array.as_array();
    let (size, is_grey) = match *array.shape() {
        [height, width, 3] => ([height, width], false),
        [height, width] => ([height, width], true),
        _ => {
            let shape = arrays::shown(array.shape());
            let message = format!("{name} has shape {shape}, but must be (rows, columns, 3)");
            return Err(input(message).into());
        }
    };
    if size.iter().any(|&side| side == 0 || side > LARGEST_SIDE_PX) {
        let [height, width] = size;
        let message = format!(
            "{name} is of {height} × {width} pixels; 1 to {LARGEST_SIDE_PX} a side are allowed"
        );
        return Err(input(message).into());
    }
    check_room(arrays::product(&size), 2 * BYTES_PER_PIXEL)?;
    let pixels = match is_grey {
        true => array.iter().map(|&value| [value; 3]).collect(),
        false => array
            .rows()
            .into_iter()
            .map(|pixel| [pixel[0], pixel[1], pixel[2]])
            .collect(),
    };
    Ok((pixels, size))
}

fn validity_of(values: &Bound<'_, PyAny>, expected: [usize; 2], name: &str) -> PyResult<Vec<bool>> {
    let py = values.py();
    let array = py.import("numpy")?.call_method1("asarray", (values,))?;
    let Ok(array) = array.cast_into::<numpy::PyArray2<bool>>() else {
        return Err(input(format!(
            "{name} must be of type bool and shape (rows, columns)"
        ))
        .into());
    };
    use numpy::PyArrayMethods;
    let array = array
        .try_readonly()
        .map_err(|_| input(format!("{name} is being written to")))?;
    let array = array.as_array();
    check_size([array.nrows(), array.ncols()], expected, name)?;
    Ok(array.iter().copied().collect())
}

fn check_size(size: [usize; 2], expected: [usize; 2], name: &str) -> Result<(), Fault> {
    if size == expected {
        return Ok(());
    }
    let [height, width] = size;
    let [expected_height, expected_width] = expected;
    Err(input(format!(
        "{name} is of {height} × {width} pixels, but the means are of {expected_height} × {expected_width}"
    )))
}

/// Refuses what no valid pixel can hold; pixels that are not valid become 0, as in files.
fn check_values(image: &mut RadianceImage, name: &str) -> Result<(), Fault> {
    for pixel in 0..image.valid.len() {
        let (mean, variance) = (&mut image.mean[pixel], &mut image.variance[pixel]);
        if !image.valid[pixel] {
            (*mean, *variance) = ([0.0; 3], [0.0; 3]);
            continue;
        }
        let is_good = |value: &f32| value.is_finite();
        let (row, column) = (pixel / image.width, pixel % image.width);
        let place = format_args!("row {row}, column {column}").to_string();
        if let Some(bad) = mean.iter().find(|value| !is_good(value)) {
            return Err(input(format!(
                "{name}: mean is {bad} at {place}; such pixels must be marked as not valid"
            )));
        }
        if let Some(bad) = variance
            .iter()
            .find(|value| !is_good(value) || **value < 0.0)
        {
            return Err(input(format!(
                "{name}: variance is {bad} at {place}; it must be 0 or more, or the pixel marked as not valid"
            )));
        }
    }
    Ok(())
}
