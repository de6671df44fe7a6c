//! The remark that a sample's facets are too coarse for a narrow lobe.

use crate::brdf::Atom;
use crate::geometry::Mesh;
use crate::transport::Scene;

/// A remark where facets shade with their own normals and neighbours differ by more than
/// an eighth of the narrowest lobe's roughness, which takes up to a sixth off its peak.
pub fn coarse_facets(scene: &Scene, atoms: &[Atom]) -> Option<String> {
    let widths = atoms.iter().filter_map(Atom::alpha);
    let narrowest = widths.fold(f64::INFINITY, f64::min);
    if !scene.is_flat() || narrowest.is_infinite() {
        return None;
    }
    let step_rad = f64::from(scene.sample().facet_step_rad(Mesh::CREASE_RAD));
    (step_rad > narrowest / 8.0).then(|| {
        format!(
            "the sample's facets turn by {:.2}° from one to the next; the narrowest lobe (alpha {narrowest}) allows {:.2}°: shading = \"smooth\" or more segments avoid it",
            step_rad.to_degrees(),
            (narrowest / 8.0).to_degrees()
        )
    })
}
