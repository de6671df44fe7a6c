//! Quantities whose unit would otherwise be a guess at the call site.
//!
//! Only what crosses floors is a type; inside a function a suffixed name
//! (`theta_h_rad`, `radiance_w_m2_sr`) is enough.

use serde::{Deserialize, Serialize};

/// A duration of light collection or of waiting, in seconds.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Seconds(pub f64);

impl Seconds {
    /// The same duration for `std` timers; negative and non-finite values become zero.
    pub fn to_duration(self) -> std::time::Duration {
        std::time::Duration::try_from_secs_f64(self.0).unwrap_or_default()
    }
}

impl std::fmt::Display for Seconds {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (count, unit) = match self.0.abs() < 1.0 {
            true => (self.0 * 1e3, "ms"),
            false => (self.0, "s"),
        };
        let count = format!("{count:.3}");
        let count = count.trim_end_matches('0').trim_end_matches('.');
        write!(out, "{count} {unit}")
    }
}

/// A relative figure in per cent with two significant digits: `0.34%`, `3.4%`, `34%`.
pub fn percent(part: f64) -> String {
    let percent = 100.0 * part;
    match percent.abs() {
        9.95.. => format!("{percent:.0}%"),
        0.995.. => format!("{percent:.1}%"),
        _ => format!("{percent:.2}%"),
    }
}

/// A number of bytes for people, with two digits or more: `320 B`, `9.7 MB`, `69 GB`.
pub fn size(bytes: u64) -> String {
    let bytes = bytes as f64;
    let (count, unit) = match bytes {
        999.5e6.. => (bytes / 1e9, "GB"),
        999.5e3.. => (bytes / 1e6, "MB"),
        999.5.. => (bytes / 1e3, "kB"),
        _ => return format!("{bytes} B"),
    };
    match count {
        9.95.. => format!("{count:.0} {unit}"),
        _ => format!("{count:.1} {unit}"),
    }
}

/// Where a light stage points its lamp, in degrees, in the stage's own axes.
///
/// The direction from the sample towards the lamp is
/// `(cos el · cos az, cos el · sin az, sin el)` in the stage frame: an
/// elevation of 90° is straight above the sample.
///
/// ```
/// use glam::DVec3;
/// use rig_core::units::StageAngles;
///
/// let lamp = StageAngles { azimuth_deg: 90.0, elevation_deg: 60.0 };
/// let to_light = lamp.to_light();
/// assert!(to_light.distance(DVec3::new(0.0, 0.5, 0.75f64.sqrt())) < 1e-12);
/// assert!((StageAngles::from_direction(to_light).elevation_deg - 60.0).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageAngles {
    /// Rotation about the stage's +z axis, degrees.
    pub azimuth_deg: f64,
    /// Height above the stage's xy plane, degrees.
    pub elevation_deg: f64,
}

impl StageAngles {
    /// An azimuth and an elevation, degrees.
    pub const fn new(azimuth_deg: f64, elevation_deg: f64) -> Self {
        Self {
            azimuth_deg,
            elevation_deg,
        }
    }

    /// Unit vector from the sample towards the lamp, stage frame.
    pub fn to_light(self) -> glam::DVec3 {
        let (sin_az, cos_az) = self.azimuth_deg.to_radians().sin_cos();
        let (sin_el, cos_el) = self.elevation_deg.to_radians().sin_cos();
        glam::DVec3::new(cos_el * cos_az, cos_el * sin_az, sin_el)
    }

    /// The angles whose [`Self::to_light`] is `direction` (any length > 0).
    /// Straight up has azimuth 0.
    pub fn from_direction(direction: glam::DVec3) -> Self {
        let d = direction.normalize();
        let horizontal = d.x.hypot(d.y);
        let azimuth_deg = if horizontal < 1e-12 {
            0.0
        } else {
            d.y.atan2(d.x).to_degrees()
        };
        Self {
            azimuth_deg,
            elevation_deg: d.z.atan2(horizontal).to_degrees(),
        }
    }
}

impl std::fmt::Display for StageAngles {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            out,
            "azimuth {:.3}°, elevation {:.3}°",
            self.azimuth_deg, self.elevation_deg
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stage_angles_and_directions_are_inverse() {
        for (azimuth_deg, elevation_deg) in
            [(0.0, 0.0), (35.0, 60.0), (-120.0, 12.5), (180.0, 89.0)]
        {
            let back = StageAngles::from_direction(
                StageAngles::new(azimuth_deg, elevation_deg).to_light(),
            );
            assert!(
                (back.azimuth_deg - azimuth_deg).abs() < 1e-9,
                "azimuth {azimuth_deg}"
            );
            assert!(
                (back.elevation_deg - elevation_deg).abs() < 1e-9,
                "elevation {elevation_deg}"
            );
        }
    }

    #[test]
    fn parts_have_two_digits() {
        let shown = [0.0034, 0.034, 0.34, 1.0, 0.0].map(percent);
        assert_eq!(shown, ["0.34%", "3.4%", "34%", "100%", "0.00%"]);
    }

    #[test]
    fn people_read_sizes_and_times() {
        for (bytes, shown) in [
            (0, "0 B"),
            (320, "320 B"),
            (999_600, "1.0 MB"),
            (9_700_000, "9.7 MB"),
            (69_314_000_000, "69 GB"),
            (1_341_400_000, "1.3 GB"),
            (u64::MAX, "18446744074 GB"),
        ] {
            assert_eq!(size(bytes), shown);
        }
        for (seconds, shown) in [
            (1e-4, "0.1 ms"),
            (0.00707, "7.07 ms"),
            (0.5, "500 ms"),
            (2.0, "2 s"),
            (0.0, "0 ms"),
        ] {
            assert_eq!(Seconds(seconds).to_string(), shown);
        }
    }

    #[test]
    fn straight_up_is_plus_z() {
        let up = StageAngles::new(77.0, 90.0).to_light();
        assert!((up - glam::DVec3::Z).length() < 1e-12);
    }
}
