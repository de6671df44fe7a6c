//! A file of a session for a page, and why there is none.

use std::sync::Arc;

use crate::beneath::BeneathError;
use crate::brdf::BrdfError;
use crate::catalogue::row::EntryError;
use crate::radiance_image::exr::ExrError;
use crate::session::SessionError;

/// How a file is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// As a page of its own without rights: no scripts, nothing from elsewhere.
    Page,
    /// As part of the page.
    Inline,
    /// As a file to be kept.
    Download,
}

/// A file for a page.
#[derive(Clone, Debug)]
pub struct Served {
    /// Media type.
    pub kind: &'static str,
    /// How it is to be shown.
    pub shown: Shown,
    /// The content.
    pub bytes: Arc<Vec<u8>>,
}

/// Why a page does not get a file; facts only.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// No file of this name is for pages, whether there is one or not.
    #[error("{file:?} is no file of a session that can be shown")]
    NotShown {
        /// As it was requested.
        file: String,
    },
    /// The file.
    #[error(transparent)]
    File(#[from] BeneathError),
    /// Its session.
    #[error(transparent)]
    Entry(#[from] EntryError),
    /// The image that a picture is made of.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Likewise.
    #[error(transparent)]
    Image(#[from] ExrError),
    /// The fitted material.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// The fit has no such image.
    #[error("the session has no {file}")]
    NoPicture {
        /// As it was requested.
        file: String,
    },
    /// The encoder.
    #[error("{file}: {source}")]
    Encode {
        /// The picture.
        file: String,
        /// Its error.
        source: image::ImageError,
    },
}

impl FileError {
    /// Whether there is nothing to be shown, as opposed to something damaged.
    pub fn is_missing(&self) -> bool {
        match self {
            Self::NotShown { .. } | Self::NoPicture { .. } => true,
            // Links are as good as nothing: a page learns nothing about them.
            Self::File(error) | Self::Entry(EntryError::File(error)) => {
                error.is_missing()
                    || matches!(error, BeneathError::Link { .. } | BeneathError::Path { .. })
            }
            Self::Entry(EntryError::Foreign { .. }) => true,
            _ => false,
        }
    }
}
