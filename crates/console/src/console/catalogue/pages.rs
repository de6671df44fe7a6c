//! What pages show of a folder's sessions, with the pictures that were made of them.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use super::served::Served;
use crate::catalogue::{Catalogue, Stamp, stamp};
use crate::fault::Advisor;

/// Pictures that are kept after they were made.
const KEPT_PICTURES: usize = 64;

/// The sessions of one folder for pages.
#[derive(Debug)]
pub struct SessionPages {
    catalogue: Catalogue,
    pictures: Mutex<VecDeque<KeptPicture>>,
    /// Comparisons are made one at a time.
    pub(super) comparing: Mutex<()>,
}

/// A picture that was made of a session's images.
#[derive(Debug)]
struct KeptPicture {
    session: String,
    file: String,
    stamp: Stamp,
    served: Served,
}

impl SessionPages {
    /// Of the sessions in this folder, which need not exist yet.
    pub fn new(folder: impl Into<PathBuf>, advisor: Advisor) -> Self {
        Self {
            catalogue: Catalogue::new(folder, advisor),
            pictures: Mutex::default(),
            comparing: Mutex::default(),
        }
    }

    /// Their list.
    pub fn catalogue(&self) -> &Catalogue {
        &self.catalogue
    }

    /// A file that was made of this session's images in its present state, or else what
    /// `make` makes.
    ///
    /// # Errors
    /// Those of `make`.
    pub(super) fn kept_or<E>(
        &self,
        session: &str,
        file: &str,
        make: impl FnOnce() -> Result<Served, E>,
    ) -> Result<Served, E> {
        let stamp = stamp(&self.catalogue.folder().join(session));
        // Held while it is made: pictures are made one at a time.
        let mut pictures = (self.pictures.lock()).unwrap_or_else(PoisonError::into_inner);
        let is_it = |kept: &&KeptPicture| {
            kept.session == session && kept.file == file && kept.stamp == stamp
        };
        if let Some(kept) = pictures.iter().find(is_it) {
            return Ok(kept.served.clone());
        }
        let served = make()?;
        if pictures.len() >= KEPT_PICTURES {
            pictures.pop_front();
        }
        pictures.push_back(KeptPicture {
            session: session.to_owned(),
            file: file.to_owned(),
            stamp,
            served: served.clone(),
        });
        Ok(served)
    }
}
