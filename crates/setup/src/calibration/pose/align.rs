//! The sample's pose from the images of a session, by Gauss–Newton from coarse pixels
//! to fine ones within the rig file's uncertainty. The step comes from a truncated
//! spectrum and the blur is eliminated, so that [`crate::least_squares`] does not fit here.

use nalgebra::{DMatrix, DVector};

use super::patches::{
    BLUR_PX2, Eliminated, LARGEST_BLUR_PX2, Pair, PatchEquations, SIDE, Target, accumulate_patches,
    needed, with_edges,
};
use super::pyramid::{factors, moved_px, target};
use super::regions::{Grid, Sight};
use super::search::{WIDEST_DEG, search};
use super::slope::slope;
use super::{PoseError, PoseEstimate, PoseOptions, ResidualShift};
use crate::bench_priors::BenchPriors;
use crate::calibration::record::Measured;
use crate::inverse::nuisance::parameters::MIN_INFORMATION;
use crate::inverse::nuisance::spectrum::Spectrum;
use crate::inverse::nuisance::{Nuisance, Parameter};
use crate::radiance_image::RadianceImage;
use crate::transport::Scene;

/// Pixels by which a step of the derivatives moves the sample.
const STEP_PX: f64 = 0.5;
/// Derivatives hold while the sample has moved by less, pixels.
const NEAR_PX: f64 = 0.3;
/// Done when a step is shorter, in posterior deviations.
const SETTLED: f64 = 0.1;
/// A pose this many prior deviations off contradicts the rig file.
const TOO_FAR: f64 = 4.0;
/// Squared contrast of the patches over noise below which there is none.
const LEAST_CONTRAST: f64 = 2.0;
/// Part of the patches' contrast that predicted regions must explain.
const LEAST_EXPLAINED: f64 = 0.5;

/// Finds the pose of `scene`'s sample in one image per light; see [`super`].
pub fn align(
    scene: &Scene,
    images: &[RadianceImage],
    priors: &BenchPriors,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    check(scene, images, priors)?;
    check_view(scene)?;
    align_from(scene, images, priors, options, None)
}

/// As [`align`]; where the description is too far off for that, the pose is searched for
/// first, within `WIDEST_DEG` and a field's width, and the stated uncertainty of the pose
/// gives way to that range.
///
/// # Errors
/// Those of [`align`], where a search finds nothing better either.
pub fn find(
    scene: &Scene,
    images: &[RadianceImage],
    priors: &BenchPriors,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    use PoseError::{NoEdges, NotThere, OutsideView, TooFar};
    let error = match align(scene, images, priors, options) {
        Err(error @ (OutsideView { .. } | NoEdges | NotThere { .. } | TooFar { .. })) => error,
        other => return other,
    };
    let sight = Sight::new(scene.sample(), options.subsamples);
    let Some(start) = search(scene, &sight, images) else {
        return Err(error);
    };
    let [low, high] = scene.sample().bounds_mm();
    let wide = BenchPriors {
        rotation_rad: 0.5 * WIDEST_DEG.to_radians(),
        translation_mm: f64::from((high - low).length()),
        ..priors.clone()
    };
    match align_from(scene, images, &wide, options, Some(start)) {
        Ok(found) if rotation_of(&found) <= WIDEST_DEG.to_radians() => Ok(PoseEstimate {
            searched: true,
            ..found
        }),
        _ => Err(error),
    }
}

/// The angle by which a pose is turned, radians.
fn rotation_of(found: &PoseEstimate) -> f64 {
    let [x, y, z, ..] = found.values;
    glam::DVec3::new(x, y, z).length()
}

/// Aligns from a rotation vector (radians) and a translation (mm), or from the description.
fn align_from(
    scene: &Scene,
    images: &[RadianceImage],
    priors: &BenchPriors,
    options: &PoseOptions,
    start: Option<[glam::DVec3; 2]>,
) -> Result<PoseEstimate, PoseError> {
    let priors = BenchPriors {
        intensity: 0.0,
        stray_light: 0.0,
        pose_covariance: None,
        ..priors.clone()
    };
    let mut aligner = Aligner {
        bench: Nuisance::new(scene, &priors),
        sight: Sight::new(scene.sample(), options.subsamples),
        images,
        options,
        values: DVector::zeros(0),
        blur_px2: 0.0,
    };
    aligner.values = DVector::zeros(aligner.bench.parameters().len());
    let mut sizes = factors(scene, &priors, options);
    if let Some([rotation, translation]) = start {
        let six = rotation
            .to_array()
            .into_iter()
            .chain(translation.to_array());
        for (k, value) in aligner.bench.of_light(None).into_iter().zip(six) {
            aligner.values[k] = value;
        }
        // A search ends within a pixel or two.
        let two = sizes.len().saturating_sub(2);
        sizes.drain(..two);
    }
    let finest = sizes.last().copied();
    let mut last = None;
    let mut rounds = 0;
    for factor in sizes {
        // A blur seen on coarse pixels is wider on finer ones.
        aligner.blur_px2 = match &last {
            Some(_) => (4.0 * aligner.blur_px2).clamp(BLUR_PX2[0], LARGEST_BLUR_PX2),
            None => BLUR_PX2[0],
        };
        let (level, taken) = aligner.level(factor, Some(&factor) == finest.as_ref())?;
        rounds += taken;
        last = Some((level, factor));
    }
    let (level, factor) = last.ok_or(PoseError::TooSmall)?;
    aligner.estimate(&level, factor, rounds)
}

fn check(scene: &Scene, images: &[RadianceImage], priors: &BenchPriors) -> Result<(), PoseError> {
    if images.len() != scene.lights.len() || images.is_empty() {
        return Err(PoseError::ImageCount {
            images: images.len(),
            lights: scene.lights.len(),
        });
    }
    if priors.rotation_rad <= 0.0 || priors.translation_mm <= 0.0 {
        return Err(PoseError::Exact);
    }
    let [width, height] = scene.camera.resolution_px;
    if let Some(light) = images
        .iter()
        .position(|i| [i.width, i.height] != [width, height])
    {
        return Err(PoseError::ImageSize {
            light,
            width,
            height,
        });
    }
    Ok(())
}

/// Refuses a mesh that is not in the camera's view.
fn check_view(scene: &Scene) -> Result<(), PoseError> {
    let size = scene.camera.resolution_px.map(|n| n as f64);
    let corners = &scene.sample().positions_mm;
    let inside = corners.iter().filter(|p| {
        let at = scene.camera.position_px(p.as_dvec3());
        at.is_some_and(|at| (0.0..size[0]).contains(&at.x) && (0.0..size[1]).contains(&at.y))
    });
    let percent = 100.0 * inside.count() as f64 / corners.len().max(1) as f64;
    if percent < LEAST_IN_VIEW_PERCENT {
        return Err(PoseError::OutsideView { percent });
    }
    Ok(())
}

/// Part of the mesh's corners that must appear in the image.
const LEAST_IN_VIEW_PERCENT: f64 = 10.0;

struct Aligner<'a> {
    bench: Nuisance,
    sight: Sight<'a>,
    images: &'a [RadianceImage],
    options: &'a PoseOptions,
    values: DVector<f64>,
    blur_px2: f64,
}

/// Where the rounds on one size of pixels ended.
struct Level {
    grid: Grid,
    patches: Vec<PatchEquations>,
    sum: Sum,
    settled: bool,
}

/// What is compared around one pose.
struct Views {
    patches: Vec<[usize; 2]>,
    wanted: Vec<bool>,
    pairs: Vec<Pair>,
}

/// All patches together with the blur eliminated.
struct Sum {
    spectrum: Spectrum,
    score: DVector<f64>,
    /// Information of blur and the other parameters together, and of the blur, with its
    /// prior.
    to_blur: DVector<f64>,
    blur_information: f64,
    blur_score: f64,
}

impl Aligner<'_> {
    /// Rounds on one size of pixels; on the finest, the slope of the score is measured.
    fn level(&mut self, factor: usize, finest: bool) -> Result<(Level, usize), PoseError> {
        let grid = Grid::new(self.images_size(), factor);
        let targets: Vec<Target> = self.images.iter().map(|i| target(i, grid)).collect();
        let mut views = self.views(grid)?;
        let mut away_px = 0.0;
        let mut round = 0;
        // The slope of the score, and the round in which it was measured.
        let mut measured: Option<(DMatrix<f64>, usize)> = None;
        loop {
            round += 1;
            if away_px > NEAR_PX * factor as f64 && measured.is_none() {
                views = self.views(grid)?;
                away_px = 0.0;
            }
            let patches = self.equations(grid, &targets, &views, &self.values, None);
            let sum = self.sum(&patches, measured.as_ref().map(|(slope, _)| slope));
            // The rays' noise moves where the score vanishes: once its slope is measured, the
            // mean over the rounds is sought.
            let averaged = measured.as_ref().map(|(_, since)| round - since);
            let gain = averaged.map_or(1.0, |rounds| 1.0 / rounds as f64);
            let step = sum.spectrum.step(&self.values, &sum.score) * gain;
            let settled = self.length(&sum.spectrum, &step) < SETTLED;
            tracing::debug!(factor, round, values = ?self.values.as_slice(), step = ?step.as_slice(), blur = self.blur_px2, "pose round");
            if finest && measured.is_none() && (settled || round >= self.options.rounds / 3) {
                let step_of = |along: &DVector<f64>| self.step_of(along, factor);
                let moved = |by: &DVector<f64>| {
                    let values = &self.values + by;
                    self.equations(grid, &targets, &views, &values, Some(&patches))
                };
                measured = Some((slope(&self.bench, &patches, step_of, moved), round));
                continue;
            }
            if settled || averaged.unwrap_or(round) >= self.options.rounds {
                let level = Level {
                    grid,
                    patches,
                    sum,
                    settled,
                };
                return Ok((level, round));
            }
            let blur = (sum.blur_score - sum.to_blur.dot(&step)) / sum.blur_information;
            self.blur_px2 = (self.blur_px2 + blur).clamp(0.0, LARGEST_BLUR_PX2);
            away_px += moved_px(&self.bench, &step);
            self.values += step;
        }
    }

    /// The pose's part of a step in posterior standard deviations, lights marginalised.
    fn length(&self, spectrum: &Spectrum, step: &DVector<f64>) -> f64 {
        let pose = self.bench.of_light(None);
        let root = spectrum.posterior_root().select_rows(&pose);
        let moved = step.select_rows(&pose);
        match (&root * root.transpose()).cholesky() {
            Some(covariance) => moved.dot(&covariance.solve(&moved)).sqrt(),
            None => f64::INFINITY,
        }
    }

    fn images_size(&self) -> [usize; 2] {
        [self.images[0].width, self.images[0].height]
    }

    /// The patches with edges, and how the regions in them change with the parameters.
    fn views(&self, grid: Grid) -> Result<Views, PoseError> {
        let seed = grid.factor as u64;
        let scene = self.bench.scene(&self.values);
        let everywhere = vec![true; grid.pixels()];
        let base = self.sight.parts(&scene, grid, &everywhere, seed);
        let patches = with_edges(grid, &base);
        if patches.is_empty() {
            return Err(PoseError::NoEdges);
        }
        let wanted = needed(grid, &patches);
        let parameters = self.bench.parameters();
        // A light's direction changes its own image alone: all lights step together.
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let kinds = [
            |p: &Parameter| matches!(p, Parameter::LightAzimuth(_)),
            |p: &Parameter| matches!(p, Parameter::LightElevation(_)),
        ];
        for kind in kinds {
            groups.push(
                (0..parameters.len())
                    .filter(|&k| kind(&parameters[k]))
                    .collect(),
            );
        }
        groups.extend(self.bench.of_light(None).into_iter().map(|k| vec![k]));
        groups.retain(|group| !group.is_empty());
        let pairs: Vec<Pair> = groups
            .into_iter()
            .map(|group| {
                let mut one = DVector::zeros(self.values.len());
                one[group[0]] = 1.0;
                let step = self.step_of(&one, grid.factor);
                let parts = [1.0, -1.0].map(|sign| {
                    let mut values = self.values.clone();
                    for &k in &group {
                        values[k] += sign * step;
                    }
                    self.sight
                        .parts(&self.bench.scene(&values), grid, &wanted, seed)
                });
                Pair {
                    parameters: group,
                    parts,
                    across: 2.0 * step,
                }
            })
            .collect();
        Ok(Views {
            patches,
            wanted,
            pairs,
        })
    }

    /// Normal equations of all patches where the parameters are `values`; weighted as
    /// `like` or by their own residuals.
    fn equations(
        &self,
        grid: Grid,
        targets: &[Target],
        views: &Views,
        values: &DVector<f64>,
        like: Option<&[PatchEquations]>,
    ) -> Vec<PatchEquations> {
        let scene = self.bench.scene(values);
        let base = self
            .sight
            .parts(&scene, grid, &views.wanted, grid.factor as u64);
        accumulate_patches(
            grid,
            targets,
            &views.patches,
            &base,
            &views.pairs,
            self.bench.parameters(),
            self.blur_px2,
            like,
        )
    }

    /// A step along a direction of the parameters that moves the image by half a pixel of the
    /// grid, at most three prior deviations; a light's is one that moves shadows about as far.
    fn step_of(&self, along: &DVector<f64>, factor: usize) -> f64 {
        let parameters = self.bench.parameters();
        let pose = self.bench.of_light(None).iter().any(|&k| along[k] != 0.0);
        let turn = |p: &Parameter| matches!(p, Parameter::Rotation(_));
        let moved = match parameters.iter().position(turn) {
            // The arc over the sample that a pixel is.
            Some(k) if !pose => {
                let mut values = DVector::zeros(along.len());
                values[k] = along.amax();
                moved_px(&self.bench, &values)
            }
            _ => moved_px(&self.bench, along),
        };
        let deviations = (0..along.len()).map(|k| along[k].abs() / self.bench.prior_deviation(k));
        let largest = 3.0 / deviations.fold(1e-12, f64::max);
        (STEP_PX * factor as f64 / moved.max(1e-9)).min(largest)
    }

    fn sum(&self, patches: &[PatchEquations], slope: Option<&DMatrix<f64>>) -> Sum {
        let n = self.values.len();
        let eliminated = Eliminated::new(patches, n);
        let mut block_scores: Vec<DVector<f64>> = patches
            .iter()
            .map(|patch| eliminated.score(patch))
            .collect();
        // The estimate has made the patches' scores smaller than their errors.
        let spectrum = Spectrum::new(&self.bench, slope.unwrap_or(&eliminated.information));
        let determined = spectrum
            .values
            .iter()
            .filter(|v| **v >= MIN_INFORMATION)
            .count();
        let count = patches.len() as f64;
        let grow = (count / (count - determined as f64).max(1.0)).sqrt();
        let prior_pull = (BLUR_PX2[0] - self.blur_px2) * BLUR_PX2[1].powi(-2);
        let score = block_scores
            .iter()
            .fold(DVector::zeros(n), |sum, s| sum + s)
            - &eliminated.to_blur * (prior_pull / eliminated.blur_information);
        for score in &mut block_scores {
            *score *= grow;
        }
        Sum {
            spectrum: spectrum.widened(&block_scores, 1.0),
            score,
            blur_score: patches.iter().map(|p| p.score[n]).sum::<f64>() + prior_pull,
            to_blur: eliminated.to_blur,
            blur_information: eliminated.blur_information,
        }
    }

    fn estimate(
        &self,
        level: &Level,
        factor: usize,
        rounds: usize,
    ) -> Result<PoseEstimate, PoseError> {
        let parameters = self.bench.parameters();
        let pose = self.bench.of_light(None);
        // Whether the images show the sample's edges where they are predicted.
        let spectrum = &level.sum.spectrum;
        let deviations = spectrum.deviations();
        let determined = pose
            .iter()
            .any(|&k| deviations[k] < 0.5 * self.bench.prior_deviation(k));
        let [chi2, freedom] = [0, 1].map(|i| level.patches.iter().map(|p| p.chi2[i]).sum::<f64>());
        let plain: f64 = level.patches.iter().map(|p| p.chi2_plain).sum();
        let explained = 1.0 - (chi2 - freedom).max(0.0) / (plain - freedom).max(1e-9);
        if !determined || plain < LEAST_CONTRAST * freedom {
            return Err(PoseError::NoEdges);
        }
        if explained < LEAST_EXPLAINED {
            return Err(PoseError::NotThere {
                percent: 100.0 * explained.max(0.0),
            });
        }
        // Whether the pose is within the rig file's uncertainty.
        for &k in &pose {
            let deviations = self.values[k].abs() / self.bench.prior_deviation(k);
            if deviations > TOO_FAR {
                let (unit, scale) = parameters[k].shown_in();
                return Err(PoseError::TooFar {
                    what: parameters[k].to_string(),
                    value: self.values[k] * scale,
                    unit,
                    deviations,
                });
            }
        }
        // The pose with its covariance, the lights marginalised.
        let root = spectrum.posterior_root();
        let all = &root * root.transpose();
        let pixel = |v: f64| v * (factor * factor) as f64;
        let blur_std = level.sum.blur_information.recip().sqrt();
        Ok(PoseEstimate {
            values: std::array::from_fn(|i| self.values[pose[i]]),
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| all[(pose[i], pose[j])])),
            prior: std::array::from_fn(|i| self.bench.prior_deviation(pose[i])),
            held: spectrum
                .fixed(&self.bench)
                .into_iter()
                .filter(|name| !name.contains("light"))
                .collect(),
            blur_px2: Measured::new(pixel(self.blur_px2), pixel(blur_std)),
            reduced_chi2: chi2 / freedom.max(1.0),
            explained,
            shifts: self.shifts(level),
            pixel_px: factor,
            rounds,
            settled: level.settled,
            searched: false,
        })
    }

    /// By how much each patch would still move the sample, along the direction that it
    /// determines best.
    fn shifts(&self, level: &Level) -> Vec<ResidualShift> {
        let translations: Vec<usize> = (0..self.values.len())
            .filter(|&k| matches!(self.bench.parameters()[k], Parameter::Translation(_)))
            .collect();
        let mut unit = DVector::zeros(self.values.len());
        let shift = |patch: &PatchEquations| -> Option<ResidualShift> {
            let own = DMatrix::from_fn(3, 3, |i, j| {
                patch.information[(translations[i], translations[j])]
            });
            let eigen = own.symmetric_eigen();
            let best = eigen.eigenvalues.imax();
            let information = eigen.eigenvalues[best];
            let direction = eigen.eigenvectors.column(best);
            let score: f64 = (0..3)
                .map(|i| direction[i] * patch.score[translations[i]])
                .sum();
            for i in 0..3 {
                unit[translations[i]] = direction[i];
            }
            let px_per_mm = moved_px(&self.bench, &unit);
            let [x, y] = patch
                .at
                .map(|i| (i + SIDE / 2) as f64 * level.grid.factor as f64);
            (information > 0.0).then(|| ResidualShift {
                at_px: [x, y],
                shift_px: score / information * px_per_mm,
                std_px: px_per_mm / information.sqrt(),
            })
        };
        level.patches.iter().filter_map(shift).collect()
    }
}
