//! The remark that a sample's facets are too coarse for a narrow lobe.

use crate::brdf::Atom;
use crate::rendering::CoarseFacets;
use crate::transport::Scene;

/// The remark, with what avoids it.
pub fn remark_on_facets(found: &CoarseFacets) -> String {
    format!("{found}: shading = \"smooth\" or more segments avoid it")
}

/// [`remark_on_facets`] on a scene whose material has these atoms, where one is due.
pub fn coarse_facets(scene: &Scene, atoms: &[Atom]) -> Option<String> {
    CoarseFacets::of(scene, atoms).map(|found| remark_on_facets(&found))
}
