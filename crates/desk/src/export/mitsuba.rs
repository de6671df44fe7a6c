//! A mixture as nested BSDFs of Mitsuba 3.
//!
//! `blendbsdf` blends two BSDFs by one number for all channels, so the channels'
//! weights go into each atom's `specular_reflectance` (or `reflectance`), which
//! multiplies it: with blend share bₖ and reflectance sₖ = wₖ/bₖ per channel the
//! sum Σ bₖ·sₖ·fₖ is Σ wₖ·fₖ exactly. The shares are the largest weight of each
//! atom's channels, and black takes the rest; if they sum to more than one they
//! are scaled down and some reflectances exceed one, which Mitsuba's `srgb`
//! texture allows with `unbounded`. A GGX atom of real index η
//! is `roughconductor` with k = 0, whose Fresnel term is then the dielectric's; a
//! coat is `plastic` without its own highlight.

use std::fmt::Write;

use super::text::xml_comment;
use super::{Format, SIMULATED_NOTE, Writer, replace};
use crate::brdf::Mixture;
use crate::brdf::atom::{Diffuse, Distribution, Facets};

/// The mixture, exactly; a model discrepancy is left out.
pub(super) const FORMAT: Format = Format {
    name: "mitsuba",
    about: "Scene fragment for the RGB variants of Mitsuba 3 (.xml): the mixture of the weights, exactly",
    ending: "xml",
    companion: None,
    writer: Writer::OfFit(|record, files| {
        let note = record.discrepancy.as_ref().map(|discrepancy| {
            format!(
                "This is the mixture alone. The fitted BRDF differs from it by a model discrepancy, {:.1} times the usual one of measured materials, which RGL and MERL exports include.",
                discrepancy.amplitude
            )
        });
        let text = to_xml(&record.mixture()?, record.simulated, note.as_deref());
        replace(&files[0], text.as_bytes())
    }),
};

/// The identifier of the BSDF in the fragment.
pub const BSDF_ID: &str = "rig";

struct Part {
    piece: Piece,
    share: f64,
    reflectance: [f64; 3],
}

/// What one BSDF holds: an atom's lobe, its diffuse part, or nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Piece {
    Facets(Facets),
    Diffuse(Diffuse),
    Black,
}

/// Shares that sum to one with the reflectances that belong to them.
fn parts(mixture: &Mixture) -> Vec<Part> {
    let weights = mixture.weights();
    let at = |k: usize| weights.each_ref().map(|channel| channel[k]);
    let largest = |w: [f64; 3]| w.into_iter().fold(0.0, f64::max);
    let atoms = mixture.dictionary().atoms().iter().enumerate();
    let mut parts: Vec<Part> = atoms
        .flat_map(|(k, atom)| {
            let pieces = [
                atom.facets().map(Piece::Facets),
                atom.diffuse().map(Piece::Diffuse),
            ];
            pieces.into_iter().flatten().map(move |piece| Part {
                piece,
                share: largest(at(k)),
                reflectance: at(k),
            })
        })
        .filter(|part| part.share > 0.0)
        .collect();
    let total: f64 = parts.iter().map(|part| part.share).sum();
    let scale = total.max(1.0);
    for part in &mut parts {
        part.share /= scale;
        part.reflectance = part.reflectance.map(|w| w / part.share);
    }
    if total < 1.0 {
        parts.push(Part {
            piece: Piece::Black,
            share: 1.0 - total,
            reflectance: [0.0; 3],
        });
    }
    parts
}

/// A scene fragment with one `bsdf` of the id [`BSDF_ID`]; for RGB variants.
/// One-sided, like the measured surface. A `note` is added as a comment.
pub fn to_xml(mixture: &Mixture, simulated: bool, note: Option<&str>) -> String {
    let parts = parts(mixture);
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n");
    xml += "<!-- BRDF fitted by rig; for the RGB variants of Mitsuba 3. -->\n";
    if simulated {
        let _ = writeln!(xml, "{}", xml_comment(&format!("{SIMULATED_NOTE}.")));
    }
    if let Some(note) = note {
        let _ = writeln!(xml, "{}", xml_comment(note));
    }
    xml += "<scene version=\"3.0.0\">\n";
    write_blend(&mut xml, &parts, 1, &format!(" id=\"{BSDF_ID}\""));
    xml += "</scene>\n";
    xml
}

/// Halves the parts until one is left: few levels, and every share exact.
fn write_blend(xml: &mut String, parts: &[Part], depth: usize, id: &str) {
    let pad = "    ".repeat(depth);
    if let [part] = parts {
        write_atom(xml, part, &pad, id);
        return;
    }
    let (first, second) = parts.split_at(parts.len() / 2);
    let sum = |parts: &[Part]| parts.iter().map(|part| part.share).sum::<f64>();
    // blendbsdf: weight 0 is the first BSDF, 1 the second.
    let weight = sum(second) / sum(parts);
    let _ = writeln!(xml, "{pad}<bsdf type=\"blendbsdf\"{id}>");
    let _ = writeln!(xml, "{pad}    <float name=\"weight\" value=\"{weight}\"/>");
    write_blend(xml, first, depth + 1, "");
    write_blend(xml, second, depth + 1, "");
    let _ = writeln!(xml, "{pad}</bsdf>");
}

fn write_atom(xml: &mut String, part: &Part, pad: &str, id: &str) {
    let texture = |name: &str, [r, g, b]: [f64; 3]| {
        format!(
            "{pad}    <texture type=\"srgb\" name=\"{name}\">\n\
             {pad}        <vector name=\"color\" value=\"{r}, {g}, {b}\"/>\n\
             {pad}        <boolean name=\"unbounded\" value=\"true\"/>\n\
             {pad}    </texture>\n"
        )
    };
    match part.piece {
        Piece::Facets(Facets {
            distribution,
            alpha,
            eta,
        }) => {
            let distribution = match distribution {
                Distribution::Ggx => "ggx",
                Distribution::Beckmann => "beckmann",
            };
            let _ = writeln!(xml, "{pad}<bsdf type=\"roughconductor\"{id}>");
            let _ = writeln!(
                xml,
                "{pad}    <string name=\"distribution\" value=\"{distribution}\"/>"
            );
            let _ = writeln!(xml, "{pad}    <float name=\"alpha\" value=\"{alpha}\"/>");
            let _ = writeln!(xml, "{pad}    <spectrum name=\"eta\" value=\"{eta}\"/>");
            let _ = writeln!(xml, "{pad}    <spectrum name=\"k\" value=\"0\"/>");
            *xml += &texture("specular_reflectance", part.reflectance);
        }
        Piece::Diffuse(Diffuse::Coated { eta }) => {
            let _ = writeln!(xml, "{pad}<bsdf type=\"plastic\"{id}>");
            let _ = writeln!(xml, "{pad}    <float name=\"int_ior\" value=\"{eta}\"/>");
            let _ = writeln!(xml, "{pad}    <float name=\"ext_ior\" value=\"1\"/>");
            *xml += &texture("diffuse_reflectance", part.reflectance);
            *xml += &texture("specular_reflectance", [0.0; 3]);
        }
        Piece::Diffuse(Diffuse::Lambertian(albedo)) => {
            let _ = writeln!(xml, "{pad}<bsdf type=\"diffuse\"{id}>");
            *xml += &texture("reflectance", part.reflectance.map(|s| s * albedo));
        }
        Piece::Black => {
            let _ = writeln!(xml, "{pad}<bsdf type=\"diffuse\"{id}>");
            *xml += &texture("reflectance", [0.0; 3]);
        }
    }
    let _ = writeln!(xml, "{pad}</bsdf>");
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::brdf::{Atom, Dictionary};

    fn is_part_of(piece: Piece, atom: Atom) -> bool {
        match piece {
            Piece::Facets(facets) => atom.facets() == Some(facets),
            Piece::Diffuse(diffuse) => atom.diffuse() == Some(diffuse),
            Piece::Black => atom == Atom::Black,
        }
    }

    /// Whatever the weights, the shares sum to one and share times reflectance
    /// is the weight again.
    #[test]
    fn shares_and_reflectances_give_the_weights_back() {
        let dictionary = Arc::new(Dictionary::paper42());
        let spread = |first: usize| {
            let mut weights = vec![0.0; 42];
            (weights[first], weights[40], weights[41]) = (0.6, 0.3, 0.1);
            weights
        };
        let grey = [spread(3), spread(3), spread(3)];
        for weights in [[spread(1), spread(2), spread(3)], grey] {
            let mixture = Mixture::new(dictionary.clone(), weights.clone()).unwrap();
            let parts = parts(&mixture);
            let total: f64 = parts.iter().map(|part| part.share).sum();
            assert!((total - 1.0).abs() < 1e-12, "{total}");
            for part in &parts {
                let Some(k) = mixture
                    .dictionary()
                    .atoms()
                    .iter()
                    .position(|atom| is_part_of(part.piece, *atom))
                else {
                    panic!("unknown atom");
                };
                let black = part.piece == Piece::Black;
                for (reflectance, weights) in part.reflectance.iter().zip(&weights) {
                    let expected = if black { 0.0 } else { weights[k] };
                    assert!((part.share * reflectance - expected).abs() < 1e-12);
                }
            }
            let xml = to_xml(&mixture, true, None);
            assert_eq!(xml.matches("<bsdf").count(), xml.matches("</bsdf>").count());
            assert_eq!(
                xml.matches("roughconductor").count(),
                parts.len() - 1 - usize::from(parts.iter().any(|p| p.piece == Piece::Black))
            );
            assert!(xml.contains("SIMULATED"));
        }
    }
}
