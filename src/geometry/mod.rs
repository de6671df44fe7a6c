//! Surfaces: triangle meshes and their files, the sample shapes, and the
//! watertight ray queries over them. Lengths are millimetres.

pub mod bvh;
pub mod files;
pub mod form_error;
pub mod mesh;
pub mod mirror;
pub mod obj;
pub mod ply;
pub mod shapes;
pub mod stl;

pub use bvh::{Bvh, Hit, Ray};
pub use form_error::FormError;
pub use mesh::{Mesh, MeshError};
pub use shapes::Shape;
