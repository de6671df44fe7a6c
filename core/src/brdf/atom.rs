//! One entry of a dictionary: a simple BRDF in closed form.
//!
//! An atom is a lobe of facets, diffuse, or nothing. A lobe's value is D·G, which depends
//! on the distribution and its width, times the Fresnel reflectance, which depends on the
//! index alone.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::ggx::{self, Cosines, Real};
use super::{beckmann, coat};

/// One entry of a dictionary.
///
/// ```
/// use rig_core::brdf::Atom;
/// use rig_core::brdf::ggx::Cosines;
///
/// let plastic = Atom::Ggx { alpha: 0.2, eta: 1.5 };
/// assert_eq!((plastic.kind(), plastic.alpha(), plastic.albedo()), ("ggx", Some(0.2), None));
///
/// // Light and viewer along the normal: D = 1/(π alpha²), G = 1, F = ((eta − 1)/(eta + 1))².
/// let normal = [0.0, 0.0, 1.0];
/// let at = Cosines::<f64>::new(normal, normal).expect("above the horizon");
/// let expected = 0.04 / (4.0 * std::f64::consts::PI * 0.04);
/// assert!((plastic.eval(&at) - expected).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Atom {
    /// A GGX reflection lobe, see [`ggx`].
    Ggx {
        /// Width of the facet distribution, (0, 1].
        alpha: f64,
        /// Real relative index of refraction, 1.01 and above.
        eta: f64,
    },
    /// A Beckmann reflection lobe, see [`beckmann`].
    Beckmann {
        /// Width of the facet distribution, (0, 1].
        alpha: f64,
        /// Real relative index of refraction, 1.01 and above.
        eta: f64,
    },
    /// White diffuse matter under a smooth interface, without the light that the
    /// interface itself reflects, see [`coat`].
    Coated {
        /// Real relative index of refraction, 1.01 and above.
        eta: f64,
    },
    /// Equal radiance in all directions.
    Lambertian {
        /// Reflected over incident power, [0, 1].
        albedo: f64,
    },
    /// Reflects nothing; lets a mixture's other weights sum to less than one.
    Black,
}

/// How facet normals are distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distribution {
    /// Long tails, see [`ggx`].
    Ggx,
    /// Short tails, see [`beckmann`].
    Beckmann,
}

impl Distribution {
    /// D·G1·G1 / (4 cos θi cos θo), 1/sr.
    pub fn d_g<T: Real>(self, alpha: T, at: &Cosines<T>) -> T {
        match self {
            Self::Ggx => ggx::d_g(alpha, at.cos_i, at.cos_o, at.sin2_h),
            Self::Beckmann => beckmann::d_g(alpha, at.cos_i, at.cos_o, at.sin2_h),
        }
    }
}

/// The facets of an atom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facets {
    /// Of their normals.
    pub distribution: Distribution,
    /// Width of it, (0, 1].
    pub alpha: f64,
    /// Real relative index of refraction.
    pub eta: f64,
}

/// The diffuse part of an atom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Diffuse {
    /// The same in all directions, of this albedo.
    Lambertian(f64),
    /// Under an interface of this index.
    Coated {
        /// Real relative index of refraction.
        eta: f64,
    },
}

impl Atom {
    /// Its lobe, if it has one.
    pub fn facets(&self) -> Option<Facets> {
        let (distribution, alpha, eta) = match *self {
            Atom::Ggx { alpha, eta } => (Distribution::Ggx, alpha, eta),
            Atom::Beckmann { alpha, eta } => (Distribution::Beckmann, alpha, eta),
            Atom::Coated { .. } | Atom::Lambertian { .. } | Atom::Black => return None,
        };
        Some(Facets {
            distribution,
            alpha,
            eta,
        })
    }

    /// Its diffuse part, if it has one.
    pub fn diffuse(&self) -> Option<Diffuse> {
        match *self {
            Atom::Coated { eta } => Some(Diffuse::Coated { eta }),
            Atom::Lambertian { albedo } => Some(Diffuse::Lambertian(albedo)),
            Atom::Ggx { .. } | Atom::Beckmann { .. } | Atom::Black => None,
        }
    }

    /// Whether f_r depends on the directions.
    pub fn varies(&self) -> bool {
        !matches!(self, Atom::Lambertian { .. } | Atom::Black)
    }

    /// What files call it: `ggx`, `beckmann`, `coated`, `lambertian`, `black`.
    pub fn kind(&self) -> &'static str {
        match self {
            Atom::Ggx { .. } => "ggx",
            Atom::Beckmann { .. } => "beckmann",
            Atom::Coated { .. } => "coated",
            Atom::Lambertian { .. } => "lambertian",
            Atom::Black => "black",
        }
    }

    /// The width of its lobe.
    pub fn alpha(&self) -> Option<f64> {
        Some(self.facets()?.alpha)
    }

    /// Its index of refraction.
    pub fn eta(&self) -> Option<f64> {
        match *self {
            Atom::Ggx { eta, .. } | Atom::Beckmann { eta, .. } | Atom::Coated { eta } => Some(eta),
            Atom::Lambertian { .. } | Atom::Black => None,
        }
    }

    /// The albedo of a Lambertian.
    pub fn albedo(&self) -> Option<f64> {
        match *self {
            Atom::Lambertian { albedo } => Some(albedo),
            _ => None,
        }
    }

    /// From [`Self::kind`] and its parameters; `None` if one is missing or the kind is
    /// not known. Ranges are checked by the dictionary.
    pub fn from_parts(
        kind: &str,
        alpha: Option<f64>,
        eta: Option<f64>,
        albedo: Option<f64>,
    ) -> Option<Self> {
        Some(match kind {
            "ggx" => Atom::Ggx {
                alpha: alpha?,
                eta: eta?,
            },
            "beckmann" => Atom::Beckmann {
                alpha: alpha?,
                eta: eta?,
            },
            "coated" => Atom::Coated { eta: eta? },
            "lambertian" => Atom::Lambertian { albedo: albedo? },
            "black" => Atom::Black,
            _ => return None,
        })
    }

    /// f_r, 1/sr, cosine excluded, for directions above the horizon.
    pub fn eval<T: Real>(&self, at: &Cosines<T>) -> T {
        match (self.facets(), self.diffuse()) {
            (Some(facets), _) => facets.eval(at),
            (None, Some(diffuse)) => diffuse.eval(at),
            (None, None) => T::of(0.0),
        }
    }

    /// A direction for the other end of a reflection, given one end (unit, local
    /// frame, z > 0), with its density per solid angle (1/sr, cosine excluded).
    /// `u` is uniform in [0, 1)². `None` where the sample falls below the
    /// horizon and for [`Atom::Black`].
    pub fn sample(&self, from: DVec3, u: [f64; 2]) -> Option<(DVec3, f64)> {
        let to = match self.facets() {
            Some(facets) => facets.sample(from, u),
            None => self.diffuse().map(|_| cosine_direction(u))?,
        };
        let pdf = self.pdf(from, to);
        (pdf > 0.0).then_some((to, pdf))
    }

    /// Density of [`Self::sample`] at `to`, per solid angle (1/sr, cosine excluded).
    pub fn pdf(&self, from: DVec3, to: DVec3) -> f64 {
        let Some(at) = Cosines::new(from.to_array(), to.to_array()) else {
            return 0.0;
        };
        match (self.facets(), self.diffuse()) {
            (Some(facets), _) => facets.pdf(&at),
            (None, Some(_)) => at.cos_o * std::f64::consts::FRAC_1_PI,
            (None, None) => 0.0,
        }
    }
}

impl Facets {
    /// Roughly the share of light that is reflected: the Fresnel factor at 45°.
    pub fn power_at_45_deg(&self) -> f64 {
        ggx::fresnel(self.eta, std::f64::consts::FRAC_1_SQRT_2)
    }

    fn eval<T: Real>(&self, at: &Cosines<T>) -> T {
        self.distribution.d_g(T::of(self.alpha), at) * ggx::fresnel(T::of(self.eta), at.cos_d)
    }

    fn sample(&self, from: DVec3, u: [f64; 2]) -> DVec3 {
        match self.distribution {
            Distribution::Ggx => {
                DVec3::from_array(ggx::sample_visible(self.alpha, from.to_array(), u))
            }
            Distribution::Beckmann => {
                let normal = DVec3::from_array(beckmann::sample_normal(self.alpha, u));
                2.0 * from.dot(normal) * normal - from
            }
        }
    }

    fn pdf(&self, at: &Cosines<f64>) -> f64 {
        match self.distribution {
            Distribution::Ggx => ggx::pdf_visible(self.alpha, at.cos_i, at.sin2_h),
            Distribution::Beckmann => {
                let cos_h = (1.0 - at.sin2_h).sqrt();
                beckmann::distribution(self.alpha, at.sin2_h) * cos_h / (4.0 * at.cos_d)
            }
        }
    }
}

impl Diffuse {
    /// The share of light that is reflected, under a coat that of light at 45°.
    pub fn power_at_45_deg(&self) -> f64 {
        match *self {
            Diffuse::Lambertian(albedo) => albedo,
            Diffuse::Coated { eta } => 1.0 - ggx::fresnel(eta, std::f64::consts::FRAC_1_SQRT_2),
        }
    }

    /// f_r, 1/sr.
    pub fn eval<T: Real>(&self, at: &Cosines<T>) -> T {
        match *self {
            Diffuse::Lambertian(albedo) => T::of(albedo) * T::of(std::f64::consts::FRAC_1_PI),
            Diffuse::Coated { eta } => {
                coat::eval(T::of(eta), T::of(coat::norm(eta)), at.cos_i, at.cos_o)
            }
        }
    }
}

/// Direction with density cos θ/π (1/sr, cosine excluded) from `u` uniform in [0, 1)².
pub fn cosine_direction(u: [f64; 2]) -> DVec3 {
    let radius = u[1].sqrt();
    let (sin, cos) = (std::f64::consts::TAU * u[0]).sin_cos();
    DVec3::new(radius * cos, radius * sin, (1.0 - u[1]).sqrt())
}
