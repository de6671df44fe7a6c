//! A camera that puts its files into a folder, as a tethering program does.
//!
//! What is wanted stands in a request file for whoever releases the shutter, a
//! person or a script; the next new file that has become whole is the frame.

use std::collections::BTreeMap;
use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::retake::FrameFault;
use super::{
    Camera, CameraInfo, CameraSettings, DeviceError, FrameKey, RawFrame, image_file, outside,
};
use crate::units::Seconds;

/// The folder and what its files hold.
#[derive(Clone, Debug, PartialEq)]
pub struct FolderConfig {
    /// Where the files appear.
    pub folder: PathBuf,
    /// The camera as the rig file describes it: nobody can be asked.
    pub info: CameraInfo,
    /// How long a file may take beyond the exposure.
    pub timeout: Seconds,
    /// A file that has not changed for so long is taken to be whole.
    pub stable: Seconds,
}

/// A folder as a camera.
#[derive(Clone, Debug)]
pub struct FolderCamera {
    config: FolderConfig,
    settings: Option<CameraSettings>,
    requests: u64,
}

/// The file that says what is wanted.
pub const REQUEST_FILE: &str = "rig-request.json";
/// How often the folder is looked at.
const POLL: Duration = Duration::from_millis(50);
/// What tells one state of a file from another: length, time, and number on its file
/// system, because the times of some go in steps of two seconds.
type State = (u64, Option<SystemTime>, u64);

impl FolderCamera {
    /// A camera of this configuration.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn new(config: FolderConfig) -> Result<Self, DeviceError> {
        let camera = Self {
            config,
            settings: None,
            requests: 0,
        };
        camera.files()?;
        Ok(camera)
    }

    fn device(&self) -> String {
        self.config.folder.display().to_string()
    }

    fn io_error(&self, source: std::io::Error) -> DeviceError {
        let device = self.device();
        match source.kind() {
            std::io::ErrorKind::NotFound => DeviceError::NotFound { device },
            std::io::ErrorKind::PermissionDenied => DeviceError::PermissionDenied { device },
            _ => DeviceError::Io { device, source },
        }
    }

    /// The image files of the folder.
    fn files(&self) -> Result<BTreeMap<PathBuf, State>, DeviceError> {
        self.files_that(image_file::has_raw_ending)
    }

    fn files_that(
        &self,
        is_wanted: fn(&Path) -> bool,
    ) -> Result<BTreeMap<PathBuf, State>, DeviceError> {
        let entries = std::fs::read_dir(&self.config.folder).map_err(|e| self.io_error(e))?;
        let state = |path: PathBuf| {
            // A file that is gone again is no file.
            let meta = std::fs::metadata(&path)
                .ok()
                .filter(|meta| meta.is_file())?;
            Some((path, (meta.len(), meta.modified().ok(), meta.ino())))
        };
        Ok(entries
            .flatten()
            .map(|entry| entry.path())
            .filter(|path| is_wanted(path))
            .filter_map(state)
            .collect())
    }

    /// Says what is wanted: whole at any moment, by renaming.
    fn request(&self, settings: CameraSettings) -> std::io::Result<()> {
        let request = serde_json::json!({
            "number": self.requests,
            "exposure_s": settings.exposure.0,
            "gain": settings.gain,
        });
        // Other programs, perhaps of other users, read it.
        let file = tempfile::Builder::new()
            .permissions(Permissions::from_mode(0o666))
            .tempfile_in(&self.config.folder)?;
        std::fs::write(file.path(), format!("{request}\n"))?;
        file.persist(self.config.folder.join(REQUEST_FILE))?;
        Ok(())
    }

    fn read(&self, path: &Path) -> Result<RawFrame, FrameFault> {
        image_file::read(
            path,
            self.config.info.resolution_px,
            self.config.info.bit_depth,
        )
    }
}

impl Camera for FolderCamera {
    fn info(&self) -> &CameraInfo {
        &self.config.info
    }

    /// Nothing can be read back, so that only the images show whether the
    /// settings were applied.
    fn configure(&mut self, requested: CameraSettings) -> Result<CameraSettings, DeviceError> {
        let applied = CameraSettings {
            exposure: super::nearest_exposure(&self.config.info, requested.exposure),
            gain: requested.gain,
        };
        self.settings = Some(applied);
        Ok(applied)
    }

    fn set_shutter(&mut self, _open: bool) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn grab(&mut self, _key: FrameKey) -> Result<RawFrame, DeviceError> {
        let settings = self.settings.ok_or_else(|| DeviceError::Refused {
            device: self.device(),
            command: "a frame".to_owned(),
            reason: "it is not configured".to_owned(),
        })?;
        self.requests += 1;
        let timeout = Seconds(settings.exposure.0 + self.config.timeout.0);
        let device = self.device();
        let camera = self.clone();
        let sent = "a request for a frame; its files cannot be read";
        outside::frame_within(device, timeout, sent, move || {
            camera.next_file(settings, timeout)
        })
    }

    fn longest_frame(&self, exposure: Seconds) -> Seconds {
        Seconds(exposure.0 + self.config.timeout.0 + 2.0 * outside::HANDOVER.as_secs_f64())
    }
}

impl FolderCamera {
    /// Asks for a frame and waits for its file.
    fn next_file(
        &self,
        settings: CameraSettings,
        timeout: Seconds,
    ) -> Result<RawFrame, DeviceError> {
        let deadline = Instant::now() + timeout.to_duration();
        let old = self.files()?;
        let old_others = self.files_that(image_file::has_other_ending)?;
        self.request(settings)
            .map_err(|error| self.io_error(error))?;
        let wanted = format!("a frame of {} at gain {}", settings.exposure, settings.gain);
        tracing::info!("waiting for {wanted} in {}", self.device());
        let mut seen: BTreeMap<PathBuf, (State, Instant)> = BTreeMap::new();
        let mut fault = None;
        while Instant::now() < deadline {
            for (path, state) in self.files()? {
                if old.get(&path) == Some(&state) {
                    continue;
                }
                let (last, since) = seen.entry(path.clone()).or_insert((state, Instant::now()));
                if *last != state {
                    (*last, *since) = (state, Instant::now());
                }
                if since.elapsed() < self.config.stable.to_duration() {
                    continue;
                }
                match self.read(&path) {
                    Ok(frame) => return Ok(frame),
                    // Its program may only have paused; looked at again when it changes
                    // or has stood still for as long once more.
                    Err(wrong) => {
                        fault = Some(wrong);
                        *since = Instant::now();
                    }
                }
            }
            std::thread::sleep(POLL);
        }
        let device = self.device();
        let others = self.files_that(image_file::has_other_ending)?;
        let is_new = |(path, state): &(&PathBuf, &State)| old_others.get(*path) != Some(*state);
        let other = others.iter().find(is_new).map(|(path, _)| {
            let ending = path.extension().unwrap_or_default().to_string_lossy();
            FrameFault::NotRaw {
                name: path
                    .file_name()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into(),
                kind: format!("a {} file", ending.to_uppercase()),
            }
        });
        Err(match fault.or(other) {
            Some(fault) => DeviceError::BadFrame { device, fault },
            None => DeviceError::NoReply {
                device,
                timeout,
                sent: wanted,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{FrameKind, Mosaic};
    use image::{ImageBuffer, Luma};
    use std::io::Write;

    const KEY: FrameKey = FrameKey {
        light: 0,
        exposure: 0,
        repeat: 0,
        kind: FrameKind::Light,
    };

    fn camera(folder: &Path, timeout_s: f64) -> FolderCamera {
        let mut camera = FolderCamera::new(FolderConfig {
            folder: folder.to_owned(),
            info: CameraInfo {
                driver: "folder".to_owned(),
                model: "folder".to_owned(),
                serial: String::new(),
                resolution_px: [4, 2],
                bit_depth: 12,
                mosaic: Mosaic::None,
                exposure_range: [Seconds(0.001), Seconds(30.0)],
                exposure_step: Seconds(0.001),
            },
            timeout: Seconds(timeout_s),
            stable: Seconds(0.2),
        })
        .unwrap();
        camera
            .configure(CameraSettings {
                exposure: Seconds(0.05),
                gain: 1.0,
            })
            .unwrap();
        camera
    }

    fn png(level: u16) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        ImageBuffer::from_pixel(4, 2, Luma([level]))
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    }

    /// Waits until the camera has asked, then acts in the folder.
    fn after_request(
        folder: &Path,
        act: impl FnOnce(&Path) + Send + 'static,
    ) -> std::thread::JoinHandle<()> {
        let folder = folder.to_owned();
        std::thread::spawn(move || {
            let deadline = Instant::now() + Duration::from_secs(60);
            while !folder.join(REQUEST_FILE).exists() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(5));
            }
            act(&folder);
        })
    }

    #[test]
    fn an_old_file_is_no_frame_and_half_a_file_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("old.png"), png(1)).unwrap();
        std::fs::write(folder.path().join("photo.jpg"), "not raw").unwrap();
        let mut camera = camera(folder.path(), 60.0);
        let writer = after_request(folder.path(), |folder| {
            let bytes = png(700);
            let mut file = std::fs::File::create(folder.join("new.png")).unwrap();
            file.write_all(&bytes[..bytes.len() / 2]).unwrap();
            file.sync_all().unwrap();
            // Longer than a file must stand still to be looked at.
            std::thread::sleep(Duration::from_millis(600));
            file.write_all(&bytes[bytes.len() / 2..]).unwrap();
        });
        let frame = camera.grab(KEY).unwrap();
        writer.join().unwrap();
        assert_eq!(frame.counts, [700; 8]);
        let request = std::fs::read_to_string(folder.path().join(REQUEST_FILE)).unwrap();
        let request: serde_json::Value = serde_json::from_str(&request).unwrap();
        assert_eq!(request["exposure_s"], 0.05);
        assert_eq!(request["number"], 1);
        // The files that another program makes here tell what the umask allows.
        let mode = |name: &str| {
            let path = folder.path().join(name);
            std::fs::metadata(path).unwrap().permissions().mode() & 0o777
        };
        assert_eq!(mode(REQUEST_FILE), mode("old.png"));
    }

    #[test]
    fn the_same_name_written_anew_is_a_new_frame() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("capture.png"), png(1)).unwrap();
        let mut camera = camera(folder.path(), 60.0);
        let writer = after_request(folder.path(), |folder| {
            std::fs::write(folder.join("part"), png(800)).unwrap();
            std::fs::rename(folder.join("part"), folder.join("capture.png")).unwrap();
        });
        assert_eq!(camera.grab(KEY).unwrap().counts, [800; 8]);
        writer.join().unwrap();
    }

    #[test]
    fn nothing_or_nothing_right_ends_at_the_time_out() {
        let folder = tempfile::tempdir().unwrap();
        let error = camera(folder.path(), 0.1).grab(KEY).unwrap_err();
        assert!(matches!(error, DeviceError::NoReply { .. }), "{error}");
        let other = tempfile::tempdir().unwrap();
        let writer = after_request(other.path(), |folder| {
            std::fs::write(folder.join("bad.tif"), "half").unwrap();
        });
        let error = camera(other.path(), 3.0).grab(KEY).unwrap_err();
        writer.join().unwrap();
        assert!(matches!(error, DeviceError::BadFrame { .. }), "{error}");
        let mut gone = camera(other.path(), 0.1);
        drop(other);
        assert!(matches!(gone.grab(KEY), Err(DeviceError::NotFound { .. })));
    }
}
