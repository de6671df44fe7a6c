//! `rig` measures how a material reflects light: images of a concave sample of
//! known shape, taken under a few known lights, are explained by following
//! light through all its interreflections and fitting the weights of a BRDF
//! dictionary.
//!
//! The core (BRDFs, geometry, transport, the fit) is the crate [`rig_core`]; its modules
//! are re-exported here, so that one path serves both. The modules of this crate stand on
//! it; they are floors, and a floor imports only from floors below it (`tests/floors.rs`
//! checks that from the source):
//!
//! | floor | modules |
//! |---|---|
//! | 0 | [`interrupt`], [`checksum`], [`plot`] |
//! | 2 | [`radiometry`] |
//! | 3 | [`device`], [`simulation`] |
//! | 4 | [`benchmark`], [`scores`], [`config`], [`session`], [`calibration`] |
//! | 5 | [`capture`], [`evaluate`], [`material`], [`rendering`] |
//! | 6 | [`workflow`] |
//! | 7 | [`report`], [`export`] |
//! | 8 | [`cli`] |

pub use rig_core::{
    brdf, file_system, frames, geometry, inverse, least_squares, outside_file, outside_table,
    outside_text, progress, radiance_image, random, shown, statistics, transport, units,
    whole_file,
};

pub mod checksum;
pub mod interrupt;
#[cfg(feature = "figures")]
pub mod plot;

pub mod radiometry;

pub mod device;
pub mod simulation;

pub mod benchmark;
pub mod calibration;
pub mod config;
pub mod scores;
pub mod session;

pub mod capture;
#[cfg(feature = "experiments")]
pub mod evaluate;
pub mod material;
pub mod rendering;

pub mod workflow;

pub mod export;
#[cfg(feature = "reports")]
pub mod report;

pub mod cli;
