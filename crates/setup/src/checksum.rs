//! SHA-256 (FIPS 180-4) in hexadecimal, as files and records state it.

use sha2::{Digest, Sha256};

/// SHA-256 of bytes, 64 lowercase hexadecimal digits.
///
/// ```
/// assert!(rig_setup::checksum::sha256_hex(b"abc").starts_with("ba7816bf"));
/// ```
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Bytes as lowercase hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
