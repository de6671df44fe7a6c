//! Does a fit predict images that it has not seen? A part of the lights is fitted, the rest is
//! predicted and compared with what was captured.

use std::borrow::Cow;
use std::path::Path;

use super::cell_images::{assume_noise, read_mask};
use super::fit_images::{remarks_on, sources_of};
use super::fit_plan::FitPlan;
use super::fit_run::Run;
use super::fit_session::prepared;
use super::notice::Observer;
use super::scene_check::check_scene;
use super::validate_baselines::{Fitted, Neighbours, lambertian};
use super::validate_keep::picture_of;
use super::validate_pixels::{Pixel, compared, of_sample};
use super::validate_predict::{predict, under};
use super::validate_score::{Compared, Tally};
use super::{FitRequest, NamedImage, WorkflowError};
use crate::cells::AverageError;
use crate::config::scene::SceneFile;
use crate::config::scene_concern::DescribedIn;
use crate::radiance_image::{RadianceImage, exr};
use crate::session::fit_record::FitRecord;
use crate::session::utc_now;
use crate::session::validation::{FORMAT, LeftOut, Validation};
use crate::shown::nth;
use crate::transport::Scene;

/// Which lights are fitted; the rest is predicted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum HoldOut {
    /// A quarter of the lights, one at least, is predicted: the fit keeps most of what it would
    /// have had, so that its error is nearly that of the fit of all lights.
    #[default]
    Quarter,
    /// So many lights are predicted, evenly spaced in the scene's order.
    Count(usize),
    /// These lights, from 0, are fitted.
    Fitted(Vec<usize>),
}

/// Lights that cannot be divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum HoldOutError {
    #[error(
        "{lights} of the scene's lights has an image; one to fit and one to predict are needed"
    )]
    TooFew { lights: usize },
    /// Nothing is left to fit or to predict.
    #[error("{held_out} of {lights} lights are to be predicted; allowed are 1 to {}", lights - 1)]
    Count { held_out: usize, lights: usize },
    #[error("there is no {light}: the lights are 1 to {lights}", light = nth("light", *light))]
    NoSuchLight { light: usize, lights: usize },
}

impl HoldOut {
    /// Of `lights` lights, those that are fitted and those that are predicted, from 0, ascending.
    ///
    /// # Errors
    /// Nothing to fit or to predict, or a light that is not there.
    pub fn divide(&self, lights: usize) -> Result<[Vec<usize>; 2], HoldOutError> {
        if lights < 2 {
            return Err(HoldOutError::TooFew { lights });
        }
        let evenly = |count: usize| -> Vec<usize> {
            (0..count)
                .map(|k| (2 * k + 1) * lights / (2 * count))
                .collect()
        };
        let held_out = match self {
            Self::Quarter => evenly((lights / 4).max(1)),
            Self::Count(count) if (1..lights).contains(count) => evenly(*count),
            Self::Count(count) => {
                let held_out = *count;
                return Err(HoldOutError::Count { held_out, lights });
            }
            Self::Fitted(fitted) => {
                if let Some(&light) = fitted.iter().find(|&&light| light >= lights) {
                    return Err(HoldOutError::NoSuchLight { light, lights });
                }
                (0..lights)
                    .filter(|light| !fitted.contains(light))
                    .collect()
            }
        };
        if held_out.is_empty() || held_out.len() == lights {
            let held_out = held_out.len();
            return Err(HoldOutError::Count { held_out, lights });
        }
        let fitted = (0..lights)
            .filter(|light| !held_out.contains(light))
            .collect();
        Ok([fitted, held_out])
    }
}

/// A predicted light's images.
#[derive(Clone, Debug)]
pub struct LightPrediction {
    /// Its number, from 0.
    pub light: usize,
    /// As captured; valid where it is compared.
    pub captured: RadianceImage,
    /// As predicted, with the variance of posterior samples and paths together.
    pub predicted: RadianceImage,
}

/// What a validation found.
#[derive(Clone, Debug)]
pub struct Validated {
    /// The errors.
    pub validation: Validation,
    /// The fit of a part of the lights.
    pub fit: FitRecord,
    /// Per predicted light the name of a PNG file and its bytes: captured, predicted, difference.
    /// Empty in a build without the feature `figures`.
    pub pictures: Vec<(String, Vec<u8>)>,
}

/// Validates a session, which is only read. The bench is taken as its records describe it.
///
/// # Errors
/// As [`fit_session`](super::fit_session); lights that cannot be divided.
pub fn validate_session(
    root: &Path,
    hold_out: &HoldOut,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<Validated, WorkflowError> {
    let mut prepared = prepared(root, request, observer)?;
    let rows = std::mem::take(&mut prepared.images);
    let whole = rows.into_iter().enumerate().map(|(light, mut rows)| {
        Ok::<_, WorkflowError>(NamedImage {
            name: crate::session::layout::radiance_file(light as u32),
            image: rows.next_rows(rows.size()[1])?,
            has_variance: true,
        })
    });
    let images: Vec<NamedImage> = whole.collect::<Result<_, _>>()?;
    let (scene, plan) = (&prepared.scene, &prepared.plan);
    let mut found = drawn(scene, plan, images.into(), hold_out, observer)?;
    found.fit.remarks.extend(prepared.glare_remark);
    found.validation.simulated = prepared.session.record().simulated;
    Ok(found)
}

/// Validates images of a scene file, one per light in its order.
///
/// # Errors
/// As [`fit_images`](super::fit_images); lights that cannot be divided.
pub fn validate_images<P: AsRef<Path>>(
    scene: &Path,
    images: &[P],
    hold_out: &HoldOut,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<Validated, WorkflowError> {
    let file = SceneFile::load(scene)?;
    let read = images.iter().map(|path| {
        let path = path.as_ref();
        let read = exr::read_sized(path, file.camera.resolution_px)?;
        Ok::<_, WorkflowError>(NamedImage {
            name: path.display().to_string(),
            image: read.image,
            has_variance: read.has_variance,
        })
    });
    let images: Vec<NamedImage> = read.collect::<Result<_, _>>()?;
    let (scene, plan) = described(&file, request, observer)?;
    drawn(&scene, &plan, images.into(), hold_out, observer)
}

/// Likewise of images in memory; `each` takes the images of each predicted light in turn.
///
/// # Errors
/// Likewise.
pub fn validate_images_in_memory(
    file: &SceneFile,
    images: &[NamedImage],
    hold_out: &HoldOut,
    request: &FitRequest,
    observer: &dyn Observer,
    mut each: impl FnMut(LightPrediction),
) -> Result<(Validation, FitRecord), WorkflowError> {
    let (scene, plan) = described(file, request, observer)?;
    validate(
        &scene,
        &plan,
        images.into(),
        hold_out,
        observer,
        |prediction| {
            each(prediction);
            Ok(())
        },
    )
}

/// The scene of a file, and the plan of a fit of its images.
fn described(
    file: &SceneFile,
    request: &FitRequest,
    observer: &dyn Observer,
) -> Result<(Scene, FitPlan), WorkflowError> {
    let plan = FitPlan::new(request, None, &file.uncertainty, file.sample.form_error)?;
    let scene = file.scene()?;
    check_scene(&scene, DescribedIn::Scene, &file.sample.surface, observer)?;
    Ok((scene, plan))
}

/// Validates, and draws the picture of each light as soon as it is predicted: its images are then
/// freed.
fn drawn(
    scene: &Scene,
    plan: &FitPlan,
    images: Cow<'_, [NamedImage]>,
    hold_out: &HoldOut,
    observer: &dyn Observer,
) -> Result<Validated, WorkflowError> {
    let mut pictures = Vec::new();
    let (validation, fit) = validate(scene, plan, images, hold_out, observer, |prediction| {
        pictures.extend(picture_of(&prediction)?);
        Ok(())
    })?;
    Ok(Validated {
        validation,
        fit,
        pictures,
    })
}

fn validate(
    scene: &Scene,
    plan: &FitPlan,
    images: Cow<'_, [NamedImage]>,
    hold_out: &HoldOut,
    observer: &dyn Observer,
    mut each: impl FnMut(LightPrediction) -> Result<(), WorkflowError>,
) -> Result<(Validation, FitRecord), WorkflowError> {
    let (given, lights) = (images.len(), scene.lights.len());
    if given != lights {
        let images = given;
        return Err(AverageError::ImageCount { images, lights }.into());
    }
    let sources = sources_of(&images, scene.camera.resolution_px)?;
    let remarks = remarks_on(&sources, observer);
    let unstated: Vec<Option<f32>> = sources.iter().map(|s| s.mean_of_unstated).collect();
    let [fitted, held_out] = hold_out.divide(images.len())?;

    // The fit of a part.
    let part = under(scene, &fitted);
    let sources = sources.into_iter().enumerate();
    let of_part = sources.filter(|(light, _)| fitted.contains(light));
    let captured = plan.average(&part, of_part.map(|(_, source)| source).collect())?;
    let Run {
        mut record,
        fit,
        refined,
    } = plan.run(&part, &captured, false, None, observer)?;
    record.remarks.extend(remarks);

    // What was captured is compared without the lens' glare, as predictions have none.
    let mut images = images;
    if let Some(glare) = &plan.glare {
        let images = images.to_mut().iter_mut();
        images.for_each(|image| glare.remove_from(&mut image.image));
    }

    // The sample where the refined bench has it, under all lights. Those that were not fitted
    // could not be refined.
    let refined = refined.map(|mut refined| {
        refined.lights.clone_from(&scene.lights);
        refined.falloffs.clone_from(&scene.falloffs);
        refined
    });
    let scene = refined.as_ref().unwrap_or(scene);

    // The pixels, and what else predicts them.
    let mask = plan.mask.as_deref();
    let mask = mask
        .map(|path| read_mask(path, scene.camera.resolution_px))
        .transpose()?;
    let sample = of_sample(scene);
    let pixels_of = |light: usize| -> (Vec<Pixel>, LeftOut) {
        compared(scene, light, &sample, &images[light].image, mask.as_deref())
    };
    let seen: Vec<Vec<Pixel>> = fitted.iter().map(|&light| pixels_of(light).0).collect();
    let seen = fitted.iter().zip(&seen);
    let seen: Vec<Fitted<'_>> = seen
        .map(|(&light, pixels)| (&pixels[..], &images[light].image))
        .collect();
    let lambertian = lambertian(&seen);
    let mut neighbours = Neighbours::of(&seen);

    // The prediction of the rest, a few lights at a time.
    let posterior = record.posterior.as_ref();
    let has_intervals = posterior.is_some_and(|posterior| posterior.samples.len() > 1);
    let (mut all, mut lights) = (Tally::default(), Vec::new());
    let material = &fit.material;
    let samples = predict(
        scene,
        &held_out,
        material,
        &record,
        observer,
        |light, predicted| {
            let (pixels, left_out) = pixels_of(light);
            let captured = with_noise(&images[light].image, unstated[light]);
            let tally = Tally::of(
                &Compared {
                    pixels: &pixels,
                    left_out,
                    captured: &captured,
                    predicted: &predicted.image,
                    deviations: has_intervals.then_some(&predicted.deviations[..]),
                    lambertian,
                },
                &mut neighbours,
            );
            lights.push(tally.score(light, has_intervals));
            all.join(tally);
            let deviations = &predicted.deviations;
            each(pictured(
                light,
                &captured,
                predicted.image,
                deviations,
                &pixels,
            ))
        },
    )?;
    let validation = Validation {
        format: FORMAT,
        simulated: false,
        made_utc: utc_now(),
        rig: env!("CARGO_PKG_VERSION").to_owned(),
        dictionary: record.dictionary.clone(),
        verdict: record.verdict(),
        images: images.iter().map(|image| image.name.clone()).collect(),
        fitted_lights: fitted,
        posterior_samples: samples,
        all: all.score(lights.len(), has_intervals),
        lights,
    };
    Ok((validation, record))
}

/// An image with the noise that the fit assumes where none is stated, given its mean then.
fn with_noise(image: &RadianceImage, mean_of_unstated: Option<f32>) -> Cow<'_, RadianceImage> {
    let mut image = Cow::Borrowed(image);
    if let Some(mean) = mean_of_unstated {
        assume_noise(image.to_mut(), mean);
    }
    image
}

/// The images of a light, valid where they are compared.
fn pictured(
    light: usize,
    captured: &RadianceImage,
    mut predicted: RadianceImage,
    deviations: &[[f32; 3]],
    pixels: &[Pixel],
) -> LightPrediction {
    let mut captured = captured.clone();
    captured.valid.fill(false);
    for pixel in pixels {
        captured.valid[pixel.index] = true;
    }
    for (variance, deviation) in predicted.variance.iter_mut().zip(deviations) {
        (0..3).for_each(|c| variance[c] += deviation[c] * deviation[c]);
    }
    predicted.valid.clone_from(&captured.valid);
    LightPrediction {
        light,
        captured,
        predicted,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::Brdf;
    use crate::cells::glare::Glare;
    use crate::transport::{RenderOptions, render};
    use glam::Vec3;

    /// A lobe that no dictionary has, over a diffuse base.
    struct Measured;

    impl Brdf for Measured {
        fn eval(&self, to_light: Vec3, to_viewer: Vec3) -> [f32; 3] {
            if to_light.z <= 0.0 || to_viewer.z <= 0.0 {
                return [0.0; 3];
            }
            let half = (to_light + to_viewer).normalize();
            let lobe = 0.4 * (-(1.0 - half.z * half.z) / 0.06).exp();
            [0.12, 0.08, 0.05].map(|diffuse| diffuse + lobe)
        }
    }

    fn scene() -> SceneFile {
        let mut text = "[camera]\nmodel = \"orthographic\"\nresolution_px = [32, 32]\nextent_mm = [2.2, 2.2]\nposition_mm = [0.0, 0.0, 9.0]\n[sample]\nshape = { kind = \"sphere\", radius_mm = 1.0, segments = 96 }\nshading = \"smooth\"\n".to_owned();
        for [x, y] in [[0.0, 0.1], [0.5, 0.1], [-0.4, 0.3], [0.1, -0.6]] {
            text += &format!(
                "[[light]]\nkind = \"directional\"\nto_light = [{x}, {y}, 1.0]\nirradiance = 3.0\n"
            );
        }
        SceneFile::parse("scene.toml", Path::new(""), &text).unwrap()
    }

    #[test]
    fn what_is_stated_is_the_error_against_the_rendered_truth() {
        let file = scene();
        let options = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 2,
            ..RenderOptions::default()
        };
        let truth = render(&file.scene().unwrap(), &Measured, &options);
        let images: Vec<NamedImage> = truth
            .iter()
            .map(|image| NamedImage {
                name: "captured".to_owned(),
                image: RadianceImage {
                    variance: image
                        .mean
                        .iter()
                        .map(|m| m.map(|m| (0.003 * m).powi(2) + 1e-8))
                        .collect(),
                    ..image.clone()
                },
                has_variance: true,
            })
            .collect();
        let request = FitRequest {
            dictionary: Some("paper42".to_owned()),
            samples_per_cell: Some(16),
            max_reflections: Some(2),
            ..FitRequest::default()
        };
        let (quarter, mut predictions) = (HoldOut::default(), Vec::new());
        let each = |prediction| predictions.push(prediction);
        let found = validate_images_in_memory(&file, &images, &quarter, &request, &(), each);
        let found = found.unwrap().0;
        let score = &found.all.overall;
        assert_eq!(found.fitted_lights, [0, 1, 3]);
        let prediction = &predictions[0];
        assert_eq!(prediction.light, 2);
        let (mut error, mut square) = (0.0, 0.0);
        for pixel in (0..truth[2].mean.len()).filter(|&p| prediction.predicted.valid[p]) {
            for c in 0..3 {
                let true_value = f64::from(truth[2].mean[pixel][c]);
                error += (f64::from(prediction.predicted.mean[pixel][c]) - true_value).powi(2);
                square += true_value * true_value;
            }
        }
        let expected = (error / square).sqrt();
        let stated = score.relative_rms.unwrap();
        assert!((stated - expected).abs() < 1e-9, "{stated} {expected}");
        assert!(score.pixels > 300, "{score:?}");
        assert!(
            stated < 0.06 && stated < 0.5 * score.lambertian.unwrap(),
            "{score:?}"
        );
        assert_eq!(score.neighbours, None, "too few lights");
        assert_eq!(found.posterior_samples, 16);
    }

    /// The lens has 1% of glare, the record states (0 ± 1)%: one deviation off. Its uncertainty
    /// widens the intervals, which contain no fewer pixels.
    #[test]
    fn intervals_contain_what_is_not_known_of_the_glare() {
        let file = scene();
        let options = RenderOptions {
            samples_per_pixel: 64,
            max_reflections: 1,
            ..RenderOptions::default()
        };
        let matt = crate::brdf::load("lambertian:0.4").unwrap();
        let mut images = render(&file.scene().unwrap(), &*matt, &options);
        for image in &mut images {
            let pixels = image.mean.len() as f32;
            let mean = [0, 1, 2].map(|c| image.mean.iter().map(|m| m[c]).sum::<f32>() / pixels);
            for (radiance, variance) in image.mean.iter_mut().zip(&mut image.variance) {
                *radiance = std::array::from_fn(|c| 0.99 * radiance[c] + 0.01 * mean[c]);
                *variance = radiance.map(|m| (0.001 * m).powi(2) + 1e-8);
            }
        }
        let named = |image: RadianceImage| NamedImage {
            name: "captured".to_owned(),
            image,
            has_variance: true,
        };
        let images: Vec<NamedImage> = images.into_iter().map(named).collect();
        let request = FitRequest {
            dictionary: Some("rig26".to_owned()),
            samples_per_cell: Some(16),
            max_reflections: Some(1),
            ..FitRequest::default()
        };
        let score = |std: f64| {
            let (scene, mut plan) = described(&file, &request, &()).unwrap();
            plan.glare = Some(Glare {
                uniform: 0.0,
                halo: 0.0,
                halo_width: 0.1,
                covariance: [[std * std, 0.0], [0.0, 0.0]],
            });
            let found = validate(
                &scene,
                &plan,
                (&images[..]).into(),
                &HoldOut::default(),
                &(),
                |_| Ok(()),
            );
            let all = found.unwrap().0.all;
            (all.coverage.unwrap(), all.median_half_width.unwrap())
        };
        let (known, unknown) = (score(0.0), score(0.01));
        assert!(unknown.0 >= known.0, "{known:?} {unknown:?}");
        assert!(unknown.1 > 1.15 * known.1, "{known:?} {unknown:?}");
    }

    #[test]
    fn lights_are_divided_or_refused() {
        let quarter = HoldOut::Quarter;
        assert_eq!(quarter.divide(8), Ok([vec![0, 1, 3, 4, 5, 7], vec![2, 6]]));
        assert_eq!(quarter.divide(2), Ok([vec![0], vec![1]]));
        let these = HoldOut::Fitted(vec![2, 0]);
        assert_eq!(these.divide(4), Ok([vec![0, 2], vec![1, 3]]));
        for (choice, lights) in [
            (quarter, 1),
            (HoldOut::Count(0), 4),
            (HoldOut::Count(4), 4),
            (HoldOut::Fitted(vec![4]), 4),
            (HoldOut::Fitted(vec![0, 1]), 2),
        ] {
            assert!(choice.divide(lights).is_err(), "{choice:?}");
        }
    }
}
