//! The simulated rigs' records, so that the program works in an empty folder.

/// A file of `calibration/simulated/`.
macro_rules! shipped {
    ($path:literal) => {
        (
            $path,
            include_bytes!(concat!("../../../../calibration/simulated/", $path)),
        )
    };
}

/// Names of the rigs with this sensor.
pub(super) const RIGS: [&str; 3] = ["simulated", "simulated-tilted", "simulated-ball"];

/// `<kind>/<file>` and its bytes. They were made by `rig calibrate` on the
/// simulated rig; `tests/physics/radiometry.rs` makes them again and compares.
pub(super) const SIMULATED: &[(&str, &[u8])] = &[
    shipped!("sensor/20261121T020000Z-sensor.toml"),
    shipped!("sensor/20261121T020000Z-sensor-dark.png"),
    shipped!("sensor/20261121T020000Z-sensor-offset.png"),
    shipped!("flat/20261121T020000Z-flat.toml"),
    shipped!("flat/20261121T020000Z-flat.png"),
    shipped!("scale/20261121T020000Z-scale.toml"),
];
