//! Surfaces: triangle meshes and their files, the sample shapes, and the
//! watertight ray queries over them. Lengths are millimetres.

pub mod bvh;
pub mod mesh;
pub mod ply;
pub mod shapes;

pub use bvh::{Bvh, Hit, Ray};
pub use mesh::{Mesh, MeshError};
pub use shapes::Shape;
