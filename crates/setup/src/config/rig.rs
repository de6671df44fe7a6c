//! The rig file: everything that one bench is and how it is used.

use std::path::Path;

use super::ConfigError;
use super::camera::{CameraConfig, CameraDriver};
use super::fit::FitRequest;
use super::geometry::GeometryConfig;
use super::lab::LabConfig;
use super::limits::LimitsConfig;
use super::process::{CalibrationConfig, CaptureConfig, read_fit};
use super::reader::Section;
use super::simulation::{SimulationConfig, Timing};
use super::stage::{StageConfig, StageDriver};
use super::view::{SurfaceSpec, with_lens};
use crate::bench_priors::BenchPriors;
use crate::geometry::Shape;

/// A rig file, parsed and valid.
#[derive(Clone, Debug, PartialEq)]
pub struct RigConfig {
    /// Name of the bench; also the folder of its calibration records.
    pub name: String,
    /// The camera.
    pub camera: CameraConfig,
    /// The light stage and its lamp.
    pub stage: StageConfig,
    /// Where camera, sample and stage are.
    pub geometry: GeometryConfig,
    /// How a capture is done.
    pub capture: CaptureConfig,
    /// How warm the devices may become.
    pub limits: LimitsConfig,
    /// How a session is fitted by default.
    pub fit: FitRequest,
    /// How well the bench is known.
    pub uncertainty: BenchPriors,
    /// Which calibration records belong to it.
    pub calibration: CalibrationConfig,
    /// Who measures.
    pub lab: LabConfig,
    /// The simulated bench; there if and only if the camera is simulated.
    pub simulation: Option<SimulationConfig>,
    /// The file's text as it was read, for the session.
    pub text: String,
}

impl RigConfig {
    /// Reads a rig file; paths in it are relative to it.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = super::read_text(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(&path.display().to_string(), folder, &text)
    }

    /// Reads a rig from text; `file` is what errors call it.
    pub fn parse(file: &str, folder: &Path, text: &str) -> Result<Self, ConfigError> {
        Self::read(&mut Section::parse(file, folder, text)?, text)
    }

    /// Whether its devices are simulated.
    pub fn is_simulated(&self) -> bool {
        self.simulation.is_some()
    }

    /// Whether it is simulated with a clock that jumps instead of waiting.
    pub fn is_instant(&self) -> bool {
        let simulation = self.simulation.as_ref();
        simulation.is_some_and(|simulation| simulation.timing == Timing::Instant)
    }

    pub(super) fn read(root: &mut Section, text: &str) -> Result<Self, ConfigError> {
        let mut rig = root.section("rig")?.required()?;
        let name = rig.parsed("name", NAME, valid_name)?.required()?;
        rig.finish()?;
        let camera = CameraConfig::read(root.section("camera")?.required()?)?;
        let stage = StageConfig::read(root.section("stage")?.required()?)?;
        let simulated_camera = camera.driver == CameraDriver::Simulated;
        // A person can stand at a simulated bench, too.
        let goes_with_it = match &stage.driver {
            StageDriver::Manual(_) => true,
            _ => stage.is_simulated() == simulated_camera,
        };
        if !goes_with_it {
            let driver = stage.driver_name();
            let allowed = "simulated together with the camera or not at all, or manual";
            return Err(root.conflict("stage.driver", format!("{driver:?}"), allowed));
        }
        let simulation = root.section("simulation")?.optional();
        let simulation = match (simulation, simulated_camera) {
            (Some(table), true) => Some(SimulationConfig::read(table, &camera)?),
            (None, false) => None,
            (None, true) => {
                return Err(root.missing("simulation", "a table, because the camera is simulated"));
            }
            (Some(_), false) => {
                let allowed = "absent unless the camera is simulated";
                return Err(root.conflict("simulation", "given", allowed));
            }
        };
        let geometry = GeometryConfig::read(
            root.section("geometry")?.required()?,
            &camera,
            &stage.kinematics(),
        )?;
        if let Some(lens) = simulation
            .as_ref()
            .and_then(|simulation| simulation.lens.mapping)
        {
            with_lens(geometry.camera, lens, root, "simulation.lens.radial")?;
        }
        let mut uncertainty = super::uncertainty::read(root.section_or_empty("uncertainty")?)?;
        if matches!(
            geometry.sample.surface,
            SurfaceSpec::Shape(Shape::Sphere { .. })
        ) {
            // A ball has a place and no orientation: not 0, which would call the place exact, too.
            uncertainty.rotation_rad = uncertainty.rotation_rad.min(BALL_ROTATION_RAD);
        }
        let capture = root.section_or_empty("capture")?;
        let config = Self {
            name,
            capture: CaptureConfig::read(capture, &camera)?,
            camera,
            stage,
            geometry,
            limits: LimitsConfig::read(root.section_or_empty("limits")?)?,
            fit: read_fit(root.section_or_empty("fit")?)?,
            uncertainty,
            calibration: CalibrationConfig::read(root.section_or_empty("calibration")?)?,
            lab: LabConfig::read(root.section_or_empty("lab")?)?,
            simulation,
            text: text.to_owned(),
        };
        root.check_finished()?;
        Ok(config)
    }
}

/// By how much a ball may be turned against the description, radians.
const BALL_ROTATION_RAD: f64 = 1e-6;

const NAME: &str = "1 to 40 of a-z, 0-9 and -, because it names a folder";

fn valid_name(text: &str) -> Option<String> {
    let allowed = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
    ((1..=40).contains(&text.len()) && text.bytes().all(allowed)).then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;
    use crate::config::BUILT_IN;
    use crate::config::stage::StageDriver;

    fn simulated() -> &'static str {
        BUILT_IN[0].1
    }

    fn parse(text: &str) -> Result<RigConfig, ConfigError> {
        RigConfig::parse("rig.toml", Path::new(""), text)
    }

    /// Dotted paths of the keys a file has, set or commented out.
    fn written(text: &str) -> BTreeSet<String> {
        let mut table = String::new();
        let mut keys = BTreeSet::new();
        for line in text.lines() {
            let line = line.trim_start_matches(['#', ' ']);
            if let Some(header) = line.strip_prefix("[[") {
                table = format!("{}[]", header.trim_end_matches(']'));
            } else if let Some(header) = line.strip_prefix('[') {
                table = header.trim_end_matches(']').to_owned();
            } else if let Some((key, _)) = line.split_once(" = ")
                && !key.contains(' ')
            {
                keys.insert(format!("{table}.{key}"));
            }
        }
        keys
    }

    /// Every key that the readers request, in every variant, stands in a
    /// commented file; what a scene file also has (`brdf`, a body's surface) is explained there.
    #[test]
    fn the_commented_files_name_every_key() {
        let mut asked = BTreeSet::new();
        let shape = "kind = \"bowl\"";
        let perspective = simulated()
            .replace("model = \"orthographic\"", "model = \"perspective\"")
            .replace("extent_mm = [29.3, 22.0]", "fov_deg = 12.0");
        let mut texts: Vec<_> = BUILT_IN
            .iter()
            .map(|(_, text)| (*text).to_owned())
            .collect();
        texts.push(perspective);
        let arc = "mechanism = \"arc\"\nradius_mm = 400.0";
        texts.push(
            BUILT_IN[1]
                .1
                .replace("driver = \"grbl\"", &format!("driver = \"grbl\"\n{arc}")),
        );
        for other in [
            "kind = \"cap\"",
            "kind = \"cap\"\nopening_deg = 60",
            "kind = \"ridge\"",
            "kind = \"ridge\"\nform = \"extruded\"\nlength_mm = 20",
            "kind = \"designed\"\nlength_mm = 3",
            "kind = \"tetrahedron\"\ndepth_mm = 3",
            "kind = \"groove\"\nwidth_mm = 3",
        ] {
            texts.push(simulated().replace(shape, other));
        }
        for other in [
            "driver = \"command\"\ncommand = \"photo {exposure_s} {output}\"",
            "driver = \"folder\"\nfolder = \"in\"",
            "driver = \"gphoto2\"\nbody = \"port = any\"",
        ] {
            texts.push(simulated().replacen("driver = \"simulated\"", other, 1));
        }
        let body = "[[geometry.body]]\nmesh = \"holder.obj\"\nbrdf = { table = \"paint.binary\" }";
        let stage = "[geometry.sample_from_stage]";
        texts.push(simulated().replace(stage, &format!("{body}\n{stage}")));
        let mesh = "[geometry.sample]\nmesh = \"scan.ply\"";
        texts.push(
            simulated()
                .replace("[geometry.sample]", mesh)
                .replace("[geometry.sample.shape]", "[geometry.sample.no_shape]"),
        );
        for text in texts {
            let mut root = Section::parse("rig.toml", Path::new(""), &text).unwrap();
            // The tetrahedron refuses `segments`; what it read is recorded all the same.
            let _ = RigConfig::read(&mut root, &text);
            asked.extend(root.vocabulary());
        }
        let mut written: BTreeSet<_> = BUILT_IN
            .iter()
            .flat_map(|(_, text)| written(text))
            .collect();
        let tables: BTreeSet<_> = asked
            .iter()
            .filter(|key| {
                let inside = [format!("{key}."), format!("{key}[].")];
                asked
                    .iter()
                    .any(|other| inside.iter().any(|table| other.starts_with(table)))
            })
            .cloned()
            .collect();
        let missing: Vec<_> = asked
            .difference(&tables)
            .filter(|key| !written.contains(*key) && !key.starts_with("geometry.body[]."))
            .collect();
        assert!(missing.is_empty(), "in no commented file: {missing:?}");
        written.retain(|key| !asked.contains(key));
        assert!(written.is_empty(), "no such keys: {written:?}");
        assert!(
            asked.len() > 100,
            "only {} keys were asked for",
            asked.len()
        );
    }

    #[test]
    fn the_simulated_rig_reads_as_written() {
        let rig = parse(simulated()).unwrap();
        assert!(rig.is_simulated());
        assert_eq!(rig.camera.resolution_px, [640, 480]);
        assert_eq!(rig.fit.samples_per_cell, Some(160));
        let StageDriver::Simulated(grbl) = &rig.stage.driver else {
            panic!("not simulated");
        };
        assert_eq!(grbl.lamp_on, [["M3 S1000"], ["M7"], ["M8"]]);
        assert_eq!(grbl.lamp_off, ["M5", "M9"]);
        assert_eq!(grbl.kinematics.first.position(-180.0), 0.0);
        assert_eq!(rig.text, simulated());
    }

    #[test]
    fn the_shipped_rig_sees_the_sample_along_the_zenith() {
        let rig = parse(simulated()).unwrap();
        assert!((rig.geometry.coaxial() - glam::DVec3::Z).length() < 1e-9);
    }

    /// What the shipped file states of a bowl's orientation says nothing of a ball's.
    #[test]
    fn a_ball_has_a_place_and_no_orientation() {
        let of = |name: &str| {
            let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name).unwrap();
            parse(text).unwrap().uncertainty
        };
        let [ball, ridge] = ["simulated-ball", "simulated-tilted"].map(of);
        assert!(ball.rotation_rad <= 1e-6 && ridge.rotation_rad > 1e-3);
        assert_eq!(ball.translation_mm, ridge.translation_mm);
    }

    #[test]
    fn bad_rigs_are_refused_with_the_place() {
        // A change of the simulated rig, and what is said of it.
        const CASES: &str = r#"
name = "simulated" => name = "../x" | `rig.name` is "../x"
object_na = 0.0 => radial = [-0.5, 0, 0] | `geometry.camera.radial` is [-0.5, 0.0, 0.0], but must be another distortion
object_na = 0.0 => principal_point_px = [641.0, 2.0] | `geometry.camera.principal_point_px` is [641, 2], but must be within the image
[simulation.lens] => [simulation.lens]\nradial = [-1.0, 0.0, 0.0] | `simulation.lens.radial` is [-1.0, 0.0, 0.0], but must be another distortion
bit_depth = 12 => bit_depth = 32 | `camera.bit_depth` is 32, but must be an integer from 8 to 16
driver = "simulated" => driver = "nikon" | `camera.driver` is "nikon", but must be "v4l" or "command" or "folder" or "gphoto2"
axis = "Y" => axis = "X" | `stage.elevation.axis` is X, but must be another axis
max_deg = 90.0 => max_deg = 10.0 | `stage.elevation.max_deg` is 10, but must be at least min_deg (45)
measures = "G" => measures = "R" | `stage.lamp[1].measures` is R, but must be a colour that no earlier
on = "M7" => on = "M7!" | `stage.lamp[1].on` is "M7!"
longest_ms = 500.0 => longest_ms = 5000.0 | `capture.longest_ms` is 5000, but must be a number from 0.05 to 2000
driver = "simulated" => driver = "command"\ncommand = "photo {output}" | `camera.command` is "photo {output}", but must be a program with
driver = "simulated" => driver = "v4l"\ndevice = "/dev/video0"\ncontrols = "exposure = 3" | `camera.controls` is "exposure = 3", but must be
material = => # | `simulation.material` is missing
scale = 1.0 => scale = 0.0 | `stage.azimuth.scale` is 0, but must be away from 0
[fit] => [fits] | unknown key `fits`
# model_error = 0.01 => model_error = 2 | `fit.model_error` is 2, but must be a number from 0 to 1
optimizer = "gauss-newton" => optimizer = "adam" | `fit.optimizer` is "adam", but must be "gauss-newton" or
refine_bench = false => mask = "m.png" | unknown key `fit.mask`
driver = "simulated" => driver = "v4l"\ndevice = "/dev/video0"\nformat = "Y12 " | `stage.driver` is "simulated", but must be simulated together
"#;
        for case in CASES.trim().lines() {
            let (change, expected) = case.split_once(" | ").unwrap();
            let (good, bad) = change.split_once(" => ").unwrap();
            assert!(simulated().contains(good), "{good}");
            let changed = simulated().replacen(good, &bad.replace("\\n", "\n"), 1);
            let error = parse(&changed).unwrap_err().to_string();
            assert!(error.contains(expected), "{bad}: {error}");
        }
    }

    proptest! {
        /// Whatever is typed over a piece of a rig file, it is read or refused,
        /// and an error has a line of the file.
        #[test]
        fn a_mistyped_file_is_read_or_refused(
            at in 0..simulated().len(),
            length in 0usize..40,
            typed in "[a-z0-9 .=\\[\\]{}\"'#\n-]{0,12}",
        ) {
            let at = simulated().floor_char_boundary(at);
            let end = simulated().floor_char_boundary(at + length).max(at);
            let text = format!("{}{typed}{}", &simulated()[..at], &simulated()[end..]);
            let line = match parse(&text) {
                Ok(_) => 1,
                Err(
                    ConfigError::Syntax { line, .. }
                    | ConfigError::UnknownKey { line, .. }
                    | ConfigError::Missing { line, .. }
                    | ConfigError::Invalid { line, .. },
                ) => line,
                Err(other) => return Err(TestCaseError::fail(other.to_string())),
            };
            prop_assert!((1..=1 + text.matches('\n').count()).contains(&line), "line {line}");
        }
    }
}
