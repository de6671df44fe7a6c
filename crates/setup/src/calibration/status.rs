//! The records in force of a rig, at a glance: values, age, and what speaks against them.

use jiff::Timestamp;
use serde::Serialize;

use super::camera::{CameraValues, LensModel};
use super::directions::DirectionsValues;
use super::fitness::Concern;
use super::glare::GlareValues;
use super::pose::PoseValues;
use super::record::{
    FlatValues, Kind, LampValues, LightsValues, Measured, ResponseValues, ScaleValues,
    SensorValues, Values,
};
use super::slanted_edge::FocusValues;
use super::{Library, Loaded};
use crate::config::RigConfig;

/// Whether a kind of record can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// It can be used.
    Good,
    /// It can be used, but something speaks against it.
    Doubtful,
    /// A capture refuses it, or it cannot be read.
    Refused,
    /// There is none.
    Missing,
}

/// The record in force of one kind.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct RecordStatus {
    pub kind: Kind,
    /// Whether it can be used.
    pub state: State,
    pub id: Option<String>,
    /// When it was measured, UTC, RFC 3339.
    pub date: Option<String>,
    /// Its age, days; none of a simulated rig's.
    pub age_days: Option<f64>,
    /// The gain to which it belongs.
    pub gain: Option<f64>,
    /// The device on which it was measured.
    pub device_serial: Option<String>,
    /// How it was measured.
    pub method: Option<String>,
    /// The main values with their standard uncertainties, or what holds without a record.
    pub summary: String,
    pub concerns: Vec<String>,
}

impl RecordStatus {
    /// Whether the calibration should be made.
    pub fn needs_calibration(&self) -> bool {
        use Kind::*;
        match self.state {
            State::Good => false,
            State::Doubtful | State::Refused => true,
            // A linear camera has no response; lens, lights and pose may be in the rig file.
            State::Missing => !matches!(
                self.kind,
                Response | Lights | Directions | Pose | Focus | Camera | Glare
            ),
        }
    }
}

/// The status of every kind of record of a rig, at this time.
pub fn status(rig: &RigConfig, library: &Library, now: Timestamp) -> Vec<RecordStatus> {
    let pins = &rig.calibration;
    let of = Reader { rig, library, now };
    vec![
        of.kind(&pins.sensor, of_sensor),
        of.kind(&pins.flat, of_flat),
        of.kind(&pins.scale, of_scale),
        of.kind(&pins.lights, of_lights),
        of.kind(&pins.directions, of_directions),
        of.kind(&None, of_lamp),
        of.kind(&pins.focus, of_focus),
        of.kind(&pins.pose, of_pose),
        of.kind(&None, of_response),
        of.kind(&pins.camera, of_camera),
        of.kind(&pins.glare, of_glare),
    ]
}

struct Reader<'a> {
    rig: &'a RigConfig,
    library: &'a Library,
    now: Timestamp,
}

impl Reader<'_> {
    fn kind<V: Values>(
        &self,
        pinned: &Option<String>,
        summary: impl Fn(&V) -> String,
    ) -> RecordStatus {
        let mut status = RecordStatus {
            kind: V::KIND,
            state: State::Missing,
            id: None,
            date: None,
            age_days: None,
            gain: None,
            device_serial: None,
            method: None,
            summary: without(V::KIND).to_owned(),
            concerns: Vec::new(),
        };
        let gain = self.rig.camera.gain;
        let loaded: Loaded<V> = match self.library.load_for(pinned.as_deref(), gain) {
            Ok(Some(loaded)) => loaded,
            Ok(None) => return status,
            Err(error) => {
                status.state = State::Refused;
                status.summary = "cannot be read".to_owned();
                status.concerns.push(error.to_string());
                return status;
            }
        };
        let simulated = self.rig.is_simulated();
        let serial = self.rig.camera.serial.as_deref().unwrap_or_default();
        let concerns = loaded.concerns_on(simulated, serial, &self.rig.camera, self.now);
        let refused = concerns.iter().any(|c| matches!(c, Concern::Other(_)));
        status.state = match (concerns.is_empty(), refused) {
            (true, _) => State::Good,
            (false, true) => State::Refused,
            (false, false) => State::Doubtful,
        };
        status.age_days = (!simulated).then(|| loaded.age_days(self.now));
        status.concerns = concerns.iter().map(Concern::to_string).collect();
        let record = loaded.record;
        status.summary = format!("{} ({})", summary(&record.values), record.id);
        status.gain = record.settings.gain;
        status.id = Some(record.id);
        status.date = Some(record.date);
        status.device_serial = Some(record.device_serial);
        status.method = Some(record.method);
        status
    }
}

/// What holds without a record of this kind.
fn without(kind: Kind) -> &'static str {
    match kind {
        Kind::Sensor => "a capture needs it",
        Kind::Flat => "every pixel counts as equally sensitive",
        Kind::Scale => "radiances are relative",
        Kind::Lights => "the rig file's irradiance is used",
        Kind::Directions => "the rig file's light directions are used",
        Kind::Lamp => "the lamp's warm-up time is unknown",
        Kind::Pose => "the rig file's pose is used",
        Kind::Focus => "the rig file's point spread, focus and aperture are used",
        Kind::Camera => "the rig file's lens is used",
        Kind::Response => "counts are taken as proportional to light",
        Kind::Glare => "the lens is taken to scatter no light",
    }
}

fn of_sensor(v: &SensorValues) -> String {
    format!(
        "gain {} DN/e⁻, read noise {} e⁻, full well {} e⁻, linear within {:.2}%, {} hot pixels",
        v.gain_dn_per_e,
        v.read_noise_e,
        v.full_well_e,
        100.0 * v.linearity_error,
        v.hot_pixels.len()
    )
}

fn of_flat(v: &FlatValues) -> String {
    format!("response of each pixel known to {:.3}%", 100.0 * v.std)
}

fn of_scale(v: &ScaleValues) -> String {
    let relative = 100.0 * v.responsivity_e_s.std / v.responsivity_e_s.value;
    format!(
        "{:.4e} e⁻/s per W/(m² sr), known to {relative:.2}%",
        v.responsivity_e_s.value
    )
}

fn of_lights(v: &LightsValues) -> String {
    let [red, green, blue] = v.irradiance_w_m2;
    format!("{red}, {green}, {blue} W/m²")
}

fn of_directions(v: &DirectionsValues) -> String {
    let distance = match v.distance_mm {
        Some(distance) => format!(", {} mm away", distance),
        None => String::new(),
    };
    format!(
        "{} lights, each to ±{:.3}° and in common to ±{:.3}°{distance}",
        v.lights.len(),
        v.light_std_deg,
        v.common_std_deg
    )
}

fn of_lamp(v: &LampValues) -> String {
    format!(
        "warm after {:.0} s, drift {} % per hour, steady from {}",
        v.warm_up_time_s,
        Measured::new(100.0 * v.drift_per_hour.value, 100.0 * v.drift_per_hour.std),
        v.steady_from_s
            .map_or("no measured exposure on".to_owned(), |s| format!("{s} s"))
    )
}

fn of_focus(v: &FocusValues) -> String {
    let lens = v.lens.map_or(String::new(), |lens| {
        let (focus, aperture) = (lens.focus_mm, lens.object_na);
        format!(", sharp at {focus} mm, aperture {aperture}")
    });
    format!("point spread {} px{lens}", v.point_spread_px)
}

fn of_camera(v: &CameraValues) -> String {
    let unit = match v.model {
        LensModel::Perspective => "focal length",
        LensModel::Orthographic => "pixels per mm",
    };
    let number = |value: f64, names: [&str; 2]| match names.iter().find_map(|n| v.std(n)) {
        Some(std) => Measured { value, std }.to_string(),
        None => format!("{value:.3}"),
    };
    format!(
        "{unit} {}, {}, {} views, corners within {:.3} px{}",
        number(v.scale[0], ["fx", "mx"]),
        number(v.scale[1], ["fy", "my"]),
        v.views,
        v.residual_px,
        if v.pose.is_some() {
            ", with its pose"
        } else {
            ""
        }
    )
}

fn of_pose(v: &PoseValues) -> String {
    let std = v.deviations();
    let three = |values: [f64; 3], from: usize| {
        let pairs = (0..3).map(|i| {
            let std = std[from + i];
            Measured::new(values[i], std).to_string()
        });
        pairs.collect::<Vec<_>>().join(", ")
    };
    format!(
        "turned by {} deg, moved by {} mm, edges within {:.2} px",
        three(v.rotation_deg, 0),
        three(v.translation_mm, 3),
        v.residual_px
    )
}

fn of_glare(v: &GlareValues) -> String {
    let percent = |m: Measured| Measured::new(100.0 * m.value, 100.0 * m.std);
    format!(
        "{} % of the light evenly, {} % in a halo of {:.0}% of the diagonal",
        percent(v.uniform),
        percent(v.halo),
        100.0 * v.halo_width
    )
}

fn of_response(v: &ResponseValues) -> String {
    format!("curves of {} channels", v.channels.len())
}
