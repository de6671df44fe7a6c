//! From raw counts to radiance: what a sensor's noise is, which exposures to
//! take, and how a bracket becomes one radiance with its variance.

pub mod adopted_exposures;
pub mod agreement;
pub mod bracket_doubts;
pub mod bracket_files;
pub mod bracket_merge;
pub mod bracket_table;
mod comparison;
pub mod exposure;
pub mod filter_order;
pub mod frame_exposure;
pub mod frame_file;
pub mod framing;
pub mod linearity;
pub mod merge;
pub mod mosaic;
mod neighbourhood;
pub mod plane;
mod rate;
pub mod response;
pub mod sensor;
pub mod single_frames;
pub mod stack;
mod written_time;
