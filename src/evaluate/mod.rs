//! Estimates beside the truth, where the truth is known.

pub mod misalignment;
pub mod score_sheet;

pub use score_sheet::score;
