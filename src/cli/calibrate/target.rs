//! Where the records of a calibration go.

use std::path::PathBuf;

use jiff::Timestamp;

use crate::calibration::Library;
use crate::calibration::record::{Kind, Record, Settings, Values};
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
pub(super) struct Target<'a> {
    rig: &'a RigConfig,
    pub library: Library,
    id: Option<&'a str>,
    date: Timestamp,
    valid_days: Option<u32>,
    device_serial: String,
    /// What the values are found from.
    pub source: String,
    /// Settings to which they belong.
    pub settings: Settings,
}

impl<'a> Target<'a> {
    pub fn new(
        rig: &'a RigConfig,
        library: Library,
        args: &'a CommonArgs,
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
            // Before devices work for what could not be kept.
            whole_file::check_folder(folder)
                .map_err(|error| CliError::new(format!("{}: {error}", folder.display())))
                .hint(
                    "records are kept there; make the folder writable, or name another with --out",
                )?;
        }
        Ok(Self {
            rig,
            library,
            id: args.id.as_deref(),
            date: args.date.unwrap_or_else(Timestamp::now),
            valid_days: args.valid_days,
            device_serial: rig.camera.serial.clone().unwrap_or_default(),
            source: match rig.is_simulated() {
                true => "rig calibrate, on the simulated bench".to_owned(),
                false => "rig calibrate".to_owned(),
            },
            settings: Settings {
                gain: Some(rig.camera.gain),
                bit_depth: Some(rig.camera.bit_depth),
                resolution_px: Some(rig.camera.resolution_px),
                ..Settings::default()
            },
        })
    }

    pub fn id(&self, kind: Kind) -> String {
        match self.id {
            Some(id) => id.to_owned(),
            None => format!("{}-{}", self.date.strftime("%Y%m%dT%H%M%SZ"), kind.folder()),
        }
    }

    fn after(&self, days: u32) -> String {
        let until = self.date + jiff::SignedDuration::from_hours(24 * i64::from(days));
        until.strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
    }

    pub fn add<V: Values>(
        &self,
        values: V,
        method: &str,
        maps: &[(&str, &[u8])],
    ) -> Result<PathBuf, CliError> {
        let record = Record {
            id: self.id(V::KIND),
            kind: V::KIND,
            rig: self.rig.name.clone(),
            device_serial: self.device_serial.clone(),
            date: self.date.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
            valid_until: self.valid_days.map(|days| self.after(days)),
            method: method.to_owned(),
            source: self.source.clone(),
            settings: self.settings,
            values,
        };
        self.library
            .add(&record, maps)?
            .ok_or_else(|| CliError::new("the built-in records cannot be added to"))
    }

    /// Draws a figure into the folder `plots` beside the records, named as the
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
