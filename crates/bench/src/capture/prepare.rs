//! A capture from a rig file to a session: planned and checked while nothing moves, begun on
//! devices, resumed from its folder.
//!
//! ```no_run
//! use rig_bench::capture::open::{OpenOptions, open_devices};
//! use rig_bench::capture::prepare::{CaptureRequest, Lights, prepare};
//! use rig_setup::config::{Surroundings, resolve_rig};
//! use rig_device::interrupt::Interrupt;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let rig = resolve_rig(Some("simulated"), &Surroundings::of_process(), Vec::new)?;
//! let request = CaptureRequest::new(Lights::Count(4), "sessions");
//! let prepared = prepare(&rig, &request, &mut |notice| eprintln!("{notice:?}"))?;
//! println!("{} lights take {}", prepared.plan().lights.len(), prepared.plan().estimated_s);
//! let devices = open_devices(&rig.config, &OpenOptions::default())?;
//! let job = prepared.begin(devices, &mut |_| ())?;
//! println!("{}", job.root().display());
//! job.run(&mut (), Interrupt::new())?;
//! # Ok(())
//! # }
//! ```

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::findings::{Notice, PrepareError};
use super::light_choice::{self, Ranking};
use super::open::Devices;
use super::plan::{LightChoice, Pace, PlanRequest, check_space, plan};
use super::reach::StageReach;
use super::records::Records;
use super::{Capture, CaptureError, Chooser, Observer, Outcome, RadianceSink, region_of_interest};
use crate::calibration::Library;
use crate::calibration::depth_of_field;
use crate::checksum::sha256_hex;
use crate::config::scene_concern::{DescribedIn, SceneConcern};
use crate::config::simulation::MaterialSpec;
use crate::config::{ResolvedRig, RigConfig};
use crate::interrupt::Interrupt;
use crate::radiometry::sensor::SensorNoise;
use crate::session::commit::{SystemDisk, check_creatable};
use crate::session::layout::{CALIBRATION_FOLDER, session_name};
use crate::session::scene_files;
use crate::session::{
    CalibrationCopy, Event, NewSession, PlanRecord, Session, SessionRecord, SessionWriter, Until,
    Versions,
};
use crate::transport::Scene;
use crate::transport::visibility::{Concern, Visibility};
use crate::units::StageAngles;

pub use super::lights::Lights;

/// Angle that [`Lights::All`] keeps between two lights, degrees.
pub const ALL_SPACING_DEG: f64 = 15.0;
/// Directions closer than this are one, radians: 0.001°.
const SAME_LIGHT_RAD: f64 = 1.7e-5;

/// What is to be captured.
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureRequest {
    /// Under which lights.
    pub lights: Lights,
    /// When it has enough, where more follow that are chosen as it goes.
    pub until: Option<Until>,
    /// Name of the sample: letters, digits, dots, hyphens, underscores. `None`: the material's
    /// name on a simulated rig, else `sample`.
    pub sample: Option<String>,
    /// What the operator notes of its material.
    pub material: Option<String>,
    /// What the operator notes otherwise.
    pub comment: Option<String>,
    /// The folder that receives the session's folder.
    pub folder: PathBuf,
    /// Nothing will be captured: without a record the noise of a usual sensor is taken for
    /// the estimates.
    pub only_plan: bool,
}

impl CaptureRequest {
    /// A sample without a name.
    pub fn new(lights: Lights, folder: impl Into<PathBuf>) -> Self {
        Self {
            lights,
            until: None,
            sample: None,
            material: None,
            comment: None,
            folder: folder.into(),
            only_plan: false,
        }
    }
}

/// A capture that is planned and checked.
pub struct Prepared<'a> {
    rig: &'a ResolvedRig,
    sample: String,
    material: Option<String>,
    comment: Option<String>,
    folder: PathBuf,
    records: Records,
    noise: SensorNoise,
    request: PlanRequest,
    plan: PlanRecord,
    ranking: Option<Ranking>,
}

/// Plans a capture and checks what can be checked without a device: the session's name and
/// place, calibration records, what the camera sees of the sample, what the lights reach. Remarks go to `notice`.
///
/// # Errors
/// What refuses the capture.
pub fn prepare<'a>(
    rig: &'a ResolvedRig,
    request: &CaptureRequest,
    notice: &mut dyn FnMut(Notice<'_>),
) -> Result<Prepared<'a>, PrepareError> {
    let config = &rig.config;
    // The session's name and place.
    let sample = request.sample.clone();
    let sample = sample.unwrap_or_else(|| sample_name(config));
    let now = jiff::Timestamp::now();
    session_name(now, &sample, &short_id(now))?;
    check_creatable(&request.folder)?;

    // Calibration records.
    let records = Records::load(&Library::of_rig(rig), config)?;
    records.check(config, jiff::Timestamp::now(), notice);

    // What the camera sees.
    check_view(config, notice)?;
    let blur = depth_of_field::of_rig(config, records.focus())?;
    let limit_px = config.capture.blur_limit_px;
    if let Some(blur) = blur.filter(|blur| blur.worst.disc_px > limit_px) {
        notice(Notice::Blur { blur, limit_px });
    }
    let noise = match (request.only_plan, records.sensor_id()) {
        (true, None) => SensorNoise::usual(config.camera.bit_depth, config.camera.gain),
        _ => records.noise(config)?,
    };

    // The lights and the plan.
    let reach = StageReach::of_rig(config)?;
    let mut ranking = None;
    let lights = match &request.lights {
        Lights::Count(count) => LightChoice::Count(*count),
        Lights::All => LightChoice::Spacing(ALL_SPACING_DEG),
        Lights::Best(count) => {
            let found = light_choice::best(config, &reach, *count, notice)?;
            let lights = found.best.iter().map(|ranked| ranked.light).collect();
            ranking = Some(found);
            LightChoice::Listed(lights)
        }
        Lights::Listed(lights) => {
            check_each_once(lights)?;
            LightChoice::Listed(lights.clone())
        }
    };
    let mut plan_request = PlanRequest::of_rig(config, reach, lights);
    plan_request.rules.until = request.until;
    let planned = plan(&plan_request, &noise)?;
    check_lights(config, &planned.lights)?;
    let lights = towards_lens(config, &planned.lights);
    if !lights.is_empty() {
        notice(Notice::TowardsLens { lights });
    }
    Ok(Prepared {
        rig,
        sample,
        material: request.material.clone(),
        comment: request.comment.clone(),
        folder: request.folder.clone(),
        records,
        noise,
        request: plan_request,
        plan: planned,
        ranking,
    })
}

/// Lights of a plan that stand behind the sample, as the camera sees it.
fn towards_lens(config: &RigConfig, lights: &[StageAngles]) -> Vec<(usize, StageAngles, f64)> {
    let coaxial = config.geometry.coaxial();
    let lights = lights.iter().enumerate();
    lights
        .map(|(light, &angles)| {
            let off = angles.to_light().angle_between(coaxial).to_degrees();
            (light, angles, off)
        })
        .filter(|(.., off_deg)| *off_deg > 90.0)
        .collect()
}

impl Prepared<'_> {
    /// The plan, by the rig file's description of the camera.
    pub fn plan(&self) -> &PlanRecord {
        &self.plan
    }

    /// Of [`Lights::Best`]: what each light is expected to leave unknown.
    pub fn ranking(&self) -> Option<&Ranking> {
        self.ranking.as_ref()
    }

    /// Id of the sensor record that the estimates are made by.
    pub fn sensor_id(&self) -> Option<&str> {
        self.records.sensor_id()
    }

    /// Whether the disk has room for the session.
    ///
    /// # Errors
    /// [`CaptureError::NotEnoughSpace`].
    pub fn check_space(&self) -> Result<(), CaptureError> {
        let reserve_bytes = self.rig.config.capture.disk_reserve_bytes;
        check_space(&self.plan, &self.folder, reserve_bytes)
    }

    /// Makes the session on these devices. Nothing has moved afterwards either.
    ///
    /// # Errors
    /// The camera is not the rig file's, or the session cannot be written.
    pub fn begin(
        mut self,
        mut devices: Devices,
        notice: &mut dyn FnMut(Notice<'_>),
    ) -> Result<Job, PrepareError> {
        // The plan for the camera that is connected.
        let config = &self.rig.config;
        let camera = devices.camera.info().clone();
        let (is, stated) = (camera.resolution_px, config.camera.resolution_px);
        if is != stated {
            return Err(PrepareError::Resolution { is, stated });
        }
        let sensor_c = devices.camera.temperature_c();
        self.records.check_temperature(config, sensor_c, notice);
        let of_rig_file = self.request.rules.exposure;
        self.request.narrow_to(&camera);
        if self.request.rules.exposure != of_rig_file {
            self.plan = plan(&self.request, &self.noise)?;
        }

        // The session, with copies of all that it depends on.
        let created = jiff::Timestamp::now();
        let copies = self.records.copies();
        let record = SessionRecord {
            sample: self.sample,
            created_utc: created.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
            simulated: config.is_simulated(),
            true_material: true_material(config),
            material: self.material,
            comment: self.comment,
            seed: (config.simulation.as_ref()).map_or(config.fit.seed(), |s| s.seed),
            rig: self.rig.file.clone(),
            config: config.text.clone(),
            versions: Versions {
                rig: env!("CARGO_PKG_VERSION").to_owned(),
                camera,
                stage: devices.stage.info().clone(),
            },
            plan: self.plan,
            calibration: copies
                .iter()
                .filter(|copy| copy.is_record)
                .map(|copy| CalibrationCopy {
                    id: copy.name.trim_end_matches(".toml").to_owned(),
                    file: format!("{CALIBRATION_FOLDER}/{}", copy.name),
                    sha256: sha256_hex(&copy.bytes),
                })
                .collect(),
        };
        let records = copies.into_iter().map(|copy| (copy.name, copy.bytes));
        let calibration: Vec<_> = records.chain(scene_files(config)?).collect();
        let session = SessionWriter::create(
            Arc::new(SystemDisk),
            &NewSession {
                parent: &self.folder,
                created,
                short_id: &short_id(created),
                record: &record,
                calibration: &calibration,
            },
        )?;
        Job::new(config.clone(), devices, session, self.noise)
    }
}

/// An interrupted session that is ready to go on.
pub struct Interrupted {
    config: RigConfig,
    session: SessionWriter,
    noise: SensorNoise,
    begun: Vec<(StageAngles, bool)>,
}

/// Opens an interrupted session for writing. Files that no journal record names are moved
/// to its quarantine.
///
/// # Errors
/// The session or its copies of the calibration cannot be used, or another process has it.
pub fn resume(root: &Path) -> Result<Interrupted, PrepareError> {
    let session = Session::open(root)?;
    let config = session.rig()?;
    StageReach::of_rig(&config)?.check(&session.record().plan.lights)?;
    let begun = session.begun_lights();
    let session = SessionWriter::resume(Arc::new(SystemDisk), root)?;
    let copies = Library::Folder(root.join(CALIBRATION_FOLDER));
    Ok(Interrupted {
        noise: Records::noise_of_copies(&copies, &config)?,
        config,
        session,
        begun,
    })
}

impl Interrupted {
    /// The rig as it was.
    pub fn rig(&self) -> &RigConfig {
        &self.config
    }

    /// For [`OpenOptions::begun`](super::open::OpenOptions::begun).
    pub fn begun(&self) -> &[(StageAngles, bool)] {
        &self.begun
    }

    /// Whether files were moved to the quarantine just now.
    pub fn has_quarantined(&self) -> bool {
        let last = self.session.journal().records.last();
        matches!(
            last.map(|record| &record.event),
            Some(Event::Resume { quarantined: 1.. })
        )
    }

    /// Goes on with these devices.
    ///
    /// # Errors
    /// The scene cannot be built.
    pub fn go_on(self, devices: Devices) -> Result<Job, PrepareError> {
        Job::new(self.config, devices, self.session, self.noise)
    }
}

/// A capture with its session and its devices: all that remains is to run it.
pub struct Job {
    config: RigConfig,
    devices: Devices,
    session: SessionWriter,
    noise: Arc<SensorNoise>,
    region_of_interest: Vec<bool>,
    chooser: Option<Box<dyn Chooser>>,
}

impl Job {
    fn new(
        config: RigConfig,
        devices: Devices,
        session: SessionWriter,
        noise: SensorNoise,
    ) -> Result<Self, PrepareError> {
        let scene = config.geometry.scene(&[])?;
        Ok(Self {
            region_of_interest: region_of_interest::sample_pixels(&scene, &config.geometry.camera),
            noise: Arc::new(noise),
            config,
            devices,
            session,
            chooser: None,
        })
    }

    /// With the lights that follow those of the plan chosen by this.
    pub fn choosing_by(mut self, chooser: Box<dyn Chooser>) -> Self {
        self.chooser = Some(chooser);
        self
    }

    /// The session's folder.
    pub fn root(&self) -> &Path {
        self.session.root()
    }

    /// The rig.
    pub fn rig(&self) -> &RigConfig {
        &self.config
    }

    /// Whether the lamp stays on when the computer or the cable fails.
    pub fn lacks_watchdog(&self) -> bool {
        !self.config.is_simulated() && !self.devices.stage.info().has_watchdog
    }

    /// Captures and merges what the session does not hold yet. However it ends, the lamp is
    /// off; a session that was not finished can be resumed.
    ///
    /// # Errors
    /// What the capture met that it cannot go on with.
    pub fn run(
        self,
        observer: &mut dyn Observer,
        interrupt: Interrupt,
    ) -> Result<Outcome, CaptureError> {
        let Devices {
            stage,
            camera,
            bench,
        } = self.devices;
        let config = &self.config;
        let colours = config.stage.measures.iter().map(|m| m.colours()).collect();
        let sink = RadianceSink::new(
            Arc::clone(&self.noise),
            config.camera.mosaic,
            colours,
            self.session.root().to_owned(),
        );
        let outcome = Capture {
            camera,
            stage,
            session: self.session,
            reserve_bytes: config.capture.disk_reserve_bytes,
            position_tolerance_deg: config.stage.position_tolerance_deg(),
            pace: Pace::of_rig(config),
            noise: &self.noise,
            region_of_interest: Some(&self.region_of_interest),
            sink: Box::new(sink),
            chooser: self.chooser,
            observer,
            interrupt,
        }
        .run();
        // The simulated firmware ends after its stage.
        drop(bench);
        outcome
    }
}

/// Refuses a bench whose camera does not see the front of the sample.
fn check_view(config: &RigConfig, notice: &mut dyn FnMut(Notice<'_>)) -> Result<(), PrepareError> {
    let scene = config.geometry.scene(&[])?;
    for remark in scene.remarks() {
        notice(Notice::File(remark));
    }
    for concern in concerns_of(config, &scene) {
        if concern.concern.is_fatal() {
            return Err(Box::new(concern).into());
        }
        notice(Notice::View(&concern));
    }
    Ok(())
}

/// Refuses lights that reach nothing of what the camera sees.
fn check_lights(config: &RigConfig, lights: &[StageAngles]) -> Result<(), PrepareError> {
    for concern in concerns_of(config, &config.geometry.scene(lights)?) {
        if let Concern::Unlit { light, .. } = concern.concern {
            return Err(PrepareError::Unlit {
                concern: Box::new(concern),
                angles: lights[light],
            });
        }
    }
    Ok(())
}

fn concerns_of(config: &RigConfig, scene: &Scene) -> Vec<SceneConcern> {
    let seen = Visibility::of(scene);
    SceneConcern::all(&seen, DescribedIn::Rig, &config.geometry.sample.surface)
}

/// Refuses a direction that is named twice: its light would count as two.
fn check_each_once(lights: &[StageAngles]) -> Result<(), PrepareError> {
    for (number, &second) in lights.iter().enumerate() {
        let is_same =
            |first: &&StageAngles| first.to_light().distance(second.to_light()) < SAME_LIGHT_RAD;
        if let Some(&first) = lights[..number].iter().find(is_same) {
            return Err(PrepareError::SameLight { first, second });
        }
    }
    Ok(())
}

fn true_material(config: &RigConfig) -> Option<String> {
    let simulation = config.simulation.as_ref()?;
    Some(match &simulation.material {
        MaterialSpec::Bundled { source, name } => format!("{source}:{name}"),
        MaterialSpec::Brdf(_) => "the rig file's simulation.brdf".to_owned(),
    })
}

/// The bundled material's name on a simulated rig, else `sample`.
fn sample_name(config: &RigConfig) -> String {
    match config.simulation.as_ref().map(|s| &s.material) {
        Some(MaterialSpec::Bundled { name, .. }) => name.clone(),
        _ => "sample".to_owned(),
    }
}

/// Six hexadecimal digits that distinguish sessions begun in one second.
fn short_id(created: jiff::Timestamp) -> String {
    let key = format!("{} {}", created.as_nanosecond(), std::process::id());
    sha256_hex(key.as_bytes())[..6].to_owned()
}
