//! The record of a fit, for tests of what reads and writes one.

use super::*;
use crate::inverse::FitOptions;

/// The record of a fit, with every optional part.
pub fn fit() -> FitRecord {
    let score = |estimate: f64| ChannelScore {
        channels: [estimate, estimate * 1.5, estimate * 2.0],
        overall: estimate * 1.4,
    };
    let metric = MetricScores {
        estimate: score(0.05),
        reference_projection: score(0.04),
        floor: score(0.03),
        single_bounce_start: Some(score(0.4)),
    };
    let atom = |index, kind: &str, alpha, eta, albedo| AtomRecord {
        index,
        kind: kind.to_owned(),
        alpha,
        eta,
        albedo,
    };
    let cell = Interval {
        value: [0.1, 0.2, 0.3],
        lower: [0.05, 0.15, 0.25],
        upper: [0.15, 0.25, 0.4],
        constrained: true,
    };
    FitRecord {
        simulated: true,
        dictionary: "paper42".to_owned(),
        atoms: vec![
            atom(0, "ggx", Some(0.05), Some(1.5), None),
            atom(1, "lambertian", None, None, Some(1.0)),
            atom(2, "black", None, None, None),
        ],
        weights: [
            vec![0.5, 0.25, 0.25],
            vec![0.1, 0.2, 0.7],
            vec![0.0, 0.0, 1.0],
        ],
        weight_deviations: [vec![0.01; 3], vec![0.02; 3], vec![0.0; 3]],
        settings: FitSettings {
            optimizer: "gauss-newton".to_owned(),
            samples_requested: Some(512),
            adapted_paths: Some(true),
            asked: FitRequest {
                mask: Some("mask.png".into()),
                memory_mib: Some(256),
                job: Some("5f0c".to_owned()),
                ..FitRequest::recorded(&FitOptions::default())
            },
            session: None,
            scene: Some("bench.toml".to_owned()),
            images: vec!["a.exr".to_owned(), "b.exr".to_owned()],
            samples_per_pixel: 256,
            max_reflections: 16,
            seed: 7,
            kernel: "portable".to_owned(),
        },
        loss: 1.25,
        reduced_chi_square: vec![[1.0, 1.1, 0.9], [1.2, 1.0, 1.0]],
        truncation_remainder: vec![2e-4, 1e-4],
        outlier_fraction: vec![0.0, 0.01],
        discrepancy: Some(DiscrepancyRecord {
            amplitude: 0.35,
            by_channel: [0.1, -0.2, 0.0].map(|g| Discrepancy::even(|_| g)),
        }),
        posterior: Some(PosteriorRecord {
            samples: [0.25, 0.5]
                .map(|first| [0, 1, 2].map(|_| vec![first, 0.25, 0.75 - first]))
                .to_vec(),
        }),
        termination: "the step changed no weight by more than 1e-6".to_owned(),
        trace: vec![TracePoint {
            step: 0,
            loss: 8.0,
            seconds: 0.125,
        }],
        timings: vec![Timing {
            stage: "trace".to_owned(),
            seconds: 0.5,
        }],
        versions: BTreeMap::from([("rig".to_owned(), "0.1.0".to_owned())]),
        score: Some(ScoreSheet {
            truth: "paper white".to_owned(),
            environment_error: metric,
            brdf_error: metric,
            brdf_cube_root_error: None,
            plain: Some(crate::brdf::plain_error::PlainErrors {
                albedo: Vec::new(),
                peak: Vec::new(),
            }),
        }),
        table: AngleTable {
            theta_h_deg: vec![0.0, 45.0],
            theta_d_deg: vec![0.0, 30.0, 60.0],
            cells: vec![cell; 6],
        },
        warnings: vec![Warning {
            what: "residuals follow the crease".to_owned(),
            likely_cause: "pose error".to_owned(),
            grade: Grade::Distrust,
        }],
        remarks: vec!["48 of 64 paths per cell were traced".to_owned()],
        bench: Some(BenchRecord {
            rounds: 3,
            settled: true,
            residual_described: 0.4,
            residual_refined: -0.01,
            held: vec!["rotation about z".to_owned()],
            parameter: vec![BenchParameter {
                name: "azimuth of light 1".to_owned(),
                unit: "deg".to_owned(),
                value: -0.12,
                deviation: 0.03,
                prior_deviation: 0.3,
            }],
        }),
        budget: Some(BudgetRecord {
            sources: vec!["capture noise".to_owned(), "model".to_owned()],
            row: vec![BudgetRow {
                theta_h_deg: 10.0,
                theta_d_deg: 45.0,
                value: 0.2,
                relative_std: 0.05,
                share: vec![0.25, 0.75],
            }],
        }),
    }
}
