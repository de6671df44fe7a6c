use super::*;
use proptest::prelude::*;

fn map(min: f64, max: f64) -> AxisMap {
    AxisMap {
        scale: 1.0,
        offset: 0.0,
        min,
        max,
    }
}

fn arm() -> TwoAxes {
    TwoAxes {
        mechanism: Mechanism::Rotary,
        first: map(-180.0, 180.0),
        second: AxisMap {
            scale: -2.0,
            offset: 90.0,
            ..map(5.0, 90.0)
        },
        approach: 2.0,
    }
}

fn arc() -> TwoAxes {
    TwoAxes {
        mechanism: Mechanism::Arc {
            radius_mm: 400.0,
            centre_height_mm: -60.0,
        },
        first: map(-170.0, 170.0),
        second: map(10.0, 130.0),
        approach: 1.0,
    }
}

fn gantry() -> TwoAxes {
    TwoAxes {
        mechanism: Mechanism::Gantry { height_mm: 300.0 },
        first: map(-250.0, 250.0),
        second: map(-200.0, 200.0),
        approach: 5.0,
    }
}

fn angles(azimuth_deg: f64, elevation_deg: f64) -> StageAngles {
    StageAngles::new(azimuth_deg, elevation_deg)
}

#[test]
fn limits_are_named_in_their_units() {
    assert_eq!(arm().limits(), "azimuth -180° to 180°, elevation 5° to 90°");
    assert_eq!(
        arc().limits(),
        "turntable -170° to 170°, carriage 10° to 130°"
    );
    assert_eq!(
        gantry().limits(),
        "lamp's x -250 mm to 250 mm, y -200 mm to 200 mm"
    );
}

#[test]
fn what_is_no_reachable_direction_has_no_pose() {
    for stage in [arm(), arc(), gantry()] {
        for (azimuth_deg, elevation_deg) in [
            (f64::NAN, 45.0),
            (0.0, f64::INFINITY),
            (0.0, f64::NAN),
            (0.0, -5.0),
            (0.0, 1.0),
            (0.0, 0.0),
        ] {
            let target = angles(azimuth_deg, elevation_deg);
            assert_eq!(stage.solve(target), None, "{target}");
        }
    }
}

#[test]
fn another_turn_or_the_other_side_of_the_zenith_is_found() {
    let pose = |stage: &TwoAxes, azimuth_deg, elevation_deg| {
        stage.solve(angles(azimuth_deg, elevation_deg)).unwrap().0
    };
    assert_eq!(pose(&arm(), 270.0, 45.0), [-90.0, 45.0]);
    assert_eq!(pose(&arm(), 30.0, 135.0), [-150.0, 45.0]);
    let half = TwoAxes {
        first: map(0.0, 180.0),
        second: map(0.0, 180.0),
        ..arm()
    };
    assert_eq!(pose(&half, -60.0, 20.0), [120.0, 160.0]);
}

#[test]
fn a_target_within_the_limits_is_taken_as_it_is_written() {
    for (azimuth_deg, elevation_deg) in [(180.0, 45.0), (-180.0, 45.0), (0.0, 90.0)] {
        let pose = arm().solve(angles(azimuth_deg, elevation_deg));
        assert_eq!(pose, Some(Pose([azimuth_deg, elevation_deg])));
    }
}

/// By hand: the ray at 45° meets a circle of radius 500 about (0, −100) where
/// t² + 2·100·t·sin 45° + 100² = 500², so t = 424.264, at (300, 300), which the
/// circle's centre sees at atan(400 / 300) = 53.130°.
#[test]
fn an_arc_with_its_centre_below_the_sample() {
    let stage = TwoAxes {
        mechanism: Mechanism::Arc {
            radius_mm: 500.0,
            centre_height_mm: -100.0,
        },
        ..arc()
    };
    let pose = stage.solve(angles(30.0, 45.0)).unwrap();
    assert!((pose.0[1] - 53.130_102_354).abs() < 1e-8, "{pose:?}");
    let (direction, distance_mm) = stage.lamp(pose);
    assert!((direction - angles(30.0, 45.0).to_light()).length() < 1e-12);
    assert!((distance_mm.unwrap() - 300.0 * 2f64.sqrt()).abs() < 1e-9);
}

/// A lamp 300 mm high at 60° of elevation is 300 / tan 60° = 173.205 mm aside.
#[test]
fn a_gantry_by_hand() {
    let pose = gantry().solve(angles(90.0, 60.0)).unwrap();
    assert!(pose.0[0].abs() < 1e-9 && (pose.0[1] - 173.205_080_757).abs() < 1e-8);
    let (_, distance_mm) = gantry().lamp(pose);
    assert!((distance_mm.unwrap() - 346.410_161_514).abs() < 1e-8);
    assert_eq!(
        gantry().solve(angles(90.0, 55.0)),
        None,
        "210 mm is too far"
    );
    assert!(gantry().solve(angles(0.0, 55.0)).is_some());
    let straight_up = gantry().solve(angles(12.0, 90.0)).unwrap();
    assert!(straight_up.0.iter().all(|mm| mm.abs() < 1e-9));
}

#[test]
fn approach_comes_from_one_side_and_stays_within_the_limits() {
    let start = |from, to| arm().approach(Pose(from), Pose(to)).map(|pose| pose.0);
    assert_eq!(start([50.0, 50.0], [10.0, 20.0]), Some([8.0, 18.0]));
    assert_eq!(start([0.0, 6.0], [10.0, 20.0]), None);
    assert_eq!(start([0.0, 50.0], [10.0, 20.0]), Some([0.0, 18.0]));
    // No room below: from above, whether it is there already or at home beyond the limit.
    assert_eq!(start([0.0, 50.0], [-180.0, 6.0]), None);
    assert_eq!(start([-180.0, 0.0], [-179.0, 5.0]), Some([-177.0, 7.0]));
    assert_eq!(start([0.0, 0.0], [10.0, 5.5]), Some([0.0, 7.5]));
    let straight = TwoAxes {
        approach: 0.0,
        ..arm()
    };
    assert_eq!(
        straight.approach(Pose([50.0, 50.0]), Pose([0.0, 20.0])),
        None
    );
}

/// Each stage with the lowest elevation that it has at some azimuth.
fn stages() -> impl Strategy<Value = TwoAxes> {
    let tall = TwoAxes {
        mechanism: Mechanism::Arc {
            radius_mm: 150.0,
            centre_height_mm: 120.0,
        },
        second: map(-40.0, 200.0),
        ..arc()
    };
    prop::sample::select(vec![arm(), arc(), tall, gantry()])
}

proptest! {
    /// Forward after inverse: whatever pose is chosen is within the limits and
    /// has the target's direction.
    #[test]
    fn a_pose_points_where_the_target_does(
        stage in stages(),
        azimuth_deg in -720.0..720.0f64,
        elevation_deg in -90.0..270.0f64,
    ) {
        let target = angles(azimuth_deg, elevation_deg);
        if let Some(pose) = stage.solve(target) {
            prop_assert!(stage.first.reaches(pose.0[0]) && stage.second.reaches(pose.0[1]));
            let (direction, distance_mm) = stage.lamp(pose);
            prop_assert!((direction - target.to_light()).length() < 1e-6);
            prop_assert!(distance_mm.is_none_or(|mm| mm > 0.0 && mm < 1000.0));
            let back = stage.angles_like(target, pose, pose);
            prop_assert!((back.to_light() - target.to_light()).length() < 1e-12);
        }
    }

    /// Inverse after forward: every pose within the limits has a direction that
    /// is reached, so nothing reachable is refused.
    #[test]
    fn every_pose_within_the_limits_is_found_again(
        stage in stages(),
        first in 0.0..1.0f64,
        second in 0.0..1.0f64,
    ) {
        let at = |map: &AxisMap, part: f64| map.min + part * (map.max - map.min);
        let pose = Pose([at(&stage.first, first), at(&stage.second, second)]);
        let (direction, distance_mm) = stage.lamp(pose);
        let found = stage.solve(StageAngles::from_direction(direction));
        prop_assert!(found.is_some(), "{pose:?}");
        let (again, distance_again_mm) = stage.lamp(found.unwrap());
        prop_assert!((direction - again).length() < 1e-6);
        let (is, was) = (distance_again_mm.unwrap_or(0.0), distance_mm.unwrap_or(0.0));
        prop_assert!((is - was).abs() < 1e-3);
    }

    /// A reached pose is reported as the target was written, a small way off it.
    #[test]
    fn what_was_reached_is_told_in_the_target_s_words(
        stage in stages(),
        azimuth_deg in -400.0..400.0f64,
        elevation_deg in 20.0..160.0f64,
        off in (-0.5..0.5f64, -0.5..0.5f64),
    ) {
        let target = angles(azimuth_deg, elevation_deg);
        prop_assume!((elevation_deg - 90.0).abs() > 2.0);
        if let Some(wanted) = stage.solve(target) {
            let reached = Pose([wanted.0[0] + off.0, wanted.0[1] + off.1]);
            let told = stage.angles_like(target, wanted, reached);
            let (truth, _) = stage.lamp(reached);
            prop_assert!((told.to_light() - truth).length() < 1e-4, "{told} of {target}");
            prop_assert!((told.azimuth_deg - azimuth_deg).abs() < 90.0);
        }
    }

    /// The arm turns fully, so only the height can be out of reach.
    #[test]
    fn nothing_above_the_arm_s_horizon_is_refused(
        azimuth_deg in -720.0..720.0f64,
        elevation_deg in -90.0..270.0f64,
    ) {
        let target = angles(azimuth_deg, elevation_deg);
        let height_deg = target.to_light().z.asin().to_degrees();
        if arm().solve(target).is_none() {
            prop_assert!(height_deg < 5.0 + 1e-4);
        } else {
            prop_assert!(height_deg > 5.0 - 1e-4);
        }
    }

    #[test]
    fn an_approach_is_followed_by_a_move_up(
        from in (-180.0..180.0f64, 5.0..90.0f64),
        to in (-178.0..180.0f64, 7.0..90.0f64),
    ) {
        let arm = arm();
        let from = Pose([from.0, from.1]);
        let to = Pose([to.0, to.1]);
        let start = arm.approach(from, to).unwrap_or(from);
        prop_assert!(to.0[0] - start.0[0] >= 2.0 - 1e-5);
        prop_assert!(to.0[1] - start.0[1] >= 2.0 - 1e-5);
        prop_assert!(arm.first.reaches(start.0[0]) && arm.second.reaches(start.0[1]));
    }
}
