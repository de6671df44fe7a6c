//! Surfaces: triangle meshes and their files, the sample shapes, and ray queries.
//!
//! A sample is a triangle mesh whose triangles reflect on their front, the side from which the
//! corners run counter-clockwise; backs are black. Conventions:
//!
//! - Lengths are millimetres.
//! - The sample's frame is right-handed; its +z axis points out of the hollow, towards the
//!   camera, and the rim of the built-in shapes lies in the plane z = 0.
//! - Mesh files have units and axes of their own; a [`Placement`] says which.
//!
//! | type or function | what it is |
//! |---|---|
//! | [`Mesh`] | a checked triangle mesh, with normals for smooth shading where known |
//! | [`Shape`] | the built-in samples: bowl, sphere, cap, corner, grooves, ridge, the paper's designed shape |
//! | [`files::read`], [`files::write`] | PLY, OBJ and STL |
//! | [`inspect::inspect`] | what a file holds, and the placement that it probably needs |
//! | [`Bvh`], [`Ray`], [`Hit`] | the nearest triangle along a ray, without gaps at edges |
//! | [`FormError`] | how far an as-made surface may be from its mesh |
//!
//! ```
//! use rig_core::geometry::{Bvh, Ray, Shape};
//! use glam::Vec3;
//!
//! let bowl = Shape::Bowl { radius_mm: 10.0, segments: 64 }.mesh()?;
//! let down = Ray {
//!     origin_mm: Vec3::new(1.0, 2.0, 50.0),
//!     direction: Vec3::NEG_Z,
//!     limit_mm: f32::INFINITY,
//! };
//! let hit = Bvh::new(&bowl).closest(&down).expect("the bowl is below");
//! // z = −√(10² − 1² − 2²)
//! assert!((50.0 - hit.distance_mm + 95f32.sqrt()).abs() < 0.02);
//! # Ok::<(), rig_core::geometry::MeshError>(())
//! ```

pub mod bvh;
mod draft;
pub mod files;
pub mod form_error;
pub mod inspect;
pub mod mesh;
pub mod mesh_error;
pub mod mirror;
pub mod obj;
pub mod placement;
pub mod ply;
mod ply_header;
pub mod seams;
pub mod shapes;
pub mod smooth;
pub mod stl;
mod text;
pub mod topology;
mod triangulate;

pub use bvh::{Bvh, Hit, Ray};
pub use form_error::FormError;
pub use mesh::Mesh;
pub use mesh_error::{FileRemark, MeshError, MeshRemark};
pub use placement::Placement;
pub use shapes::Shape;
