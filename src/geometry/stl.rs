//! STL: binary (80 bytes of any text, a count, 50 bytes per triangle, little-endian)
//! and ascii (3D Systems, "StereoLithography Interface Specification", 1989).
//!
//! The format shares no vertices; corners at exactly equal places become one. The
//! front is told by the order of the corners; the stored normals are passed over.

use std::collections::HashMap;
use std::io::Write;

use glam::Vec3;

use super::mesh::{MAX_TRIANGLES, Mesh, MeshError};
use crate::shown::excerpt;

const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// The mesh of a file's bytes. A file whose length fits its binary count is binary,
/// whatever its first word: many binary files begin with "solid" too.
pub fn parse(bytes: &[u8], mm_per_unit: f32) -> Result<Mesh, MeshError> {
    let count = bytes
        .get(HEADER - 4..)
        .and_then(|rest| rest.first_chunk())
        .map(|count| u32::from_le_bytes(*count) as usize);
    let declared = count.map(|n| HEADER + n * TRIANGLE);
    let mut weld = Weld::default();
    if declared == Some(bytes.len()) {
        binary(&bytes[HEADER..], mm_per_unit, &mut weld)?;
    } else if bytes.trim_ascii_start().starts_with(b"solid") {
        ascii(bytes, mm_per_unit, &mut weld)?;
    } else {
        return Err(match (count, declared) {
            (Some(count), Some(declared)) => MeshError::format(format!(
                "the file declares {count} triangles, which take {declared} bytes, but has {}",
                bytes.len()
            )),
            _ => MeshError::format(format!(
                "the file has {} bytes: neither \"solid\" nor a binary header of {HEADER}",
                bytes.len()
            )),
        });
    }
    Mesh::new(weld.positions, weld.triangles)
}

fn binary(body: &[u8], mm_per_unit: f32, weld: &mut Weld) -> Result<(), MeshError> {
    for (index, record) in body.chunks_exact(TRIANGLE).enumerate() {
        let number = |at: usize| {
            let four = record[at..].first_chunk().copied().unwrap_or_default();
            f32::from_le_bytes(four) * mm_per_unit
        };
        let corners = [12, 24, 36].map(|at| Vec3::new(number(at), number(at + 4), number(at + 8)));
        if !corners.iter().all(|p| p.is_finite()) {
            return Err(MeshError::format(format!(
                "triangle {index}, byte {}: a coordinate is not finite",
                HEADER + index * TRIANGLE
            )));
        }
        weld.push(corners)?;
    }
    Ok(())
}

fn ascii(bytes: &[u8], mm_per_unit: f32, weld: &mut Weld) -> Result<(), MeshError> {
    let mut corners: Vec<Vec3> = Vec::with_capacity(3);
    let mut in_loop = false;
    let mut ended = false;
    for (index, raw) in bytes.split(|&b| b == b'\n').enumerate() {
        let wrong = |what: String| MeshError::format(format!("line {}: {what}", index + 1));
        // Names of solids may be in any encoding.
        let line = String::from_utf8_lossy(raw);
        let mut words = line.split_ascii_whitespace();
        let Some(first) = words.next() else { continue };
        match first.to_ascii_lowercase().as_str() {
            "solid" => ended = false,
            "facet" | "endfacet" => {}
            "outer" if !in_loop => in_loop = true,
            "vertex" if in_loop && corners.len() < 3 => {
                let mut p = [0.0f32; 3];
                for value in &mut p {
                    let word = words
                        .next()
                        .ok_or_else(|| wrong("three numbers are needed".to_owned()))?;
                    *value = match word.parse::<f32>().map(|v| v * mm_per_unit) {
                        Ok(number) if number.is_finite() => number,
                        _ => {
                            return Err(wrong(format!(
                                "{:?} is not a finite number",
                                excerpt(word)
                            )));
                        }
                    };
                }
                corners.push(Vec3::from_array(p));
            }
            "endloop" if in_loop => {
                let Ok(triangle) = <[Vec3; 3]>::try_from(corners.as_slice()) else {
                    return Err(wrong(format!(
                        "the loop has {} corners; 3 are needed",
                        corners.len()
                    )));
                };
                weld.push(triangle)?;
                corners.clear();
                in_loop = false;
            }
            "endsolid" if !in_loop => ended = true,
            _ => {
                let word: String = first.chars().take(40).collect();
                return Err(wrong(format!("{:?} is out of place here", excerpt(&word))));
            }
        }
    }
    if ended {
        Ok(())
    } else {
        Err(MeshError::format("the file ends before \"endsolid\""))
    }
}

/// Triangles whose corners at exactly equal places are one vertex.
#[derive(Default)]
struct Weld {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    vertex_at: HashMap<[u32; 3], u32>,
}

impl Weld {
    fn push(&mut self, corners: [Vec3; 3]) -> Result<(), MeshError> {
        let triangle = corners.map(|p| {
            // Adding zero makes −0 and 0 one.
            let key = (p + Vec3::ZERO).to_array().map(f32::to_bits);
            *self.vertex_at.entry(key).or_insert_with(|| {
                self.positions.push(p);
                (self.positions.len() - 1) as u32
            })
        });
        self.triangles.push(triangle);
        if self.triangles.len() > MAX_TRIANGLES {
            return Err(MeshError::TooLarge {
                triangles: self.triangles.len(),
                limit: MAX_TRIANGLES,
            });
        }
        Ok(())
    }
}

/// Writes a mesh as binary STL, millimetres; vertex normals find no place in it.
pub fn write(mesh: &Mesh, out: &mut dyn Write) -> std::io::Result<()> {
    let mut header = [b' '; HEADER - 4];
    header[..11].copy_from_slice(b"millimetres");
    out.write_all(&header)?;
    out.write_all(&(mesh.triangles.len() as u32).to_le_bytes())?;
    for i in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(i);
        for value in [mesh.face_normal(i), a, b, c]
            .iter()
            .flat_map(|v| v.to_array())
        {
            out.write_all(&value.to_le_bytes())?;
        }
        out.write_all(&[0; 2])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "solid a square\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 1e0 1 0\n  endloop\n endfacet\n facet normal 0 0 1\n  outer loop\n   vertex 0 -0.0 0\n   vertex 1 1 0\n   vertex 0 1 0\n  endloop\n endfacet\nendsolid a square\n";

    #[test]
    fn equal_corners_are_welded() {
        let mesh = parse(SQUARE.as_bytes(), 2.0).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_mm[2], Vec3::new(2.0, 2.0, 0.0));
    }

    #[test]
    fn a_binary_file_may_begin_with_solid() {
        let mesh = parse(SQUARE.as_bytes(), 1.0).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        assert_eq!(bytes.len(), 84 + 2 * 50);
        bytes[..5].copy_from_slice(b"solid");
        assert_eq!(parse(&bytes, 1.0).unwrap(), mesh);
    }

    #[test]
    fn errors_name_the_place() {
        for (good, wrong, expected) in [
            (
                "vertex 1 0 0",
                "vertex 1 inf 0",
                "line 5: \"inf\" is not a finite number",
            ),
            (
                "vertex 1 0 0",
                "vertex 1 0",
                "line 5: three numbers are needed",
            ),
            ("   vertex 1 0 0\n", "", "line 6: the loop has 2 corners"),
            (
                "  endloop\n",
                "   vertex 2 2 2\n",
                "line 7: \"vertex\" is out of place here",
            ),
            (
                "endsolid",
                "endsolids",
                "line 16: \"endsolids\" is out of place",
            ),
            (
                "endsolid a square\n",
                "",
                "the file ends before \"endsolid\"",
            ),
            ("1e0 1 0", "1 0 0", "triangle 0 has no area"),
        ] {
            assert!(SQUARE.contains(good), "{good}");
            let text = SQUARE.replacen(good, wrong, 1);
            let error = parse(text.as_bytes(), 1.0).unwrap_err().to_string();
            assert!(error.contains(expected), "{wrong}: {error}");
        }
        let mut bytes = vec![0; 84];
        bytes[80..].copy_from_slice(&u32::MAX.to_le_bytes());
        let error = parse(&bytes, 1.0).unwrap_err().to_string();
        assert!(error.contains("declares 4294967295 triangles"), "{error}");
        bytes[80..].copy_from_slice(&1u32.to_le_bytes());
        bytes.extend([0; 50]);
        bytes[84 + 16..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        let error = parse(&bytes, 1.0).unwrap_err().to_string();
        assert!(
            error.contains("triangle 0, byte 84: a coordinate is not finite"),
            "{error}"
        );
    }
}
