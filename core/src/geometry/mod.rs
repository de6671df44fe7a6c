//! Surfaces: triangle meshes and their files, the sample shapes, and the
//! watertight ray queries over them. Lengths are millimetres.

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
