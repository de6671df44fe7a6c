//! The few functions of Embree 4 that a comparison needs, from a shared library that
//! is opened at run time. Constants and structures follow Embree 4's public headers
//! (`rtcore_ray.h`, `rtcore_scene.h`, `rtcore_common.h`).

use std::ffi::{CString, c_char, c_int, c_uint, c_void};
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::ptr::null_mut;

use glam::Vec3;
use libloading::Library;
use rig::geometry::{Mesh, Ray};

/// Names the shared library.
pub const VARIABLE: &str = "EMBREE_LIBRARY";

const NO_HIT: c_uint = u32::MAX;
const FLAG_ROBUST: c_int = 1 << 2;
const QUALITY_HIGH: c_int = 2;
const GEOMETRY_TRIANGLE: c_int = 0;
const BUFFER_INDEX: c_int = 0;
const BUFFER_VERTEX: c_int = 1;
const FORMAT_UINT3: c_int = 0x5003;
const FORMAT_FLOAT3: c_int = 0x9003;
const QUERY_COHERENT: c_int = 1 << 16;
const FEATURE_TRIANGLE: c_uint = 1 << 1;

type Handle = *mut c_void;

#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RtcRay {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
}

#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RtcHit {
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: c_uint,
    geometry: c_uint,
    instance: [c_uint; 2],
}

#[repr(C, align(16))]
struct RtcRayHit {
    ray: RtcRay,
    hit: RtcHit,
}

/// `RTCIntersectArguments` and `RTCOccludedArguments`, which are alike.
#[repr(C)]
struct QueryArguments {
    flags: c_int,
    features: c_uint,
    context: *mut c_void,
    filter: *mut c_void,
    callback: *mut c_void,
    minimum_width: f32,
}

/// How an Embree scene is built and queried.
#[derive(Clone, Copy, Debug)]
pub struct Mode {
    /// `RTC_SCENE_FLAG_ROBUST`.
    pub robust: bool,
    /// `RTC_RAY_QUERY_FLAG_COHERENT` instead of incoherent.
    pub coherent: bool,
}

/// A mesh in Embree, built in high quality.
pub struct Embree {
    device: Handle,
    scene: Handle,
    arguments: QueryArguments,
    intersect1: unsafe extern "C" fn(Handle, *mut RtcRayHit, *mut QueryArguments),
    occluded1: unsafe extern "C" fn(Handle, *mut RtcRay, *mut QueryArguments),
    release_scene: unsafe extern "C" fn(Handle),
    release_device: unsafe extern "C" fn(Handle),
}

impl Embree {
    /// The library of [`VARIABLE`], or what to do to get one.
    pub fn path() -> Result<PathBuf, String> {
        let advice = "the PyPI wheel embreex holds one: python3 -m venv v; \
            v/bin/pip install embreex==4.4.0.post1; \
            export EMBREE_LIBRARY=$(find $PWD/v -name 'libembree4*')";
        let path = std::env::var_os(VARIABLE)
            .map(PathBuf::from)
            .ok_or_else(|| {
                format!("{VARIABLE} does not name Embree 4's shared library; {advice}")
            })?;
        if path.is_file() {
            Ok(path)
        } else {
            Err(format!(
                "{VARIABLE}={}: no such file; {advice}",
                path.display()
            ))
        }
    }

    /// Builds `mesh` on one thread. `verbose` lets Embree print what it chose.
    pub fn new(mesh: &Mesh, mode: Mode, verbose: bool) -> Result<Self, String> {
        let path = Self::path()?;
        let said = |error: libloading::Error| format!("{}: {error}", path.display());
        let configuration = if verbose {
            "threads=1,verbose=2"
        } else {
            "threads=1"
        };
        let configuration = CString::new(configuration).map_err(|e| e.to_string())?;
        // SAFETY: the signatures are those of Embree 4's headers; buffers are allocated
        // by Embree for exactly the items that are written.
        unsafe {
            // Never unloaded: its worker threads may outlive a device.
            let library = ManuallyDrop::new(Library::new(&path).map_err(said)?);
            macro_rules! function {
                ($name:literal, fn($($argument:ty),*) $(-> $result:ty)?) => {
                    *library
                        .get::<unsafe extern "C" fn($($argument),*) $(-> $result)?>($name)
                        .map_err(said)?
                };
            }
            let new_device = function!(b"rtcNewDevice\0", fn(*const c_char) -> Handle);
            let new_scene = function!(b"rtcNewScene\0", fn(Handle) -> Handle);
            let set_flags = function!(b"rtcSetSceneFlags\0", fn(Handle, c_int));
            let set_quality = function!(b"rtcSetSceneBuildQuality\0", fn(Handle, c_int));
            let new_geometry = function!(b"rtcNewGeometry\0", fn(Handle, c_int) -> Handle);
            let new_buffer = function!(
                b"rtcSetNewGeometryBuffer\0",
                fn(Handle, c_int, c_uint, c_int, usize, usize) -> *mut c_void
            );
            let commit_geometry = function!(b"rtcCommitGeometry\0", fn(Handle));
            let attach = function!(b"rtcAttachGeometry\0", fn(Handle, Handle) -> c_uint);
            let release_geometry = function!(b"rtcReleaseGeometry\0", fn(Handle));
            let commit_scene = function!(b"rtcCommitScene\0", fn(Handle));
            let error = function!(b"rtcGetDeviceError\0", fn(Handle) -> c_int);

            let device = new_device(configuration.as_ptr());
            if device.is_null() {
                return Err(format!(
                    "Embree makes no device: error {}",
                    error(null_mut())
                ));
            }
            let scene = new_scene(device);
            set_flags(scene, if mode.robust { FLAG_ROBUST } else { 0 });
            set_quality(scene, QUALITY_HIGH);
            let geometry = new_geometry(device, GEOMETRY_TRIANGLE);
            let [vertices, triangles] = [mesh.positions_mm.len(), mesh.triangles.len()];
            let to = new_buffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, 12, vertices);
            std::ptr::copy_nonoverlapping(mesh.positions_mm.as_ptr(), to.cast::<Vec3>(), vertices);
            let to = new_buffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, 12, triangles);
            std::ptr::copy_nonoverlapping(mesh.triangles.as_ptr(), to.cast(), triangles);
            commit_geometry(geometry);
            attach(scene, geometry);
            release_geometry(geometry);
            commit_scene(scene);
            let code = error(device);
            if code != 0 {
                return Err(format!("Embree's build ends with error {code}"));
            }
            Ok(Self {
                device,
                scene,
                arguments: QueryArguments {
                    flags: if mode.coherent { QUERY_COHERENT } else { 0 },
                    features: FEATURE_TRIANGLE,
                    context: null_mut(),
                    filter: null_mut(),
                    callback: null_mut(),
                    minimum_width: 0.0,
                },
                intersect1: function!(
                    b"rtcIntersect1\0",
                    fn(Handle, *mut RtcRayHit, *mut QueryArguments)
                ),
                occluded1: function!(
                    b"rtcOccluded1\0",
                    fn(Handle, *mut RtcRay, *mut QueryArguments)
                ),
                release_scene: function!(b"rtcReleaseScene\0", fn(Handle)),
                release_device: function!(b"rtcReleaseDevice\0", fn(Handle)),
            })
        }
    }

    /// Distance and triangle of the nearest hit.
    #[inline]
    pub fn closest(&mut self, ray: &Ray) -> Option<(f32, u32)> {
        let mut query = RtcRayHit {
            ray: of(ray),
            hit: RtcHit {
                normal: [0.0; 3],
                uv: [0.0; 2],
                primitive: NO_HIT,
                geometry: NO_HIT,
                instance: [NO_HIT; 2],
            },
        };
        // SAFETY: the scene lives as long as `self`; Embree writes into `query` alone.
        unsafe { (self.intersect1)(self.scene, &mut query, &mut self.arguments) };
        (query.hit.geometry != NO_HIT).then_some((query.ray.far, query.hit.primitive))
    }

    /// Whether anything lies on the ray.
    #[inline]
    pub fn any(&mut self, ray: &Ray) -> bool {
        let mut query = of(ray);
        // SAFETY: as in `closest`.
        unsafe { (self.occluded1)(self.scene, &mut query, &mut self.arguments) };
        query.far < 0.0
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        // SAFETY: both were made in `new` and are released once.
        unsafe {
            (self.release_scene)(self.scene);
            (self.release_device)(self.device);
        }
    }
}

fn of(ray: &Ray) -> RtcRay {
    RtcRay {
        origin: ray.origin_mm.to_array(),
        near: 0.0,
        direction: ray.direction.to_array(),
        time: 0.0,
        far: ray.limit_mm,
        mask: u32::MAX,
        id: 0,
        flags: 0,
    }
}

const _: () = {
    assert!(size_of::<RtcRay>() == 48);
    assert!(size_of::<RtcRayHit>() == 96);
};
