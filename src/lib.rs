//! `rig` measures how a material reflects light: images of a concave sample of known shape,
//! taken under a few known lights, are explained by following light through all its
//! interreflections and fitting the weights of a BRDF dictionary. What the program does, this
//! library does; the command line ([`cli`]) parses, shows and advises.
//!
//! | to | see |
//! |---|---|
//! | capture a sample by a rig file, simulated or real | [`capture::prepare`], [`capture::open`] |
//! | fit a captured session, or images of a scene | [`workflow::fit_session`], [`workflow::fit_images`] |
//! | fit and report many sessions, on one machine or many | [`batch`] |
//! | read sessions and fits | [`session::Session`], [`session::fit_record`] |
//! | check a bench before anything moves | [`doctor`] |
//! | list the sessions of a folder, compare repeats | [`catalogue`] |
//! | capture many samples, one after the other | [`queue`] |
//! | merge exposure brackets into radiance | [`radiometry`] |
//! | calibrate camera, lights, lens, pose | [`calibration`] |
//! | write a material for other programs | [`export`] |
//! | drive a camera or stage | [`device`] |
//! | simulate the bench | [`simulation`], [`device::simulated`] |
//!
//! The modules come from crates by reader, re-exported here, so that one path serves all:
//!
//! | crate | modules |
//! |---|---|
//! | [`rig_core`] | [`brdf`], [`geometry`], [`transport`], [`inverse`] and what they stand on |
//! | [`rig_device`] | [`device`], [`radiometry`], [`interrupt`] |
//! | [`rig_setup`] | [`config`], [`calibration`], [`simulation`] |
//! | [`rig_bench`] | [`session`], [`calibrating`], [`capture`], [`catalogue`], [`workflow`], [`queue`] |
//! | [`rig_desk`] | [`material`], [`export`], [`report`], [`batch`] |
//! | [`rig_lab`] | [`evaluate`], [`benchmark`] |
//! | `rig_console` | `console` |

pub use rig_core::{
    bench_priors, brdf, cells, file_system, frames, geometry, inverse, least_squares, outside_file,
    outside_table, outside_text, parametric, plausibility, progress, radiance_image, random,
    scores, shown, simplex, statistics, transport, units, whole_file,
};

pub use rig_bench::{
    beneath, calibrating, capture, catalogue, doctor, fault, queue, rendering, session, workflow,
    write_queue,
};
#[cfg(feature = "console")]
pub use rig_console::console;
#[cfg(feature = "reports")]
pub use rig_desk::{batch, report};
pub use rig_desk::{cluster, export, material, result_table};
pub use rig_device::{device, interrupt, radiometry};
pub use rig_lab::{benchmark, design};
#[cfg(feature = "experiments")]
pub use rig_lab::{evaluate, job_array};
#[cfg(feature = "figures")]
pub use rig_setup::plot;
pub use rig_setup::{calibration, checksum, config, shell_words, simulation};

pub mod cli;

/// The program of README.md, which runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// The driver of docs/adding-a-driver.md, likewise.
#[cfg(doctest)]
#[doc = include_str!("../docs/adding-a-driver.md")]
struct AddingADriver;
