//! A sphere of the material as a binary glTF 2.0 file.

use std::f64::consts::{PI, TAU};

use serde_json::{Map, Value, json};

use super::model::{AsModel, ModelFormat};
use super::{Format, PICTURE, Subject, Writer};
use crate::parametric::{Parameters, USUAL_IOR};

/// The nearest of that model, on a sphere.
pub(super) const FORMAT: Format = Format {
    name: "gltf",
    about: "Sphere of the material in binary glTF 2.0 (.glb), likewise",
    ending: ModelFormat::Gltf.ending(),
    companion: PICTURE,
    writer: Writer::AsModel(ModelFormat::Gltf),
};

/// Radius of the sphere, metres.
const RADIUS_M: f64 = 0.5;
/// Meridians and parallels of the sphere.
const MERIDIANS: u16 = 64;
const PARALLELS: u16 = 32;

/// Component types of glTF.
const U16: u32 = 5123;
const F32: u32 = 5126;
/// Kinds of buffers of glTF.
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// The file.
pub fn to_glb(material: &AsModel, subject: &Subject<'_>) -> Vec<u8> {
    let sphere = Sphere::new();
    let json = document(material, subject, &sphere).to_string();
    let chunks = [
        (*b"JSON", padded(json.into_bytes(), b' ')),
        (*b"BIN\0", padded(sphere.bytes(), 0)),
    ];
    let length = 12
        + chunks
            .iter()
            .map(|(_, bytes)| 8 + bytes.len())
            .sum::<usize>();
    let word = |value: usize| (value as u32).to_le_bytes();
    let mut file = Vec::with_capacity(length);
    file.extend(b"glTF");
    file.extend(word(2));
    file.extend(word(length));
    for (kind, bytes) in chunks {
        file.extend(word(bytes.len()));
        file.extend(kind);
        file.extend(bytes);
    }
    file
}

/// To a multiple of four bytes.
fn padded(mut bytes: Vec<u8>, with: u8) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(4), with);
    bytes
}

fn document(material: &AsModel, subject: &Subject<'_>, sphere: &Sphere) -> Value {
    let lines = subject.lines(material);
    let extensions = extensions(&material.fitted.parameters);
    let used: Vec<&String> = extensions.keys().collect();
    let core = &material.fitted.core;
    let [r, g, b] = core.base_color;
    let mut surface = json!({
        "name": subject.name(),
        "pbrMetallicRoughness": {
            "baseColorFactor": [r, g, b, 1.0],
            "metallicFactor": core.metalness,
            "roughnessFactor": core.roughness,
        },
        "extras": {
            "environmentError": material.loss.error(),
            "environmentErrorWithoutExtensions": material.without_extensions,
            "worst": material.loss.worst,
            "simulated": subject.simulated,
            "colors": "linear, primaries of Rec. 709",
            "note": lines,
        },
    });
    let mut root = json!({
        "asset": {
            "version": "2.0",
            "generator": format!("rig {}", env!("CARGO_PKG_VERSION")),
        },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "sphere" }],
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "NORMAL": 1 },
            "indices": 2,
            "material": 0,
        }] }],
        "accessors": sphere.accessors(),
        "bufferViews": sphere.views(),
        "buffers": [{ "byteLength": sphere.bytes().len() }],
    });
    if !used.is_empty() {
        root["extensionsUsed"] = json!(used);
        surface["extensions"] = Value::Object(extensions);
    }
    root["materials"] = json!([surface]);
    root
}

/// What the core cannot say, where it is not the default.
fn extensions(p: &Parameters) -> Map<String, Value> {
    let mut all = Map::new();
    if p.ior != USUAL_IOR {
        all.insert("KHR_materials_ior".into(), json!({ "ior": p.ior }));
    }
    if p.specular_color != [1.0; 3] {
        // The factor is that of all the reflection, the colour's that at normal incidence.
        let (weight, color) = p.specular_weight_and_color();
        let mut specular = json!({ "specularFactor": weight });
        if color != [1.0; 3] {
            specular["specularColorFactor"] = json!(color);
        }
        all.insert("KHR_materials_specular".into(), specular);
    }
    if p.coat_weight > 0.0 {
        all.insert(
            "KHR_materials_clearcoat".into(),
            json!({
                "clearcoatFactor": p.coat_weight,
                "clearcoatRoughnessFactor": p.coat_roughness,
            }),
        );
    }
    if p.fuzz != [0.0; 3] {
        all.insert(
            "KHR_materials_sheen".into(),
            json!({
                "sheenColorFactor": p.fuzz,
                "sheenRoughnessFactor": p.fuzz_roughness,
            }),
        );
    }
    all
}

/// A sphere of meridians and parallels.
struct Sphere {
    normals: Vec<[f32; 3]>,
    indices: Vec<u16>,
}

impl Sphere {
    fn new() -> Self {
        let across = MERIDIANS + 1;
        let mut normals = Vec::new();
        for row in 0..=PARALLELS {
            let (sin, cos) = (PI * f64::from(row) / f64::from(PARALLELS)).sin_cos();
            for column in 0..across {
                let (sin_phi, cos_phi) = (TAU * f64::from(column) / f64::from(MERIDIANS)).sin_cos();
                normals.push([sin * cos_phi, cos, -sin * sin_phi].map(|v| v as f32));
            }
        }
        let mut indices = Vec::new();
        for row in 0..PARALLELS {
            for column in 0..MERIDIANS {
                let [a, b] = [row, row + 1].map(|row| row * across + column);
                // The poles have one triangle each, not two.
                if row > 0 {
                    indices.extend([a, b, a + 1]);
                }
                if row + 1 < PARALLELS {
                    indices.extend([a + 1, b, b + 1]);
                }
            }
        }
        Self { normals, indices }
    }

    fn positions(&self) -> impl Iterator<Item = [f32; 3]> {
        let scaled = |normal: &[f32; 3]| normal.map(|v| v * RADIUS_M as f32);
        self.normals.iter().map(scaled)
    }

    /// Positions, normals, indices.
    fn bytes(&self) -> Vec<u8> {
        let vertices = self.positions().chain(self.normals.iter().copied());
        let mut bytes: Vec<u8> = vertices.flatten().flat_map(f32::to_le_bytes).collect();
        bytes.extend(self.indices.iter().flat_map(|index| index.to_le_bytes()));
        bytes
    }

    fn accessors(&self) -> Value {
        let count = self.normals.len();
        let axis = |c: usize, of: fn(f32, f32) -> f32| {
            self.positions()
                .map(|p| p[c])
                .reduce(of)
                .unwrap_or_default()
        };
        let least = [0, 1, 2].map(|c| axis(c, f32::min));
        let largest = [0, 1, 2].map(|c| axis(c, f32::max));
        json!([
            {
                "bufferView": 0, "componentType": F32, "count": count, "type": "VEC3",
                "min": least, "max": largest,
            },
            { "bufferView": 1, "componentType": F32, "count": count, "type": "VEC3" },
            { "bufferView": 2, "componentType": U16, "count": self.indices.len(), "type": "SCALAR" },
        ])
    }

    fn views(&self) -> Value {
        let vertices = self.normals.len() * 12;
        json!([
            { "buffer": 0, "byteOffset": 0, "byteLength": vertices, "target": VERTICES },
            { "buffer": 0, "byteOffset": vertices, "byteLength": vertices, "target": VERTICES },
            { "buffer": 0, "byteOffset": 2 * vertices, "byteLength": 2 * self.indices.len(), "target": INDICES },
        ])
    }
}
