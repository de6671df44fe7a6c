//! A material of pbrt-v4: a reference to the spectral RGL file that holds the values.
//!
//! `measured` is the one material of pbrt that can hold a mixture with weights per
//! channel: `mix` takes one amount for all channels and chooses one side at random,
//! and `conductor` has no factor per channel.

use super::text::literal;
use super::{Companion, Format, SIMULATED_NOTE, Writer, replace, rgl};

/// With the file of spectra that it refers to.
pub(super) const FORMAT: Format = Format {
    name: "pbrt",
    about: "Material for pbrt-v4 (.pbrt), with the .bsdf it refers to",
    ending: "pbrt",
    companion: Some(Companion::Instead("spectral.bsdf")),
    writer: Writer::OfFit(|record, files| {
        let [out, bsdf] = files else {
            unreachable!("two files are made")
        };
        replace(bsdf, &rgl::of_fit(record, rgl::Channels::Spectral)?)?;
        let name = bsdf.file_name().unwrap_or_default().to_string_lossy();
        replace(out, to_text(&name, record.simulated).as_bytes())
    }),
};

/// The material's name in the fragment.
pub const MATERIAL_NAME: &str = "rig";

/// A fragment that makes the named material; `bsdf` is the file's name, relative to
/// the scene that includes the fragment.
pub fn to_text(bsdf: &str, simulated: bool) -> String {
    let mut text = String::from("# BRDF fitted by rig; for pbrt-v4.\n");
    if simulated {
        text += &format!("# {SIMULATED_NOTE}.\n");
    }
    let name = literal(bsdf);
    text + &format!(
        "MakeNamedMaterial \"{MATERIAL_NAME}\"\n    \"string type\" \"measured\"\n    \"string filename\" {name}\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_its_file() {
        let text = to_text("a \"b\".bsdf", true);
        assert!(
            text.contains("\"string filename\" \"a \\\"b\\\".bsdf\""),
            "{text}"
        );
        assert!(text.contains("SIMULATED") && !to_text("a.bsdf", false).contains("SIMULATED"));
    }
}
