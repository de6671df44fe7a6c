//! Whether a sample is the same all over and in every direction: it is turned by angles
//! about its axis under which its shape is the same, and its images compared.
//!
//! Under light and view that stand still, a turned sample of one isotropic material shows
//! the same image. Radiance of regions (sectors of rings about the axis) is compared between
//! the turns, by channel. What differs in a region under all lights alike speaks against one
//! material; what differs otherwise under other lights speaks against isotropy.

use glam::{DQuat, DVec2, DVec3};

use crate::geometry::{Bvh, Ray};
use crate::radiance_image::RadianceImage;
use crate::statistics::{chi2_tail, median};
use crate::transport::Scene;

/// Rings of equal area about the axis, and sectors of each.
const RINGS: usize = 2;
const SECTORS: usize = 8;
const REGIONS: usize = RINGS * SECTORS;
/// A region with fewer pixels is not compared.
const LEAST_PIXELS: usize = 6;
/// A region this much darker than the brightest under its light is in shadow.
const DARK: f64 = 0.02;
/// How far the turned surface may be from the shape, over its size.
const SYMMETRY: f64 = 0.01;
/// Points of the surface at which that is checked, at most.
const CHECKED: usize = 400;

/// Images of the sample turned by one angle, one per light.
pub struct Turn<'a> {
    /// Angle about the sample's z axis, degrees.
    pub angle_deg: f64,
    /// Images.
    pub images: &'a [RadianceImage],
}

/// Why turns cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum RotationError {
    /// Fewer than two turns.
    #[error("{found} turns of the sample, at least 2 are compared")]
    TooFew { found: usize },
    /// A session of another bench.
    #[error("turn {} has other lights or pixels than the first", index + 1)]
    Differs {
        /// The turn, from 0.
        index: usize,
    },
    #[error("the shape is another one when turned by {angle_deg}°: up to {off_mm:.3} mm elsewhere")]
    NotSymmetric {
        angle_deg: f64,
        /// Largest distance of a turned point from the surface along the view.
        off_mm: f64,
    },
    #[error(
        "only {found} regions of the sample are lit and in view, at least {needed} are compared"
    )]
    NothingSeen { found: usize, needed: usize },
}

/// A sum of squares that is χ² distributed for a good sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChiSquare {
    /// The sum, of the channel that differs most.
    pub value: f64,
    /// Its degrees of freedom.
    pub freedom: f64,
    /// Chance that a good sample gives as much in one of three channels.
    pub p: f64,
}

/// Whether a sample is uniform and isotropic.
#[derive(Clone, Debug, PartialEq)]
pub struct RotationTest {
    /// Whether all regions are of one material.
    pub uniformity: ChiSquare,
    /// Whether the material is the same in every direction.
    pub isotropy: ChiSquare,
    /// Root mean square relative difference of regions between turns.
    pub difference: f64,
    /// Regions that were compared, over all lights.
    pub compared: usize,
}

impl RotationTest {
    /// Usual relative standard deviation of a region's radiance when a sample is seated
    /// again.
    pub const REPEATABILITY: f64 = 0.01;
    /// Usual chance that a good sample fails.
    pub const SIGNIFICANCE: f64 = 0.01;

    /// Whether neither test rejects the sample, at this significance for both together.
    pub fn passes(&self, significance: f64) -> bool {
        self.uniformity.p.min(self.isotropy.p) >= 0.5 * significance
    }
}

/// Compares turns of `scene`'s sample. `repeatability` is the relative standard deviation of
/// a region's radiance when the sample is seated again.
pub fn compare(
    scene: &Scene,
    turns: &[Turn],
    repeatability: f64,
) -> Result<RotationTest, RotationError> {
    let Some(first) = turns.first().filter(|_| turns.len() > 1) else {
        return Err(RotationError::TooFew { found: turns.len() });
    };
    let pixels = scene.camera.pixels();
    for (index, turn) in turns.iter().enumerate() {
        let fits = turn.images.len() == scene.lights.len()
            && turn.images.iter().all(|i| i.mean.len() == pixels);
        if !fits {
            return Err(RotationError::Differs { index });
        }
    }
    let surface = Surface::of(scene);
    for turn in &turns[1..] {
        surface.check(scene, turn.angle_deg - first.angle_deg)?;
    }
    let regions = surface.regions(scene);
    let sums: Vec<Vec<[Mean; 3]>> = turns.iter().map(|t| means(t, &regions)).collect();
    test(&sums, scene.lights.len(), repeatability)
}

/// Radiance of a region, and the variance of its noise.
#[derive(Clone, Copy, Default)]
struct Mean {
    value: f64,
    variance: f64,
    pixels: usize,
}

/// By light, then region.
fn means(turn: &Turn, regions: &[Option<usize>]) -> Vec<[Mean; 3]> {
    let mut means = Vec::new();
    for image in turn.images {
        let mut sums = [[Mean::default(); 3]; REGIONS];
        for (pixel, region) in regions.iter().enumerate() {
            let Some(region) = region.filter(|_| image.valid[pixel]) else {
                continue;
            };
            for (channel, sum) in sums[region].iter_mut().enumerate() {
                sum.value += f64::from(image.mean[pixel][channel]);
                sum.variance += f64::from(image.variance[pixel][channel]);
                sum.pixels += 1;
            }
        }
        for sum in sums.iter_mut().flatten() {
            let n = sum.pixels.max(1) as f64;
            sum.value /= n;
            sum.variance /= n * n;
        }
        means.extend(sums);
    }
    means
}

fn test(
    sums: &[Vec<[Mean; 3]>],
    lights: usize,
    repeatability: f64,
) -> Result<RotationTest, RotationError> {
    let turns = sums.len() as f64;
    let mut worst: Option<[ChiSquare; 2]> = None;
    let (mut squares, mut count, mut compared) = (0.0, 0.0, 0);
    for channel in 0..3 {
        let at = |turn: usize, light: usize, region: usize| {
            sums[turn][light * REGIONS + region][channel]
        };
        let mean = |light: usize, region: usize| {
            (0..sums.len())
                .map(|t| at(t, light, region).value)
                .sum::<f64>()
                / turns
        };
        // The lights under which each region is lit and in view.
        let brightest = |light: usize| (0..REGIONS).map(|r| mean(light, r)).fold(0.0, f64::max);
        let cells: Vec<Vec<usize>> = (0..REGIONS)
            .map(|region| {
                let seen = |light: &usize| {
                    let enough =
                        (0..sums.len()).all(|t| at(t, *light, region).pixels >= LEAST_PIXELS);
                    enough && mean(*light, region) > DARK * brightest(*light)
                };
                (0..lights).filter(seen).collect()
            })
            .collect();
        let found = cells.iter().filter(|lights| !lights.is_empty()).count();
        if found < REGIONS / 2 {
            return Err(RotationError::NothingSeen {
                found,
                needed: REGIONS / 2,
            });
        }
        // The lamp may have changed between sessions: the median ratio is its.
        let scales: Vec<f64> = (0..sums.len())
            .map(|turn| {
                let compared = (0..REGIONS).flat_map(|r| cells[r].iter().map(move |&l| (l, r)));
                let ratios = compared.map(|(l, r)| at(turn, l, r).value / mean(l, r));
                median(ratios).unwrap_or(1.0).max(1e-12)
            })
            .collect();
        // χ² and degrees of freedom: of a region's mean over the lights (uniformity), and
        // of the lights about that mean (isotropy).
        let mut sums2 = [[0.0f64; 2]; 2];
        for (region, lights) in cells.iter().enumerate().filter(|(_, l)| !l.is_empty()) {
            for (turn, scale) in scales.iter().enumerate() {
                let share = 1.0 - 1.0 / turns;
                let offs: Vec<[f64; 2]> = lights
                    .iter()
                    .map(|&light| {
                        let (own, mean) = (at(turn, light, region), mean(light, region));
                        let noise2 = own.variance / (mean * mean);
                        [own.value / (scale * mean) - 1.0, noise2]
                    })
                    .collect();
                let n = offs.len() as f64;
                let off = offs.iter().map(|o| o[0]).sum::<f64>() / n;
                let noise2 = offs.iter().map(|o| o[1]).sum::<f64>() / n;
                let own2 = repeatability.powi(2);
                sums2[0][0] += off * off / (share * (noise2 / n + own2));
                sums2[0][1] += share;
                for [o, noise2] in &offs {
                    sums2[1][0] += (o - off).powi(2) / (share * (noise2 + own2));
                    squares += o * o;
                    count += 1.0;
                }
                sums2[1][1] += share * (n - 1.0);
                compared += offs.len();
            }
        }
        // One scale per turn was taken from them.
        sums2[0][1] -= turns - 1.0;
        let own = sums2.map(|[value, freedom]| ChiSquare {
            value,
            freedom,
            p: (3.0 * chi2_tail(value, freedom)).min(1.0),
        });
        worst = Some(match worst {
            None => own,
            Some(old) => [0, 1].map(|i| if own[i].p < old[i].p { own[i] } else { old[i] }),
        });
    }
    let Some([uniformity, isotropy]) = worst else {
        return Err(RotationError::TooFew { found: 0 });
    };
    Ok(RotationTest {
        uniformity,
        isotropy,
        difference: (squares / f64::max(count, 1.0)).sqrt(),
        compared: compared / 3 / sums.len(),
    })
}

/// What each pixel's middle sees.
struct Surface {
    bvh: Bvh,
    /// In the sample's frame, millimetres.
    points: Vec<Option<DVec3>>,
}

impl Surface {
    fn of(scene: &Scene) -> Self {
        let bvh = Bvh::new(scene.sample());
        let width = scene.camera.resolution_px[0];
        let point = |pixel: usize| {
            let at = DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5;
            let ray = scene.camera.ray(at, DVec2::ZERO);
            let hit = bvh.closest(&ray)?;
            Some((ray.origin_mm + ray.direction * hit.distance_mm).as_dvec3())
        };
        let points = (0..scene.camera.pixels()).map(point).collect();
        Self { bvh, points }
    }

    /// Points of the surface must lie on it when turned.
    fn check(&self, scene: &Scene, angle_deg: f64) -> Result<(), RotationError> {
        let turn = DQuat::from_rotation_z(angle_deg.to_radians());
        let seen: Vec<DVec3> = self.inner(scene).into_iter().flatten().collect();
        let size_mm = seen
            .iter()
            .map(|p| p.truncate().length())
            .fold(1e-9, f64::max);
        let every = (seen.len() / CHECKED).max(1);
        let mut off_mm = 0.0f64;
        for point in seen.iter().step_by(every) {
            let turned = turn * *point;
            let ray = Ray {
                origin_mm: (turned + DVec3::Z * 4.0 * size_mm).as_vec3(),
                direction: -glam::Vec3::Z,
                limit_mm: f32::INFINITY,
            };
            let off = match self.bvh.closest(&ray) {
                Some(hit) => (f64::from(hit.distance_mm) - 4.0 * size_mm).abs(),
                None => size_mm,
            };
            off_mm = off_mm.max(off);
        }
        match off_mm <= SYMMETRY * size_mm {
            true => Ok(()),
            false => Err(RotationError::NotSymmetric { angle_deg, off_mm }),
        }
    }

    /// The points of pixels all of whose neighbours see the sample.
    fn inner(&self, scene: &Scene) -> Vec<Option<DVec3>> {
        let [width, height] = scene.camera.resolution_px;
        (0..self.points.len())
            .map(|pixel| {
                let (x, y) = (pixel % width, pixel / width);
                let edge = x == 0 || y == 0 || x + 1 == width || y + 1 == height;
                let around = || {
                    (y - 1..=y + 1)
                        .all(|y| (x - 1..=x + 1).all(|x| self.points[y * width + x].is_some()))
                };
                self.points[pixel].filter(|_| !edge && around())
            })
            .collect()
    }

    /// The region of each pixel.
    fn regions(&self, scene: &Scene) -> Vec<Option<usize>> {
        let inner = self.inner(scene);
        let radius = |p: &DVec3| p.truncate().length();
        let widest = inner.iter().flatten().map(radius).fold(1e-9, f64::max);
        let region = |p: DVec3| {
            let ring = (radius(&p) / widest).powi(2) * RINGS as f64;
            let around = p.truncate().to_angle() / std::f64::consts::TAU + 0.5;
            let sector = ((around * SECTORS as f64) as usize).min(SECTORS - 1);
            (ring as usize).min(RINGS - 1) * SECTORS + sector
        };
        inner.into_iter().map(|p| p.map(region)).collect()
    }
}

#[cfg(test)]
mod tests;
