//! `rig capture`: from a plan to a session, its fit and its report.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use serde_json::json;

use super::capture_progress::Bar;
use super::capture_records::Records;
use super::output::{write_json, write_path};
use super::progress::duration;
use super::rig_choice::RigArg;
use super::{CliError, Context, HintExt, fit, interrupt, light_choice, open, preflight, sharpness};
use crate::calibration::Library;
use crate::capture::plan::{LightChoice, Pace, PlanRequest, check_space, plan};
use crate::capture::reach::StageReach;
use crate::capture::{Capture, Outcome, RadianceSink, Spent, interest};
use crate::config::RigConfig;
use crate::config::simulation::{MaterialSpec, Timing};
use crate::device::{CameraInfo, LampChannel};
use crate::interrupt::Signal;
use crate::out;
use crate::radiometry::sensor::SensorNoise;
use crate::session::commit::SystemDisk;
use crate::session::journal::sha256_hex;
use crate::session::layout::{CALIBRATION_FOLDER, QUARANTINE_FOLDER};
use crate::session::{
    CalibrationCopy, Event, ExposureRules, NewSession, PlanRecord, Session, SessionRecord,
    SessionWriter, Versions, scene_files,
};
use crate::units::{Seconds, StageAngles};
use crate::workflow::{FitWork, work_of};

/// Captures a sample under several lights, then fits and reports it
///
/// stdout's last line is the session's folder.
#[derive(clap::Args, Debug)]
pub struct CaptureArgs {
    #[command(flatten)]
    rig: RigArg,
    /// How many light directions (around the sample at several heights, past the camera's body);
    /// `all` that keep 15° between them; or `best:N`, those that tell most about an unknown material
    #[arg(long, value_name = "N|all|best:N", value_parser = parse_lights, required_unless_present_any = ["light", "resume"], conflicts_with_all = ["light", "resume"])]
    lights: Option<Lights>,
    /// One light direction, azimuth and elevation in degrees; may be repeated
    #[arg(long, value_name = "AZ,EL", value_parser = parse_angles, allow_hyphen_values = true, conflicts_with = "resume")]
    light: Vec<StageAngles>,
    /// Folder that receives the session's folder
    #[arg(
        long,
        value_name = "DIR",
        default_value = SESSIONS,
        conflicts_with = "resume"
    )]
    out: PathBuf,
    /// Name of the sample: letters, digits, dots, hyphens, underscores
    #[arg(long, value_name = "NAME", conflicts_with = "resume")]
    sample: Option<String>,
    /// Prints the plan with its estimates; nothing is opened and nothing moves
    #[arg(long, conflicts_with = "resume")]
    dry_run: bool,
    /// Go on with an interrupted session; plan and configuration are in it
    #[arg(long, value_name = "SESSION", conflicts_with = "rig")]
    resume: Option<PathBuf>,
    /// Capture and merge only
    #[arg(long)]
    no_fit: bool,
    /// The plan (with --dry-run) or the result as JSON
    #[arg(long)]
    json: bool,
}

/// Folder of the sessions where `--out` names no other.
pub(super) const SESSIONS: &str = "sessions";

/// `--lights`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lights {
    Count(usize),
    All,
    Best(usize),
}

impl CaptureArgs {
    /// `--rig simulated --lights COUNT --out OUT`.
    pub fn on_simulated_rig(count: usize, out: PathBuf) -> Self {
        Self {
            rig: RigArg {
                rig: Some("simulated".to_owned()),
            },
            lights: Some(Lights::Count(count)),
            light: Vec::new(),
            out,
            sample: None,
            dry_run: false,
            resume: None,
            no_fit: false,
            json: false,
        }
    }
}

/// Angle that `--lights all` keeps between two lights, degrees.
const ALL_SPACING_DEG: f64 = 15.0;

/// Directions closer than this are one, radians: 0.001°.
const SAME_LIGHT_RAD: f64 = 1.7e-5;

fn parse_lights(text: &str) -> Result<Lights, String> {
    if text == "all" {
        return Ok(Lights::All);
    }
    if let Some(count) = text.strip_prefix("best:") {
        return match count.parse() {
            Ok(count) if (1..=light_choice::CANDIDATES).contains(&count) => Ok(Lights::Best(count)),
            _ => Err(format!(
                "best:N takes a number N from 1 to {}",
                light_choice::CANDIDATES
            )),
        };
    }
    match text.parse() {
        Ok(count @ 1..=100_000) => Ok(Lights::Count(count)),
        _ => Err(format!(
            "a number from 1 to 100000, all, or best:N with N from 1 to {}",
            light_choice::CANDIDATES
        )),
    }
}

fn parse_angles(text: &str) -> Result<StageAngles, String> {
    let parsed = text.split_once(',').and_then(|(azimuth, elevation)| {
        let number = |text: &str| text.trim().parse().ok().filter(|x: &f64| x.is_finite());
        Some((number(azimuth)?, number(elevation)?))
    });
    let (azimuth_deg, elevation_deg) =
        parsed.ok_or("two numbers in degrees with a comma between, e.g. 40,35")?;
    Ok(StageAngles {
        azimuth_deg,
        elevation_deg,
    })
}

/// `rig capture`.
pub fn run(args: &CaptureArgs, context: &Context) -> Result<(), CliError> {
    match &args.resume {
        Some(root) => resume(args, root, context),
        None => start(args, context),
    }
}

fn start(args: &CaptureArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.rig.resolve(context)?;
    let config = &rig.config;
    let library = Library::of_rig(&rig);
    let records = Records::load(&library, config)?;
    for concern in records.concerns(config, jiff::Timestamp::now()) {
        context.warn(format_args!("{concern}"));
    }
    // What cannot be read, seen or fitted is said before anything moves.
    preflight::check_bench(config, context)?;
    let limit_px = config.capture.blur_limit_px;
    if let Some(found) = sharpness::of_rig(config, records.focus())?
        && let Some(concern) = sharpness::concern(&found, limit_px)
    {
        context.warn(format_args!("{concern}; {}", sharpness::REMEDY));
    }
    let noise = match (args.dry_run, records.sensor_id()) {
        (true, None) => SensorNoise::usual(config.camera.bit_depth, config.camera.gain),
        _ => records.noise(config)?,
    };
    let reach = StageReach::of_rig(config)?;
    let lights = light_choice(args, config, &reach, context)?;
    let request = request(&lights, config, &reach, None);
    let planned = plan(&request, &noise)?;
    preflight::check_lights(config, &planned.lights)?;
    let reserve_bytes = config.capture.disk_reserve_bytes;
    if args.dry_run {
        let fit = work_of(config, &planned.lights)?;
        print_plan(&planned, &fit, records.sensor_id(), args.json)?;
        return Ok(check_space(&planned, &args.out, reserve_bytes)?);
    }
    check_space(&planned, &args.out, reserve_bytes)?;
    let sample = args.sample.clone().unwrap_or_else(|| sample_name(config));
    let created = jiff::Timestamp::now();
    let short_id = short_id(created);
    // A name that cannot be is said before a device is touched.
    crate::session::layout::session_name(created, &sample, &short_id)?;

    let interrupt = interrupt::listen()?;
    let mut devices = open::open_devices(config, &[], || truth(config))?;
    let camera_info = devices.camera.info().clone();
    check_camera(&camera_info, config)?;
    let sensor_c = devices.camera.temperature_c();
    for concern in records.temperature_concerns(config, sensor_c) {
        context.warn(format_args!("{concern}"));
    }
    let request = self::request(&lights, config, &reach, Some(&camera_info));
    let planned = plan(&request, &noise)?;
    let copies = records.copies();
    let record = SessionRecord {
        sample,
        created_utc: created.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        simulated: config.is_simulated(),
        true_material: true_material(config),
        seed: config
            .simulation
            .as_ref()
            .map_or(config.fit.seed, |s| s.seed),
        rig: rig.file.clone(),
        config: config.text.clone(),
        versions: Versions {
            rig: env!("CARGO_PKG_VERSION").to_owned(),
            camera: camera_info,
            stage: devices.stage.info().clone(),
        },
        plan: planned,
        calibration: copies
            .iter()
            .filter(|(_, is_record, _)| *is_record)
            .map(|(name, _, bytes)| CalibrationCopy {
                id: name.trim_end_matches(".toml").to_owned(),
                file: format!("{CALIBRATION_FOLDER}/{name}"),
                sha256: sha256_hex(bytes),
            })
            .collect(),
    };
    let calibration: Vec<_> = copies
        .into_iter()
        .map(|(name, _, bytes)| (name, bytes))
        .chain(
            scene_files(config)
                .hint("`mesh`, `table` and `weights` in the rig file are relative to that file")?,
        )
        .collect();
    let writer = SessionWriter::create(
        Arc::new(SystemDisk),
        &NewSession {
            parent: &args.out,
            created,
            short_id: &short_id,
            record: &record,
            calibration: &calibration,
        },
    )?;
    carry_out(args, config, devices, writer, noise, interrupt, context)
}

fn resume(args: &CaptureArgs, root: &Path, context: &Context) -> Result<(), CliError> {
    let session = Session::open(root)?;
    let record = session.record().clone();
    let config = session.rig()?;
    StageReach::of_rig(&config)?.check(&record.plan.lights)?;
    let interrupt = interrupt::listen()?;
    let writer = SessionWriter::resume(Arc::new(SystemDisk), root)?;
    if let Some(Event::Resume { quarantined: 1.. }) =
        writer.journal().records.last().map(|r| &r.event)
    {
        let quarantine = root.join(QUARANTINE_FOLDER);
        context.warn(format!(
            "files that no journal record vouches for were moved to {}",
            quarantine.display()
        ));
    }
    let library = Library::Folder(root.join(CALIBRATION_FOLDER));
    let noise = Records::load_copies(&library)?.noise(&config)?;
    let has_frames = |light: u32| session.frames().any(|frame| frame.key.light == light);
    let begun: Vec<(StageAngles, bool)> = (0..)
        .zip(&record.plan.lights)
        .filter(|&(light, _)| has_frames(light))
        .map(|(light, &angles)| (angles, session.light_is_finished(light)))
        .collect();
    let devices = open::open_devices(&config, &begun, || truth(&config))?;
    carry_out(args, &config, devices, writer, noise, interrupt, context)
}

/// Captures, then fits and reports; prints the session's folder.
fn carry_out(
    args: &CaptureArgs,
    config: &RigConfig,
    devices: open::Devices,
    session: SessionWriter,
    noise: SensorNoise,
    interrupt: crate::interrupt::Interrupt,
    context: &Context,
) -> Result<(), CliError> {
    let root = session.root().to_owned();
    let began = Instant::now();
    let noise = Arc::new(noise);
    let scene = config.geometry.scene(&[])?;
    let sample = interest::sample_pixels(&scene, &config.geometry.camera);
    if !config.is_simulated() && !devices.stage.info().has_watchdog {
        context.warn(
            "the stage's firmware has no watchdog: if the computer or the cable fails, the lamp stays on",
        );
    }
    let colours = config.stage.measures.iter().map(|m| m.colours()).collect();
    let sink = RadianceSink::new(
        Arc::clone(&noise),
        config.camera.mosaic,
        colours,
        root.clone(),
    );
    let mut bar = Bar::new(context);
    let captured = Capture {
        camera: devices.camera,
        stage: devices.stage,
        session,
        reserve_bytes: config.capture.disk_reserve_bytes,
        position_tolerance_deg: config.stage.position_tolerance_deg(),
        pace: pace(config),
        noise: &noise,
        interest: Some(&sample),
        sink: Box::new(sink),
        observer: &mut bar,
        interrupt: interrupt.clone(),
    }
    .run();
    bar.finish();
    let elapsed_s = began.elapsed().as_secs_f64();
    let outcome = match captured {
        Ok(outcome) => outcome,
        Err(error) => {
            print_result(args, &root, Outcome::Interrupted, elapsed_s, bar.spent())?;
            return Err(suspended(error, &root));
        }
    };
    if outcome == Outcome::Interrupted {
        let signal = interrupt.signal().unwrap_or(Signal::Interrupt);
        print_result(args, &root, outcome, elapsed_s, bar.spent())?;
        return Err(
            CliError::interrupted(signal, "the capture was interrupted; the lamp is off")
                .hint(resume_hint(&root)),
        );
    }
    context.note(format!("captured in {elapsed_s:.1} s"));
    if let Some(spent) = bar.spent().filter(|_| !is_instant(config)) {
        context.note(spent.to_string());
    }
    if !args.no_fit {
        let unfitted = unfitted(args, &root);
        interrupt::end_on_signal(context, unfitted.clone())?;
        if let Some(signal) = interrupt.signal() {
            return Err(unfitted(signal));
        }
        fit::fit_and_report(&root, context)?;
    }
    print_result(args, &root, outcome, elapsed_s, bar.spent())
}

/// What marks a plan that no sensor record stands behind.
const NO_SENSOR_RECORD: &str =
    "estimated for a usual sensor, no sensor record: run `rig calibrate sensor`";

/// What `--dry-run --json` prints.
#[derive(serde::Serialize)]
struct PrintedPlan<'a> {
    #[serde(flatten)]
    plan: &'a PlanRecord,
    /// What the fit will have to do.
    fit: FitWork,
    /// The record that time and size are estimated by.
    sensor_record: Option<&'a str>,
    /// How they are estimated without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    estimated: Option<&'static str>,
}

/// Whether its clock jumps instead of waiting.
fn is_instant(config: &RigConfig) -> bool {
    let simulation = config.simulation.as_ref();
    simulation.is_some_and(|simulation| simulation.timing == Timing::Instant)
}

/// What a signal during the fit says: the capture itself is done.
fn unfitted(
    args: &CaptureArgs,
    root: &Path,
) -> impl Fn(Signal) -> CliError + Clone + Send + 'static {
    let (root, prints_path) = (root.to_owned(), !args.json);
    move |signal| {
        if prints_path {
            // Whoever reads stdout may be gone; the signal is what counts.
            drop(write_path(&root));
        }
        let root = root.display();
        CliError::interrupted(signal, "the fit was interrupted; the capture is complete").hint(
            format!("`rig fit {root}` and `rig report {root}` do the rest"),
        )
    }
}

fn resume_hint(root: &Path) -> String {
    format!("`rig capture --resume {}` continues it", root.display())
}

/// What a capture met that cannot go on now; its session can be resumed.
fn suspended(error: crate::capture::CaptureError, root: &Path) -> CliError {
    let error = CliError::from(error);
    let advice = match error.advice() {
        Some(advice) => format!("{advice}; then {}", resume_hint(root)),
        None => resume_hint(root),
    };
    CliError::new(format!("the capture is suspended: {}", error.fact())).hint(advice)
}

fn print_result(
    args: &CaptureArgs,
    root: &Path,
    outcome: Outcome,
    elapsed_s: f64,
    spent: Option<Spent>,
) -> Result<(), CliError> {
    if args.json {
        let summary = Session::open(root)?.summary();
        return write_json(&json!({
            "session": root.to_string_lossy(),
            "complete": outcome == Outcome::Complete,
            "elapsed_s": elapsed_s,
            "spent": spent,
            "wall_over_devices": spent.and_then(|spent| spent.over_devices()),
            "wall_over_plan": spent.and_then(|spent| spent.over_plan()),
            "summary": summary,
        }));
    }
    write_path(root)
}

/// `sensor_id` is the record that exposures and time are estimated by; without one they are
/// estimated for a usual sensor, and marked.
fn print_plan(
    plan: &PlanRecord,
    fit: &FitWork,
    sensor_id: Option<&str>,
    as_json: bool,
) -> Result<(), CliError> {
    if as_json {
        return write_json(&PrintedPlan {
            plan,
            fit: *fit,
            sensor_record: sensor_id,
            estimated: sensor_id.is_none().then_some(NO_SENSOR_RECORD),
        });
    }
    let mark = match sensor_id {
        Some(_) => String::new(),
        None => format!(" ({NO_SENSOR_RECORD})"),
    };
    let rules = &plan.exposure;
    let channels = plan.channels.len();
    out!("{} lights, {channels} lamp channels", plan.lights.len())?;
    for (light, angles) in plan.lights.iter().enumerate() {
        out!("  light {light}: {angles}")?;
    }
    out!(
        "exposures {} to {}, neighbours at most {} times as long, up to {} frames averaged",
        rules.shortest_s,
        rules.longest_s,
        rules.ratio,
        rules.max_frames
    )?;
    out!(
        "chosen from pilot frames so that no pixel of the sample is saturated and dark ones reach a signal-to-noise ratio of {}",
        rules.dark_snr
    )?;
    out!(
        "about {} on the bench, {} merged images and {:.1} MB for a scene of usual contrast{mark}",
        duration(plan.estimated_s.0),
        plan.lights.len(),
        plan.estimated_bytes as f64 / 1e6
    )?;
    out!("then a fit: {fit}")
}

/// The directions that the command line asks for.
fn light_choice(
    args: &CaptureArgs,
    config: &RigConfig,
    reach: &StageReach,
    context: &Context,
) -> Result<LightChoice, CliError> {
    Ok(match args.lights {
        Some(Lights::Count(count)) => LightChoice::Count(count),
        Some(Lights::All) => LightChoice::Spacing(ALL_SPACING_DEG),
        Some(Lights::Best(count)) => LightChoice::Listed(light_choice::best(
            config,
            reach,
            config.geometry.coaxial(),
            count,
            context,
        )?),
        None => LightChoice::Listed(each_once(&args.light)?),
    })
}

/// What a capture is planned from. The camera's own limits count once it is known.
/// Refuses a direction that is named twice: its light would count as two.
fn each_once(lights: &[StageAngles]) -> Result<Vec<StageAngles>, CliError> {
    for (number, angles) in lights.iter().enumerate() {
        let same =
            |other: &&StageAngles| other.to_light().distance(angles.to_light()) < SAME_LIGHT_RAD;
        if let Some(other) = lights[..number].iter().find(same) {
            let fact = match other == angles {
                true => format!("--light names the direction {angles} twice"),
                false => format!("--light names one direction twice: {other} and {angles}"),
            };
            return Err(CliError::new(fact).hint(
                "name each direction once; how well a light repeats, `rig stage repeatability` tells",
            ));
        }
    }
    Ok(lights.to_vec())
}

fn request(
    lights: &LightChoice,
    config: &RigConfig,
    reach: &StageReach,
    camera: Option<&CameraInfo>,
) -> PlanRequest {
    let capture = &config.capture;
    let [mut shortest, mut longest] = capture.exposure_range;
    let mut step = config.camera.exposure_step;
    if let Some(camera) = camera {
        shortest = Seconds(shortest.0.max(camera.exposure_range[0].0));
        longest = Seconds(longest.0.min(camera.exposure_range[1].0).max(shortest.0));
        step = Seconds(step.0.max(camera.exposure_step.0));
    }
    // On a bench whose clock jumps, nothing needs to settle.
    let is_instant = is_instant(config);
    let wait = |time: Seconds| if is_instant { Seconds(0.0) } else { time };
    PlanRequest {
        lights: lights.clone(),
        reach: reach.clone(),
        coaxial: config.geometry.coaxial(),
        channels: (0..config.stage.measures.len() as u8)
            .map(LampChannel)
            .collect(),
        gain: config.camera.gain,
        exposure: ExposureRules {
            // In the middle of the range, as ratios go.
            pilot_s: Seconds(on_step((shortest.0 * longest.0).sqrt(), step.0)),
            shortest_s: shortest,
            longest_s: longest,
            step_s: step,
            peak_fraction: capture.peak_fraction,
            dark_snr: capture.snr,
            ratio: capture.exposure_ratio,
            max_frames: capture.max_frames,
            ambient: capture.ambient,
            dark_frames: capture.dark_frames,
        },
        settle: wait(capture.settle),
        lamp_settle: wait(capture.lamp_settle),
        lamp_warm_up: wait(capture.lamp_warm_up),
        settings_latency_frames: config.camera.settings_latency_frames,
        revisit_first: capture
            .revisit_first
            .unwrap_or(config.stage.driver_name() != "manual"),
        stage_tolerance_deg: config.stage.position_tolerance_deg().unwrap_or(0.0),
        limits: config.limits.temperature,
        resolution_px: config.camera.resolution_px,
        pace: pace(config),
    }
}

/// A simulated bench computes for so long what a light shows, on two processors.
const SIMULATED_VIEW_S: f64 = 2.0;

/// How fast this bench is.
fn pace(config: &RigConfig) -> Pace {
    let (stage_deg_s, homing) = config.stage.pace();
    let simulation = config.simulation.as_ref();
    Pace {
        stage_deg_s,
        homing,
        frame_interval: Seconds(simulation.map_or(1.0 / 30.0, |s| s.camera.frame_interval_s)),
        view: Seconds(simulation.map_or(0.0, |_| SIMULATED_VIEW_S)),
    }
}

fn on_step(exposure_s: f64, step_s: f64) -> f64 {
    (exposure_s / step_s).round().max(1.0) * step_s
}

fn check_camera(info: &CameraInfo, config: &RigConfig) -> Result<(), CliError> {
    let wanted = config.camera.resolution_px;
    if info.resolution_px == wanted {
        return Ok(());
    }
    let size = |[width, height]: [u32; 2]| format!("{width} x {height}");
    Err(CliError::new(format!(
        "the camera gives frames of {}, the rig file says {}",
        size(info.resolution_px),
        size(wanted)
    ))
    .hint("correct camera.resolution_px in the rig file; `rig camera info` shows what the camera offers"))
}

fn truth(config: &RigConfig) -> Result<Arc<dyn mock_devices::RadianceSource>, CliError> {
    match config.truth()? {
        Some(source) => Ok(source),
        None => Err(CliError::new(
            "the rig is not simulated, so it has no simulated scene",
        )),
    }
}

fn true_material(config: &RigConfig) -> Option<String> {
    config
        .simulation
        .as_ref()
        .map(|simulation| match &simulation.material {
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

/// Six hexadecimal digits that keep apart sessions begun in one second.
fn short_id(created: jiff::Timestamp) -> String {
    let key = format!("{} {}", created.as_nanosecond(), std::process::id());
    sha256_hex(key.as_bytes())[..6].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::BUILT_IN;
    use glam::DVec3;

    #[test]
    fn lights_are_a_number_or_all_or_the_best() {
        assert_eq!(parse_lights("4"), Ok(Lights::Count(4)));
        assert_eq!(parse_lights("all"), Ok(Lights::All));
        assert_eq!(parse_lights("best:6"), Ok(Lights::Best(6)));
        for bad in ["0", "-1", "four", "1.5", "", "1000000", "best", "Best:3"] {
            assert!(parse_lights(bad).is_err(), "{bad}");
        }
        for bad in [
            "best:0",
            "best:x",
            "best:1000",
            "best:",
            "best:-1",
            "best:2.5",
        ] {
            let error = parse_lights(bad).unwrap_err();
            assert!(error.contains("from 1 to 60"), "{bad}: {error}");
        }
        assert!(parse_angles("-40, 35.5").is_ok());
        for bad in ["40", "a,b", "nan,1", "1,2,3", ""] {
            assert!(parse_angles(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_shipped_rig_sees_the_sample_along_the_zenith() {
        let rig = RigConfig::parse("simulated", Path::new(""), BUILT_IN[0].1).unwrap();
        assert!((rig.geometry.coaxial() - DVec3::Z).length() < 1e-9);
    }
}
