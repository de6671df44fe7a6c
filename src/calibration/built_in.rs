//! The simulated rig's records, so that the program works in an empty folder.

/// `<kind>/<file>` and its bytes.
pub(super) const SIMULATED: &[(&str, &[u8])] = &[];
