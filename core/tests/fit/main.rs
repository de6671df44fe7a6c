//! BRDFs and fits of images: against measured files, bounds, the paper's algorithm.

#[path = "../transport/statistics.rs"]
#[allow(dead_code)]
mod statistics;

mod bounded;
mod brdf;
mod images;
mod paper;
