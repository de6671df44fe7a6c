//! Fresnel terms as renderers approximate them; the dielectric's own is [`ggx::fresnel`].

use crate::brdf::ggx;

/// Reflectance at normal incidence of an interface between air and a dielectric.
pub fn f0_from_ior(ior: f64) -> f64 {
    let ratio = (ior - 1.0) / (ior + 1.0);
    ratio * ratio
}

/// Schlick 1994: from `f0` at normal to 1 at grazing incidence.
pub fn schlick(f0: f64, cos_d: f64) -> f64 {
    f0 + (1.0 - f0) * schlick_share(cos_d)
}

/// (1 − cos θd)⁵.
pub fn schlick_share(cos_d: f64) -> f64 {
    let rest = (1.0 - cos_d).clamp(0.0, 1.0);
    let square = rest * rest;
    square * square * rest
}

/// Metal by Kutz, Hašan and Edmondson 2021 ("Novel aspects of the Adobe Standard Material"):
/// Schlick's curve, lowered so that at cos θd = 1/7 it is `tint` times as high.
pub fn f82(f0: f64, tint: f64, cos_d: f64) -> f64 {
    let dip = f82_dip(f0, tint);
    let rest = (1.0 - cos_d).clamp(0.0, 1.0);
    (schlick(f0, cos_d) - dip * cos_d * schlick_share(cos_d) * rest).clamp(0.0, 1.0)
}

/// Factor of cos θd·(1 − cos θd)⁶ in [`f82`].
fn f82_dip(f0: f64, tint: f64) -> f64 {
    const COS: f64 = 1.0 / 7.0;
    schlick(f0, COS) * (1.0 - tint) / (COS * schlick_share(COS) * (1.0 - COS))
}

/// Mean of [`f82`] over the hemisphere, weighted by the cosine: ∫ 2c·F dc.
pub fn f82_mean(f0: f64, tint: f64) -> f64 {
    f0 + (1.0 - f0) / 21.0 - f82_dip(f0, tint) / 126.0
}

/// How far a dielectric's reflectance is from its value at normal incidence to 1, in [0, 1].
pub fn dielectric_share(ior: f64, cos_d: f64) -> f64 {
    let f0 = f0_from_ior(ior);
    ((ggx::fresnel(ior, cos_d) - f0) / (1.0 - f0)).clamp(0.0, 1.0)
}

/// Mean of [`dielectric_share`] over the hemisphere, weighted by the cosine.
pub fn dielectric_share_mean(ior: f64) -> f64 {
    const NODES: usize = 64;
    let at = |k: usize| {
        let cos = (k as f64 + 0.5) / NODES as f64;
        2.0 * cos * dielectric_share(ior, cos)
    };
    (0..NODES).map(at).sum::<f64>() / NODES as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(fresnel: impl Fn(f64) -> f64) -> f64 {
        let n = 20_000;
        let at = |k: usize| (k as f64 + 0.5) / f64::from(n);
        (0..n as usize)
            .map(|k| 2.0 * at(k) * fresnel(at(k)))
            .sum::<f64>()
            / f64::from(n)
    }

    #[test]
    fn published_values() {
        // Glass of index 1.5 and water of 1.333 at normal incidence.
        assert!((f0_from_ior(1.5) - 0.04).abs() < 1e-12);
        assert!((f0_from_ior(1.333) - 0.0204).abs() < 1e-4);
        // Mean reflectance of glass over the hemisphere: 0.0918 (Judd 1942).
        let glass = mean(|cos| 0.04 + 0.96 * dielectric_share(1.5, cos));
        assert!((glass - 0.0918).abs() < 2e-4, "{glass}");
        // At cos = 1/7 the tint is the factor of Schlick's curve, elsewhere it hardly shows.
        assert!((f82(0.7, 0.6, 1.0 / 7.0) - 0.6 * schlick(0.7, 1.0 / 7.0)).abs() < 1e-12);
        assert_eq!(f82(0.7, 0.6, 1.0), 0.7);
        assert!((f82(0.7, 1.0, 0.3) - schlick(0.7, 0.3)).abs() < 1e-12);
    }

    #[test]
    fn means_are_integrals() {
        let metal = mean(|cos| f82(0.8, 0.5, cos));
        assert!((f82_mean(0.8, 0.5) - metal).abs() < 1e-6);
        let glass = mean(|cos| dielectric_share(1.6, cos));
        assert!((dielectric_share_mean(1.6) - glass).abs() < 1e-3);
    }
}
