//! The calibration records of a bench, judged as a capture judges them.

use jiff::Timestamp;

use super::{Check, Trouble};
use crate::calibration::camera::CameraValues;
use crate::calibration::directions::DirectionsValues;
use crate::calibration::fitness::Concern;
use crate::calibration::glare::GlareValues;
use crate::calibration::record::{
    FlatValues, Kind, LightsValues, ScaleValues, SensorValues, Values,
};
use crate::calibration::slanted_edge::FocusValues;
use crate::calibration::{Library, Loaded, RecordError, Seal};
use crate::capture::findings::Notice;
use crate::capture::records::Records;
use crate::config::ResolvedRig;

/// What a kind of record is called, and what its lack means.
fn named(kind: Kind) -> (&'static str, &'static str) {
    match kind {
        Kind::Sensor => ("sensor", "a capture needs it"),
        Kind::Flat => ("flat", "without it every pixel counts as equally sensitive"),
        Kind::Scale => (
            "scale",
            "without it radiances are relative, per unit irradiance",
        ),
        Kind::Lights => (
            "lights",
            "without it the rig file's irradiance_w_m2 is used",
        ),
        Kind::Directions => (
            "directions",
            "without it the rig file's light directions are used",
        ),
        Kind::Response => (
            "response",
            "without it counts are taken as proportional to light",
        ),
        Kind::Focus => (
            "focus",
            "without it the rig file's point spread, focus and aperture are used",
        ),
        Kind::Pose => ("pose", "without it the sample lies as the rig file states"),
        Kind::Glare => ("glare", "without it the lens is taken to scatter no light"),
        Kind::Camera => ("lens", "without it the lens is as the rig file states"),
        Kind::Lamp => ("lamp", "without it nobody knows how long it must warm up"),
    }
}

pub(super) fn checks(rig: &ResolvedRig, library: &Library) -> Vec<Check> {
    let (ids, gain) = (&rig.config.calibration, rig.config.camera.gain);
    let mut checks = vec![
        record::<SensorValues>(rig, library.load_for(ids.sensor.as_deref(), gain), library),
        record::<FlatValues>(rig, library.load_for(ids.flat.as_deref(), gain), library),
        record::<ScaleValues>(rig, library.load_for(ids.scale.as_deref(), gain), library),
        record::<LightsValues>(rig, library.load(ids.lights.as_deref()), library),
        record::<DirectionsValues>(rig, library.load(ids.directions.as_deref()), library),
        record::<CameraValues>(rig, library.load(ids.camera.as_deref()), library),
        record::<FocusValues>(rig, library.load(ids.focus.as_deref()), library),
    ];
    let glare = library.load::<GlareValues>(ids.glare.as_deref());
    // A simulated lens may have none.
    if !rig.config.is_simulated() || !matches!(glare, Ok(None)) {
        checks.push(record::<GlareValues>(rig, glare, library));
    }
    // A record that cannot be used has its own line.
    let Ok(records) = Records::load(library, &rig.config) else {
        return checks;
    };
    if let Err(error) = records.noise(&rig.config) {
        checks[0] = Check::refused(named(Kind::Sensor).0, error);
    }
    records.check(&rig.config, Timestamp::now(), &mut |notice| {
        if let Notice::WarmUp { needed_s, .. } = notice {
            let trouble = Trouble::WarmUp { needed_s };
            let name = named(Kind::Lamp).0;
            checks.push(Check::warning(name, notice.to_string(), trouble));
        }
    });
    checks
}

fn record<V: Values>(
    rig: &ResolvedRig,
    loaded: Result<Option<Loaded<V>>, RecordError>,
    library: &Library,
) -> Check {
    let (name, without) = named(V::KIND);
    let loaded = match loaded {
        Err(error) => return Check::refused(name, error),
        // None could be added.
        Ok(None) if library.is_built_in() => {
            return Check::ok(name, format!("none is built in: {without}"));
        }
        Ok(None) => {
            let fact = format!("no record in {}: {without}", library.place());
            return Check::warning(name, fact, Trouble::NoRecord(V::KIND));
        }
        Ok(Some(loaded)) => loaded,
    };
    let serial = rig.config.camera.serial.as_deref().unwrap_or_default();
    let is_simulated = rig.config.is_simulated();
    let concerns = loaded.concerns_on(is_simulated, serial, &rig.config.camera, Timestamp::now());
    match concerns.into_iter().next() {
        Some(Concern::Other(error)) => return Check::refused(name, error),
        Some(concern) => {
            let (kind, fact) = (V::KIND, concern.to_string());
            return Check::warning(name, fact, Trouble::OldRecord { kind, concern });
        }
        None => {}
    }
    let unsealed = match loaded.seal {
        Seal::Missing => "; it has no checksum, so a change would not be noticed",
        _ => "",
    };
    let record = &loaded.record;
    let fact = format!("record {} of {}{unsealed}", record.id, record.date);
    Check::ok(name, fact)
}
