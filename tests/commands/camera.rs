//! `rig calibrate camera` as the operator meets it: from photographs of a board to a record,
//! and refusals with advice.

use std::path::Path;

use crate::command_support::{run, small_bench, text};
use glam::{DQuat, DVec2, DVec3};
use rig::frames::Rigid;
use rig::transport::{Camera, Coefficients, LensSpec, Projection};
use serde_json::Value;

const SIZE: [usize; 2] = [160, 120];
const SQUARES: [f64; 2] = [10.0, 8.0];
const SQUARE_MM: f64 = 12.0;

fn truth() -> Camera {
    let from = DVec3::new(3.0, -2.0, 250.0);
    let projection = Projection::Perspective { fov_rad: 0.55 };
    let camera = Camera::looking_at(SIZE, projection, from, DVec3::ZERO, DVec3::Y).unwrap();
    let lens = LensSpec {
        principal_offset: DVec2::new(0.02, -0.02),
        aspect: 1.0,
        distortion: Coefficients {
            radial: [-0.1, 0.0, 0.0],
            tangential: [0.0; 2],
        },
    };
    camera.with_lens(lens).unwrap()
}

/// A photograph of the board, moved in the sample's frame, as a 16-bit PNG.
fn photograph(camera: &Camera, turn: DQuat, shift: DVec3, path: &Path) {
    let half = 0.5 * DVec2::from_array(SQUARES) * SQUARE_MM;
    let board: Rigid<rig::frames::Sample, rig::frames::Sample> = Rigid::new(turn, shift);
    let to_board = board.inverse();
    let sample = &camera.sample_from_camera;
    let seen = |px: DVec2| {
        let (origin, direction) = camera.chief_ray(px);
        let from = to_board.point(sample.point(origin));
        let along = to_board.direction(sample.direction(direction));
        let at = (from - along * (from.z / along.z)).truncate();
        if (at.abs() - half).max_element() > 0.0 {
            return 0.85;
        }
        // Edges as wide as a third of a pixel.
        let wave = |x: f64| {
            let nearest = (x / SQUARE_MM).round();
            let beyond = (x - nearest * SQUARE_MM) / 0.29;
            let sign = 1.0 - 2.0 * nearest.rem_euclid(2.0);
            sign * (2.0 * beyond).clamp(-1.0, 1.0)
        };
        0.47 - 0.38 * wave(at.x + half.x) * wave(at.y + half.y)
    };
    let image = image::ImageBuffer::from_fn(SIZE[0] as u32, SIZE[1] as u32, |x, y| {
        let mut sum = 0.0;
        // Five by five places over a pixel and its margin: a little blur.
        for i in 0..25 {
            let at = DVec2::new(f64::from(i % 5), f64::from(i / 5)) / 3.0 - 1.0 / 6.0;
            sum += seen(DVec2::new(f64::from(x), f64::from(y)) + at);
        }
        image::Luma([(65535.0 * sum / 25.0) as u16])
    });
    image.save(path).unwrap();
}

#[test]
fn a_lens_is_measured_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut config = small_bench::rig_file();
    for (key, new) in [
        ("resolution_px = [64, 64]", "resolution_px = [160, 120]"),
        ("model = \"orthographic\"", "model = \"perspective\""),
        ("extent_mm = [22.0, 22.0]", "fov_deg = 28.0"),
        (
            "position_mm = [0.0, 0.0, 200.0]",
            "position_mm = [0.0, 0.0, 240.0]",
        ),
    ] {
        assert!(config.contains(key), "{key}");
        config = config.replace(key, new);
    }
    std::fs::write(at.join("rig.toml"), config).unwrap();
    let camera = truth();
    let mut views = Vec::new();
    for k in 0..6 {
        let angle = std::f64::consts::TAU * f64::from(k) / 5.0;
        let axis = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let tilt = if k == 0 { 0.0 } else { 0.45 };
        let away = if k == 0 { 0.0 } else { 11.0 };
        let name = format!("view{k}.png");
        let shift = DVec3::new(angle.sin(), -angle.cos(), 0.0) * away;
        let turn = DQuat::from_axis_angle(axis, tilt);
        photograph(&camera, turn, shift, &at.join(&name));
        views.push(name);
    }
    let all: Vec<&str> = views.iter().map(String::as_str).collect();
    let command = |views: &[&str], further: &[&str]| {
        let mut arguments = vec!["calibrate", "camera"];
        arguments.extend(views);
        arguments.extend(["--square", "12", "--json"]);
        arguments.extend(further);
        run(at, &arguments)
    };
    let records = at.join("calibration/simulated/camera");
    for (views, further, fact, advice) in [
        (
            &all[..],
            ["--squares", "9,8"],
            "shows a board",
            "counts squares along each side of the board",
        ),
        (
            &all[..2],
            ["--squares", "10,8"],
            "2 views",
            "the whole board, evenly lit",
        ),
        (
            &all[..1],
            ["--squares", "2,8"],
            "must be",
            "correct the value; nothing was kept",
        ),
        (&["rig.toml"], ["--squares", "10,8"], "rig.toml", "PNG"),
    ] {
        let refused = command(views, &further);
        let said = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{said}");
        assert!(
            said.contains(fact) && said.contains("hint:") && said.contains(advice),
            "{said}"
        );
        assert!(!records.exists(), "{said}");
    }

    let measured = command(&all, &["--squares", "10,8", "--datum", "1", "--id", "lens"]);
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    let found: Value = serde_json::from_slice(&measured.stdout).unwrap();
    let number = |v: &Value| v.as_f64().unwrap();
    let focal_px = camera.scale_px().x;
    assert!(
        (number(&found["scale"][0]) / focal_px - 1.0).abs() < 0.003,
        "{found}"
    );
    for (axis, expected) in [(0, 83.2), (1, 57.6)] {
        let off = number(&found["principal_point_px"][axis]) - expected;
        assert!(off.abs() < 0.5, "{found}");
        let place = number(&found["pose"]["position_mm"][axis]);
        let off = place - [3.0, -2.0][axis];
        assert!(off.abs() < 1.0, "{found}");
    }
    let off_mm = number(&found["pose"]["position_mm"][2]) - 250.0;
    assert!(off_mm.abs() < 1.0, "{found}");
    assert!((number(&found["radial"][0]) + 0.1).abs() < 0.02, "{found}");
    assert!(records.join("lens.toml").is_file());
    assert!(at.join("calibration/simulated/plots/lens.svg").is_file());
    let status = text(&run(at, &["calibrate", "status"]).stdout);
    assert!(status.contains("focal length"), "{status}");
}
