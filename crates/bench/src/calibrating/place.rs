//! Where the records of a calibration go.

use std::path::{Path, PathBuf};

use super::CalibratingError;
use crate::calibration::Library;
use crate::calibration::measurement::Measurement;
use crate::calibration::record::{Settings, Values};
use crate::config::ResolvedRig;
#[cfg(feature = "figures")]
use crate::plot::Figure;
use crate::whole_file;

/// Where the records of one calibration go, and what they have in common.
#[derive(Clone, Debug)]
pub struct Place {
    /// The records there.
    pub library: Library,
    /// What the records have in common.
    pub measurement: Measurement,
    /// Whether the rig's own records are in the program, and others go to this folder.
    pub instead_of_built_in: bool,
}

/// A record that was kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Its file.
    pub record: PathBuf,
    /// Its figure, if it has one.
    pub figure: Option<PathBuf>,
}

impl Place {
    /// The folder `out`, else that of the rig's records; a measurement that is made now.
    pub fn of_rig(rig: &ResolvedRig, out: Option<&Path>) -> Self {
        let mut instead_of_built_in = false;
        let library = match (out, Library::of_rig(rig)) {
            (Some(folder), _) => Library::Folder(folder.to_owned()),
            (None, Library::BuiltIn(_)) => {
                instead_of_built_in = true;
                Library::Folder(PathBuf::from("calibration").join(&rig.config.name))
            }
            (None, Library::Before(folder, _)) => Library::Folder(folder),
            (None, folder) => folder,
        };
        Self {
            library,
            measurement: Measurement::on(&rig.config),
            instead_of_built_in,
        }
    }

    /// Whether records can be kept here, before devices take what could not be kept.
    ///
    /// # Errors
    /// [`CalibratingError::Folder`].
    pub fn check(&self) -> Result<(), CalibratingError> {
        let Library::Folder(folder) = &self.library else {
            return Ok(());
        };
        whole_file::check_folder(folder).map_err(|source| CalibratingError::Folder {
            folder: folder.clone(),
            source,
        })
    }

    /// The same for values from files, of any gain and bit depth.
    #[must_use]
    pub fn measured_from(mut self, source: String, resolution_px: [u32; 2]) -> Self {
        self.measurement.source = source;
        self.measurement.settings = Settings {
            resolution_px: Some(resolution_px),
            ..Settings::default()
        };
        self
    }

    /// Keeps a record of values that were found by `method`, with its maps: names and bytes.
    ///
    /// # Errors
    /// A file that cannot be written, or a record of that name that is there.
    pub fn keep<V: Values>(
        &self,
        values: V,
        method: &str,
        maps: &[(&str, &[u8])],
    ) -> Result<Kept, CalibratingError> {
        let record = self.measurement.record(values, method);
        let record = self.library.add(&record, maps)?;
        Ok(Kept {
            record: record.ok_or(CalibratingError::BuiltIn)?,
            figure: None,
        })
    }

    /// Draws the figure of a record as SVG and PNG, with [`Self::write_plot`].
    ///
    /// # Errors
    /// [`CalibratingError::Plot`], [`CalibratingError::File`].
    #[cfg(feature = "figures")]
    pub fn draw(&self, kept: Kept, figure: &Figure) -> Result<Kept, CalibratingError> {
        let png = figure.png()?;
        let svg = figure.svg()?;
        self.write_plot(&kept, "svg", svg.as_bytes())?;
        let figure = self.write_plot(&kept, "png", &png)?;
        Ok(Kept { figure, ..kept })
    }

    /// Writes `plots/RECORD.ending` in the folder of the records; returns its path, or `None` where
    /// they are in no folder.
    ///
    /// # Errors
    /// [`CalibratingError::File`].
    #[cfg(feature = "figures")]
    pub fn write_plot(
        &self,
        kept: &Kept,
        ending: &str,
        bytes: &[u8],
    ) -> Result<Option<PathBuf>, CalibratingError> {
        let Library::Folder(folder) = &self.library else {
            return Ok(None);
        };
        let folder = folder.join("plots");
        let failed = |path: &Path, source| CalibratingError::File {
            path: path.to_owned(),
            source,
        };
        std::fs::create_dir_all(&folder).map_err(|error| failed(&folder, error))?;
        let stem = kept.record.file_stem().unwrap_or_default();
        let path = folder.join(format!("{}.{ending}", stem.to_string_lossy()));
        whole_file::replace(&path, |out| out.write_all(bytes))
            .map_err(|error| failed(&path, error))?;
        Ok(Some(path))
    }
}
