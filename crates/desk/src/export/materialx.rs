//! OpenPBR Surface as a MaterialX document.

use std::fmt::Write;

use super::model::{AsModel, ModelFormat};
use super::text::{xml_comment, xml_value};
use super::{Format, PICTURE, Subject, Writer};
use crate::parametric::COAT_IOR;

/// The nearest of that model.
pub(super) const FORMAT: Format = Format {
    name: "openpbr",
    about: "OpenPBR in MaterialX (.mtlx), the nearest of that model; what it loses is printed and drawn",
    ending: ModelFormat::OpenPbr.ending(),
    companion: PICTURE,
    writer: Writer::AsModel(ModelFormat::OpenPbr),
};

/// The document's text.
pub fn to_xml(material: &AsModel, subject: &Subject<'_>) -> String {
    let p = &material.fitted.parameters;
    let (fuzz_weight, fuzz_color) = p.fuzz_weight_and_color();
    let color = |[r, g, b]: [f64; 3]| format!("{r:.4}, {g:.4}, {b:.4}");
    let float = |value: f64| format!("{value:.4}");
    let inputs = [
        ("base_weight", "float", float(1.0)),
        ("base_color", "color3", color(p.base_color)),
        (
            "base_diffuse_roughness",
            "float",
            float(p.diffuse_roughness),
        ),
        ("base_metalness", "float", float(p.metalness)),
        ("specular_weight", "float", float(1.0)),
        ("specular_color", "color3", color(p.specular_color)),
        ("specular_roughness", "float", float(p.roughness)),
        ("specular_ior", "float", float(p.ior)),
        ("coat_weight", "float", float(p.coat_weight)),
        ("coat_roughness", "float", float(p.coat_roughness)),
        ("coat_ior", "float", float(COAT_IOR)),
        ("coat_darkening", "float", float(0.0)),
        ("fuzz_weight", "float", float(fuzz_weight)),
        ("fuzz_color", "color3", color(fuzz_color)),
        ("fuzz_roughness", "float", float(p.fuzz_roughness)),
    ];
    let name = subject.identifier();
    let mut xml = String::from("<?xml version=\"1.0\"?>\n");
    for line in subject.lines(material) {
        let _ = writeln!(xml, "{}", xml_comment(&line));
    }
    let _ = writeln!(
        xml,
        "<materialx version=\"1.39\" colorspace=\"lin_rec709\">"
    );
    let _ = writeln!(
        xml,
        "  <open_pbr_surface name=\"{name}_surface\" type=\"surfaceshader\">"
    );
    for (input, kind, value) in inputs {
        let _ = writeln!(
            xml,
            "    <input name=\"{input}\" type=\"{kind}\" value=\"{value}\" />"
        );
    }
    let _ = writeln!(xml, "  </open_pbr_surface>");
    let _ = writeln!(
        xml,
        "  <surfacematerial name=\"{name}\" type=\"material\" uiname=\"{}\">",
        xml_value(&subject.name())
    );
    let _ = writeln!(
        xml,
        "    <input name=\"surfaceshader\" type=\"surfaceshader\" nodename=\"{name}_surface\" />"
    );
    xml += "  </surfacematerial>\n</materialx>\n";
    xml
}
