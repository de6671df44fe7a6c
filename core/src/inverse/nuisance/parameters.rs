//! What may differ from a bench's description, how well it is known, and the scene
//! that the differences make.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use crate::bench_priors::BenchPriors;
use crate::cells::Captured;
use crate::frames::{Rigid, Sample};
use crate::shown::nth;
use crate::transport::{Light, Scene};

/// An axis of the sample's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// To the right in the image of a camera from above.
    X,
    /// Up in the image.
    Y,
    /// Towards the camera's side.
    Z,
}

impl Axis {
    const ALL: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

    fn unit(self) -> DVec3 {
        [DVec3::X, DVec3::Y, DVec3::Z][self as usize]
    }

    fn name(self) -> char {
        ['x', 'y', 'z'][self as usize]
    }
}

/// One way in which a bench may differ from its description. Lights count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// A light's direction, towards larger azimuth about the sample's z; an arc, radians.
    LightAzimuth(usize),
    /// A light's direction, towards the sample's z, radians.
    LightElevation(usize),
    /// Natural logarithm of a light's intensity over the stated one.
    Intensity(usize),
    /// The sample's rotation about an axis through its datum, radians.
    Rotation(Axis),
    /// The sample's place, millimetres.
    Translation(Axis),
    /// Constant radiance in one light's image, unit of the images.
    StrayLight(usize),
}

impl std::fmt::Display for Parameter {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Parameter::LightAzimuth(light) => {
                write!(out, "azimuth of {light}", light = nth("light", *light))
            }
            Parameter::LightElevation(light) => {
                write!(out, "elevation of {light}", light = nth("light", *light))
            }
            Parameter::Intensity(light) => {
                write!(out, "intensity of {light}", light = nth("light", *light))
            }
            Parameter::Rotation(axis) => write!(out, "rotation about {}", axis.name()),
            Parameter::Translation(axis) => write!(out, "translation along {}", axis.name()),
            Parameter::StrayLight(light) => {
                write!(out, "stray light in {light}", light = nth("image", *light))
            }
        }
    }
}

impl Parameter {
    /// Unit in which values are shown, and how many of it one internal unit is.
    pub fn shown_in(self) -> (&'static str, f64) {
        match self {
            Parameter::LightAzimuth(_) | Parameter::LightElevation(_) | Parameter::Rotation(_) => {
                ("deg", 1f64.to_degrees())
            }
            Parameter::Intensity(_) => ("relative", 1.0),
            Parameter::Translation(_) => ("mm", 1.0),
            Parameter::StrayLight(_) => ("radiance", 1.0),
        }
    }

    /// Whether it changes where light goes, not just how much there is.
    pub fn is_geometric(self) -> bool {
        !matches!(self, Parameter::Intensity(_) | Parameter::StrayLight(_))
    }

    /// The light of which it is a property; `None` for the sample's pose.
    pub fn light(self) -> Option<usize> {
        match self {
            Parameter::LightAzimuth(light)
            | Parameter::LightElevation(light)
            | Parameter::Intensity(light)
            | Parameter::StrayLight(light) => Some(light),
            Parameter::Rotation(_) | Parameter::Translation(_) => None,
        }
    }
}

/// Deviation of the common scale before any image, ln, above which weights that know their own
/// size within their prior would know the scale better.
const WIDE_SCALE: f64 = 0.1;

/// λ below which a direction is fixed: the posterior's deviation would be above 87% of
/// the prior's.
pub const MIN_INFORMATION: f64 = 1.0 / 3.0;

/// A described bench and what may differ from the description. Values of the
/// parameters are differences: all zero is the description.
pub struct Nuisance {
    described: Scene,
    parameters: Vec<Parameter>,
    /// Prior covariance, and its lower Cholesky factor.
    covariance: DMatrix<f64>,
    root: DMatrix<f64>,
}

impl Nuisance {
    /// The parameters whose prior deviation is above 0.
    pub fn new(described: &Scene, priors: &BenchPriors) -> Self {
        let lights = 0..described.lights.len();
        let mut parameters = Vec::new();
        let mut deviations = Vec::new();
        let mut add = |deviation: f64, new: &mut dyn Iterator<Item = Parameter>| {
            if deviation > 0.0 {
                for parameter in new {
                    parameters.push(parameter);
                    deviations.push(deviation);
                }
            }
        };
        add(
            priors.light_rad,
            &mut lights
                .clone()
                .flat_map(|l| [Parameter::LightAzimuth(l), Parameter::LightElevation(l)]),
        );
        add(
            priors.intensity,
            &mut lights.clone().map(Parameter::Intensity),
        );
        // A measured pose brings its own deviations.
        let pose = |described: f64| priors.pose_covariance.map_or(described, |_| 1.0);
        add(
            pose(priors.rotation_rad),
            &mut Axis::ALL.map(Parameter::Rotation).into_iter(),
        );
        add(
            pose(priors.translation_mm),
            &mut Axis::ALL.map(Parameter::Translation).into_iter(),
        );
        add(priors.stray_light, &mut lights.map(Parameter::StrayLight));
        let mut covariance = DMatrix::from_diagonal(&DVector::from_vec(deviations).map(|d| d * d));
        // What the lights share: a turn ω of the stage moves a light at d along e by
        // e·(ω × d) = ω·(d × e); a common scale is the same for all.
        let shared: Vec<([f64; 3], f64)> = parameters
            .iter()
            .map(|&parameter| match parameter {
                Parameter::LightAzimuth(light) | Parameter::LightElevation(light) => {
                    let d = towards(&described.lights[light]);
                    let [azimuth, elevation] = tangents(d);
                    let along = match parameter {
                        Parameter::LightAzimuth(_) => azimuth,
                        _ => elevation,
                    };
                    ((d.cross(along) * priors.stage_rad).to_array(), 0.0)
                }
                Parameter::Intensity(_) => ([0.0; 3], priors.common_intensity),
                _ => ([0.0; 3], 0.0),
            })
            .collect();
        for (i, a) in shared.iter().enumerate() {
            for (j, b) in shared.iter().enumerate() {
                let turn: f64 = a.0.iter().zip(&b.0).map(|(a, b)| a * b).sum();
                covariance[(i, j)] += turn + a.1 * b.1;
            }
        }
        if let Some(measured) = &priors.pose_covariance {
            let place = |parameter: &Parameter| match *parameter {
                Parameter::Rotation(axis) => Some(axis as usize),
                Parameter::Translation(axis) => Some(3 + axis as usize),
                _ => None,
            };
            for (i, a) in parameters.iter().enumerate() {
                for (j, b) in parameters.iter().enumerate() {
                    if let (Some(a), Some(b)) = (place(a), place(b)) {
                        covariance[(i, j)] = measured[a][b];
                    }
                }
            }
        }
        // Positive definite: every parameter has a deviation of its own above 0.
        let root = covariance.clone().cholesky().map_or_else(
            || DMatrix::from_diagonal(&covariance.diagonal().map(f64::sqrt)),
            |c| c.l(),
        );
        Self {
            described: described.clone(),
            parameters,
            covariance,
            root,
        }
    }

    /// What may differ, in the order of the values.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// Which parameters are those of a light, or of none.
    pub fn of_light(&self, light: Option<usize>) -> Vec<usize> {
        let own = |&k: &usize| self.parameters[k].light() == light;
        (0..self.parameters.len()).filter(own).collect()
    }

    /// Standard deviation of a parameter before any image.
    pub fn prior_deviation(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].sqrt()
    }

    /// Lower triangular root L of the prior covariance L Lᵀ.
    pub fn prior_root(&self) -> &DMatrix<f64> {
        &self.root
    }

    /// The parameters moved by a scale common to all intensities: 1 for each, 0 for others.
    pub fn common_scale(&self) -> DVector<f64> {
        let is_intensity = |p: &Parameter| matches!(p, Parameter::Intensity(_));
        let moved = self.parameters.iter().map(is_intensity);
        DVector::from_iterator(self.parameters.len(), moved.map(|m| f64::from(u8::from(m))))
    }

    /// Whether images with this information on the parameters leave that scale open. One that
    /// is described well, within `WIDE_SCALE`, is held by the description
    /// whatever the weights' prior claims.
    pub fn leaves_scale_open(&self, information: &DMatrix<f64>) -> bool {
        let common = self.common_scale();
        let whitened = self.root.solve_lower_triangular(&common);
        let precision = whitened.map_or(0.0, |q| q.norm_squared());
        let by_images = common.dot(&(information * &common));
        precision > 0.0
            && precision < WIDE_SCALE.powi(-2)
            && by_images < MIN_INFORMATION * precision
    }

    /// Half the diagonal of the box around the sample.
    pub fn sample_radius_mm(&self) -> f64 {
        let [low, high] = self.described.sample().bounds_mm();
        0.5 * f64::from(low.distance(high))
    }

    /// The scene with the differences, in the frame of the sample where it truly is:
    /// the sample stays, camera and lights move. Known bodies move with the sample.
    pub fn scene(&self, values: &DVector<f64>) -> Scene {
        let mut scene = self.described.clone();
        let mut arcs = vec![[0.0; 2]; scene.lights.len()];
        let (mut rotation_rad, mut translation_mm) = (DVec3::ZERO, DVec3::ZERO);
        for (&parameter, &value) in self.parameters.iter().zip(values.iter()) {
            match parameter {
                Parameter::LightAzimuth(light) => arcs[light][0] = value,
                Parameter::LightElevation(light) => arcs[light][1] = value,
                Parameter::Intensity(light) => scale(&mut scene.lights[light], value.exp()),
                Parameter::Rotation(axis) => rotation_rad += axis.unit() * value,
                Parameter::Translation(axis) => translation_mm += axis.unit() * value,
                Parameter::StrayLight(_) => {}
            }
        }
        for (light, arcs) in scene.lights.iter_mut().zip(arcs) {
            turn(light, arcs);
        }
        with_sample_at(scene, rotation_rad, translation_mm)
    }

    /// Captured images without the stray light.
    pub fn without_stray_light(&self, captured: &Captured, values: &DVector<f64>) -> Captured {
        let mut captured = captured.clone();
        for (parameter, &value) in self.parameters.iter().zip(values.iter()) {
            if let Parameter::StrayLight(light) = *parameter {
                for cell in &mut captured.images[light].mean {
                    *cell = cell.map(|radiance| radiance - value);
                }
            }
        }
        captured
    }
}

/// The scene whose sample is turned about its datum (axis times angle) and then moved
/// against the description, in the frame of the sample where it truly is: camera and
/// lights move instead.
pub fn with_sample_at(mut scene: Scene, rotation_rad: DVec3, translation_mm: DVec3) -> Scene {
    let described_from_true: Rigid<Sample, Sample> =
        Rigid::from_rotation_vector(rotation_rad, translation_mm);
    let true_from_described = described_from_true.inverse();
    for light in &mut scene.lights {
        carry(light, &true_from_described);
    }
    scene.camera.sample_from_camera = true_from_described * scene.camera.sample_from_camera;
    scene
}

/// Unit vector from the sample's datum towards a light.
fn towards(light: &Light) -> DVec3 {
    match light {
        Light::Directional { to_light, .. } => *to_light,
        Light::Point { position_mm, .. } => position_mm.normalize_or(DVec3::Z),
    }
}

/// Unit vectors across `direction`, towards larger azimuth and larger elevation;
/// straight above the sample, where azimuth has no meaning, it counts as 0.
fn tangents(direction: DVec3) -> [DVec3; 2] {
    let azimuth = DVec3::Z
        .cross(direction)
        .try_normalize()
        .filter(|_| direction.x.hypot(direction.y) > 1e-6)
        .unwrap_or(DVec3::Y);
    [azimuth, direction.cross(azimuth)]
}

/// Moves a light along the two arcs, radians, at its distance from the datum.
fn turn(light: &mut Light, [azimuth_rad, elevation_rad]: [f64; 2]) {
    let direction = towards(light);
    let [azimuth, elevation] = tangents(direction);
    let arc = azimuth * azimuth_rad + elevation * elevation_rad;
    let angle = arc.length();
    if angle == 0.0 {
        return;
    }
    let turned = direction * angle.cos() + arc * (angle.sin() / angle);
    match light {
        Light::Directional { to_light, .. } => *to_light = turned,
        Light::Point { position_mm, .. } => *position_mm = turned * position_mm.length(),
    }
}

/// The light's coordinates in another frame.
fn carry(light: &mut Light, transform: &Rigid<Sample, Sample>) {
    match light {
        Light::Directional { to_light, .. } => *to_light = transform.direction(*to_light),
        Light::Point { position_mm, .. } => *position_mm = transform.point(*position_mm),
    }
}

fn scale(light: &mut Light, factor: f64) {
    let strength = match light {
        Light::Directional { irradiance, .. } => irradiance,
        Light::Point { intensity_mm2, .. } => intensity_mm2,
    };
    *strength = strength.map(|s| s * factor);
}
