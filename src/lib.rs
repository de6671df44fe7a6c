//! `rig` measures how a material reflects light: images of a concave sample of
//! known shape, taken under a few known lights, are explained by following
//! light through all its interreflections and fitting the weights of a BRDF
//! dictionary.
//!
//! The modules are floors; a floor imports only from floors below it
//! (`tests/floors.rs` checks that from the source):
//!
//! | floor | modules |
//! |---|---|
//! | 0 | [`units`], [`frames`], [`random`], [`shown`], [`statistics`], [`least_squares`], [`checksum`], [`radiance_image`], [`interrupt`], [`outside_file`], [`outside_text`], [`outside_table`], [`file_system`], [`whole_file`], [`plot`] |
//! | 1 | [`brdf`], [`geometry`] |
//! | 2 | [`transport`], [`radiometry`] |
//! | 3 | [`inverse`], [`device`], [`simulation`] |
//! | 4 | [`config`], [`session`], [`calibration`] |
//! | 5 | [`capture`], [`evaluate`] |
//! | 6 | [`report`], [`export`] |
//! | 7 | [`cli`] |

pub mod checksum;
pub mod file_system;
pub mod frames;
pub mod interrupt;
pub mod least_squares;
pub mod outside_file;
pub mod outside_table;
pub mod outside_text;
pub mod plot;
pub mod radiance_image;
pub mod random;
pub mod shown;
pub mod statistics;
pub mod units;
pub mod whole_file;

pub mod brdf;
pub mod geometry;

pub mod radiometry;
pub mod transport;

pub mod device;
pub mod inverse;
pub mod simulation;

pub mod calibration;
pub mod config;
pub mod session;

pub mod capture;
pub mod evaluate;

pub mod export;
pub mod report;

pub mod cli;
