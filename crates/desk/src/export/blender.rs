//! A script that makes the material in Blender.

use std::fmt::Write;

use super::model::{AsModel, ModelFormat};
use super::text::literal;
use super::{Format, PICTURE, Subject, Writer};
use crate::parametric::COAT_IOR;

/// The nearest of the Principled BSDF.
pub(super) const FORMAT: Format = Format {
    name: "blender",
    about: "Script that makes the material in Blender 4.0 and later (.py), likewise",
    ending: ModelFormat::Blender.ending(),
    companion: PICTURE,
    writer: Writer::AsModel(ModelFormat::Blender),
};

/// What follows the values.
const MAKE: &str = r#"

def make_material():
    """Adds the material to the open file and returns it."""
    if bpy.app.version < (4, 0, 0):
        raise RuntimeError("this material needs Blender 4.0 or later: the Principled BSDF was another before")
    material = bpy.data.materials.new(NAME)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    surface = tree.nodes.new("ShaderNodeBsdfPrincipled")
    surface.distribution = "MULTI_GGX"
    for socket, value in VALUES.items():
        surface.inputs[socket].default_value = value
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    material["rig_note"] = NOTE
    material["rig_environment_error"] = ENVIRONMENT_ERROR
    return material


if __name__ == "__main__":
    made = make_material()
    print("made the material", made.name)
"#;

/// The script's text.
pub fn to_script(material: &AsModel, subject: &Subject<'_>) -> String {
    let p = &material.fitted.parameters;
    let (fuzz_weight, fuzz_color) = p.fuzz_weight_and_color();
    let color = |[r, g, b]: [f64; 3]| format!("({r:.4}, {g:.4}, {b:.4}, 1.0)");
    let float = |value: f64| format!("{value:.4}");
    let sockets = [
        ("Base Color", color(p.base_color)),
        ("Metallic", float(p.metalness)),
        ("Roughness", float(p.roughness)),
        ("IOR", float(p.ior)),
        ("Specular IOR Level", float(0.5)),
        ("Specular Tint", color(p.specular_color)),
        ("Coat Weight", float(p.coat_weight)),
        ("Coat Roughness", float(p.coat_roughness)),
        ("Coat IOR", float(COAT_IOR)),
        ("Sheen Weight", float(fuzz_weight)),
        ("Sheen Roughness", float(p.fuzz_roughness)),
        ("Sheen Tint", color(fuzz_color)),
    ];
    let mut script = String::new();
    for line in subject.lines(material) {
        let _ = writeln!(script, "# {line}");
    }
    script += "#\n# For the Principled BSDF of Blender 4.0 and later. Run it in the Text Editor, or with\n";
    script +=
        "# `blender --python FILE`; then choose the material for an object. Colours are linear,\n";
    script += "# with the primaries of Rec. 709, Blender's default working space.\n\n";
    script += "import bpy\n\n";
    let _ = writeln!(script, "NAME = {}", literal(&subject.name()));
    let note = subject.lines(material).join("; ");
    let _ = writeln!(script, "NOTE = {}", literal(&note));
    let _ = writeln!(script, "ENVIRONMENT_ERROR = {:.4}", material.loss.error());
    let maps = material.loss.environment.maps.iter();
    let by_map = maps.map(|(map, error)| format!("\"{map}\": {error:.4}"));
    let by_map: Vec<String> = by_map.collect();
    let _ = writeln!(script, "ERROR_BY_MAP = {{{}}}", by_map.join(", "));
    script += "VALUES = {\n";
    for (socket, value) in sockets {
        let _ = writeln!(script, "    \"{socket}\": {value},");
    }
    script + "}\n" + MAKE
}
