use super::*;
use crate::motion::trapezoid;

fn lamp(model: LampModel) -> Bench {
    let config = BenchConfig {
        lamp: model,
        ..BenchConfig::default()
    };
    Bench::new(config, Clock::manual())
}

#[test]
fn power_warms_up_and_drifts_by_the_formula() {
    let bench = lamp(LampModel {
        power: [1.0, 0.8, 1.0],
        warm_up_fraction: 0.1,
        warm_up_s: 60.0,
        drift_per_hour: 0.02,
        ..LampModel::default()
    });
    bench.clock().advance(1800.0);
    bench.set_lamp(1800.0, [1.0, 0.5, 0.0]);
    bench.clock().advance(60.0);
    let warm = (1.0 - 0.1 * (-1.0_f64).exp()) * (1.0 + 0.02 * 1860.0 / 3600.0);
    let [red, green, blue] = bench.illumination().channels;
    assert!((red - warm).abs() < 1e-12);
    assert!((green - 0.8 * 0.5 * warm).abs() < 1e-12);
    assert_eq!(blue, 0.0);
    // A change of power does not cool the lamp, switching it off does.
    bench.set_lamp(1860.0, [0.5, 0.0, 0.0]);
    assert!((bench.illumination().channels[0] - 0.5 * warm).abs() < 1e-12);
    bench.set_lamp(1860.0, [0.0, 0.0, 0.0]);
    bench.set_lamp(1860.0, [1.0, 0.0, 0.0]);
    let cold = 0.9 * (1.0 + 0.02 * 1860.0 / 3600.0);
    assert!((bench.illumination().channels[0] - cold).abs() < 1e-12);
}

/// Against a sum of many short exposures.
#[test]
fn flicker_averages_over_an_exposure() {
    let bench = lamp(LampModel {
        flicker_depth: 0.3,
        flicker_hz: 120.0,
        ..LampModel::default()
    });
    bench.set_lamp(0.0, [1.0, 0.0, 0.0]);
    let (start_s, end_s, n) = (1.234, 1.2371, 1000);
    let at = |i: f64| start_s + (end_s - start_s) * i / f64::from(n);
    let sum: f64 = (0..n)
        .map(|i| {
            bench
                .illumination_over(at(f64::from(i)), at(f64::from(i) + 1.0))
                .channels[0]
        })
        .sum();
    let whole = bench.illumination_over(start_s, end_s).channels[0];
    assert!((whole - sum / f64::from(n)).abs() < 1e-9, "{whole}");
    assert!((whole - 1.0).abs() > 0.01, "{whole}");
}

#[test]
fn an_exposure_averages_the_lamp_and_takes_the_middle_of_the_way() {
    let bench = lamp(LampModel::default());
    bench.set_lamp(1.0, [1.0, 0.0, 0.0]);
    bench.set_lamp(2.0, [0.0, 0.0, 1.0]);
    bench.set_lamp(3.0, [0.0; 3]);
    bench.follow(0.0, &trapezoid([0.0; 3], [40.0, 0.0, 0.0], 0.0, 10.0, 1e9));
    let light = bench.illumination_over(0.0, 4.0);
    for (mean, expected) in light.channels.iter().zip([0.25, 0.0, 0.25]) {
        assert!((mean - expected).abs() < 1e-12, "{:?}", light.channels);
    }
    assert!((light.azimuth_rad.to_degrees() - (20.0 - 180.0)).abs() < 1e-6);
    assert!((bench.turned_deg(0.0, 4.0) - 40.0).abs() < 1e-6);
}

#[test]
fn a_new_plan_replaces_the_future_and_keeps_the_past() {
    let bench = lamp(LampModel::default());
    bench.follow(0.0, &trapezoid([0.0; 3], [40.0, 0.0, 0.0], 0.0, 10.0, 1e9));
    bench.follow(2.0, &[]);
    bench.clock().advance(10.0);
    assert!((bench.motor_position()[0] - 20.0).abs() < 1e-6);
    let middle = bench.illumination_over(0.0, 2.0);
    assert!((middle.azimuth_rad.to_degrees() + 170.0).abs() < 1e-6);
}

#[test]
fn cut_drives_coast_and_the_firmware_does_not_know() {
    let config = BenchConfig {
        errors: StageErrors {
            coast_s: 0.1,
            ..StageErrors::default()
        },
        seed: 3,
        ..BenchConfig::default()
    };
    let bench = Bench::new(config, Clock::manual());
    bench.follow(0.0, &trapezoid([0.0; 3], [40.0, 0.0, 0.0], 0.0, 10.0, 1e9));
    bench.clock().advance(1.0);
    bench.cut_drives(1.0, [10.0, 0.0, 0.0]);
    let coasted = bench.motor_position()[0] - 10.0;
    assert!((0.0..1.0).contains(&coasted) && coasted > 1e-3, "{coasted}");
    // What the firmware plans from its 10 begins where the stage truly is.
    bench.follow(
        1.0,
        &trapezoid([10.0, 0.0, 0.0], [11.0, 0.0, 0.0], 1.0, 10.0, 1e9),
    );
    bench.clock().advance(1.0);
    assert!((bench.motor_position()[0] - 11.0 - coasted).abs() < 1e-6);
}

/// Sends the stage to a place by way of others, lights the lamp there, and says where
/// the lamp truly was.
fn visit(bench: &Bench, way: &[Position], to: Position) -> [f64; 2] {
    for &to in way.iter().chain([&to]) {
        let now_s = bench.clock().now_s();
        let from = lock(&bench.state).target(now_s);
        bench.follow(now_s, &trapezoid(from, to, now_s, 10.0, 100.0));
        bench.clock().advance(100.0);
    }
    let now_s = bench.clock().now_s();
    bench.set_lamp(now_s, [1.0; 3]);
    let light = bench.illumination();
    bench.set_lamp(now_s, [0.0; 3]);
    assert_eq!(light.sent_to_deg, [to[0] - 180.0, to[1]]);
    [light.azimuth_rad, light.elevation_rad]
}

/// Whatever the way there, to the last bit; and anew at every visit.
#[test]
fn errors_belong_to_target_and_visit() {
    let bench = || {
        let config = BenchConfig {
            errors: StageErrors {
                positioning_mm: 0.05,
                repeatability_mm: 0.01,
                ..StageErrors::default()
            },
            seed: 3,
            ..BenchConfig::default()
        };
        Bench::new(config, Clock::manual())
    };
    let (a, b) = ([31.7, 47.3, 0.0], [90.1, 12.9, 0.0]);
    let one = bench();
    let first = visit(&one, &[], a);
    let other = visit(&one, &[[3.1, 4.7, 0.0]], b);
    let second = visit(&one, &[], a);
    assert_ne!(first, second);
    assert!((first[0] - second[0]).abs() < f64::to_radians(0.1));
    let another = bench();
    assert_eq!(
        visit(&another, &[[17.3, 60.0, 0.0], [0.1, 0.3, 0.0]], b),
        other
    );
    assert_eq!(visit(&another, &[[1.0, 1.0, 0.0]], a), first);
    // One that was made after the first visit, e.g. by another process.
    let later = bench();
    later.count_visit(a);
    assert_eq!(visit(&later, &[], a), second);
    assert_eq!(visit(&later, &[], b), other);
    // One that was made during the first visit: it goes on there, or was over.
    let during = bench();
    during.continue_visit(a);
    assert_eq!(visit(&during, &[], a), first);
    assert_eq!(visit(&during, &[], b), other);
    assert_eq!(visit(&during, &[], a), second);
    let over = bench();
    over.continue_visit(a);
    assert_eq!(visit(&over, &[], b), other);
    assert_eq!(visit(&over, &[], a), second);
}

#[test]
fn homing_errors_have_the_stated_spread() {
    let config = BenchConfig {
        errors: StageErrors {
            homing_mm: 0.05,
            ..StageErrors::default()
        },
        ..BenchConfig::default()
    };
    let bench = Bench::new(config, Clock::instant());
    let n = 2000;
    let mut sum2 = 0.0;
    for _ in 0..n {
        bench.begin_homing();
        bench.end_homing(&[0]);
        let slip = lock(&bench.state).slip;
        assert_eq!(slip[1], 0.0);
        sum2 += slip[0] * slip[0];
    }
    // Five standard deviations of a variance estimated from n samples.
    let ratio = sum2 / f64::from(n) / 0.05_f64.powi(2);
    assert!(
        (ratio - 1.0).abs() < 5.0 * (2.0 / f64::from(n)).sqrt(),
        "{ratio}"
    );
}
