//! The bench as pages see it.

use serde::{Serialize, Serializer};

use crate::console::picture::levels::SensorLevels;
use crate::device::frame_figures::FrameFigures;
use crate::device::{CameraInfo, CameraSettings, LampChannel, LampState, StageActivity};
use crate::fault::Fault;
use crate::units::{Seconds, StageAngles};

/// What keeps the bench from taking another command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Busy {
    /// The devices are being opened.
    Connecting,
    /// The stage seeks its reference switches.
    Homing,
    /// The stage moves.
    Moving,
    /// The lamp is being switched.
    Switching,
    /// Motion and lamp are being stopped.
    Stopping,
    /// The devices are being closed.
    Disconnecting,
}

/// The topic `bench`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct State {
    /// The devices are open.
    pub connected: bool,
    /// What is under way.
    pub busy: Option<Busy>,
    /// What went wrong last; cleared by the next command.
    pub error: Option<Fault>,
    /// Why the bench cannot be connected now.
    pub lent_to: Option<&'static str>,
    /// The camera, while connected.
    pub camera: Option<CameraFacts>,
    /// As the camera applied them.
    pub settings: Option<AppliedSettings>,
    /// The stage, while connected; `None` where there is only a camera.
    pub stage: Option<StageFacts>,
    /// In how many seconds the lamp goes out without a sign of life of the controlling page.
    pub lamp_off_in_s: Option<f64>,
    /// Figures of a recent frame.
    pub view: Option<View>,
}

/// What the camera is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraFacts {
    /// Model as the device gives it.
    pub model: String,
    /// Serial number; empty if it has none.
    pub serial: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Significant bits of a count.
    pub bit_depth: u32,
    /// Shortest and longest exposure; NaN where it cannot be set.
    pub exposure_range_s: [Seconds; 2],
}

impl From<&CameraInfo> for CameraFacts {
    fn from(camera: &CameraInfo) -> Self {
        let [width, height] = camera.resolution_px;
        Self {
            model: camera.model.clone(),
            serial: camera.serial.clone(),
            width,
            height,
            bit_depth: camera.bit_depth,
            exposure_range_s: camera.exposure_range,
        }
    }
}

/// Settings of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AppliedSettings {
    /// NaN where the exposure cannot be set.
    pub exposure_s: Seconds,
    /// A factor.
    pub gain: f64,
}

impl From<CameraSettings> for AppliedSettings {
    fn from(settings: CameraSettings) -> Self {
        Self {
            exposure_s: settings.exposure,
            gain: settings.gain,
        }
    }
}

/// What the stage does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StageFacts {
    /// As it reports.
    pub activity: StageActivity,
    /// `None` while unknown.
    pub position: Option<StageAngles>,
    /// Where it is being moved.
    pub target: Option<StageAngles>,
    /// As it reports, or as it was switched last where it reports nothing.
    #[serde(serialize_with = "channel")]
    pub lamp: LampState,
    /// Whose word that is; `None` where nothing is known.
    pub lamp_word: Option<LampWord>,
}

/// How the state of a lamp is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LampWord {
    /// The stage reports it.
    Reported,
    /// The command was sent, and the stage reports nothing.
    Sent,
}

fn channel<S: Serializer>(lamp: &LampState, out: S) -> Result<S::Ok, S::Error> {
    match lamp {
        LampState::Off => out.serialize_none(),
        LampState::On(LampChannel(channel)) => out.serialize_u8(*channel),
    }
}

/// Figures of a frame, and of the stream that it is of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct View {
    /// The frame's running number since the bench was connected, from 1.
    pub number: u64,
    /// Frames per second, smoothed over about five.
    pub frames_per_s: f64,
    /// Of the frame.
    #[serde(flatten)]
    pub figures: FrameFigures,
    /// Of the sensor.
    #[serde(flatten)]
    pub levels: SensorLevels,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_get_channels_and_nothing_where_the_lamp_is_off() {
        let facts = |lamp| StageFacts {
            activity: StageActivity::Idle,
            position: None,
            target: None,
            lamp,
            lamp_word: Some(LampWord::Sent),
        };
        let json = |lamp| serde_json::to_value(facts(lamp)).unwrap();
        assert_eq!(json(LampState::Off)["lamp"], serde_json::Value::Null);
        assert_eq!(json(LampState::On(LampChannel(2)))["lamp"], 2);
        assert_eq!(json(LampState::Off)["lamp_word"], "sent");
        let state = State {
            busy: Some(Busy::Homing),
            settings: Some(AppliedSettings {
                exposure_s: Seconds(f64::NAN),
                gain: 1.0,
            }),
            ..State::default()
        };
        let json = serde_json::to_value(state).unwrap();
        assert_eq!(
            (&json["busy"], &json["connected"]),
            (&"homing".into(), &false.into())
        );
        assert_eq!(json["settings"]["exposure_s"], serde_json::Value::Null);
    }
}
