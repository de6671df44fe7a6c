//! The GGX microfacet reflection lobe of a smooth dielectric interface.
//!
//! Walter et al. 2007, "Microfacet Models for Refraction through Rough
//! Surfaces": distribution D (Eq. 33) of width `alpha`, separable Smith masking
//! G1(i)·G1(o) (Eq. 34), exact unpolarised Fresnel reflectance for a real
//! relative index `eta`, one-sided, without compensation for scattering between
//! facets: f_r = D·G1·G1·F / (4 cos θi cos θo), in 1/sr.
//!
//! f_r is the product of [`d_g`], which depends on `alpha` alone, and
//! [`fresnel`], which depends on `eta` alone. Both are written without the
//! cancellations of the textbook forms, so they are finite and accurate for
//! `alpha` from 0.01 to 1, `eta` from 1.01 up, coaxial and grazing directions,
//! in single precision too.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Single or double precision: the arithmetic the closed forms need.
pub trait Real:
    Copy
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The nearest value of this precision.
    fn of(value: f64) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// e to this power.
    fn exp(self) -> Self;
    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    fn exp(self) -> Self {
        self.exp()
    }
    fn sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    fn exp(self) -> Self {
        self.exp()
    }
    fn sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }
}

/// All that an isotropic microfacet lobe needs of a pair of directions.
///
/// sin² θh is kept instead of cos θh: near the mirror direction the cosine
/// rounds to 1 and narrow lobes lose their shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cosines<T> {
    /// Cosine between the normal and the direction to the light, (0, 1].
    pub cos_i: T,
    /// Cosine between the normal and the direction to the viewer, (0, 1].
    pub cos_o: T,
    /// Squared sine between the normal and the half vector, [0, 1).
    pub sin2_h: T,
    /// Cosine between the half vector and either direction, (0, 1].
    pub cos_d: T,
}

impl<T: Real> Cosines<T> {
    /// From unit vectors in the local frame (+z is the normal); `None` if
    /// either is at or below the horizon.
    pub fn new(to_light: [T; 3], to_viewer: [T; 3]) -> Option<Self> {
        let zero = T::of(0.0);
        let [ix, iy, cos_i] = to_light;
        let [ox, oy, cos_o] = to_viewer;
        if !(cos_i > zero && cos_o > zero) {
            return None;
        }
        let (hx, hy, hz) = (ix + ox, iy + oy, cos_i + cos_o);
        let tangential2 = hx * hx + hy * hy;
        let length2 = tangential2 + hz * hz;
        // Both are unit vectors, so |i + o| = 2 cos θd.
        let cos_d = T::of(0.5) * length2.sqrt();
        Some(Self {
            cos_i,
            cos_o,
            sin2_h: tangential2 / length2,
            cos_d: if cos_d > T::of(1.0) {
                T::of(1.0)
            } else {
                cos_d
            },
        })
    }
}

/// Distribution of facet normals D(θh), 1/sr; `sin2_h` = sin² θh.
pub fn distribution<T: Real>(alpha: T, sin2_h: T) -> T {
    let alpha2 = alpha * alpha;
    // cos²θ·α² + sin²θ, written as a sum of non-negative terms.
    let spread = alpha2 * (T::of(1.0) - sin2_h) + sin2_h;
    alpha2 / (T::of(std::f64::consts::PI) * spread * spread)
}

/// G1(θ) / (2 cos θ), finite at the horizon; G1 is Smith's masking function.
pub fn masking_over_two_cos<T: Real>(alpha: T, cos: T) -> T {
    let alpha2 = alpha * alpha;
    let cos2 = cos * cos;
    T::of(1.0) / (cos + (cos2 + alpha2 * (T::of(1.0) - cos2)).sqrt())
}

/// D·G1(i)·G1(o) / (4 cos θi cos θo), 1/sr: the lobe without its Fresnel factor.
pub fn d_g<T: Real>(alpha: T, cos_i: T, cos_o: T, sin2_h: T) -> T {
    distribution(alpha, sin2_h)
        * masking_over_two_cos(alpha, cos_i)
        * masking_over_two_cos(alpha, cos_o)
}

/// Fresnel amplitudes (r_s, r_p) at an interface from air to a dielectric of
/// real relative index `eta` ≥ 1; `cos_d` is the cosine of incidence, [0, 1].
///
/// The usual differences c − g and η²c − g (g² = η² − 1 + c²) are multiplied out,
/// which keeps the relative accuracy for `eta` close to 1.
pub fn fresnel_amplitudes<T: Real>(eta: T, cos_d: T) -> (T, T) {
    let one = T::of(1.0);
    let eta2 = eta * eta;
    let contrast = (eta - one) * (eta + one); // η² − 1
    let c2 = cos_d * cos_d;
    let g = (contrast + c2).sqrt();
    let s_sum = cos_d + g;
    let p_sum = eta2 * cos_d + g;
    let r_s = -contrast / (s_sum * s_sum);
    let r_p = contrast * ((eta2 + one) * c2 - one) / (p_sum * p_sum);
    (r_s, r_p)
}

/// Unpolarised Fresnel reflectance, [0, 1]; arguments of [`fresnel_amplitudes`].
pub fn fresnel<T: Real>(eta: T, cos_d: T) -> T {
    let (r_s, r_p) = fresnel_amplitudes(eta, cos_d);
    T::of(0.5) * (r_s * r_s + r_p * r_p)
}

/// How a reflection changes (I, Q, U): the entries of its Mueller matrix that are not
/// zero, with Q and U about s, the normal of the plane of incidence (Q = Is − Ip),
/// and p = k × s for light that travels along k, before and after alike. V stays zero:
/// no phase is lost between s and p at a dielectric.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mueller {
    /// I from I.
    pub ii: f32,
    /// I from Q, and Q from I.
    pub iq: f32,
    /// Q from Q.
    pub qq: f32,
    /// U from U.
    pub uu: f32,
}

/// The Fresnel reflection; arguments of [`fresnel_amplitudes`].
pub fn fresnel_mueller(eta: f32, cos_d: f32) -> Mueller {
    let (r_s, r_p) = fresnel_amplitudes(eta, cos_d);
    let mean = 0.5 * (r_s * r_s + r_p * r_p);
    Mueller {
        ii: mean,
        iq: 0.5 * (r_s * r_s - r_p * r_p),
        qq: mean,
        uu: r_s * r_p,
    }
}

/// f_r of one lobe, 1/sr, cosine excluded.
pub fn eval<T: Real>(alpha: T, eta: T, at: &Cosines<T>) -> T {
    d_g(alpha, at.cos_i, at.cos_o, at.sin2_h) * fresnel(eta, at.cos_d)
}

/// Density of [`sample_visible`], per solid angle of the sampled direction
/// (1/sr, cosine excluded): G1(i)·D / (4 cos θi). `cos_i` belongs to the given
/// direction, `sin2_h` to the half vector of both.
pub fn pdf_visible<T: Real>(alpha: T, cos_i: T, sin2_h: T) -> T {
    T::of(0.5) * distribution(alpha, sin2_h) * masking_over_two_cos(alpha, cos_i)
}

/// Mirrors `from` (unit, local frame, z > 0) at a facet drawn from the visible
/// normals (Heitz 2018), by a uniform cap (Dupuy & Benyoub 2023). `u` is uniform
/// in [0, 1)². The result may point below the horizon, where f_r = 0: that mass
/// is part of [`pdf_visible`].
pub fn sample_visible<T: Real>(alpha: T, from: [T; 3], u: [T; 2]) -> [T; 3] {
    let one = T::of(1.0);
    let [x, y, z] = from;
    let [sx, sy, sz] = unit([alpha * x, alpha * y, z]);
    let (sin_phi, cos_phi) = (T::of(std::f64::consts::TAU) * u[0]).sin_cos();
    // Uniform height in (−s_z, 1].
    let cz = (one - u[1]) * (one + sz) - sz;
    let ring2 = one - cz * cz;
    let ring = if ring2 > T::of(0.0) {
        ring2.sqrt()
    } else {
        T::of(0.0)
    };
    let [hx, hy, hz] = unit([
        alpha * (ring * cos_phi + sx),
        alpha * (ring * sin_phi + sy),
        cz + sz,
    ]);
    let twice_cos_d = T::of(2.0) * (x * hx + y * hy + z * hz);
    unit([
        twice_cos_d * hx - x,
        twice_cos_d * hy - y,
        twice_cos_d * hz - z,
    ])
}

fn unit<T: Real>([x, y, z]: [T; 3]) -> [T; 3] {
    let length = (x * x + y * y + z * z).sqrt();
    if length > T::of(0.0) {
        [x / length, y / length, z / length]
    } else {
        [T::of(0.0), T::of(0.0), T::of(1.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3,120 values of an independent renderer in single precision; see
    /// tests/data/brdf/SOURCES.md.
    const REFERENCE: &str = include_str!("../../tests/data/brdf/ggx_reference_values.csv");

    fn direction(theta: f64, phi: f64) -> [f64; 3] {
        let (s, c) = theta.sin_cos();
        [s * phi.cos(), s * phi.sin(), c]
    }

    fn narrow(v: [f64; 3]) -> [f32; 3] {
        v.map(|x| x as f32)
    }

    /// Worst relative deviations of (value, pdf) in double, then in single precision.
    fn worst_against_reference() -> [f64; 4] {
        let mut worst = [0.0f64; 4];
        let mut rows = 0;
        for line in REFERENCE.lines().skip(1) {
            let v: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            let [alpha, eta, _, theta_i, theta_o, phi, value, pdf] = v[..] else {
                panic!("columns of {line}")
            };
            let (i, o) = (direction(theta_i, 0.0), direction(theta_o, phi));
            let at = Cosines::new(i, o).unwrap();
            let at32 = Cosines::new(narrow(i), narrow(o)).unwrap();
            let ours = [
                eval(alpha, eta, &at) * at.cos_o,
                pdf_visible(alpha, at.cos_i, at.sin2_h),
                f64::from(eval(alpha as f32, eta as f32, &at32) * at32.cos_o),
                f64::from(pdf_visible(alpha as f32, at32.cos_i, at32.sin2_h)),
            ];
            for (k, ours) in ours.into_iter().enumerate() {
                let expected = if k % 2 == 0 { value } else { pdf };
                worst[k] = worst[k].max((ours - expected).abs() / expected);
            }
            rows += 1;
        }
        assert_eq!(rows, 3120);
        worst
    }

    #[test]
    fn agrees_with_an_independent_renderer() {
        let worst = worst_against_reference();
        assert!(worst.iter().all(|&w| w < 2e-4), "{worst:?}");
    }

    /// Smith G1 at alpha 0.1 as published in Mitsuba 3's tests (BSD-3-Clause),
    /// 20 angles from π/3 to π/2, tolerance stated there 1e-5.
    #[test]
    fn smith_masking_agrees_with_published_values() {
        const G1: [f64; 20] = [
            0.99261039,
            0.99160647,
            0.99042398,
            0.98901933,
            0.98733366,
            0.98528832,
            0.98277503,
            0.97964239,
            0.97567332,
            0.97054905,
            0.9637875,
            0.95463598,
            0.94187391,
            0.92344058,
            0.8956942,
            0.85189372,
            0.77902949,
            0.65144652,
            0.41989169,
            3.2584082e-06,
        ];
        use std::f64::consts::{FRAC_PI_2, FRAC_PI_3};
        for (k, expected) in G1.into_iter().enumerate() {
            let theta = FRAC_PI_3 + (FRAC_PI_2 - FRAC_PI_3) * k as f64 / 19.0;
            let cos = theta.cos();
            let g1 = 2.0 * cos * masking_over_two_cos(0.1, cos);
            assert!((g1 - expected).abs() < 1e-5, "{k}: {g1} against {expected}");
        }
        let cos = (0.98 * FRAC_PI_2).cos();
        assert!((2.0 * cos * masking_over_two_cos(0.1, cos) - 0.46130955).abs() < 1e-5);
        // An anisotropic lobe is isotropic within the plane of its own axis:
        // published for alpha_y = 0.3 at the second angle of the sweep.
        let theta = FRAC_PI_3 + (FRAC_PI_2 - FRAC_PI_3) / 19.0;
        let g1 = 2.0 * theta.cos() * masking_over_two_cos(0.3, theta.cos());
        assert!((g1 - 0.93310797).abs() < 1e-5, "{g1}");
    }

    #[test]
    fn fresnel_closed_values() {
        assert!((fresnel(1.5, 1.0) - 0.04f64).abs() < 1e-15);
        assert!((fresnel(1.5, 0.5f64.sqrt()) - 0.050239911012235954).abs() < 1e-15);
        assert!((fresnel(1.5, 0.0f64) - 1.0).abs() < 1e-15);
        // Brewster's angle: tan θ = η.
        let (r_s, r_p) = fresnel_amplitudes(1.5, 1.0 / (1.0f64 + 2.25).sqrt());
        assert!(r_p.abs() < 1e-15 && r_s < -0.3);
        for eta in [1.01, 1.3, 20.0] {
            for cos in [1e-3, 0.1, 0.5, 0.999, 1.0] {
                let wide: f64 = fresnel(eta, cos);
                let single = f64::from(fresnel(eta as f32, cos as f32));
                assert!((wide - single).abs() < 1e-5 * wide, "eta {eta}, cos {cos}");
            }
        }
    }

    /// Against the textbook forms of Walter et al. 2007 (Eqs. 20, 22, 33, 34), in double
    /// precision and where these lose no more than half their digits.
    #[test]
    fn agrees_with_the_textbook_forms() {
        for alpha in [0.01f64, 0.05, 0.3, 1.0] {
            for eta in [1.01f64, 1.5, 3.0, 20.0] {
                for theta_i in [0.0, 0.4, 1.2, 1.55, 1.57] {
                    for (d_theta, phi) in [(0.0, 3.0), (0.01, 3.1), (-0.02, 2.0), (0.0, 0.3)] {
                        let (i, o) = (
                            direction(theta_i, 0.0),
                            direction((theta_i + d_theta).min(1.5705), phi),
                        );
                        let at = Cosines::new(i, o).unwrap();
                        let sum = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
                        let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
                        let tan2 = (sum[0] * sum[0] + sum[1] * sum[1]) / (sum[2] * sum[2]);
                        let cos_h = sum[2] / length;
                        let c = (0..3).map(|k| i[k] * sum[k] / length).sum::<f64>();
                        let a2 = alpha * alpha;
                        let d = a2 / (std::f64::consts::PI * cos_h.powi(4) * (a2 + tan2).powi(2));
                        let g1 =
                            |cos: f64| 2.0 / (1.0 + (1.0 + a2 * (1.0 / (cos * cos) - 1.0)).sqrt());
                        let g = (eta * eta - 1.0 + c * c).sqrt();
                        let a = ((g - c) / (g + c)).powi(2);
                        let b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
                        let f = 0.5 * a * (1.0 + b * b);
                        let textbook = d * g1(i[2]) * g1(o[2]) * f / (4.0 * i[2] * o[2]);
                        let ours = eval(alpha, eta, &at);
                        assert!(
                            (ours - textbook).abs() < 1e-7 * textbook,
                            "alpha {alpha} eta {eta} {theta_i} {d_theta} {phi}: {ours} against {textbook}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn extremes_are_finite_and_reciprocal() {
        for alpha in [0.01, 0.1, 1.0] {
            for eta in [1.01, 1.5, 20.0] {
                for theta_i in [0.0, 0.3, 1.5, 1.5706, 1.570795] {
                    for theta_o in [0.0, 0.3, 1.5, 1.5706, 1.570795] {
                        for phi in [0.0, 1.0, std::f64::consts::PI] {
                            let (i, o) = (direction(theta_i, 0.0), direction(theta_o, phi));
                            let there = eval(alpha, eta, &Cosines::new(i, o).unwrap());
                            let back = eval(alpha, eta, &Cosines::new(o, i).unwrap());
                            assert!(there.is_finite() && there >= 0.0);
                            assert!((there - back).abs() <= 1e-12 * there);
                            if theta_i.max(theta_o) < 1.57 {
                                let at = Cosines::new(narrow(i), narrow(o)).unwrap();
                                let single = eval(alpha as f32, eta as f32, &at);
                                assert!(
                                    (f64::from(single) - there).abs() < 3e-3 * there,
                                    "alpha {alpha} eta {eta} {theta_i} {theta_o} {phi}: {single} against {there}"
                                );
                            }
                        }
                    }
                }
            }
        }
        // Coaxial at normal incidence: D(0)/4·F = F/(4πα²).
        let at = Cosines::new([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]).unwrap();
        let expected = 0.04 / (4.0 * std::f64::consts::PI * 1e-4);
        assert!((eval(0.01, 1.5, &at) - expected).abs() < 1e-12 * expected);
    }

    #[test]
    fn nothing_below_the_horizon() {
        assert!(Cosines::new([0.0, 0.6, -0.8], [0.0, 0.0, 1.0]).is_none());
        assert!(Cosines::new([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]).is_none());
        assert!(Cosines::new([f64::NAN; 3], [0.0, 0.0, 1.0]).is_none());
    }
}
