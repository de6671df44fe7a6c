//! What the scale of a session's radiance rests on, by its calibration records.

use crate::calibration::parse_record;
use crate::calibration::record::{LightsValues, Measured, Record, ScaleValues, Values};
use crate::session::{Session, SessionError};

/// A calibration record of a session, as results name it.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Its id.
    pub id: String,
    /// When it was measured, UTC, RFC 3339.
    pub date: String,
    /// Until when it may be used; `None`: no end.
    pub valid_until: Option<String>,
    /// How the values were found.
    pub method: String,
    /// What they were found from: session, image, certificate.
    pub source: String,
    /// Largest relative standard uncertainty of its values.
    pub relative_std: f64,
    /// SHA-256 of its file.
    pub sha256: String,
}

/// What the radiometric scale rests on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traceability {
    /// Irradiance of the lights, by a standard of known reflectance.
    pub irradiance: Option<Reference>,
    /// Response of the camera to radiance, by a light of known radiance.
    pub radiance: Option<Reference>,
}

impl Traceability {
    /// By the records that were copied into a session.
    ///
    /// # Errors
    /// A copy that is gone or has changed.
    pub fn of(session: &Session) -> Result<Self, SessionError> {
        let mut found = Self::default();
        for copy in &session.record().calibration {
            let bytes = session.read_file(&copy.file)?;
            let reference = |record: Record<()>, relative_std| Reference {
                id: record.id,
                date: record.date,
                valid_until: record.valid_until,
                method: record.method,
                source: record.source,
                relative_std,
                sha256: copy.sha256.clone(),
            };
            // A copy is named by kind and id; records of other kinds are none of the scale.
            let id = copy.id.rsplit('/').next().unwrap_or(&copy.id);
            if let Some(record) = of_kind::<LightsValues>(&bytes, id) {
                let values = record.values.irradiance_w_m2;
                let largest = values.into_iter().map(relative).fold(0.0, f64::max);
                found.irradiance = Some(reference(without_values(record), largest));
            } else if let Some(record) = of_kind::<ScaleValues>(&bytes, id) {
                let std = relative(record.values.responsivity_e_s);
                found.radiance = Some(reference(without_values(record), std));
            }
        }
        Ok(found)
    }

    /// Whether f rests on a standard: f is radiance over irradiance, and an irradiance that a
    /// standard of known reflectance gave is in the unit of the radiance.
    pub fn is_traceable(&self) -> bool {
        self.irradiance.is_some()
    }

    /// The same in words.
    pub fn sentence(&self) -> String {
        match &self.irradiance {
            Some(reference) => format!(
                "The scale of f rests on the irradiance record {} of {}: {} (standard uncertainty {:.2}%; from {}).",
                reference.id,
                reference.date,
                reference.method,
                100.0 * reference.relative_std,
                reference.source,
            ),
            None => "NOT TRACEABLE: the irradiance is that of the rig file; no record of a standard of known reflectance was used.".to_owned(),
        }
    }
}

fn of_kind<V: Values>(bytes: &[u8], id: &str) -> Option<Record<V>> {
    let (record, _) = parse_record::<V>(bytes, id, id).ok()?;
    (record.kind == V::KIND).then_some(record)
}

fn relative(measured: Measured) -> f64 {
    measured.std / measured.value
}

fn without_values<V>(record: Record<V>) -> Record<()> {
    Record {
        id: record.id,
        kind: record.kind,
        rig: record.rig,
        device_serial: record.device_serial,
        date: record.date,
        valid_until: record.valid_until,
        method: record.method,
        source: record.source,
        settings: record.settings,
        values: (),
    }
}
