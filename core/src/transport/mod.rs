//! How light travels from lamp to camera over the sample: scenes, path tracing, and cached paths
//! on which a fit evaluates images and their derivatives without tracing again.
//!
//! The radiance that a camera measures is a sum over paths x₁ … x_k of surface points between
//! camera and lamp,
//!
//! > L = Σₖ ∫ f(x₁) G₁ · f(x₂) G₂ · … · f(x_k) E(x_k) dx₁ … dx_k,
//!
//! with the BRDF f at each reflection, geometric factors G and the irradiance E that the lamp
//! brings to the last point. In a concave sample paths of many reflections count, and each
//! reflection is at another pair of angles: one image holds much of the BRDF.
//!
//! [`render()`] estimates L by path tracing for one BRDF. A fit needs L and its derivatives for
//! many. Its trick: the continuations of paths are drawn from a fixed [`Proposal`], not from the
//! BRDF, so the paths do not depend on it. They are traced once and stored ([`Cache`]) with the
//! values of all atoms of a dictionary at each reflection; every evaluation for other weights is
//! a pass over the stored records. Paths of one reflection are linear in the weights and need no
//! paths at all ([`DirectMatrix`]).
//!
//! Conventions: the sample's frame in millimetres ([`crate::frames`]), row 0 of an image at the
//! top, radiance in the unit of the lamps' irradiance over sr.
//!
//! | type or function | what it is |
//! |---|---|
//! | [`Scene`] | sample, known [`Body`]s, [`Camera`], [`Light`]s |
//! | [`render()`], [`RenderOptions`] | images by path tracing, with their variance |
//! | [`Cells`] | squares of pixels that a fit compares |
//! | [`DirectMatrix`], [`Cache`] | direct and indirect light of all atoms, for a fit |
//! | [`Proposal`], [`Steering`], [`points`] | where continuations go, and their random numbers |
//! | [`Visibility`], [`Remainder`] | whether a scene can be measured, and what long paths add |

pub mod cache;
pub mod camera;
pub mod camera_body;
pub mod cell_footprints;
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
pub use cell_footprints::Cells;
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
