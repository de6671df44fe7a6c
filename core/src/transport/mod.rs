//! How light travels from lamp to camera over the sample: the scene, path
//! sampling, plain rendering, and the path cache on which a fit evaluates image,
//! Jacobian and gradient without tracing again.
//!
//! Path vertices do not depend on the BRDF when continuations are drawn from a
//! fixed proposal, so paths are traced once and evaluated for any mixture.

pub mod cache;
pub mod camera;
pub mod camera_body;
pub mod cells;
mod continuation;
pub mod direct;
pub mod direct_discrepancy;
pub mod distortion;
pub mod evaluate;
pub mod event;
pub mod falloff;
pub mod footprint;
mod guide;
mod indirect;
pub mod lanes;
pub mod lens;
pub mod light;
pub mod points;
pub mod polarised;
pub mod proposal;
pub mod render;
pub mod scene;
pub mod truncation;
pub mod visibility;

pub use cache::{Cache, CacheOptions};
pub use camera::{Camera, Projection};
pub use camera_body::{CameraBody, CameraShadow, Obstruction};
pub use cells::Cells;
pub use continuation::{Continuations, Steering};
pub use direct::DirectMatrix;
pub use distortion::Coefficients;
pub use distortion::Folded;
pub use evaluate::{CellRows, Kernel};
pub use guide::Guide;
pub use indirect::indirect;
pub use lens::{Lens, LensSpec};
pub use light::Light;
pub use polarised::render_polarised;
pub use proposal::Proposal;
pub use render::{RenderOptions, render, render_with_progress, suited_proposal};
pub use scene::{Body, Scene, Shading};
pub use truncation::{Remainder, truncation_remainder};
pub use visibility::Visibility;
