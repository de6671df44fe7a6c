//! Lens distortion by the model of Brown and Conrady, in OpenCV's convention, forwards and
//! backwards.
//!
//! An ideal position x (units of the focal length, from the principal point) appears at
//! D(x) = x·(1 + k₁r² + k₂r⁴ + k₃r⁶) + r²·q + 2(q·x)·x with r = |x| and q = (p₂, p₁).
//! The derivative of D is a symmetric matrix. Where it is positive definite on a disc, D is
//! the gradient of a convex function there, so no two points of the disc appear at one.

use glam::{DMat2, DVec2};

/// Smallest factor by which the image may be compressed anywhere in its domain.
const LEAST_STRETCH: f64 = 0.1;
/// How far beyond the farthest corner the model must hold.
const MARGIN: f64 = 1.05;
/// Steps from the middle to the farthest corner in which the domain is checked.
const STEPS: f64 = 256.0;
/// Steps of the inverse; it takes about five.
const ROUNDS: usize = 60;

/// Coefficients of the model; 0 is an ideal lens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coefficients {
    /// Radial, k₁ to k₃.
    pub radial: [f64; 3],
    /// Tangential, p₁ and p₂.
    pub tangential: [f64; 2],
}

impl Coefficients {
    /// Where an ideal position appears.
    pub fn apply(&self, x: DVec2) -> DVec2 {
        let q = self.q();
        let r2 = x.length_squared();
        x * self.gain(r2) + q * r2 + x * (2.0 * q.dot(x))
    }

    /// Derivative of [`Self::apply`]: symmetric.
    pub fn derivative(&self, x: DVec2) -> DMat2 {
        let [k1, k2, k3] = self.radial;
        let q = self.q();
        let r2 = x.length_squared();
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let same = self.gain(r2) + 2.0 * q.dot(x);
        let outer = |a: DVec2, b: DVec2| DMat2::from_cols(a * b.x, a * b.y);
        DMat2::IDENTITY * same + outer(x, x) * slope + (outer(q, x) + outer(x, q)) * 2.0
    }

    fn q(&self) -> DVec2 {
        let [p1, p2] = self.tangential;
        DVec2::new(p2, p1)
    }

    /// 1 + k₁r² + k₂r⁴ + k₃r⁶.
    fn gain(&self, r2: f64) -> f64 {
        let [k1, k2, k3] = self.radial;
        1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    }

    /// Lower bound of the derivative's eigenvalues between two radii. Those of the radial
    /// part are g and g + 2r²g′ (r² as the variable), those of the tangential part at least
    /// −6|q|r.
    fn least_stretch(&self, [low, high]: [f64; 2]) -> f64 {
        let bound = |factors: [f64; 3]| -> f64 {
            let terms = self.radial.iter().zip(factors).enumerate();
            terms.fold(1.0, |sum, (i, (k, factor))| {
                let r = if *k < 0.0 { high } else { low };
                sum + k * factor * r.powi(2 * (i as i32 + 1))
            })
        };
        let radial = bound([1.0; 3]).min(bound([3.0, 5.0, 7.0]));
        radial - 6.0 * self.q().length() * high
    }
}

/// A distortion that takes no two points of its domain, a disc that covers the image, to
/// one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    coefficients: Coefficients,
    /// Radius of the domain.
    domain: f64,
    /// Every position up to this radius is the image of one of the domain.
    reach: f64,
}

/// A distortion that folds or crushes the image.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the distortion folds the image or compresses it more than tenfold {:.0}% of the way from the principal point to the farthest corner",
    100.0 * .at
)]
pub struct Folded {
    /// Distance from the principal point at which it does, over that of the farthest corner.
    pub at: f64,
}

impl Distortion {
    /// Of an image whose farthest corner is `corner` away from the principal point, in
    /// units of the focal length.
    ///
    /// # Errors
    /// [`Folded`] where the derivative is not known to be positive definite on the whole
    /// disc that the image needs.
    pub fn new(coefficients: Coefficients, corner: f64) -> Result<Self, Folded> {
        let reach = MARGIN * corner;
        let step = reach / STEPS;
        // A point of radius r appears at least this far out, because the bound on the
        // derivative is also one on the growth of this.
        let far = |r: f64| r * coefficients.gain(r * r) - 3.0 * coefficients.q().length() * r * r;
        let mut domain = 0.0;
        if !far(reach).is_finite() {
            return Err(Folded { at: 0.0 });
        }
        while far(domain) < reach {
            let next = domain + step;
            if coefficients.least_stretch([domain, next]) < LEAST_STRETCH {
                let at = far(domain).max(0.0) / corner;
                return Err(Folded { at });
            }
            domain = next;
        }
        Ok(Self {
            coefficients,
            domain,
            reach,
        })
    }

    /// The model's numbers.
    pub fn coefficients(&self) -> Coefficients {
        self.coefficients
    }

    /// Where an ideal position appears. Beyond the domain, hence outside the image, the
    /// distortion of its edge.
    pub fn apply(&self, x: DVec2) -> DVec2 {
        let edge = x.clamp_length_max(self.domain);
        self.coefficients.apply(edge) + (x - edge)
    }

    /// The ideal position of what appears at `y`: Newton's method with steps shortened
    /// until they come nearer. Beyond the reach, hence outside the image, as at its edge.
    pub fn invert(&self, y: DVec2) -> DVec2 {
        let edge = y.clamp_length_max(self.reach);
        let model = &self.coefficients;
        let miss = |x: DVec2| edge - model.apply(x);
        // Newton's path from the middle leads straight outwards, within the domain.
        let mut x = DVec2::ZERO;
        let mut off = miss(x);
        for _ in 0..ROUNDS {
            let mut step = model.derivative(x).inverse() * off;
            let nearer = loop {
                let next = x + step;
                let off_next = miss(next);
                if off_next.length() < off.length() && next.length() <= 1.01 * self.domain {
                    break Some((next, off_next));
                }
                step *= 0.5;
                if step.length() < 1e-17 * (self.domain + edge.length()) {
                    break None;
                }
            };
            match nearer {
                Some(next) => (x, off) = next,
                None => break,
            }
        }
        x + (y - edge)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The formulas of OpenCV's documentation, written out.
    #[test]
    fn opencvs_convention() {
        let lens = Coefficients {
            radial: [0.1, -0.2, 0.3],
            tangential: [0.01, -0.02],
        };
        let (x, y) = (0.3, -0.4);
        let r2 = 0.25;
        let radial = 1.0 + 0.1 * r2 - 0.2 * r2 * r2 + 0.3 * r2 * r2 * r2;
        let expected = DVec2::new(
            x * radial + 2.0 * 0.01 * x * y - 0.02 * (r2 + 2.0 * x * x),
            y * radial + 0.01 * (r2 + 2.0 * y * y) + 2.0 * -0.02 * x * y,
        );
        assert!((lens.apply(DVec2::new(x, y)) - expected).length() < 1e-15);
    }

    fn any() -> impl Strategy<Value = Coefficients> {
        (
            [-1.0..1.0, -1.0..1.0, -1.0..1.0f64],
            [-0.05..0.05, -0.05..0.05f64],
        )
            .prop_map(|(radial, tangential)| Coefficients { radial, tangential })
    }

    proptest! {
        #[test]
        fn the_derivative_is_that_of_the_map(lens in any(), x in -1.0..1.0, y in -1.0..1.0) {
            let at = DVec2::new(x, y);
            let step = 1e-6;
            let columns = [DVec2::X, DVec2::Y].map(|axis| {
                (lens.apply(at + axis * step) - lens.apply(at - axis * step)) / (2.0 * step)
            });
            let off = lens.derivative(at) - DMat2::from_cols(columns[0], columns[1]);
            prop_assert!(off.x_axis.length() + off.y_axis.length() < 1e-8, "{off}");
        }

        /// What is accepted has an inverse everywhere in the image, and its domain is where
        /// the eigenvalues stay positive.
        #[test]
        fn accepted_distortions_can_be_undone(lens in any(), x in -1.0..1.0, y in -1.0..1.0) {
            let corner = 2f64.sqrt();
            if let Ok(distortion) = Distortion::new(lens, corner) {
                let seen = DVec2::new(x, y);
                let ideal = distortion.invert(seen);
                prop_assert!((distortion.apply(ideal) - seen).length() < 1e-13);
                prop_assert!(ideal.length() <= distortion.domain);
                let matrix = lens.derivative(ideal);
                let (trace, determinant) = (matrix.x_axis.x + matrix.y_axis.y, matrix.determinant());
                let least = 0.5 * (trace - (trace * trace - 4.0 * determinant).max(0.0).sqrt());
                prop_assert!(least >= 0.99 * LEAST_STRETCH, "{least}");
            }
        }

        /// Points outside the image stay outside.
        #[test]
        fn outside_stays_outside(lens in any(), angle in 0.0..6.3, far in 1.0..50.0) {
            if let Ok(distortion) = Distortion::new(lens, 1.0) {
                let x = DVec2::from_angle(angle) * distortion.domain * far;
                prop_assert!(distortion.apply(x).length() >= 1.0);
                let y = DVec2::from_angle(angle) * distortion.reach * far;
                prop_assert!(distortion.invert(y).is_finite());
            }
        }
    }

    /// A barrel of k₁ = −1/3 has its turning point at r = 1, where it reaches 2/3.
    #[test]
    fn folds_are_found_where_they_are() {
        let barrel = Coefficients {
            radial: [-1.0 / 3.0, 0.0, 0.0],
            ..Coefficients::default()
        };
        assert!(Distortion::new(barrel, 0.6).is_ok());
        let folded = Distortion::new(barrel, 0.7).unwrap_err();
        // The stretch falls to a tenth at r = √0.9.
        let r = 0.9f64.sqrt();
        let expected = r * (1.0 - 0.3) / 0.7;
        assert!((folded.at - expected).abs() < 0.01, "{folded}");
        let nonsense = Coefficients {
            radial: [f64::NAN, 0.0, 0.0],
            ..Coefficients::default()
        };
        assert!(Distortion::new(nonsense, 1.0).is_err());
    }
}
