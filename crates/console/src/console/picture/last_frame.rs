//! The newest frame of a running capture, read from the session's folder.
//!
//! The capture is another process: what it has brought to the disk is only read, the newest
//! frame alone, and at most twice per second, however many pages request it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::levels::SensorLevels;
use super::{Counts, Marks, PictureError, jpeg};
use crate::beneath::{self, BeneathError};
use crate::device::RawFrame;
use crate::radiometry::framing::{Framing, saturation_dn};
use crate::session::Sidecar;
use crate::session::frame::decode_png;

/// Between two frames that are read.
const AT_MOST_EVERY: Duration = Duration::from_millis(500);
/// A frame of 16-bit counts: 500 MP without compression.
const LARGEST_FRAME_BYTES: u64 = 1 << 30;
const LARGEST_SIDECAR_BYTES: u64 = 1 << 20;

/// Why a frame of a session has no picture.
#[derive(Debug, thiserror::Error)]
pub enum LastFrameError {
    /// One of its files.
    #[error(transparent)]
    File(#[from] BeneathError),
    /// A file that is not what a capture writes.
    #[error("{}: {fact}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        fact: String,
    },
    /// The encoder.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// A frame that was read.
#[derive(Clone, Debug)]
pub struct Shot {
    /// How many frames had been announced when this one was.
    pub number: u64,
    /// JPEG with the marks of saturation and zeros.
    pub jpeg: Arc<Vec<u8>>,
    /// Histogram and what else a page shows, as JSON.
    pub figures: Arc<serde_json::Value>,
}

/// Which frame is the newest, and the last one that was read. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct LastFrame {
    newest: Arc<Mutex<Newest>>,
    read: Arc<Mutex<Option<Read>>>,
}

#[derive(Clone, Debug, Default)]
struct Newest {
    number: u64,
    /// The session's folder and the PNG inside it.
    file: Option<(PathBuf, String)>,
}

#[derive(Clone, Debug)]
struct Read {
    at: Instant,
    number: u64,
    result: Result<Shot, Arc<LastFrameError>>,
}

impl LastFrame {
    /// A frame is on the disk: its session's folder, and its PNG relative to that. Nothing
    /// is read yet.
    pub fn stored(&self, session: &Path, file: &str) {
        let mut newest = lock(&self.newest);
        newest.number += 1;
        newest.file = Some((session.to_owned(), file.to_owned()));
    }

    /// The newest frame that is to be shown: the newest on the disk, or the one read before
    /// where that was a moment ago. `None` before the first frame. Takes as long as reading
    /// and encoding.
    ///
    /// # Errors
    /// A file that is gone or damaged; remembered as a picture is.
    pub fn look(&self) -> Result<Option<Shot>, Arc<LastFrameError>> {
        // Held while reading, so that several pages read once.
        let mut read = lock(&self.read);
        let newest = lock(&self.newest).clone();
        let Some((session, file)) = &newest.file else {
            return Ok(None);
        };
        let is_fresh =
            |read: &Read| read.number == newest.number || read.at.elapsed() < AT_MOST_EVERY;
        if let Some(known) = read.as_ref().filter(|read| is_fresh(read)) {
            return known.result.clone().map(Some);
        }
        let result = shot(session, file, newest.number).map_err(Arc::new);
        *read = Some(Read {
            at: Instant::now(),
            number: newest.number,
            result: result.clone(),
        });
        result.map(Some)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn shot(session: &Path, file: &str, number: u64) -> Result<Shot, LastFrameError> {
    let malformed = |name: &str, fact: String| LastFrameError::Malformed {
        path: session.join(name),
        fact,
    };
    // The counts and how they were taken.
    let png = beneath::read(session, file, LARGEST_FRAME_BYTES)?;
    let frame = decode_png(&png).map_err(|fact| malformed(file, fact))?;
    let name = format!("{}.toml", file.strip_suffix(".png").unwrap_or(file));
    let text = beneath::read(session, &name, LARGEST_SIDECAR_BYTES)?;
    let sidecar: Sidecar =
        toml::from_slice(&text).map_err(|error| malformed(&name, error.message().to_owned()))?;
    // What a page shows of them.
    let counts = Counts {
        bit_depth: sidecar.bit_depth,
        mosaic: sidecar.mosaic,
    };
    let marks = Marks {
        limits: true,
        peaking: false,
    };
    Ok(Shot {
        number,
        jpeg: Arc::new(jpeg(&frame, counts, marks)?),
        figures: Arc::new(figures(&frame, &sidecar)),
    })
}

/// As a live frame has them, with the black level of the sidecar.
fn figures(frame: &RawFrame, sidecar: &Sidecar) -> serde_json::Value {
    let width = frame.width as usize;
    let framing = Framing::of(&frame.counts, width, sidecar.bit_depth, sidecar.mosaic);
    let levels = SensorLevels {
        black_dn: Some(sidecar.black_level_dn),
        full_well_dn: None,
    };
    let mut figures = serde_json::json!({
        "width": frame.width,
        "height": frame.height,
        "bit_depth": sidecar.bit_depth,
        "saturation_dn": saturation_dn(sidecar.bit_depth),
        "exposure_s": sidecar.applied.exposure,
        "gain": sidecar.applied.gain,
    });
    for more in [serde_json::to_value(framing), serde_json::to_value(levels)] {
        if let (Some(all), Ok(serde_json::Value::Object(more))) = (figures.as_object_mut(), more) {
            all.extend(more);
        }
    }
    figures
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{CameraSettings, FrameKey, FrameKind, LampState};
    use crate::session::frame::encode_png;
    use crate::units::Seconds;

    fn store(root: &Path, stem: &str, dn: u16) {
        let frame = RawFrame::new(32, 24, vec![dn; 32 * 24]);
        let key = FrameKey::new(0, 0, 0, FrameKind::Light);
        let settings = CameraSettings::new(Seconds(0.02), 1.0);
        let sidecar = Sidecar::of_frame(key, LampState::Off, settings);
        std::fs::create_dir_all(root.join("raw")).unwrap();
        let path = root.join("raw").join(stem);
        std::fs::write(path.with_extension("png"), encode_png(&frame).unwrap()).unwrap();
        let text = toml::to_string(&sidecar).unwrap();
        std::fs::write(path.with_extension("toml"), text).unwrap();
    }

    #[test]
    fn the_newest_frame_is_read_once_and_not_at_once_again() {
        let folder = tempfile::tempdir().unwrap();
        let last = LastFrame::default();
        assert!(last.look().unwrap().is_none());
        store(folder.path(), "a", 1024);
        store(folder.path(), "b", 4095);
        last.stored(folder.path(), "raw/a.png");
        let first = last.look().unwrap().unwrap();
        assert_eq!(first.figures["mean_dn"], 1024.0);
        assert_eq!(first.figures["black_dn"], 64.0);
        assert_eq!(first.figures["exposure_s"], 0.02);
        // A moment later the older one still serves; then the newer one is read.
        last.stored(folder.path(), "raw/b.png");
        let soon = last.look().unwrap().unwrap();
        assert!(Arc::ptr_eq(&soon.jpeg, &first.jpeg) && soon.number == 1);
        lock(&last.read).as_mut().unwrap().at -= AT_MOST_EVERY;
        let later = last.look().unwrap().unwrap();
        assert_eq!(
            (later.number, &later.figures["clipped_pixels"]),
            (2, &768.into())
        );
    }

    #[test]
    fn a_damaged_frame_and_a_link_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        store(folder.path(), "a", 1024);
        std::fs::write(folder.path().join("raw/a.png"), b"half a PNG").unwrap();
        let last = LastFrame::default();
        last.stored(folder.path(), "raw/a.png");
        let error = last.look().unwrap_err().to_string();
        assert!(error.contains("raw/a.png"), "{error}");
        store(folder.path(), "b", 1024);
        std::os::unix::fs::symlink("b.png", folder.path().join("raw/c.png")).unwrap();
        let last = LastFrame::default();
        last.stored(folder.path(), "raw/c.png");
        let error = last.look().unwrap_err().to_string();
        assert!(error.contains("symbolic link"), "{error}");
    }
}
