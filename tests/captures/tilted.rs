//! The benches with a tilted camera, lamps behind the sample among their lights, through whole
//! commands on small images.

use crate::command_support::{good, json, run, session_of, text, tilted_workplace};
use rig::session::fit_record;

/// What the program says of each bench, whose material reflects 0.8 at all angles: the checks
/// pass, the plan names the lamps that shine towards the lens, and the fit finds the material
/// where the camera on the axis sees nothing, at θd = 55° and beyond.
#[test]
fn tilted_benches_are_checked_captured_fitted_and_reported() {
    for (bench, baffled) in [
        (include_str!("../../rig-configs/simulated-tilted.toml"), 1),
        (include_str!("../../rig-configs/simulated-ball.toml"), 2),
    ] {
        let folder = tilted_workplace(bench);
        let checks = json(run(&folder, &["doctor", "--json"]));
        let checks = checks["checks"].as_array().unwrap();
        for name in ["view", "light paths", "depth of field"] {
            let check = checks.iter().find(|check| check["name"] == name).unwrap();
            assert_eq!(check["verdict"], "ok", "{check}");
        }
        let planned = good(run(&folder, &["capture", "--lights", "4", "--dry-run"]));
        let said = text(&planned.stderr);
        let named = said
            .split_once("by their angle to the camera's axis: ")
            .unwrap()
            .1;
        let (named, advice) = named.split_once("; ").unwrap();
        assert!(named.matches("light ").count() >= baffled, "{said}");
        assert!(
            advice.starts_with("a baffle must keep each out of the lens"),
            "{said}"
        );

        let captured = good(run(&folder, &["capture", "--lights", "4"]));
        let session = session_of(&folder, &captured);
        assert!(session.join("report.html").is_file());
        let record = fit_record::read(&session.join("fits/0")).unwrap();
        let table = &record.table;
        let at = |angles: &[f64], deg: f64| angles.iter().position(|&a| a >= deg).unwrap();
        let theta_h = at(&table.theta_h_deg, 20.0);
        for theta_d in [10.0, 30.0, 55.0] {
            let theta_d = at(&table.theta_d_deg, theta_d);
            let value = table.cell(theta_h, theta_d).unwrap().value[1];
            let off = value / (0.8 / std::f64::consts::PI) - 1.0;
            println!("{off:+.3} at {theta_d}");
            assert!(off.abs() < 0.05, "{off} at the cell {theta_h}, {theta_d}");
        }
    }
}
