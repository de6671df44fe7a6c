//! Statistical and physical tests of the dictionaries' atoms.

use std::sync::Arc;

use glam::DVec3;
use rig_core::brdf::check::{check, check_with};
use rig_core::brdf::chi_square::{ChiSquare, check_lobes, chi_square};
use rig_core::brdf::dictionary::{Atom, Dictionary};
use rig_core::brdf::nbrdf::{NAMES, NeuralBrdf};
use rig_core::brdf::rgl::RglBrdf;
use rig_core::brdf::{Brdf, Mixture, bivariate, ggx, merl};
use rig_core::random::{Purpose, stream};

/// Angles of the given direction in the sampler tests, radians: from the normal to grazing.
const ANGLES: [f64; 5] = [0.0, 0.6, 1.2, 1.5, 1.565];
const SAMPLES: u64 = 40_000;

fn direction(theta: f64, phi: f64) -> DVec3 {
    let (sin, cos) = theta.sin_cos();
    DVec3::new(sin * phi.cos(), sin * phi.sin(), cos)
}

/// An atom's own sampler against the density of `stated`.
fn sampler_check(sampled: Atom, stated: Atom, theta: f64, key: u64) -> ChiSquare {
    let from = direction(theta, 0.4);
    chi_square(
        from,
        SAMPLES,
        key,
        |numbers| {
            Some(
                sampled
                    .sample(from, [numbers.uniform(), numbers.uniform()])?
                    .0,
            )
        },
        |to| stated.pdf(from, to),
    )
}

fn lobe(alpha: f64) -> Atom {
    Atom::Ggx { alpha, eta: 1.5 }
}

/// All distinct atoms of the published dictionary, the ends of the range and the other
/// kinds, at five angles; family significance 1% by Šidák over (40 + 3 + 5) × 5 tests: each
/// at 4.2e-5, that is 3.93 standard deviations.
#[test]
fn every_atom_is_sampled_by_its_density() {
    const CRITICAL: f64 = 3.93;
    let dictionary = Dictionary::paper42();
    let duplicates = dictionary.duplicate_of();
    let mut atoms: Vec<Atom> = dictionary
        .atoms()
        .iter()
        .zip(duplicates)
        .filter(|(atom, duplicate)| duplicate.is_none() && **atom != Atom::Black)
        .map(|(atom, _)| *atom)
        .collect();
    assert_eq!(atoms.len(), 40);
    atoms.extend([lobe(0.005), lobe(0.01), lobe(1.0)]);
    atoms.extend([0.01, 0.1, 0.5, 1.0].map(|alpha| Atom::Beckmann { alpha, eta: 1.5 }));
    atoms.push(Atom::Coated { eta: 1.5 });
    for (k, &atom) in atoms.iter().enumerate() {
        for (a, &theta) in ANGLES.iter().enumerate() {
            let found = sampler_check(atom, atom, theta, (k * ANGLES.len() + a) as u64);
            assert!(found.deviate < CRITICAL, "{atom:?} at {theta}: {found:?}");
            assert!(found.total < 1.003, "{atom:?} at {theta}: {found:?}");
        }
    }
}

/// The same test must notice a width that is 5% off, and alpha² for alpha.
#[test]
fn the_sampler_test_has_power() {
    for theta in &ANGLES[..4] {
        for (sampled, stated) in [(0.105, 0.1), (0.09, 0.3), (0.0105, 0.01)] {
            let found = sampler_check(lobe(sampled), lobe(stated), *theta, 1000);
            assert!(
                found.deviate > 3.91,
                "width {sampled} for {stated} at {theta} rad: only {found:?}"
            );
        }
    }
}

/// The table made of a measured material draws from its density, for every kind of file;
/// family significance 1% over 5 × 5 tests: 3.36 standard deviations.
#[test]
fn measured_materials_are_sampled_by_their_density() {
    let paper = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/data/brdf/paper_white_rgb.bsdf"
    );
    let paper = RglBrdf::read(paper.as_ref()).unwrap();
    let network = NeuralBrdf::named("chrome").unwrap();
    let merl = merl::parse(&merl::to_bytes(&NeuralBrdf::named("red-plastic").unwrap())).unwrap();
    let averaged = bivariate::average(&NeuralBrdf::named("alum-bronze").unwrap(), 90, 90);
    let even = {
        let dictionary = Arc::new(Dictionary::paper42());
        let n = dictionary.len();
        Mixture::grey(dictionary, vec![1.0 / n as f64; n]).unwrap()
    };
    let kinds: [(&str, &dyn Brdf); 5] = [
        ("RGL", &paper),
        ("network", &network),
        ("MERL", &merl),
        ("bivariate", &averaged),
        ("mixture", &even),
    ];
    for (name, brdf) in kinds {
        let found = check_lobes(brdf, &[0.0, 35.0, 70.0, 85.0, 89.5], SAMPLES);
        for (k, at) in found.iter().enumerate() {
            assert!(at.deviate < 3.36 && at.total < 1.003, "{name}, {k}: {at:?}");
        }
        // Reflecting, not only consistent: nearly all draws leave above the horizon.
        assert!(
            found[0].total > 0.98 && found[1].total > 0.9,
            "{name}: {found:?}"
        );
    }
}

/// Monte Carlo through each atom's own sampler gives the albedo of the quadrature:
/// sample, density and value belong together, the part below the horizon included.
#[test]
fn atoms_are_physical_and_their_samplers_give_their_albedo() {
    for dictionary in [Dictionary::paper42(), Dictionary::rig26()] {
        let dictionary = Arc::new(dictionary);
        for (index, atom) in dictionary.atoms().iter().enumerate() {
            let mut weights = vec![0.0; dictionary.len()];
            weights[index] = 1.0;
            let alone = Mixture::grey(dictionary.clone(), weights).unwrap();
            let found = check(&alone);
            assert!(
                found.reciprocity < 2e-3 && found.invalid == 0,
                "{atom:?}: {found:?}"
            );
            assert!(found.largest_albedo < 1.005, "{atom:?}: {found:?}");
            let from = direction(
                rig_core::brdf::check::ALBEDO_ANGLES_DEG[4].to_radians(),
                0.0,
            );
            let (mut sum, mut sum2) = (0.0, 0.0);
            let n = 4000;
            for sample in 0..n {
                let mut numbers = stream(2026, Purpose::Experiment, index as u64, 0, sample);
                let u = [numbers.uniform(), numbers.uniform()];
                let value = atom.sample(from, u).map_or(0.0, |(to, pdf)| {
                    let at = ggx::Cosines::new(from.to_array(), to.to_array()).unwrap();
                    atom.eval(&at) * to.z / pdf
                });
                sum += value;
                sum2 += value * value;
            }
            let mean = sum / n as f64;
            let error = ((sum2 / n as f64 - mean * mean).max(0.0) / n as f64).sqrt();
            let expected = found.albedo[4][0];
            assert!(
                (mean - expected).abs() <= 5.0 * error + 4e-3 * expected,
                "{atom:?}: {mean} ± {error} against {expected}"
            );
        }
    }
}

#[test]
fn measured_materials_are_physical() {
    for name in NAMES {
        let found = check_with(&NeuralBrdf::named(name).unwrap(), 128, 2000);
        assert!(found.passes(), "{name}: {found:?}");
    }
}
