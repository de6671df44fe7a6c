//! The materials of the references.

use std::sync::Arc;

use rig_core::brdf::{Atom, Dictionary, Mixture};

pub fn mixture(atoms: &[(f64, Atom)]) -> Mixture {
    let dictionary = Dictionary::new("test", atoms.iter().map(|a| a.1).collect()).unwrap();
    Mixture::grey(Arc::new(dictionary), atoms.iter().map(|a| a.0).collect()).unwrap()
}

pub fn blend() -> Mixture {
    mixture(&[
        (0.4, Atom::Lambertian { albedo: 1.0 }),
        (
            0.35,
            Atom::Ggx {
                alpha: 0.15,
                eta: 1.5,
            },
        ),
        (
            0.15,
            Atom::Ggx {
                alpha: 0.4,
                eta: 2.0,
            },
        ),
        (0.1, Atom::Black),
    ])
}

pub fn ggx(alpha: f64, eta: f64) -> Mixture {
    mixture(&[(1.0, Atom::Ggx { alpha, eta })])
}

pub fn lambertian(albedo: f64) -> Mixture {
    mixture(&[(1.0, Atom::Lambertian { albedo })])
}
