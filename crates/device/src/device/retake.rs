//! Frames that came wrong or not at all, and taking them again.

use serde::{Deserialize, Serialize};

use super::{Camera, DeviceError, FrameKey, RawFrame};

/// So many frames in a row may be wrong before a camera is given up.
pub const MAX_WRONG: u32 = 4;
/// So many waits in a row may end without a frame; each costs a whole time-out.
pub const MAX_MISSING: u32 = 2;

/// Why a frame is not the one that was requested.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum FrameFault {
    #[error("the driver marks it as damaged")]
    Damaged,
    /// Its bytes are no image of the format.
    #[error("{0}")]
    Undecodable(String),
    /// Its values are not the sensor's counts: developed, compressed or interpolated.
    #[error("{name} holds no raw counts: it is {kind}")]
    NotRaw { name: String, kind: String },
    /// Another size than the camera's.
    #[error(
        "it has {counts} counts in {} × {} pixels instead of {} × {}",
        found[0], found[1], expected[0], expected[1]
    )]
    Size {
        /// Width and height as the frame says.
        found: [u32; 2],
        counts: usize,
        /// Width and height of the camera.
        expected: [u32; 2],
    },
    #[error("the camera reports {what} {is} for it, and {wanted} was requested")]
    Settings {
        /// `exposure` or `gain`.
        what: &'static str,
        is: String,
        /// As requested, with what it may differ by.
        wanted: String,
    },
    /// Packets of it did not arrive, also when they were requested again.
    #[error("packets of it were lost on the network")]
    LostPackets,
    /// It began before it was requested, so that lamp and settings may be older.
    #[error("it began before it was requested")]
    Late,
}

impl FrameFault {
    /// Whether the next frame may be right: a file of another format is what the camera's
    /// program makes of every frame.
    pub fn may_pass(&self) -> bool {
        !matches!(self, Self::NotRaw { .. })
    }
}

/// What went wrong before a frame was right.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Retakes {
    /// Frames that the camera's numbers show to be lost.
    #[serde(skip_serializing_if = "is_zero")]
    pub dropped: u32,
    /// Frames that were marked as damaged or could not be read.
    #[serde(skip_serializing_if = "is_zero")]
    pub damaged: u32,
    /// Frames of another size.
    #[serde(skip_serializing_if = "is_zero")]
    pub wrong_size: u32,
    /// Frames that had begun before they were requested.
    #[serde(skip_serializing_if = "is_zero")]
    pub late: u32,
    /// Waits that ended without a frame.
    #[serde(skip_serializing_if = "is_zero")]
    pub missing: u32,
    /// Settings that the camera confirmed and the images contradicted, or that it reported
    /// as others with the frame.
    #[serde(skip_serializing_if = "is_zero")]
    pub exposure_ignored: u32,
    /// Times that the camera was gone and came back.
    #[serde(skip_serializing_if = "is_zero")]
    pub reconnected: u32,
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Retakes {
    /// Whether nothing went wrong.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Adds what went wrong elsewhere.
    pub fn add(&mut self, other: Self) {
        self.dropped += other.dropped;
        self.damaged += other.damaged;
        self.wrong_size += other.wrong_size;
        self.late += other.late;
        self.missing += other.missing;
        self.exposure_ignored += other.exposure_ignored;
        self.reconnected += other.reconnected;
    }

    /// How often something went wrong.
    pub fn total(&self) -> u32 {
        let frames = self.dropped + self.damaged + self.wrong_size + self.late;
        frames + self.missing + self.exposure_ignored + self.reconnected
    }

    fn count(&mut self, fault: &FrameFault) {
        match fault {
            FrameFault::Damaged
            | FrameFault::Undecodable(_)
            | FrameFault::NotRaw { .. }
            | FrameFault::LostPackets => self.damaged += 1,
            FrameFault::Size { .. } => self.wrong_size += 1,
            FrameFault::Settings { .. } => self.exposure_ignored += 1,
            FrameFault::Late => self.late += 1,
        }
    }
}

impl std::fmt::Display for Retakes {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let counts = [
            (self.dropped, "dropped"),
            (self.damaged, "damaged"),
            (self.wrong_size, "of the wrong size"),
            (self.late, "late"),
            (self.missing, "missing"),
            (self.exposure_ignored, "with an exposure that was ignored"),
            (self.reconnected, "after the camera had been gone"),
        ];
        let mut separator = "";
        for (count, what) in counts.iter().filter(|(count, _)| *count > 0) {
            write!(out, "{separator}{count} {what}")?;
            separator = ", ";
        }
        Ok(())
    }
}

/// The next frame that is right, and what went wrong before. `retakes` also
/// counts where no frame is right in the end.
///
/// # Errors
/// The camera's last one, after [`MAX_WRONG`] wrong frames or [`MAX_MISSING`]
/// waits without any; every other at once, and so a fault that every frame will have.
pub fn grab_right(
    camera: &mut dyn Camera,
    key: FrameKey,
    retakes: &mut Retakes,
) -> Result<RawFrame, DeviceError> {
    let (mut wrong, mut missing) = (0, 0);
    let lost_before = camera.frames_lost();
    loop {
        let expected = camera.info().resolution_px;
        let error = match camera.grab(key) {
            Ok(frame) => match check_size(&frame, expected) {
                Ok(()) => {
                    let lost = camera.frames_lost().saturating_sub(lost_before);
                    retakes.dropped += u32::try_from(lost).unwrap_or(u32::MAX);
                    return Ok(frame);
                }
                Err(fault) => DeviceError::BadFrame {
                    device: camera.info().model.clone(),
                    fault,
                },
            },
            Err(error) => error,
        };
        match &error {
            DeviceError::BadFrame { fault, .. } if fault.may_pass() => {
                retakes.count(fault);
                wrong += 1;
            }
            DeviceError::NoReply { .. } => {
                retakes.missing += 1;
                missing += 1;
            }
            _ => return Err(error),
        }
        tracing::warn!("{error}");
        if wrong >= MAX_WRONG || missing >= MAX_MISSING {
            return Err(error);
        }
    }
}

fn check_size(frame: &RawFrame, expected: [u32; 2]) -> Result<(), FrameFault> {
    let found = [frame.width, frame.height];
    let counts = frame.counts.len();
    if found == expected && counts == expected[0] as usize * expected[1] as usize {
        return Ok(());
    }
    Err(FrameFault::Size {
        found,
        counts,
        expected,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{CameraInfo, CameraSettings, FrameKind, Mosaic};
    use crate::units::Seconds;

    type Answer = fn() -> Result<RawFrame, DeviceError>;

    /// Answers from a list, then with whole frames; the third one of a list has
    /// lost two frames.
    struct Scripted(CameraInfo, Vec<Answer>, u64);

    impl Camera for Scripted {
        fn info(&self) -> &CameraInfo {
            &self.0
        }
        fn configure(&mut self, asked: CameraSettings) -> Result<CameraSettings, DeviceError> {
            Ok(asked)
        }
        fn set_shutter(&mut self, _: bool) -> Result<bool, DeviceError> {
            Ok(false)
        }
        fn grab(&mut self, _: FrameKey) -> Result<RawFrame, DeviceError> {
            self.2 += 1;
            self.1
                .pop()
                .map_or_else(|| Ok(frame([2, 2], 4)), |next| next())
        }
        fn frames_lost(&self) -> u64 {
            if self.2 < 3 { 5 } else { 7 }
        }
    }

    fn frame([width, height]: [u32; 2], counts: usize) -> RawFrame {
        RawFrame::new(width, height, vec![7; counts])
    }

    fn bad(fault: FrameFault) -> Result<RawFrame, DeviceError> {
        let device = "camera".to_owned();
        Err(DeviceError::BadFrame { device, fault })
    }

    fn no_reply() -> Result<RawFrame, DeviceError> {
        Err(DeviceError::NoReply {
            device: "camera".to_owned(),
            timeout: Seconds(1.0),
            sent: "a request".to_owned(),
        })
    }

    fn run(answers: &[Answer]) -> (Result<RawFrame, DeviceError>, Retakes, usize) {
        let info = CameraInfo {
            driver: "scripted".to_owned(),
            model: "camera".to_owned(),
            serial: String::new(),
            resolution_px: [2, 2],
            bit_depth: 8,
            mosaic: Mosaic::None,
            exposure_range: [Seconds(1e-3), Seconds(1.0)],
            exposure_step: Seconds(1e-3),
        };
        let mut camera = Scripted(info, answers.iter().rev().copied().collect(), 0);
        let key = FrameKey::new(0, 0, 0, FrameKind::Light);
        let mut retakes = Retakes::default();
        let result = grab_right(&mut camera, key, &mut retakes);
        (result, retakes, camera.1.len())
    }

    #[test]
    fn each_fault_is_counted_and_the_frame_taken_again() {
        let (result, retakes, _) = run(&[
            || bad(FrameFault::Damaged),
            || Ok(frame([2, 1], 2)),
            no_reply,
            || bad(FrameFault::Late),
        ]);
        assert_eq!(result.unwrap().counts, [7; 4]);
        let expected = Retakes {
            dropped: 2,
            damaged: 1,
            wrong_size: 1,
            late: 1,
            missing: 1,
            ..Retakes::default()
        };
        assert_eq!(retakes, expected);
        assert_eq!(
            retakes.to_string(),
            "2 dropped, 1 damaged, 1 of the wrong size, 1 late, 1 missing"
        );
        let kept: Retakes =
            serde_json::from_str(&serde_json::to_string(&retakes).unwrap()).unwrap();
        assert_eq!(kept, retakes);
        assert!(run(&[]).1.is_none());
    }

    #[test]
    fn a_camera_that_stays_wrong_is_given_up() {
        let short: Answer = || Ok(frame([2, 2], 3));
        let (result, retakes, left) = run(&[short; 9]);
        assert!(matches!(result, Err(DeviceError::BadFrame { .. })));
        assert_eq!(
            (retakes.wrong_size, left),
            (MAX_WRONG, 9 - MAX_WRONG as usize)
        );
        let (result, retakes, left) = run(&[no_reply as Answer; 9]);
        assert!(matches!(result, Err(DeviceError::NoReply { .. })));
        assert_eq!(
            (retakes.missing, left),
            (MAX_MISSING, 9 - MAX_MISSING as usize)
        );
        let gone: Answer = || {
            Err(DeviceError::Disconnected {
                device: "camera".to_owned(),
            })
        };
        let other_format: Answer = || {
            bad(FrameFault::NotRaw {
                name: "frame.tif".to_owned(),
                kind: "a JPEG file".to_owned(),
            })
        };
        let (result, retakes, left) = run(&[other_format, no_reply]);
        assert!(matches!(result, Err(DeviceError::BadFrame { .. })));
        assert!(retakes.is_none() && left == 1);
        let (result, retakes, left) = run(&[gone, no_reply]);
        assert!(matches!(result, Err(DeviceError::Disconnected { .. })));
        assert!(retakes.is_none() && left == 1);
    }
}
