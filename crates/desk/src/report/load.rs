//! A session on disk, and one of its fits, as the input of a report.

mod lamp;

use std::path::{Path, PathBuf};

use super::{
    CapturedInput, ExposureInput, FitInput, LightInput, ProvenanceGroup, ReportInput, SphereInput,
    Truth, ValidationInput,
};
use crate::brdf::environment::EnvironmentMap;
use crate::brdf::sphere::{self, GreyCard, SphereImage, sphere_images};
use crate::brdf::{Brdf, BrdfError, source};
use crate::device::{FrameKind, LampState};
use crate::radiance_image::RadianceImage;
use crate::radiance_image::exr::{self, ExrError};
use crate::session::fit_record::{self, FitRecord, FitRecordError};
use crate::session::{Event, Session, SessionError, SessionState, Sidecar, layout, validation};
use crate::units::StageAngles;
use crate::workflow::white_radiance;

/// Pixels a side of the spheres under environment maps.
const SPHERE_PX: usize = 128;

/// Why a session could not be loaded.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum LoadError {
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// One of its fits.
    #[error(transparent)]
    Fit(#[from] FitRecordError),
    /// The fitted or the true BRDF.
    #[error(transparent)]
    Brdf(#[from] BrdfError),
    /// A merged image.
    #[error(transparent)]
    Image(#[from] ExrError),
    /// A frame's sidecar.
    #[error("{}: {fact}", path.display())]
    Sidecar { path: PathBuf, fact: String },
    #[error("the fit in {} is none of {}", folder.display(), session.display())]
    OtherSession { folder: PathBuf, session: PathBuf },
    /// A fit that the session doesn't have.
    #[error("{} has no fit {number}; it has {existing}", session.display())]
    NoSuchFit {
        session: PathBuf,
        number: u32,
        /// Numbers of the fits that exist, or "none".
        existing: String,
    },
}

/// Which fit of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FitChoice {
    /// The one of this number.
    Number(u32),
    /// The one in this folder, outside the session.
    Folder(PathBuf),
}

/// Loads a session with the fit that is chosen, or its latest one. A session without fits loads,
/// too.
///
/// # Errors
/// Anything on disk that is broken; a report is not made of half a fit.
pub fn load(root: &Path, fit: Option<&FitChoice>) -> Result<ReportInput, LoadError> {
    load_with(root, fit, SPHERE_PX)
}

fn load_with(
    root: &Path,
    fit: Option<&FitChoice>,
    sphere_px: usize,
) -> Result<ReportInput, LoadError> {
    let session = Session::open(root)?;
    let record = session.record();
    let fit = match fit {
        Some(FitChoice::Folder(folder)) => Some(fit_elsewhere(&session, folder)?),
        Some(FitChoice::Number(number)) => chosen_fit(&session, Some(*number))?,
        None => chosen_fit(&session, None)?,
    };
    // A material that this version cannot evaluate is named, and takes only the comparison away.
    let material = record.true_material.as_deref();
    let truth = material.map(|name| (name, source::load(name)));
    let unknown = match &truth {
        Some((_, Err(error))) => Some(error.to_string()),
        _ => None,
    };
    let truth = truth.and_then(|(name, brdf)| {
        Some(Truth {
            name: name.to_owned(),
            brdf: brdf.ok()?.into(),
        })
    });
    let spheres = match &fit {
        Some(fit) => spheres(
            &*fit.estimate,
            truth.as_ref().map(|truth| &*truth.brdf),
            sphere_px,
        ),
        None => Vec::new(),
    };
    let lights = (0..record.plan.lights.len())
        .map(|index| light(&session, index))
        .collect::<Result<_, _>>()?;
    Ok(ReportInput {
        sample: record.sample.clone(),
        session: folder_name(root),
        captured: match session.journal().clock_step() {
            Some(_) => format!(
                "{}, by a clock that was set",
                readable_time(&record.created_utc)
            ),
            None => readable_time(&record.created_utc),
        },
        simulated: record.simulated,
        incomplete: incomplete(&session),
        provenance: provenance(&session, fit.as_ref(), unknown),
        lights,
        diffuser: white_radiance(&session).ok(),
        fit,
        validation: latest_validation(&session)?,
        truth,
        spheres,
    })
}

/// The session's fit of this number, or its latest one.
fn chosen_fit(session: &Session, number: Option<u32>) -> Result<Option<FitInput>, LoadError> {
    let fits = fit_record::numbers_in(session);
    let Some(number) = number.or(fits.last().copied()) else {
        return Ok(None);
    };
    if fits.contains(&number) {
        let record = fit_record::read_in(session, number)?;
        return Ok(Some(FitInput {
            name: number.to_string(),
            images: fit_record::read_images_in(session, number)?,
            estimate: record.material()?,
            record,
        }));
    }
    let existing: Vec<String> = fits.iter().map(u32::to_string).collect();
    Err(LoadError::NoSuchFit {
        session: session.root().to_owned(),
        number,
        existing: match existing.as_slice() {
            [] => "none".to_owned(),
            numbers => numbers.join(", "),
        },
    })
}

/// The session's latest validation with its pictures.
fn latest_validation(session: &Session) -> Result<Option<ValidationInput>, LoadError> {
    let Some(number) = validation::latest_in(session) else {
        return Ok(None);
    };
    let record = validation::read_in(session, number)?;
    let mut pictures = Vec::new();
    for score in &record.lights {
        if let Some(png) = validation::read_picture_in(session, number, score.light)? {
            pictures.push((score.light, png));
        }
    }
    Ok(Some(ValidationInput {
        number,
        record,
        pictures,
    }))
}

/// The fit of a folder outside the session, which must be one of its images.
fn fit_elsewhere(session: &Session, folder: &Path) -> Result<FitInput, LoadError> {
    let record = fit_record::read(folder)?;
    let of = record.settings.session.as_deref().map(Path::new);
    if of.map(folder_name) != Some(folder_name(session.root())) {
        return Err(LoadError::OtherSession {
            folder: folder.to_owned(),
            session: session.root().to_owned(),
        });
    }
    Ok(FitInput {
        name: folder_name(folder),
        images: fit_record::read_images(folder)?,
        estimate: record.material()?,
        record,
    })
}

fn folder_name(root: &Path) -> String {
    let root = root.canonicalize().unwrap_or_else(|_| root.to_owned());
    let name = root.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// `2026-11-21 02:34 UTC` from RFC 3339; anything else stays as it is.
fn readable_time(utc: &str) -> String {
    utc.parse::<jiff::Timestamp>()
        .map_or(utc.to_owned(), |time| {
            time.strftime("%Y-%m-%d %H:%M UTC").to_string()
        })
}

fn incomplete(session: &Session) -> Option<String> {
    let count = session.record().plan.lights.len();
    let finished = (0..count)
        .filter(|&n| session.light_is_finished(n as u32))
        .count();
    let reason = session
        .journal()
        .records
        .iter()
        .rev()
        .find_map(|record| match &record.event {
            Event::Interrupted { reason } => Some(format!(": {reason}")),
            _ => None,
        });
    (session.state() == SessionState::Interrupted).then(|| {
        format!(
            "{finished} of {count} lights are finished{}.",
            reason.unwrap_or_default()
        )
    })
}

fn light(session: &Session, index: usize) -> Result<LightInput, LoadError> {
    let plan = &session.record().plan;
    let number = index as u32;
    let read_back = session
        .journal()
        .records
        .iter()
        .rev()
        .find_map(|record| match record.event {
            Event::LightStart {
                light,
                azimuth_deg,
                elevation_deg,
            } if light == number => Some(StageAngles::new(azimuth_deg, elevation_deg)),
            _ => None,
        });
    let exposures = exposures(session, number)?;
    let name = layout::radiance_file(number);
    let path = session.root().join(&name);
    let captured = path.exists().then(|| -> Result<_, LoadError> {
        let file = exr::read_opened(session.open_file(&name)?, &path, None)?;
        Ok(CapturedInput::of(&file.image))
    });
    Ok(LightInput {
        index: number,
        place: read_back.or(plan.lights.get(index).copied()),
        exposures,
        captured: captured.transpose()?,
    })
}

/// The light frames of one direction, counted by lamp channel and exposure, as
/// their sidecars give them.
fn exposures(session: &Session, light: u32) -> Result<Vec<ExposureInput>, LoadError> {
    let several = session.record().plan.channels.len() > 1;
    let measures = session.rig().map_or(Vec::new(), |rig| rig.stage.measures);
    let colour = |channel: u8| {
        let known = measures.get(usize::from(channel));
        known.map_or("lamp", |measures| measures.colour())
    };
    let mut found: Vec<ExposureInput> = Vec::new();
    for frame in session.frames() {
        if frame.key.light != light || frame.key.kind != FrameKind::Light {
            continue;
        }
        let bytes = session.read_file(&frame.sidecar.path)?;
        let sidecar: Sidecar = toml::from_slice(&bytes).map_err(|error| LoadError::Sidecar {
            path: session.root().join(&frame.sidecar.path),
            fact: error.message().to_owned(),
        })?;
        if sidecar.pilot {
            continue;
        }
        let lamp = match sidecar.lamp {
            LampState::On(channel) if several => Some((channel.0, colour(channel.0))),
            _ => None,
        };
        let exposure = sidecar.applied.exposure;
        match found
            .iter_mut()
            .find(|e| e.exposure == exposure && e.lamp == lamp)
        {
            Some(known) => known.frames += 1,
            None => found.push(ExposureInput {
                lamp,
                exposure,
                frames: 1,
            }),
        }
    }
    found.sort_by(|a, b| a.exposure.0.total_cmp(&b.exposure.0));
    Ok(found)
}

fn spheres(estimate: &dyn Brdf, truth: Option<&dyn Brdf>, sphere_px: usize) -> Vec<SphereInput> {
    let maps = EnvironmentMap::all();
    let brdfs: Vec<&dyn Brdf> = [&GreyCard as &dyn Brdf, estimate]
        .into_iter()
        .chain(truth)
        .collect();
    let images = sphere_images(&brdfs, &maps, sphere_px);
    let under = |(map, images): (&EnvironmentMap, &Vec<SphereImage>)| SphereInput {
        map: map.name().to_owned(),
        grey: as_radiance(&images[0]),
        estimate: as_radiance(&images[1]),
        truth: images.get(2).map(as_radiance),
    };
    maps.iter().zip(&images).map(under).collect()
}

/// The sphere's pixels are valid, those around it are not.
fn as_radiance(sphere: &SphereImage) -> RadianceImage {
    let mut image = RadianceImage::new(sphere.size, sphere.size);
    image.mean.clone_from(&sphere.radiance);
    image.valid.fill(false);
    for (pixel, _) in sphere::normals(sphere.size) {
        image.valid[pixel] = true;
    }
    image
}

fn provenance(
    session: &Session,
    fit: Option<&FitInput>,
    unknown_truth: Option<String>,
) -> Vec<ProvenanceGroup> {
    let record = session.record();
    let group = |title: &str, entries: Vec<(&str, String)>| ProvenanceGroup {
        title: title.to_owned(),
        entries: entries
            .into_iter()
            .map(|(key, value)| (key.to_owned(), value))
            .collect(),
    };
    // The session.
    let resumed = session.journal().records.iter();
    let resumed = resumed
        .filter(|r| matches!(r.event, Event::Resume { .. }))
        .count();
    let mut groups = vec![group(
        "Session",
        vec![
            ("Folder", folder_name(session.root())),
            ("Sample", record.sample.clone()),
            ("Started", record.created_utc.clone()),
            (
                "Simulated",
                if record.simulated { "yes" } else { "no" }.to_owned(),
            ),
            ("Rig", record.rig.clone()),
            ("Seed", record.seed.to_string()),
            ("Interruptions resumed", resumed.to_string()),
            ("Stage's reference after the last light", reference(session)),
            ("Captured with", format!("rig {}", record.versions.rig)),
        ],
    )];
    if let Some(step) = session.journal().clock_step() {
        groups[0].entries.push(("Times".to_owned(), step));
    }
    if let Some(name) = &record.true_material {
        let reason = unknown_truth.map(|reason| format!(" (cannot be evaluated: {reason})"));
        let text = format!("{name}{}", reason.unwrap_or_default());
        groups[0].entries.push(("True material".to_owned(), text));
    }
    // Its devices.
    let (camera, stage) = (&record.versions.camera, &record.versions.stage);
    let [width, height] = camera.resolution_px;
    groups.push(group(
        "Devices",
        vec![
            (
                "Camera",
                format!(
                    "{} ({}), serial {}",
                    camera.model,
                    camera.driver,
                    or_none(&camera.serial)
                ),
            ),
            (
                "Sensor",
                format!(
                    "{width} × {height} pixels, {} bits, colour filters {}",
                    camera.bit_depth, camera.mosaic
                ),
            ),
            (
                "Stage",
                format!(
                    "{} at {}, firmware {}",
                    stage.driver,
                    stage.port,
                    or_none(&stage.firmware)
                ),
            ),
            (
                "Lamp watchdog",
                if stage.has_watchdog { "yes" } else { "no" }.to_owned(),
            ),
        ],
    ));
    // Calibrations, lamp, fit and configuration.
    let copies = record.calibration.iter();
    groups.push(ProvenanceGroup {
        title: "Calibration".to_owned(),
        entries: match record.calibration.as_slice() {
            [] => vec![("Records".to_owned(), "none was used".to_owned())],
            _ => copies
                .map(|copy| {
                    (
                        copy.id.clone(),
                        format!("{}, SHA-256 {}", copy.file, copy.sha256),
                    )
                })
                .collect(),
        },
    });
    groups.push(lamp::group(session));
    groups.extend(fit.map(|fit| fit_group(&fit.record)));
    groups.push(group(
        "Configuration",
        vec![("Resolved", record.config.trim_end().to_owned())],
    ));
    groups
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

fn fit_group(record: &FitRecord) -> ProvenanceGroup {
    let settings = &record.settings;
    let mut entries: Vec<(String, String)> = [
        (
            "Dictionary",
            format!("{}, {} atoms", record.dictionary, record.atoms.len()),
        ),
        ("Optimiser", settings.optimizer.clone()),
        ("Paths per pixel", settings.samples_per_pixel.to_string()),
        (
            "Longest path",
            format!("{} reflections", settings.max_reflections),
        ),
        ("Seed", settings.seed.to_string()),
        ("Kernel", settings.kernel.clone()),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into();
    entries.extend(
        record
            .versions
            .iter()
            .map(|(name, version)| (name.clone(), version.clone())),
    );
    ProvenanceGroup {
        title: "Fit".to_owned(),
        entries,
    }
}

/// Result of the check of the stage's reference switches.
fn reference(session: &Session) -> String {
    let records = session.journal().records.iter().rev();
    let mut checks = records.filter_map(|record| match record.event {
        Event::Reference { off, .. } => Some(off),
        _ => None,
    });
    match (session.journal().suspicion(), checks.next()) {
        (Some(suspicion), _) => format!("SUSPECT: {suspicion}"),
        (None, Some([first, second])) => format!("found, off by {first:.4} and {second:.4}"),
        (None, None) => "not checked".to_owned(),
    }
}

#[cfg(test)]
mod tests;
