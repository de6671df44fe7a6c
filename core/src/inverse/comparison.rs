//! Captured and modelled radiance of every cell, for the record and as pictures.

use std::sync::Arc;

use super::objective::{ModelImage, Objective};
use crate::cells::CellImage;
use crate::radiance_image::RadianceImage;
use crate::transport::Cells;

/// How the images compare with the model of the reported material.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// What was compared.
    pub cells: Arc<Cells>,
    /// One for each light.
    pub images: Vec<ComparedImage>,
}

/// One light's image by cells, R, G, B.
#[derive(Clone, Debug)]
pub struct ComparedImage {
    /// Radiance as captured.
    pub captured: CellImage,
    /// Radiance as modelled, with the variance that the paths leave.
    pub rendered: CellImage,
    /// (captured − model)/σ of capture, render and model error; 0 where not compared.
    pub residual: Vec<[f64; 3]>,
    /// Which cells were compared: not those at the edge of a shadow.
    pub compared: Vec<bool>,
    /// Mean squared residual per channel; isolated outliers count in it as they did in the fit.
    pub reduced_chi2: [f64; 3],
}

/// Longest side of a picture, pixels.
pub const LONGEST_SIDE_PX: usize = 512;

impl Comparison {
    /// Of a model by `objective`; lamps of this strength.
    pub(super) fn new(
        objective: &Objective<'_>,
        model: &[ModelImage],
        strength: &[[f64; 3]],
    ) -> Self {
        let images = model.iter().enumerate().map(|(light, modelled)| {
            let robust_weight = objective.robust_weights(model, light);
            let mut image = ComparedImage {
                captured: CellImage::default(),
                rendered: CellImage::default(),
                residual: Vec::with_capacity(modelled.len()),
                compared: Vec::with_capacity(modelled.len()),
                reduced_chi2: [0.0; 3],
            };
            for (cell, values) in modelled.iter().enumerate() {
                let compared = objective.is_compared(light, cell);
                let [target, variance] = objective.captured(light, cell);
                let scaled = |values: [f64; 3], power: i32| -> [f64; 3] {
                    std::array::from_fn(|c| values[c] * strength[light][c].powi(power))
                };
                image.captured.mean.push(scaled(target, 1));
                image.captured.variance.push(scaled(variance, 2));
                let mean = values.map(|modelled| modelled.value());
                image.rendered.mean.push(scaled(mean, 1));
                let noise = values.map(|modelled| modelled.variance);
                image.rendered.variance.push(scaled(noise, 2));
                let residual = std::array::from_fn(|c| {
                    let deviation = objective.deviation(model, light, cell, c);
                    deviation.filter(|_| compared).map_or(0.0, |(z, _)| z)
                });
                for c in 0..3 {
                    image.reduced_chi2[c] += robust_weight[cell][c] * residual[c] * residual[c];
                }
                image.residual.push(residual);
                image.compared.push(compared);
            }
            let count = image.compared.iter().filter(|&&compared| compared).count();
            image.reduced_chi2 = image.reduced_chi2.map(|sum| sum / count.max(1) as f64);
            image
        });
        Self {
            cells: objective.shared_cells(),
            images: images.collect(),
        }
    }

    /// Mean squared residual per light and channel.
    pub fn reduced_chi2(&self) -> Vec<[f64; 3]> {
        self.images.iter().map(|image| image.reduced_chi2).collect()
    }

    /// The modelled radiance of each light as a picture of at most [`LONGEST_SIDE_PX`], with its
    /// variance; valid where a cell is.
    pub fn rendered(&self) -> Vec<RadianceImage> {
        let images = self.images.iter();
        images
            .map(|image| {
                self.painted(|cell| {
                    let single = |values: [f64; 3]| values.map(|v| v as f32);
                    let variance = image.rendered.variance[cell];
                    Some([single(image.rendered.mean[cell]), single(variance)])
                })
            })
            .collect()
    }

    /// The residual of each light likewise; valid where it was compared.
    pub fn residual(&self) -> Vec<RadianceImage> {
        let images = self.images.iter();
        images
            .map(|image| {
                self.painted(|cell| {
                    let residual = image.residual[cell].map(|v| v as f32);
                    image.compared[cell].then_some([residual, [0.0; 3]])
                })
            })
            .collect()
    }

    /// All cells of all lights as a table of comma-separated values, one row each: light, corner,
    /// side and number of pixels, whether it was compared, then for R, G and B the radiance as
    /// captured with its standard deviation, as modelled with that of the paths, and the
    /// residual in standard deviations.
    pub fn to_csv(&self) -> String {
        use std::fmt::Write;
        let mut csv = String::from("light,x_px,y_px,side_px,pixels,compared");
        for name in [
            "captured",
            "captured_sd",
            "modelled",
            "modelled_sd",
            "residual",
        ] {
            for channel in ["r", "g", "b"] {
                let _ = write!(csv, ",{name}_{channel}");
            }
        }
        csv.push('\n');
        for (light, image) in self.images.iter().enumerate() {
            for (k, cell) in self.cells.iter().enumerate() {
                let [x, y] = cell.corner_px;
                let (side, pixels, compared) = (cell.side_px, cell.pixels(), image.compared[k]);
                let _ = write!(csv, "{light},{x},{y},{side},{pixels},{compared}");
                let values = [
                    image.captured.mean[k],
                    image.captured.variance[k].map(f64::sqrt),
                    image.rendered.mean[k],
                    image.rendered.variance[k].map(f64::sqrt),
                    image.residual[k],
                ];
                for value in values.as_flattened() {
                    let _ = write!(csv, ",{:?}", *value as f32);
                }
                csv.push('\n');
            }
        }
        csv
    }

    /// Mean and variance of the cell at every pixel of a picture; invalid where there is none.
    fn painted(&self, of: impl Fn(usize) -> Option<[[f32; 3]; 2]>) -> RadianceImage {
        let [width, height] = self.cells.resolution_px();
        let step = width.max(height).div_ceil(LONGEST_SIDE_PX);
        let size = [width, height].map(|side| side.div_ceil(step));
        let mut image = RadianceImage::new(size[0], size[1]);
        image.valid.fill(false);
        for cell in 0..self.cells.len() {
            let Some([mean, variance]) = of(cell) else {
                continue;
            };
            for [x, y] in self.cells.cell(cell).each_pixel() {
                // The pixel in the middle of those that the picture's stands for.
                let centre = step / 2;
                let shown = |at: usize, side: usize| {
                    at % step == centre || at + 1 == side && at % step < centre
                };
                if shown(x, width) && shown(y, height) {
                    let at = y / step * size[0] + x / step;
                    image.mean[at] = mean;
                    image.variance[at] = variance;
                    image.valid[at] = true;
                }
            }
        }
        image
    }
}
