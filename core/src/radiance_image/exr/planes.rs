//! Which of a file's channels say what about radiance, and how a block's lines become
//! pixels.

use exr::block::UncompressedBlock;
use exr::meta::attribute::{ChannelDescription, ChannelList, SampleType};
use half::f16;

use super::layers::Layer;
use super::{COLOURS, MASK};
use crate::radiance_image::RadianceImage;

/// The channels that are read, in the file's order.
pub(super) struct Planes {
    planes: Vec<Plane>,
    bytes_per_pixel: usize,
    /// Whether variances are among them.
    pub has_variance: bool,
}

struct Plane {
    /// Bytes per pixel of the channels before this one.
    before_bytes: usize,
    sample_type: SampleType,
    role: Role,
}

/// What a channel's samples are.
#[derive(Clone, Copy)]
enum Role {
    Mean(usize),
    Variance(usize),
    GreyMean,
    GreyVariance,
    Mask,
}

impl Planes {
    /// Those of a layer, with its variances and mask where it has them.
    pub fn of(list: &ChannelList, layer: &Layer) -> Self {
        let prefix = &layer.prefix;
        let variance = |name: &str| format!("{prefix}var.{name}");
        let has = |name: &String| list.list.iter().any(|channel| channel.name == **name);
        let colours = COLOURS.map(variance);
        let grey = variance("Y");
        let mut roles: Vec<(String, Role)> = match &layer.colours[..] {
            [grey] => vec![(grey.clone(), Role::GreyMean)],
            names => names.iter().cloned().zip((0..3).map(Role::Mean)).collect(),
        };
        let means = roles.len();
        if colours.iter().all(has) {
            roles.extend(colours.into_iter().zip((0..3).map(Role::Variance)));
        } else if has(&grey) {
            roles.push((grey, Role::GreyVariance));
        }
        let has_variance = roles.len() > means;
        roles.push((format!("{prefix}{MASK}"), Role::Mask));
        let mut bytes_per_pixel = 0;
        let mut planes = Vec::new();
        for channel in &list.list {
            if let Some(&(_, role)) = roles.iter().find(|(name, _)| channel.name == **name) {
                planes.push(Plane {
                    before_bytes: bytes_per_pixel,
                    sample_type: channel.sample_type,
                    role,
                });
            }
            bytes_per_pixel += sample_bytes(channel);
        }
        Self {
            planes,
            bytes_per_pixel,
            has_variance,
        }
    }

    /// Puts a block's samples where they belong in `band`, whose first row is `first_row`
    /// of the image. False where the block has another length than its size needs.
    pub fn put(
        &self,
        block: &UncompressedBlock,
        first_row: usize,
        band: &mut RadianceImage,
    ) -> bool {
        let (left, top) = (
            block.index.pixel_position.0,
            block.index.pixel_position.1 - first_row,
        );
        let (width, height) = (block.index.pixel_size.0, block.index.pixel_size.1);
        if block.data.len() != width * height * self.bytes_per_pixel {
            return false;
        }
        for (y, line) in block
            .data
            .chunks_exact(width * self.bytes_per_pixel)
            .enumerate()
        {
            let start = (top + y) * band.width + left;
            let pixels = start..start + width;
            for plane in &self.planes {
                let samples = &line[plane.before_bytes * width..];
                let mean = &mut band.mean[pixels.clone()];
                let variance = &mut band.variance[pixels.clone()];
                let valid = &mut band.valid[pixels.clone()];
                match plane.role {
                    Role::Mean(c) => plane.each(samples, mean, |pixel, value| pixel[c] = value),
                    Role::GreyMean => plane.each(samples, mean, |pixel, value| *pixel = [value; 3]),
                    Role::Variance(c) => {
                        plane.each(samples, variance, |pixel, value| pixel[c] = value);
                    }
                    Role::GreyVariance => {
                        plane.each(samples, variance, |pixel, value| *pixel = [value; 3]);
                    }
                    Role::Mask => plane.each(samples, valid, |pixel, value| *pixel = value > 0.5),
                }
            }
        }
        true
    }
}

impl Plane {
    /// Goes over a line's samples and the pixels that they are of.
    fn each<P>(&self, samples: &[u8], pixels: &mut [P], mut put: impl FnMut(&mut P, f32)) {
        let four = samples.as_chunks::<4>().0;
        match self.sample_type {
            SampleType::F32 => {
                for (pixel, &bytes) in pixels.iter_mut().zip(four) {
                    put(pixel, f32::from_ne_bytes(bytes));
                }
            }
            SampleType::U32 => {
                for (pixel, &bytes) in pixels.iter_mut().zip(four) {
                    put(pixel, u32::from_ne_bytes(bytes) as f32);
                }
            }
            SampleType::F16 => {
                for (pixel, &bytes) in pixels.iter_mut().zip(samples.as_chunks::<2>().0) {
                    put(pixel, f16::from_ne_bytes(bytes).to_f32());
                }
            }
        }
    }
}

pub(super) fn sample_bytes(channel: &ChannelDescription) -> usize {
    channel.sample_type.bytes_per_sample()
}

/// Pixels without information become invalid and 0: values that are not finite, variances below 0.
pub(super) fn drop_meaningless(band: &mut RadianceImage) {
    let pixels = band
        .mean
        .iter_mut()
        .zip(&mut band.variance)
        .zip(&mut band.valid);
    for ((mean, variance), valid) in pixels {
        let good = mean.iter().all(|x| x.is_finite())
            && variance.iter().all(|x| x.is_finite() && *x >= 0.0);
        if !good {
            (*mean, *variance, *valid) = ([0.0; 3], [0.0; 3], false);
        }
    }
}
