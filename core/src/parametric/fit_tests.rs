use super::*;
use crate::brdf::source;

const MODELS: [Model; 3] = [Model::OpenPbr, Model::Principled, Model::Gltf];

fn difference(a: &Parameters, b: &Parameters, which: &[usize]) -> f64 {
    let (a, b) = (a.to_array(), b.to_array());
    which
        .iter()
        .map(|&k| (a[k] - b[k]).abs())
        .fold(0.0, f64::max)
}

/// A material made from a model is found again.
#[test]
fn a_models_own_material_is_recovered() {
    let plastic = Parameters {
        base_color: [0.6, 0.1, 0.05],
        roughness: 0.4,
        ..Parameters::default()
    };
    let metal = Parameters {
        base_color: [0.9, 0.6, 0.3],
        metalness: 1.0,
        roughness: 0.3,
        ..Parameters::default()
    };
    let cases = MODELS.map(|model| (model, plastic));
    for (model, truth) in cases.into_iter().chain([(Model::Gltf, metal)]) {
        let found = fit(&ParametricBrdf::new(model, &truth), model).unwrap();
        assert!(found.difference < 2e-3, "{model:?} {found:?}");
        let which = [0, 1, 2, METALNESS, ROUGHNESS];
        let off = difference(&found.parameters, &truth, &which);
        assert!(off < 0.02, "{model:?}: {off} {found:?}");
    }
}

/// Two lobes need the coat.
#[test]
fn a_coat_is_found() {
    let truth = Parameters {
        base_color: [0.5, 0.3, 0.1],
        metalness: 0.7,
        roughness: 0.6,
        coat_weight: 0.8,
        coat_roughness: 0.15,
        ..Parameters::default()
    };
    let model = Model::OpenPbr;
    let found = fit(&ParametricBrdf::new(model, &truth), model).unwrap();
    let p = found.parameters;
    assert!(found.difference < 3e-3, "{found:?}");
    assert!((p.coat_weight - 0.8).abs() < 0.05, "{p:?}");
    assert!((p.coat_roughness - 0.15).abs() < 0.01, "{p:?}");
}

/// No start is nearer to a measured material than what is found from all of them.
#[test]
fn a_fit_is_never_worse_than_its_starts() {
    let paint = source::load("nbrdf:blue-metallic-paint").unwrap();
    let target = Target::of(paint.as_ref());
    for model in [Model::Principled, Model::Gltf] {
        let found = fit(paint.as_ref(), model).unwrap();
        let of = |p: &Parameters| {
            let squares = target.residuals(&ParametricBrdf::new(model, p));
            let sum: f64 = squares.iter().map(|r| r * r).sum();
            (sum / target.len() as f64).sqrt()
        };
        assert!((of(&found.parameters) - found.difference).abs() < 1e-9);
        for start in starts(&target) {
            assert!(found.difference < of(&start), "{model:?} {start:?}");
        }
        // The extensions of glTF improve what viewers without them show.
        assert!(found.difference <= of(&found.core) + 1e-12);
    }
}

#[test]
fn what_has_no_values_has_no_fit() {
    struct Broken;
    impl Brdf for Broken {
        fn eval(&self, _: glam::Vec3, _: glam::Vec3) -> [f32; 3] {
            [f32::NAN; 3]
        }
    }
    assert_eq!(fit(&Broken, Model::Gltf), Err(FitError::NotFinite));
    let black = source::load("lambertian:0").unwrap();
    assert_eq!(fit(black.as_ref(), Model::Gltf), Err(FitError::Black));
}

/// Whatever the model: what is neutral stays so, without extensions that change nothing, and
/// no diffuse grey is nearer.
#[test]
fn neutral_materials_stay_neutral_and_no_grey_is_nearer() {
    let maps = EnvironmentMap::all();
    for spec in [
        "lambertian:0.9",
        "ggx:0.25,1.8",
        "nbrdf:black-phenolic",
        "nbrdf:aluminium",
    ] {
        let material = source::load(spec).unwrap();
        let error = |of: &dyn Brdf| {
            score::environment_error(of, material.as_ref(), &maps, SMALL_SPHERE)
                .mean
                .all
        };
        let grey = [0.01, 0.03, 0.1, 0.3, 0.9].map(|albedo| {
            let grey = source::load(&format!("lambertian:{albedo}")).unwrap();
            error(grey.as_ref())
        });
        let grey = grey.into_iter().fold(f64::INFINITY, f64::min);
        // In full with RIG_LONG; otherwise every model of the hardest one, and one of the others.
        let every = std::env::var_os("RIG_LONG").is_some() || spec.ends_with("phenolic");
        for model in MODELS.into_iter().filter(|&m| every || m == Model::Gltf) {
            let found = fit(material.as_ref(), model).unwrap();
            let p = found.parameters;
            if spec.starts_with("lambertian") && model == Model::Gltf {
                assert_eq!((p.ior, p.coat_weight, p.fuzz), (USUAL_IOR, 0.0, [0.0; 3]));
            }
            let tints = [p.fuzz_weight_and_color().1, p.specular_weight_and_color().1];
            for [r, g, b] in tints {
                let spread = r.max(g).max(b) - r.min(g).min(b);
                assert!(spread < 0.01, "{spec} {model:?}: {p:?}");
            }
            let own = error(&found.brdf());
            assert!(own < grey + 1e-3, "{spec} {model:?}: {own}, a grey {grey}");
        }
    }
}

/// No coloured fibres on a grey base, and the base's on a coloured one.
#[test]
fn fibres_have_the_bases_hue_or_none() {
    for (spec, model) in [
        ("nbrdf:silver-paint", Model::Gltf),
        ("nbrdf:chrome", Model::Gltf),
        ("nbrdf:red-plastic", Model::OpenPbr),
    ] {
        let found = fit(source::load(spec).unwrap().as_ref(), model).unwrap();
        assert!(has_usual_fibres(&found.parameters), "{spec}: {found:?}");
    }
    let fibres = |fuzz| {
        has_usual_fibres(&Parameters {
            base_color: [0.6, 0.1, 0.05],
            fuzz,
            ..Parameters::default()
        })
    };
    assert!(fibres([0.0; 3]) && fibres([0.3; 3]) && fibres([0.3, 0.05, 0.03]));
    assert!(!fibres([0.0, 1.0, 0.48]));
}
