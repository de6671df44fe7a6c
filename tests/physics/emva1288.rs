//! The figures of EMVA 1288 against the simulated sensor's true ones.

use mock_devices::sensor::SensorConfig;
use rig::calibration::procedure::{LitCamera, ProcedureOptions};
use rig::calibration::record::Measured;
use rig::calibration::sensor::{PhotonTransfer, SensorFit};
use rig::device::even_light::EvenLight;
use rig::device::{Camera, Mosaic};

fn truth(seed: u64) -> SensorConfig {
    SensorConfig {
        hot_fraction: 1e-3,
        ..SensorConfig::typical([64, 64], seed)
    }
}

fn transfer_and_fit(camera: &mut EvenLight) -> (PhotonTransfer, SensorFit) {
    let bit_depth = camera.info().bit_depth;
    let width = camera.info().resolution_px[0] as usize;
    let options = ProcedureOptions::default();
    let transfer = LitCamera::new(camera, options, &mut |_| false, &mut || {}).photon_transfer();
    let transfer = transfer.unwrap();
    let fit = transfer.solve(width, bit_depth).unwrap();
    (transfer, fit)
}

/// The figures of EMVA 1288 on 6 sensors against the truth: DSNU within 15%, PRNU within 5%,
/// saturation capacity within 1%, threshold within 5% of what the true noise gives; PRNU and
/// DSNU with a pull below 4, the linearity error of a straight sensor below 0.1%.
#[test]
fn the_figures_of_emva_1288_are_the_true_sensors() {
    for seed in 0..6 {
        let config = truth(300 + seed);
        let mut camera = EvenLight::new(config.clone(), 0.4, seed);
        let (transfer, fit) = transfer_and_fit(&mut camera);
        let found = transfer.emva1288(&fit, Mosaic::None);
        let case = format!("seed {seed}: {found:?}");
        let near = |m: Measured, truth: f64, part: f64| {
            assert!((m.value / truth - 1.0).abs() < part, "{truth}, {case}");
        };
        let gain = config.gain_dn_per_e;
        let noise_e2 = config.read_noise_e.powi(2) + 1.0 / 12.0 / (gain * gain);
        near(found.system_gain_dn_per_e, gain, 0.01);
        near(found.dark_noise_e, config.read_noise_e, 0.05);
        near(found.saturation_capacity_e, config.full_well_e, 0.01);
        near(found.snr_max, config.full_well_e.sqrt(), 0.01);
        near(
            found.sensitivity_threshold_e,
            (noise_e2 + 0.25).sqrt() + 0.5,
            0.05,
        );
        near(
            found.dynamic_range,
            config.full_well_e / found.sensitivity_threshold_e.value,
            0.01,
        );
        near(found.dark_current_e_s, config.dark_current_e_s, 0.05);
        // Nonuniformity at the exposure that is stated.
        let at_s = found.nonuniformity_exposure_s;
        near(found.dsnu_offset_e, config.offset_dsnu_e, 0.15);
        near(
            found.dsnu_e,
            config.offset_dsnu_e.hypot(config.dsnu_e_s * at_s),
            0.15,
        );
        let prnu = found.prnu.unwrap();
        near(prnu, config.prnu, 0.05);
        assert!((prnu.value - config.prnu).abs() < 4.0 * prnu.std, "{case}");
        assert!(found.linearity_error.mean < 1e-3, "{case}");
        assert!(found.linearity_error.levels >= 10, "{case}");
        assert_eq!(
            found.hot_pixels,
            camera.sensor().hot_pixels().len(),
            "{case}"
        );
        // Behind colour filters there is no one response.
        let mosaic = transfer.emva1288(&fit, Mosaic::Rggb);
        assert!(mosaic.prnu.is_none() && mosaic.prnu_absent.is_some());
    }
    // A sensor that bends by 1% at its full well shows it.
    let config = SensorConfig {
        nonlinearity: -0.01,
        ..truth(310)
    };
    let (transfer, fit) = transfer_and_fit(&mut EvenLight::new(config, 0.4, 1));
    let bent = transfer.emva1288(&fit, Mosaic::None).linearity_error;
    assert!((5e-4..5e-3).contains(&bent.mean), "{bent:?}");
}
