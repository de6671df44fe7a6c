//! What goes wrong at a still camera.

use std::time::Duration;

use mock_devices::failing::Failing;

/// What goes wrong; numbers count what it happens to.
#[derive(Debug, Default)]
pub struct Faults {
    /// Operations other than opening a session are answered with "device busy".
    pub busy: u32,
    /// Shutter speeds are refused although they are listed.
    pub refused_speeds: u32,
    /// Shutter speeds are accepted, and the one before stays.
    pub kept_speeds: u32,
    /// Files state twice the exposure that they were taken with.
    pub wrong_exif: u32,
    /// Frames are taken with half the exposure that their file states.
    pub half_exposure: u32,
    /// Files lose their second half on the way.
    pub cut_files: u32,
    /// Captures are accepted and give no file.
    pub no_file: u32,
    /// Every file comes so much later.
    pub slow: Duration,
    /// There is no room for a file.
    pub is_full: bool,
    /// It is off or out of reach.
    pub is_gone: bool,
}

/// Handle by which a test makes a body fail.
pub type BodyFaults = Failing<Faults>;
