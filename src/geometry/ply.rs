//! PLY meshes, ascii and binary of either byte order; binary little-endian is written.

use std::io::Write;

use glam::Vec3;

use super::mesh::{MAX_TRIANGLES, Mesh, MeshError};
use crate::shown::excerpt;

/// How one element's property is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return None,
        })
    }
}

enum Property {
    Scalar(String, Kind),
    List(String, Kind, Kind),
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// The body's numbers in order, whatever the encoding.
enum Body<'a> {
    Ascii(std::str::SplitAsciiWhitespace<'a>),
    LittleEndian(&'a [u8]),
    BigEndian(&'a [u8]),
}

impl Body<'_> {
    fn next(&mut self, kind: Kind) -> Option<f64> {
        let (bytes, little) = match self {
            Body::Ascii(words) => return words.next()?.parse().ok(),
            Body::LittleEndian(bytes) => (bytes, true),
            Body::BigEndian(bytes) => (bytes, false),
        };
        macro_rules! take {
            ($t:ty) => {{
                let (head, rest) = bytes.split_first_chunk()?;
                *bytes = rest;
                if little {
                    <$t>::from_le_bytes(*head) as f64
                } else {
                    <$t>::from_be_bytes(*head) as f64
                }
            }};
        }
        Some(match kind {
            Kind::I8 => take!(i8),
            Kind::U8 => take!(u8),
            Kind::I16 => take!(i16),
            Kind::U16 => take!(u16),
            Kind::I32 => take!(i32),
            Kind::U32 => take!(u32),
            Kind::F32 => take!(f32),
            Kind::F64 => take!(f64),
        })
    }
}

/// The mesh of a file's bytes; polygons are cut into fans. Coordinates are taken as
/// millimetres times `mm_per_unit`. Declared counts are never trusted beyond the bytes
/// present.
pub fn parse(bytes: &[u8], mm_per_unit: f32) -> Result<Mesh, MeshError> {
    let (elements, mut body) = header(bytes)?;
    let mut positions = Vec::new();
    let mut normals = Vec::new();
    let mut triangles = Vec::new();
    for element in &elements {
        for row in 0..element.count {
            let ended = || {
                MeshError::format(format!(
                    "{} {row} of {}: the file ends early or holds no number",
                    element.name, element.count
                ))
            };
            let mut vertex = [[0.0f64; 3]; 2];
            let mut has_normal = 0;
            for property in &element.properties {
                match property {
                    Property::Scalar(name, kind) => {
                        let value = body.next(*kind).ok_or_else(ended)?;
                        match name.as_str() {
                            "x" => vertex[0][0] = value,
                            "y" => vertex[0][1] = value,
                            "z" => vertex[0][2] = value,
                            "nx" => (vertex[1][0], has_normal) = (value, has_normal | 1),
                            "ny" => (vertex[1][1], has_normal) = (value, has_normal | 2),
                            "nz" => (vertex[1][2], has_normal) = (value, has_normal | 4),
                            _ => {}
                        }
                    }
                    Property::List(name, count_kind, kind) => {
                        let count = body.next(*count_kind).ok_or_else(ended)?;
                        let is_face = element.name == "face" && name.starts_with("vertex_ind");
                        if is_face && !(3.0..=255.0).contains(&count) {
                            return Err(MeshError::format(format!(
                                "face {row} has {count} corners; 3 to 255 are allowed"
                            )));
                        }
                        let mut fan = [0u32; 2];
                        for k in 0..count as u64 {
                            let value = body.next(*kind).ok_or_else(ended)?;
                            if !is_face {
                                continue;
                            }
                            if value < 0.0 || value > f64::from(u32::MAX) {
                                return Err(MeshError::format(format!(
                                    "face {row} refers to vertex {value}"
                                )));
                            }
                            let index = value as u32;
                            match k {
                                0 => fan[0] = index,
                                1 => fan[1] = index,
                                _ => {
                                    triangles.push([fan[0], fan[1], index]);
                                    fan[1] = index;
                                }
                            }
                        }
                        if triangles.len() > MAX_TRIANGLES {
                            return Err(MeshError::TooLarge {
                                triangles: triangles.len(),
                                limit: MAX_TRIANGLES,
                            });
                        }
                    }
                }
            }
            if element.name == "vertex" {
                let [p, n] = vertex.map(|v| Vec3::new(v[0] as f32, v[1] as f32, v[2] as f32));
                positions.push(p * mm_per_unit);
                if has_normal == 7 {
                    normals.push(n);
                }
            }
        }
    }
    let mesh = Mesh::new(positions, triangles)?;
    if !normals.is_empty() && normals.len() == mesh.positions_mm.len() {
        mesh.with_normals(normals)
    } else {
        Ok(mesh)
    }
}

fn header(bytes: &[u8]) -> Result<(Vec<Element>, Body<'_>), MeshError> {
    let mut elements: Vec<Element> = Vec::new();
    let mut format = None;
    let mut rest = bytes;
    let mut first = true;
    loop {
        let end = rest
            .iter()
            .take(1024)
            .position(|&b| b == b'\n')
            .ok_or_else(|| MeshError::format("the header has no end_header line"))?;
        let line = std::str::from_utf8(&rest[..end])
            .map_err(|_| MeshError::format("the header is not text"))?
            .trim();
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if first && words != ["ply"] {
            return Err(MeshError::format("the file does not begin with \"ply\""));
        }
        first = false;
        match words.as_slice() {
            [
                "format",
                name @ ("ascii" | "binary_little_endian" | "binary_big_endian"),
                "1.0",
            ] => {
                format = Some(*name);
            }
            ["format", other, ..] => {
                return Err(MeshError::format(format!(
                    "format {other} is not ascii 1.0, binary_little_endian 1.0 or binary_big_endian 1.0"
                )));
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| {
                    MeshError::format(format!(
                        "element {} has count {:?}",
                        excerpt(name),
                        excerpt(count)
                    ))
                })?;
                elements.push(Element {
                    name: (*name).to_owned(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", "list", count, kind, name] => {
                let (Some(count), Some(kind)) = (Kind::parse(count), Kind::parse(kind)) else {
                    return Err(MeshError::format(format!(
                        "property {name} has an unknown type"
                    )));
                };
                let element = elements
                    .last_mut()
                    .ok_or_else(|| MeshError::format("a property before any element"))?;
                element
                    .properties
                    .push(Property::List((*name).to_owned(), count, kind));
            }
            ["property", kind, name] => {
                let kind = Kind::parse(kind).ok_or_else(|| {
                    MeshError::format(format!("property {name} has the unknown type {kind}"))
                })?;
                let element = elements
                    .last_mut()
                    .ok_or_else(|| MeshError::format("a property before any element"))?;
                element
                    .properties
                    .push(Property::Scalar((*name).to_owned(), kind));
            }
            ["end_header"] => break,
            _ => {}
        }
    }
    if elements
        .iter()
        .any(|e| e.properties.is_empty() && e.count > 0)
    {
        return Err(MeshError::format("an element without properties"));
    }
    for axis in ["x", "y", "z"] {
        let given = |p: &Property| matches!(p, Property::Scalar(name, _) if name == axis);
        if let Some(vertex) = elements.iter().find(|e| e.name == "vertex")
            && !vertex.properties.iter().any(given)
        {
            return Err(MeshError::format(format!("the vertices have no {axis}")));
        }
    }
    let body = match format {
        Some("binary_little_endian") => Body::LittleEndian(rest),
        Some("binary_big_endian") => Body::BigEndian(rest),
        Some(_) => Body::Ascii(
            std::str::from_utf8(rest)
                .map_err(|_| MeshError::format("the body is not text"))?
                .split_ascii_whitespace(),
        ),
        None => return Err(MeshError::format("the header has no format line")),
    };
    Ok((elements, body))
}

/// Writes a mesh as binary little-endian PLY, millimetres.
pub fn write(mesh: &Mesh, out: &mut dyn Write) -> std::io::Result<()> {
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment millimetres\nelement vertex {}\n",
        mesh.positions_mm.len()
    )?;
    write!(
        out,
        "property float x\nproperty float y\nproperty float z\n"
    )?;
    if mesh.normals.is_some() {
        write!(
            out,
            "property float nx\nproperty float ny\nproperty float nz\n"
        )?;
    }
    write!(
        out,
        "element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.triangles.len()
    )?;
    for (i, p) in mesh.positions_mm.iter().enumerate() {
        for value in p.to_array() {
            out.write_all(&value.to_le_bytes())?;
        }
        if let Some(normals) = &mesh.normals {
            for value in normals[i].to_array() {
                out.write_all(&value.to_le_bytes())?;
            }
        }
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for v in triangle {
            out.write_all(&v.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ascii_polygons_become_fans() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
        let mesh = parse(text.as_bytes(), 10.0).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_mm[2], Vec3::new(10.0, 10.0, 0.0));
    }

    #[test]
    fn both_byte_orders_are_read() {
        let file = |order: &str, number: fn(f32) -> [u8; 4], index: fn(i32) -> [u8; 4]| {
            let mut bytes = format!("ply\nformat binary_{order}_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n").into_bytes();
            for value in [0.0, 0.0, 1.5, 2.0, 0.0, 1.5, 0.0, 3.0, 1.5] {
                bytes.extend(number(value));
            }
            bytes.push(3);
            (0..3).for_each(|i| bytes.extend(index(i)));
            bytes
        };
        let little = parse(&file("little", f32::to_le_bytes, i32::to_le_bytes), 1.0).unwrap();
        let big = parse(&file("big", f32::to_be_bytes, i32::to_be_bytes), 1.0).unwrap();
        assert_eq!(little, big);
        assert_eq!(big.positions_mm[2], Vec3::new(0.0, 3.0, 1.5));
    }

    #[test]
    fn vertices_without_a_coordinate_are_refused() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n0 0\n";
        let error = parse(text.as_bytes(), 1.0).unwrap_err().to_string();
        assert!(error.contains("the vertices have no z"), "{error}");
    }
}
