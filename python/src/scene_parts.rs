//! Camera, lights and meshes of a scene, as Python's Camera, Light and Mesh.

use glam::{DVec3, Vec3};
use pyo3::prelude::*;
use rig_core::geometry::Mesh;
use rig_core::transport::{Camera, Light, Projection};

use crate::arrays;
use crate::errors::input;
use crate::records::record;

/// Python's Camera.
pub fn camera_record(py: Python<'_>, camera: &Camera) -> PyResult<Py<PyAny>> {
    let [width, height] = camera.resolution_px;
    let (extent_mm, fov_deg) = match camera.projection {
        Projection::Orthographic { extent_mm } => (Some(extent_mm.to_array()), None),
        Projection::Perspective { fov_rad } => (None, Some(fov_rad.to_degrees())),
    };
    let place = &camera.sample_from_camera;
    let position_mm = place.point(DVec3::ZERO);
    let look_at_mm = place.point(DVec3::Z * camera.focus_mm);
    let lens = (!camera.lens.is_ideal()).then(|| camera.lens.spec());
    let principal_point_px = lens.map(|lens| {
        let [x, y] = (lens.principal_offset + 0.5).to_array();
        [x * width as f64, y * height as f64]
    });
    let vector = |values: &[f64]| arrays::array(py, values.to_vec(), &[values.len()]);
    record!(
        py,
        "Camera",
        resolution_px = (width, height),
        position_mm = vector(&position_mm.to_array())?,
        extent_mm = extent_mm.map(|extent| vector(&extent)).transpose()?,
        fov_deg = fov_deg,
        look_at_mm = vector(&look_at_mm.to_array())?,
        up = vector(&place.direction(DVec3::NEG_Y).to_array())?,
        object_na = camera.object_na,
        focus_mm = camera.focus_mm,
        point_spread_px = camera.point_spread_px,
        principal_point_px = principal_point_px.map(|point| vector(&point)).transpose()?,
        pixel_aspect = lens.map(|lens| lens.aspect),
        radial = lens
            .map(|lens| vector(&lens.distortion.radial))
            .transpose()?,
        tangential = lens
            .map(|lens| vector(&lens.distortion.tangential))
            .transpose()?,
    )
}

/// Python's Light.
pub fn light_record(py: Python<'_>, light: &Light) -> PyResult<Py<PyAny>> {
    let vector = |values: [f64; 3]| arrays::array(py, values.to_vec(), &[3]);
    match *light {
        Light::Directional {
            to_light,
            irradiance,
            angular_radius_rad,
        } => record!(
            py,
            "Light",
            to_light = vector(to_light.to_array())?,
            irradiance = vector(irradiance)?,
            angular_radius_deg = angular_radius_rad.to_degrees(),
        ),
        Light::Point {
            position_mm,
            intensity_mm2,
        } => record!(
            py,
            "Light",
            position_mm = vector(position_mm.to_array())?,
            intensity = vector(intensity_mm2)?,
        ),
    }
}

/// Python's Mesh, which takes the corners over.
pub fn mesh_record(py: Python<'_>, mesh: Mesh) -> PyResult<Py<PyAny>> {
    let vectors = |vectors: Vec<Vec3>| {
        let rows: Vec<[f32; 3]> = vectors.iter().map(Vec3::to_array).collect();
        let count = rows.len();
        arrays::triples(py, rows, &[count])
    };
    let facets = mesh.triangles.len();
    record!(
        py,
        "Mesh",
        vertices_mm = vectors(mesh.positions_mm)?,
        triangles = arrays::triples(py, mesh.triangles, &[facets])?,
        normals = mesh.normals.map(vectors).transpose()?,
    )
}

/// The mesh of Python's Mesh; `None` of anything else.
///
/// # Errors
/// Arrays of another shape, corners that are none, facets without area.
pub fn mesh_of(value: &Bound<'_, PyAny>) -> PyResult<Option<Mesh>> {
    let records = value.py().import("rig_reflectometry.records")?;
    if !value.is_instance(&records.getattr("Mesh")?)? {
        return Ok(None);
    }
    let vectors = |name: &str| -> PyResult<Vec<Vec3>> {
        let rows = arrays::rows_of_three(&value.getattr(name)?, name)?;
        Ok(rows
            .into_iter()
            .map(|row| DVec3::from(row).as_vec3())
            .collect())
    };
    let corner = |index: f64| match index {
        whole if whole.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&whole) => {
            Ok(whole as u32)
        }
        other => Err(input(format!(
            "triangles has {other}, which is no index of a vertex"
        ))),
    };
    let mut triangles = Vec::new();
    for [a, b, c] in arrays::rows_of_three(&value.getattr("triangles")?, "triangles")? {
        triangles.push([corner(a)?, corner(b)?, corner(c)?]);
    }
    let mesh = Mesh::new(vectors("vertices_mm")?, triangles);
    let mut mesh = mesh.map_err(|error| input(format!("sample: {error}")))?;
    if !value.getattr("normals")?.is_none() {
        let with_normals = mesh.with_normals(vectors("normals")?);
        mesh = with_normals.map_err(|error| input(format!("sample: {error}")))?;
    }
    Ok(Some(mesh))
}
