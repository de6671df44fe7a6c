//! What speaks against a fit, and its most likely causes.

use crate::inverse::Fit;
use crate::inverse::diagnosis::Cause;
use crate::inverse::findings::{Finding, Flip};
use crate::radiance_image::CHANNEL_NAMES;
use crate::session::fit_record::{BenchRecord, FitRecord, Grade, UNEXPLAINED_CHI_SQUARE, Warning};
use crate::shown::nth;

/// Reasons not to trust a fit, or not in everything, with what most likely made them; the
/// gravest first. `stray_light_is_stated`: a glare record was used, or stray light refined.
pub(super) fn of_fit(fit: &Fit, record: &FitRecord, stray_light_is_stated: bool) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut warn = |grade: Grade, what: String, likely_cause: &str| {
        warnings.push(Warning {
            what,
            likely_cause: likely_cause.to_owned(),
            grade,
        });
    };

    // By the residual and the images. Stray light that the shadows show comes before what else
    // it may cause.
    let grave = match record.worst_reduced_chi_square() {
        Some(worst) if worst > UNEXPLAINED_CHI_SQUARE => Grade::Distrust,
        _ => Grade::Reservation,
    };
    let is_stray = |finding: &&Finding| matches!(finding, Finding::StrayLight { .. });
    let shares = fit.findings.iter().filter_map(|finding| match finding {
        Finding::StrayLight { share_of_mean, .. } => Some(*share_of_mean),
        _ => None,
    });
    let source = StraySource::of(&shares.collect::<Vec<f64>>(), stray_light_is_stated);
    for finding in fit.findings.iter().filter(is_stray) {
        let (_, what, likely_cause) = describe(finding, source);
        warn(grave, what, likely_cause);
    }
    let is_said = fit.findings.iter().any(|finding| is_stray(&finding))
        && fit.diagnosis.finding() == Some(Cause::StrayLight);
    let has_cause = is_said
        || describe_excess(fit, source, |what, likely_cause| {
            warn(grave, what, likely_cause)
        });
    for finding in fit.findings.iter().filter(|finding| !is_stray(finding)) {
        if matches!(finding, Finding::Misfit { .. }) && has_cause {
            continue;
        }
        let (grade, what, likely_cause) = describe(finding, source);
        warn(grade, what, likely_cause);
    }

    // By how the fit was made.
    if let Some(deviation) = record.bench.as_ref().and_then(common_scale_deviation)
        && deviation > NOTABLE_SCALE_DEVIATION
    {
        let percent = 100.0 * deviation;
        let is_open = record.bench.as_ref().is_some_and(holds_scale);
        warn(
            Grade::Reservation,
            if is_open {
                format!(
                    "nothing in these images determines the scale: the stated irradiance is kept, known within ±{percent:.0}% as stated, and f as a whole no better"
                )
            } else {
                format!(
                    "the irradiance is known within ±{percent:.0}% after the fit, and f as a whole no better"
                )
            },
            "images that show little interreflection, by which alone a fit finds the scale; `rig calibrate white` measures it",
        );
    }
    for (light, &share) in record.truncation_remainder.iter().enumerate() {
        if share > NOTABLE_REMAINDER {
            warn(
                Grade::Reservation,
                format!(
                    "paths of more than {} reflections, which were not followed, hold {:.2}% of the light ({light})",
                    record.settings.max_reflections,
                    100.0 * share,
                    light = nth("light", light)
                ),
                "--max-reflections is too small for so bright a material in so deep a shape",
            );
        }
    }
    for (light, &part) in fit.outlier_fraction.iter().enumerate() {
        if part > NOTABLE_OUTLIERS {
            warn(
                Grade::Reservation,
                format!(
                    "{:.1}% of the values of {light} are isolated outliers and have less weight",
                    100.0 * part,
                    light = nth("light", light)
                ),
                "dust or scratches on the sample, or hot pixels",
            );
        }
    }
    if fit.samples[0] < FEW_PATHS {
        warn(
            Grade::Reservation,
            format!(
                "{} paths per cell were followed; below {FEW_PATHS} the paths' noise can steer the fit",
                fit.samples[0]
            ),
            "--spp or --memory is small",
        );
    }
    warnings.sort_by_key(|warning| std::cmp::Reverse(warning.grade));
    warnings
}

/// Describes an excess residual with its cause, or as of no known cause; `false` without excess.
fn describe_excess(fit: &Fit, source: StraySource, mut warn: impl FnMut(String, &str)) -> bool {
    let diagnosis = &fit.diagnosis;
    let deviations = diagnosis.mean_square.sqrt();
    if let Some(cause) = diagnosis.finding() {
        let part = Cause::ALL
            .into_iter()
            .zip(diagnosis.explained)
            .find(|(c, _)| *c == cause)
            .map_or(0.0, |(_, part)| {
                100.0 * (part / diagnosis.mean_square).clamp(0.0, 1.0)
            });
        warn(
            format!(
                "the residual is {deviations:.1} times what noise and model error allow (root mean square); {part:.0}% of it looks like {}",
                looks_like(cause)
            ),
            advice(cause, source),
        );
        true
    } else if diagnosis.is_unexplained() {
        warn(
            format!(
                "the residual is {deviations:.1} times what noise and model error allow (root mean square); no single fault explains it"
            ),
            "a depth or shape that is not the mesh's, light that spreads below the surface, or a material beyond the mixtures and the model discrepancy; the report's residuals show where",
        );
        true
    } else {
        false
    }
}

/// What a finding means for the result, the fact, and its most likely cause.
fn describe(finding: &Finding, source: StraySource) -> (Grade, String, &'static str) {
    use Grade::{Distrust, Reservation};
    // Beyond this much, either way, a factor is no inaccuracy.
    let by_factor = |ratio: f64, limit: f64| {
        if ratio.ln().abs() > limit.ln() {
            Distrust
        } else {
            Reservation
        }
    };
    match *finding {
        Finding::StrayLight { image, share, .. } => (
            Reservation,
            format!(
                "{image} has stray light: {:.1}% of its bright parts (99th percentile) where neither the lamp nor the sample sends light",
                100.0 * share,
                image = nth("image", image)
            ),
            source.advice(),
        ),
        Finding::NoInformation { channel } => (
            Distrust,
            format!(
                "the images contain no information on the material in the {} channel: the result is the prior",
                CHANNEL_NAMES[channel]
            ),
            "variances as large as the images, too few paths (--spp), or a mask that leaves too little",
        ),
        Finding::DarkChannel { image, channel } => (
            Reservation,
            format!(
                "{image} shows no light above its noise in the {} channel",
                CHANNEL_NAMES[channel],
                image = nth("image", image)
            ),
            "a lamp or filter without this colour; the material's values there are upper limits",
        ),
        Finding::Misfit { mean_square } => (
            if mean_square > UNEXPLAINED_CHI_SQUARE {
                Distrust
            } else {
                Reservation
            },
            format!(
                "the images differ from those of the material by {:.1} times what noise and model error allow (root mean square of the worst image and channel)",
                mean_square.sqrt()
            ),
            "few values that are far off, such as glare or dust, or variances that are stated too small; the report's residuals show where",
        ),
        Finding::Unexplained { image, share } => (
            Distrust,
            format!(
                "{:.0}% of the light of {image} is not where the material puts it",
                100.0 * share.min(9.99),
                image = nth("image", image)
            ),
            "an image of something else, or a scene file whose camera, lights or sample are not those of the images",
        ),
        Finding::NoStructure { image } => (
            Distrust,
            format!(
                "{image} shows no shading of the sample: the same radiance in all pixels explains it as well",
                image = nth("image", image)
            ),
            "an image of noise or of an evenly lit surface, or a scene file that is not of this image",
        ),
        Finding::Scatter { image, ratio } => (
            by_factor(ratio, IMPOSSIBLE_SCATTER),
            format!(
                "neighbouring pixels of {image} scatter by {} times the standard deviation that its variance states",
                factor(ratio),
                image = nth("image", image)
            ),
            if ratio > 1.0 {
                "a variance that leaves out noise, such as that of the mean of several frames, or one in another unit"
            } else {
                "a variance in another unit, a standard deviation in its place, or images that were smoothed"
            },
        ),
        Finding::TooBright { channel, ratio } => (
            by_factor(ratio, IMPOSSIBLE_BRIGHTNESS),
            format!(
                "in the {} channel the images are {} times as bright as the brightest material that resembles them: it would reflect more light than arrives",
                CHANNEL_NAMES[channel],
                factor(ratio)
            ),
            "an irradiance or radiance in another unit, or not divided by the exposure; `rig calibrate white` measures the scale",
        ),
        Finding::Scale {
            channel,
            ratio,
            log_std,
        } => (
            by_factor(ratio, IMPOSSIBLE_SCALE),
            format!(
                "in the {} channel direct light and interreflections agree if the irradiance is {} (± {:.0}%) times the stated one",
                CHANNEL_NAMES[channel],
                factor(ratio),
                100.0 * log_std
            ),
            "an irradiance in another unit or of another lamp; `rig calibrate white` measures it, and --refine-bench --uncertainty common_intensity=1 fits it",
        ),
        Finding::Bounded { channel, albedo } => (
            by_factor(albedo, IMPOSSIBLE_ALBEDO),
            format!(
                "the images ask for a material that reflects up to {:.0}% of the {} light that arrives; it was bounded to 100%",
                100.0 * albedo,
                CHANNEL_NAMES[channel]
            ),
            "intensities that are stated too low, or angles that the images show little of; `rig calibrate white` measures the scale, more lights show more angles",
        ),
        Finding::Exchanged { image, light, flip } => (
            Distrust,
            format!(
                "{image} looks like that of {light}{}",
                match flip {
                    Flip::None => "",
                    Flip::Horizontal => " with left and right exchanged",
                    Flip::Vertical => " with top and bottom exchanged",
                    Flip::HalfTurn => " turned by 180°",
                },
                image = nth("image", image),
                light = nth("light", light)
            ),
            match flip {
                Flip::None => "images that are not in the order of the scene's lights",
                _ => {
                    "images that were mirrored or turned, or a camera whose `up` or side is another"
                }
            },
        ),
    }
}

/// Two significant digits.
fn factor(ratio: f64) -> String {
    match ratio.abs().log10().floor() {
        magnitude if magnitude >= 4.0 => format!("{ratio:.1e}"),
        magnitude => {
            let digits = (1.0 - magnitude).max(0.0) as usize;
            format!("{ratio:.digits$}")
        }
    }
}

/// Standard deviation of the intensities' common scale, relative, where the bench was refined with
/// unknown intensities: that of the light known best, which a common error cannot exceed.
fn common_scale_deviation(bench: &BenchRecord) -> Option<f64> {
    let intensities = bench.parameter.iter();
    let intensities = intensities.filter(|parameter| parameter.name.starts_with("intensity"));
    intensities
        .map(|intensity| intensity.deviation)
        .min_by(f64::total_cmp)
}

/// Whether the images leave the intensities' common scale open.
fn holds_scale(bench: &BenchRecord) -> bool {
    bench
        .held
        .iter()
        .any(|name| name.starts_with("intensity of"))
}

/// Standard deviation of the common scale up to which it needs no warning.
const NOTABLE_SCALE_DEVIATION: f64 = 0.1;
/// Light beyond the longest path that a fit should not leave out.
const NOTABLE_REMAINDER: f64 = 1e-3;
/// Outlier fraction up to which dust needs no warning.
const NOTABLE_OUTLIERS: f64 = 0.02;
/// Paths per pixel from which independent halves work well.
const FEW_PATHS: u32 = 128;
/// Albedo before the bound from which a material is no result.
const IMPOSSIBLE_ALBEDO: f64 = 1.2;
/// Scatter of neighbouring pixels over the stated one, either way, that no noise model is off by.
const IMPOSSIBLE_SCATTER: f64 = 10.0;
/// Brightness over the brightest material's that no inaccuracy of the irradiance explains.
const IMPOSSIBLE_BRIGHTNESS: f64 = 1.25;
/// Factor between irradiances, either way, that no inaccuracy explains.
const IMPOSSIBLE_SCALE: f64 = 1.5;

/// Factor between images' shares of their means up to which these count as the same.
const PROPORTIONAL: f64 = 1.5;

/// What the residual looks like, by cause.
fn looks_like(cause: Cause) -> &'static str {
    match cause {
        Cause::StrayLight => "stray light",
        Cause::ShapeOrPose => "a wrong shape or pose",
        Cause::NonUniform => "a material that varies",
        Cause::Translucency => "translucency or blur",
        Cause::Dictionary => "a material beyond the dictionary",
    }
}

/// Where stray light most likely comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum StraySource {
    /// The lens: it is in proportion to the images' means, and no glare was measured.
    Lens,
    /// The bench or the lens, whose glare was not measured.
    Either,
    /// The bench: what the lens adds is known.
    Bench,
}

impl StraySource {
    /// By its shares of the means of the images that show any.
    fn of(shares: &[f64], is_stated: bool) -> Self {
        let [least, most] = shares
            .iter()
            .fold([f64::INFINITY, 0.0], |[low, high], &share| {
                [share.min(low), share.max(high)]
            });
        match is_stated {
            true => Self::Bench,
            false if shares.len() > 1 && most < PROPORTIONAL * least => Self::Lens,
            false => Self::Either,
        }
    }

    fn advice(self) -> &'static str {
        match self {
            Self::Lens => {
                "glare of the lens, because it is in proportion to the images' means; there is no record of it (`rig calibrate glare` makes one); or stray light from the room or the holder"
            }
            Self::Either => {
                "stray light from the room or the holder, or glare of the lens; darken the one, or subtract frames taken with the lamp off, and measure the other, of which there is no record: `rig calibrate glare`"
            }
            Self::Bench => {
                "stray light from the room or the holder; darken them, or subtract frames taken with the lamp off"
            }
        }
    }
}

/// What to look at, by cause.
fn advice(cause: Cause, source: StraySource) -> &'static str {
    match cause {
        Cause::StrayLight => source.advice(),
        Cause::ShapeOrPose => {
            "pose or shape of the sample differ from the scene file's; measure its pose again"
        }
        Cause::NonUniform => {
            "the material varies over the sample; fit a uniform region alone with --mask"
        }
        Cause::Translucency => {
            "light spreads below the surface, or the image is not sharp; neither is part of the model"
        }
        Cause::Dictionary => {
            "neither mixtures of the dictionary nor the model discrepancy describe the material; try another with --dictionary, or more lights"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glare_is_named_where_it_is_not_known() {
        for (shares, is_stated, source) in [
            (&[0.010, 0.011, 0.012][..], false, StraySource::Lens),
            (&[0.010, 0.011, 0.012], true, StraySource::Bench),
            (&[0.010, 0.018], false, StraySource::Either),
            (&[0.010], false, StraySource::Either),
            (&[], false, StraySource::Either),
        ] {
            let found = StraySource::of(shares, is_stated);
            assert_eq!(found, source, "{shares:?}");
            let names_glare = found.advice().contains("no record");
            assert_eq!(names_glare, !is_stated, "{shares:?}");
        }
    }
}
