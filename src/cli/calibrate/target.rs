//! Where the records of a calibration go.

use std::path::PathBuf;

use jiff::Timestamp;

use crate::calibration::Library;
use crate::calibration::record::{Kind, Record, Settings, Values};
use crate::cli::rig_choice::RigArg;
use crate::cli::{CliError, Context};
use crate::config::RigConfig;

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
    ) -> Self {
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
            (None, folder) => folder,
        };
        Self {
            rig,
            library,
            id: args.id.as_deref(),
            date: args.date.unwrap_or_else(Timestamp::now),
            device_serial: rig.camera.serial.clone().unwrap_or_default(),
            source: match rig.is_simulated() {
                true => "rig calibrate, on the simulated bench".to_owned(),
                false => "rig calibrate".to_owned(),
            },
            settings: Settings {
                gain: Some(rig.camera.gain),
                bit_depth: Some(rig.camera.bit_depth),
                resolution_px: Some(rig.camera.resolution_px),
            },
        }
    }

    pub fn id(&self, kind: Kind) -> String {
        match self.id {
            Some(id) => id.to_owned(),
            None => format!("{}-{}", self.date.strftime("%Y%m%dT%H%M%SZ"), kind.folder()),
        }
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
            valid_until: None,
            method: method.to_owned(),
            source: self.source.clone(),
            settings: self.settings,
            values,
        };
        self.library
            .add(&record, maps)?
            .ok_or_else(|| CliError::new("the built-in records cannot be added to"))
    }
}
