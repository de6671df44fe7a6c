//! What a design is handed on as: scene, lamps, surface, drawing and figures.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::{DesignRequest, FINAL, Found, Lamp, VIEW, drawing, solid};
use crate::geometry::{Mesh, MeshError, files};
use crate::transport::Light;
use crate::whole_file;

/// Why a design could not be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum WriteError {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("{}: {source}", path.display())]
    File {
        path: PathBuf,
        source: std::io::Error,
    },
}

/// Facets around the surface that is written.
const SEGMENTS: u32 = 256;
/// Steps from the axis to the rim of what is made: chords lie within 0.01 mm of a surface of
/// 20 mm radius.
const PART_STEPS: u32 = 48;

/// Writes into `folder`, which is made: `scene.toml` with `sample.ply`, `lights.txt`, the parts
/// to make as STL, `drawing.svg` and `design.json`. Returns their paths.
///
/// # Errors
/// A file that cannot be written.
pub fn write(
    folder: &Path,
    found: &Found,
    request: &DesignRequest,
) -> Result<Vec<PathBuf>, WriteError> {
    let file_error = |path: &Path| {
        let path = path.to_owned();
        move |source| WriteError::File { path, source }
    };
    std::fs::create_dir_all(folder).map_err(file_error(folder))?;
    let mesh = found.profile.mesh(&request.limits, SEGMENTS)?;
    let mut written = vec![folder.join("sample.ply")];
    files::write(&written[0], &mesh)?;
    for part in solid::parts(&found.profile, &request.limits, PART_STEPS)? {
        let path = folder.join(format!("{}.stl", part.name));
        files::write(&path, &part.solid)?;
        written.push(path);
    }
    let figures = serde_json::json!({
        "images": request.images,
        "limits": request.limits,
        "tolerance": request.tolerance,
        "profile_height_and_slope": found.profile.knots,
        "steepest_deg": found.profile.steepest_deg(),
        "smallest_radius_mm": found.profile.smallest_radius_mm(&request.limits),
        "depth_mm": found.profile.depth(found.design.camera_tilt_deg) * request.limits.radius_mm,
        "seed": request.seed,
        "theta_d_bands_deg": crate::inverse::expected_error::BANDS_DEG,
        "design": found.design,
        "compared_with": found.others,
    });
    let texts = [
        ("scene.toml", scene(found, mesh, request)),
        ("lights.txt", lights(&found.design.lights)),
        ("drawing.svg", drawing::svg(found, request)),
        ("design.json", format!("{figures:#}\n")),
    ];
    for (name, text) in texts {
        let path = folder.join(name);
        whole_file::replace(&path, |file| file.write_all(text.as_bytes()))
            .map_err(file_error(&path))?;
        written.push(path);
    }
    Ok(written)
}

/// Lamps as `rig capture --lights FILE` reads them.
fn lights(lights: &[Lamp]) -> String {
    let mut text = "# azimuth, elevation, degrees\n".to_owned();
    for lamp in lights {
        let _ = writeln!(
            text,
            "{},{}",
            lamp.angles.azimuth_deg, lamp.angles.elevation_deg
        );
    }
    text
}

fn scene(found: &Found, mesh: Mesh, request: &DesignRequest) -> String {
    let tilt_deg = found.design.camera_tilt_deg;
    let camera = request.scene(mesh, tilt_deg, FINAL[0]).camera;
    let place = camera.sample_from_camera;
    let mut text = format!(
        "[camera]\nmodel = \"orthographic\"\nresolution_px = [64, 64]\nextent_mm = [{extent}, {extent}]\n\
         position_mm = {:?}\nlook_at_mm = {:?}\nup = {:?}\n\n\
         [sample]\nmesh = \"sample.ply\"\nshading = \"smooth\"\n",
        place.point(DVec3::ZERO).to_array(),
        place.point(camera.focus_mm * DVec3::Z).to_array(),
        place.direction(-DVec3::Y).to_array(),
        extent = VIEW * request.limits.radius_mm,
    );
    for lamp in &found.design.lights {
        let light = match lamp.light {
            Light::Directional { to_light, .. } => {
                format!(
                    "kind = \"directional\"\nto_light = {:?}\n",
                    to_light.to_array()
                )
            }
            Light::Point {
                position_mm,
                intensity_mm2,
            } => format!(
                "kind = \"point\"\nposition_mm = {:?}\nintensity = {intensity_mm2:?}\n",
                position_mm.to_array()
            ),
        };
        let _ = write!(text, "\n[[light]]\n{light}");
    }
    text
}
