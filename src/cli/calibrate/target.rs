//! Where the records of a calibration go.

use std::path::PathBuf;

use jiff::Timestamp;

use crate::calibration::Library;
use crate::calibration::measurement::Measurement;
use crate::calibration::record::{Settings, Values};
use crate::cli::rig_choice::RigArg;
use crate::cli::{CliError, Context, HintExt};
use crate::config::RigConfig;
#[cfg(feature = "figures")]
use crate::plot::Figure;
use crate::whole_file;

#[derive(clap::Args, Debug)]
pub(super) struct CommonArgs {
    #[command(flatten)]
    pub rig: RigArg,
    /// Folder of the rig's records; the record goes into its folder of that kind
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Name of the record; the date and the kind if not given
    #[arg(long, value_name = "ID")]
    pub id: Option<String>,
    /// Time of the measurement (UTC, RFC 3339); now if not given
    #[arg(long, value_name = "TIME", hide = true)]
    pub date: Option<Timestamp>,
    /// How long the record may be used (days; default: no end, and a warning when it is old)
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=36_500))]
    valid_days: Option<u32>,
    /// What was found, as JSON
    #[arg(long)]
    pub json: bool,
}

/// Where the records of one calibration go, and what they have in common.
pub(super) struct Target {
    pub library: Library,
    pub measurement: Measurement,
}

impl Target {
    pub fn new(
        rig: &RigConfig,
        library: Library,
        args: &CommonArgs,
        context: &Context,
    ) -> Result<Self, CliError> {
        let library = match (&args.out, library) {
            (Some(folder), _) => Library::Folder(folder.clone()),
            (None, Library::BuiltIn(_)) => {
                let folder = PathBuf::from("calibration").join(&rig.name);
                context.note(format_args!(
                    "built-in records stay as they are: writing to {}",
                    folder.display()
                ));
                Library::Folder(folder)
            }
            (None, Library::Before(folder, _)) => Library::Folder(folder),
            (None, folder) => folder,
        };
        if let Library::Folder(folder) = &library {
            // Before devices take what could not be kept.
            whole_file::check_folder(folder)
                .map_err(|error| CliError::new(format!("{}: {error}", folder.display())))
                .hint(
                    "records are kept there; make the folder writable, or name another with --out",
                )?;
        }
        let measurement = Measurement::on(rig);
        Ok(Self {
            library,
            measurement: Measurement {
                id: args.id.clone(),
                date: args.date.unwrap_or(measurement.date),
                valid_days: args.valid_days,
                ..measurement
            },
        })
    }

    /// The same for values from files, of any gain and bit depth.
    pub fn measured_from(mut self, source: String, resolution_px: [u32; 2]) -> Self {
        self.measurement.source = source;
        self.measurement.settings = Settings {
            resolution_px: Some(resolution_px),
            ..Settings::default()
        };
        self
    }

    pub fn add<V: Values>(
        &self,
        values: V,
        method: &str,
        maps: &[(&str, &[u8])],
    ) -> Result<PathBuf, CliError> {
        let record = self.measurement.record(values, method);
        self.library
            .add(&record, maps)?
            .ok_or_else(|| CliError::new("the built-in records cannot be added to"))
    }

    /// Puts a page into the folder `plots` next to the records, named as the record.
    #[cfg(feature = "reports")]
    pub fn put_page(
        &self,
        html: &str,
        record: &std::path::Path,
        context: &Context,
    ) -> Result<(), CliError> {
        let Library::Folder(folder) = &self.library else {
            return Ok(());
        };
        let stem = record.file_stem().unwrap_or_default().to_string_lossy();
        let path = folder.join("plots").join(format!("{stem}.html"));
        whole_file::replace(&path, |out| out.write_all(html.as_bytes()))
            .map_err(|error| CliError::new(format!("{}: {error}", path.display())))?;
        context.note(format_args!("EMVA 1288 figures: {}", path.display()));
        Ok(())
    }

    /// Draws a figure into the folder `plots` next to the records, named as the
    /// record: SVG and PNG.
    #[cfg(feature = "figures")]
    pub fn draw(
        &self,
        figure: &Figure,
        record: &std::path::Path,
        context: &Context,
    ) -> Result<(), CliError> {
        let Library::Folder(folder) = &self.library else {
            return Ok(());
        };
        let folder = folder.join("plots");
        std::fs::create_dir_all(&folder)
            .map_err(|error| CliError::new(format!("{}: {error}", folder.display())))?;
        let stem = record.file_stem().unwrap_or_default().to_string_lossy();
        let png = figure.png()?;
        for (ending, bytes) in [("svg", figure.svg()?.as_bytes()), ("png", &png)] {
            let path = folder.join(format!("{stem}.{ending}"));
            whole_file::replace(&path, |out| out.write_all(bytes))
                .map_err(|error| CliError::new(format!("{}: {error}", path.display())))?;
        }
        let shown = folder.join(format!("{stem}.png"));
        context.note(format_args!("figure: {}", shown.display()));
        Ok(())
    }
}
