//! A camera that puts its files into a folder, as a tethering program does.
//!
//! What is wanted stands in a request file for whoever releases the shutter, a
//! person or a script; the next new file that has become whole is the frame.

use std::collections::BTreeMap;
use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use rustix::fs::{Access, access};

use super::described::{DescribedCamera, Driver, FrameSource, Taken, Wanted, find_none, io_error};
use super::retake::FrameFault;
use super::{CameraInfo, DeviceError, image_file};
use crate::units::Seconds;

/// `camera.driver = "folder"`.
pub const DRIVER: Driver = Driver {
    name: "folder",
    offer: "a folder into which another program writes frames",
    only_practice: false,
    key: "folder",
    allowed: "a path",
    is_path: true,
    accepts: |_| true,
    ready: |path| {
        let access = access(path, Access::READ_OK | Access::WRITE_OK);
        let name = path.to_string_lossy().into_owned();
        match access {
            Ok(()) => Ok(format!("files are awaited in {name}")),
            Err(error) => Err(io_error(name, error.into())),
        }
    },
    open: |path, description| {
        let folder = FrameFolder::new(PathBuf::from(path), FILE_IS_STABLE)?;
        let info = CameraInfo {
            model: folder.name(),
            ..description.info
        };
        Ok(Box::new(DescribedCamera::new(
            folder,
            info,
            description.timeout,
        )))
    },
    find: find_none,
};

/// A file that has not changed for so long is read.
const FILE_IS_STABLE: Seconds = Seconds(0.5);

/// A folder in which frames appear.
#[derive(Clone, Debug)]
pub struct FrameFolder {
    path: PathBuf,
    /// A file that has not changed for so long is taken to be whole.
    stable: Seconds,
}

/// The file that says what is wanted.
pub const REQUEST_FILE: &str = "rig-request.json";
/// How often the folder is looked at.
const POLL: Duration = Duration::from_millis(50);
/// What distinguishes one state of a file from another: length, time, and number on its file
/// system, because the times of some go in steps of two seconds.
type State = (u64, Option<SystemTime>, u64);

impl FrameFolder {
    /// A folder in which a file that has not changed for `stable` is taken to be whole.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn new(path: PathBuf, stable: Seconds) -> Result<Self, DeviceError> {
        let folder = Self { path, stable };
        folder.files()?;
        Ok(folder)
    }

    fn io_error(&self, source: std::io::Error) -> DeviceError {
        io_error(self.name(), source)
    }

    /// The image files of the folder.
    fn files(&self) -> Result<BTreeMap<PathBuf, State>, DeviceError> {
        self.files_that(image_file::has_raw_ending)
    }

    fn files_that(
        &self,
        is_wanted: fn(&Path) -> bool,
    ) -> Result<BTreeMap<PathBuf, State>, DeviceError> {
        let entries = std::fs::read_dir(&self.path).map_err(|e| self.io_error(e))?;
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

    /// Writes what is wanted: whole at any moment, by renaming.
    fn request(&self, wanted: &Wanted) -> std::io::Result<()> {
        let request = serde_json::json!({
            "number": wanted.number,
            "exposure_s": wanted.settings.exposure.0,
            "gain": wanted.settings.gain,
        });
        // Other programs, perhaps of other users, read it.
        let file = tempfile::Builder::new()
            .permissions(Permissions::from_mode(0o666))
            .tempfile_in(&self.path)?;
        std::fs::write(file.path(), format!("{request}\n"))?;
        file.persist(self.path.join(REQUEST_FILE))?;
        Ok(())
    }
}

impl FrameSource for FrameFolder {
    const SENT: &'static str = "a request for a frame; its files cannot be read";

    fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Writes the request and waits for the frame's file.
    fn take(&self, wanted: &Wanted) -> Result<Taken, DeviceError> {
        let old = self.files()?;
        let old_others = self.files_that(image_file::has_other_ending)?;
        self.request(wanted).map_err(|error| self.io_error(error))?;
        let settings = wanted.settings;
        let sent = format!("a frame of {} at gain {}", settings.exposure, settings.gain);
        tracing::info!("waiting for {sent} in {}", self.name());
        let mut seen: BTreeMap<PathBuf, (State, Instant)> = BTreeMap::new();
        let mut fault = None;
        while Instant::now() < wanted.deadline {
            for (path, state) in self.files()? {
                if old.get(&path) == Some(&state) {
                    continue;
                }
                let (last, since) = seen.entry(path.clone()).or_insert((state, Instant::now()));
                if *last != state {
                    (*last, *since) = (state, Instant::now());
                }
                if since.elapsed() < self.stable.to_duration() {
                    continue;
                }
                match wanted.read(&path) {
                    Ok(frame) => return Ok(frame.into()),
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
        let device = self.name();
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
                timeout: wanted.timeout,
                sent,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Camera;
    use crate::device::described::tests::{KEY, configured};
    use image::{ImageBuffer, Luma};
    use std::io::Write;

    fn camera(folder: &Path, timeout_s: f64) -> DescribedCamera<FrameFolder> {
        let folder = FrameFolder::new(folder.to_owned(), Seconds(0.2)).unwrap();
        configured(folder, timeout_s, 0.05, 1.0)
    }

    fn png(level: u16) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        ImageBuffer::from_pixel(4, 2, Luma([level]))
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    }

    /// Waits for the request, then acts in the folder.
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
