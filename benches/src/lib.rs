//! What the benchmarks share: the measured scenes, rays of bounces, the clock, and Embree.

pub mod clock;
pub mod embree;
pub mod rays;
pub mod scenes;
pub mod strategies;
