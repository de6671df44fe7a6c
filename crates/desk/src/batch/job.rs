//! One job: a session with the options of its fit.

use std::path::{Path, PathBuf};

use crate::brdf::Dictionary;
use crate::checksum::sha256_hex;
use crate::outside_file::{ends_in, read_regular};
use crate::workflow::FitRequest;

/// More than any mask or dictionary has.
const LARGEST_FILE_BYTES: u64 = 1 << 30;

/// A session that is to be fitted and reported.
#[derive(Clone, Debug)]
pub struct Job {
    /// From 1, in the order in which the sessions were named.
    pub number: usize,
    /// The session's folder, absolute.
    pub session: PathBuf,
    /// SHA-256 of its `session.toml`, which tells it from every other session.
    pub session_sha256: String,
    /// Options of the fit, as on the command line.
    pub options: String,
    /// The same, with memory and kernel stated, so that it gives the same numbers on any machine
    /// that has the kernel.
    pub request: FitRequest,
    /// Processor time that it is expected to take, seconds.
    pub expected_cpu_s: f64,
    /// Memory that it is expected to take at its peak, MiB.
    pub expected_mib: u64,
}

impl Job {
    /// The session's folder without what it lies in.
    pub fn session_name(&self) -> String {
        let name = self.session.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// What the result depends on, as SHA-256: session, options, the files that the options
    /// name, the program's version. A fit that states it is this job's.
    ///
    /// # Errors
    /// A file that cannot be read, with its path.
    pub fn key(&self) -> Result<String, (PathBuf, std::io::Error)> {
        let mut request = self.request.clone();
        let mut text = format!(
            "rig {}\nsession {}\n",
            env!("CARGO_PKG_VERSION"),
            self.session_sha256
        );
        // Files count by what they hold, wherever they lie.
        let dictionary = request.dictionary.take_if(|name| is_file(name));
        let files = [
            ("dictionary", dictionary.map(PathBuf::from)),
            ("mask", request.mask.take()),
        ];
        for (what, file) in files {
            if let Some(file) = file {
                let bytes = read_regular(&file, LARGEST_FILE_BYTES);
                let bytes = bytes.map_err(|error| (file, error))?;
                text += &format!("{what} {}\n", sha256_hex(&bytes));
            }
        }
        text += &format!("{request:?}\n");
        Ok(sha256_hex(text.as_bytes()))
    }
}

/// Whether a dictionary is named by its file.
fn is_file(dictionary: &str) -> bool {
    let is_of_kind = |ending| ends_in(Path::new(dictionary), ending);
    !Dictionary::NAMES.contains(&dictionary) && ["toml", "json"].into_iter().any(is_of_kind)
}

/// The request with its relative paths taken from this folder.
pub(super) fn resolved(request: FitRequest, folder: &Path) -> FitRequest {
    let dictionary = request.dictionary.map(|name| {
        if is_file(&name) {
            folder.join(name).to_string_lossy().into_owned()
        } else {
            name
        }
    });
    FitRequest {
        dictionary,
        mask: request.mask.map(|path| folder.join(path)),
        ..request
    }
}
