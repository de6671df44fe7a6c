//! Estimates beside the truth, where the truth is known.

pub mod intervals;
pub mod score_sheet;
pub mod small_bench;

pub use score_sheet::score;
