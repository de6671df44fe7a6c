//! The newest frame of the bench. It is encoded when a page requests it, once for all pages
//! that request the same.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{Counts, Marks, PictureError, jpeg};
use crate::device::RawFrame;

/// The newest frame, shared by the camera's thread, which replaces it, and the pages.
#[derive(Clone, Debug, Default)]
pub struct LiveFrame {
    newest: Arc<Mutex<Option<Newest>>>,
    encoded: Arc<Mutex<Vec<Encoded>>>,
}

#[derive(Clone, Debug)]
struct Newest {
    number: u64,
    frame: Arc<RawFrame>,
    counts: Counts,
}

/// A picture of a frame.
#[derive(Clone, Debug)]
pub struct LivePicture {
    /// The frame's running number since the bench was connected, from 1.
    pub number: u64,
    /// JPEG.
    pub jpeg: Arc<Vec<u8>>,
}

#[derive(Debug)]
struct Encoded {
    marks: Marks,
    picture: LivePicture,
}

impl LiveFrame {
    /// Replaces the frame; never waits for a page's picture to be encoded.
    pub fn show(&self, number: u64, frame: Arc<RawFrame>, counts: Counts) {
        *lock(&self.newest) = Some(Newest {
            number,
            frame,
            counts,
        });
    }

    /// Nothing is live any more.
    pub fn clear(&self) {
        *lock(&self.newest) = None;
        lock(&self.encoded).clear();
    }

    /// The newest frame, `None` where there is none.
    pub fn newest(&self) -> Option<(Arc<RawFrame>, Counts)> {
        let newest = lock(&self.newest);
        newest
            .as_ref()
            .map(|newest| (newest.frame.clone(), newest.counts))
    }

    /// The picture of the newest frame, `None` where there is none. Takes as long as the
    /// encoding, some 10 ms; requests of several pages wait for one another.
    ///
    /// # Errors
    /// The encoder's.
    pub fn picture(&self, marks: Marks) -> Result<Option<LivePicture>, PictureError> {
        // Held while encoding, so that no two pages encode the same frame.
        let mut encoded = lock(&self.encoded);
        let Some(newest) = lock(&self.newest).clone() else {
            return Ok(None);
        };
        encoded.retain(|encoded| encoded.picture.number == newest.number);
        if let Some(known) = encoded.iter().find(|encoded| encoded.marks == marks) {
            return Ok(Some(known.picture.clone()));
        }
        let picture = LivePicture {
            number: newest.number,
            jpeg: Arc::new(jpeg(&newest.frame, newest.counts, marks)?),
        };
        encoded.push(Encoded {
            marks,
            picture: picture.clone(),
        });
        Ok(Some(picture))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::radiometry::mosaic::Mosaic;

    #[test]
    fn the_newest_frame_is_encoded_once_per_kind_of_picture() {
        let live = LiveFrame::default();
        let marks = |peaking| Marks {
            limits: true,
            peaking,
        };
        assert!(live.picture(marks(false)).unwrap().is_none());
        let counts = Counts {
            bit_depth: 12,
            mosaic: Mosaic::None,
        };
        let frame = |dn| Arc::new(RawFrame::new(16, 16, vec![dn; 256]));
        live.show(1, frame(100), counts);
        let first = live.picture(marks(false)).unwrap().unwrap();
        let again = live.picture(marks(false)).unwrap().unwrap();
        assert!(Arc::ptr_eq(&first.jpeg, &again.jpeg));
        let other = live.picture(marks(true)).unwrap().unwrap();
        assert!(!Arc::ptr_eq(&first.jpeg, &other.jpeg));
        live.show(2, frame(3000), counts);
        let second = live.picture(marks(false)).unwrap().unwrap();
        assert_eq!((first.number, second.number), (1, 2));
        assert_ne!(first.jpeg, second.jpeg);
        assert_eq!(lock(&live.encoded).len(), 1, "older pictures were kept");
        live.clear();
        assert!(live.picture(marks(false)).unwrap().is_none());
    }
}
