//! Wavefront OBJ: `v`, `vn` and `f` lines; groups, materials and texture
//! coordinates are passed over (Wavefront, "Advanced Visualizer" manual, appendix B1).

use std::collections::HashMap;
use std::io::Write;

use glam::Vec3;

use super::mesh::{MAX_TRIANGLES, Mesh, MeshError};
use crate::shown::excerpt;

/// The mesh of a file's bytes; polygons are cut into fans. Normals are kept where
/// every corner has one: positions used with several normals become as many vertices.
pub fn parse(bytes: &[u8], mm_per_unit: f32) -> Result<Mesh, MeshError> {
    let mut file = File::default();
    // A line that ends in a backslash goes on in the next one.
    let mut begun = String::new();
    for (index, raw) in bytes.split(|&b| b == b'\n').enumerate() {
        let text = String::from_utf8_lossy(raw);
        let text = text.trim_end();
        if let Some(head) = text.strip_suffix('\\') {
            begun += head;
            begun.push(' ');
            continue;
        }
        begun += text;
        file.line(&begun)
            .map_err(|what| MeshError::format(format!("line {}: {what}", index + 1)))?;
        begun.clear();
        if file.triangles.len() > MAX_TRIANGLES {
            return Err(MeshError::TooLarge {
                triangles: file.triangles.len(),
                limit: MAX_TRIANGLES,
            });
        }
    }
    file.mesh(mm_per_unit)
}

/// Indices of a corner's position and normal.
type Corner = (u32, Option<u32>);

/// What has been read so far.
#[derive(Default)]
struct File {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[Corner; 3]>,
}

impl File {
    fn line(&mut self, line: &str) -> Result<(), String> {
        let line = line.split('#').next().unwrap_or("");
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => self.positions.push(vector(words)?),
            Some("vn") => self.normals.push(vector(words)?),
            Some("f") => {
                let mut fan: [Option<Corner>; 2] = [None; 2];
                let mut corners = 0;
                for word in words {
                    let corner = self.corner(word)?;
                    match fan {
                        [None, _] => fan[0] = Some(corner),
                        [_, None] => fan[1] = Some(corner),
                        [Some(a), Some(b)] => {
                            self.triangles.push([a, b, corner]);
                            fan[1] = Some(corner);
                        }
                    }
                    corners += 1;
                }
                if corners < 3 {
                    return Err(format!(
                        "the face has {corners} corners; at least 3 are needed"
                    ));
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; 1 is the first, −1 the last so far.
    fn corner(&self, word: &str) -> Result<Corner, String> {
        let index = |text: &str, count: usize, what: &str| -> Result<u32, String> {
            let number: i64 = text
                .parse()
                .map_err(|_| format!("{:?} is not a corner of a face", excerpt(word)))?;
            let from_zero = match number {
                1.. => number - 1,
                _ => number.saturating_add(count as i64),
            };
            if number != 0 && (0..count as i64).contains(&from_zero) {
                Ok(from_zero as u32)
            } else {
                Err(format!(
                    "the face refers to {what} {number}, but {count} stand before it"
                ))
            }
        };
        let mut parts = word.split('/');
        let position = index(parts.next().unwrap_or(""), self.positions.len(), "vertex")?;
        let normal = match parts.nth(1) {
            None | Some("") => None,
            Some(text) => Some(index(text, self.normals.len(), "normal")?),
        };
        Ok((position, normal))
    }

    fn mesh(self, mm_per_unit: f32) -> Result<Mesh, MeshError> {
        let scaled = |p: &Vec3| *p * mm_per_unit;
        let shaded = self.triangles.iter().flatten().all(|c| c.1.is_some());
        if !shaded {
            let positions = self.positions.iter().map(scaled).collect();
            let triangles = self.triangles.iter().map(|t| t.map(|c| c.0)).collect();
            return Mesh::new(positions, triangles);
        }
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        let mut vertex_of: HashMap<Corner, u32> = HashMap::new();
        let mut vertex = |corner: Corner| {
            *vertex_of.entry(corner).or_insert_with(|| {
                positions.push(scaled(&self.positions[corner.0 as usize]));
                normals.push(self.normals[corner.1.unwrap_or(0) as usize]);
                (positions.len() - 1) as u32
            })
        };
        // Vertices in the order of the file's positions.
        let mut corners: Vec<Corner> = self.triangles.iter().flatten().copied().collect();
        corners.sort_unstable();
        corners.into_iter().for_each(|c| {
            vertex(c);
        });
        let triangles = self.triangles.iter().map(|t| t.map(&mut vertex)).collect();
        Mesh::new(positions, triangles)?.with_normals(normals)
    }
}

fn vector<'a>(mut words: impl Iterator<Item = &'a str>) -> Result<Vec3, String> {
    let mut v = [0.0f32; 3];
    for value in &mut v {
        let word = words.next().ok_or("three numbers are needed")?;
        *value = match word.parse() {
            Ok(number) if f32::is_finite(number) => number,
            _ => return Err(format!("{:?} is not a finite number", excerpt(word))),
        };
    }
    Ok(Vec3::from_array(v))
}

/// Writes a mesh, millimetres, with its normals where it has them; numbers in full.
pub fn write(mesh: &Mesh, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "# millimetres")?;
    for p in &mesh.positions_mm {
        writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for n in mesh.normals.iter().flatten() {
        writeln!(out, "vn {} {} {}", n.x, n.y, n.z)?;
    }
    for &triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| u64::from(v) + 1);
        if mesh.normals.is_some() {
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        } else {
            writeln!(out, "f {a} {b} {c}")?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "# by hand\nmtllib x.mtl\no square\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0 # last\nvt 0 0\ng front\nf 1 2/1 3 \\\n -1\n";

    #[test]
    fn polygons_relative_indices_and_continued_lines_are_read() {
        let mesh = parse(SQUARE.as_bytes(), 10.0).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_mm[2], Vec3::new(10.0, 10.0, 0.0));
        assert!(mesh.normals.is_none());
    }

    #[test]
    fn a_crease_has_a_vertex_for_each_normal() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2\n";
        let mesh = parse(text.as_bytes(), 1.0).unwrap();
        assert_eq!(mesh.positions_mm.len(), 6);
        let normals = mesh.normals.as_ref().unwrap();
        for (i, corners) in mesh.triangles.iter().enumerate() {
            for &v in corners {
                assert!(mesh.face_normal(i).dot(normals[v as usize]) > 0.999);
            }
        }
    }

    #[test]
    fn errors_name_the_line() {
        for (good, wrong, expected) in [
            (
                "v 1 1 0",
                "v 1 nan 0",
                "line 6: \"nan\" is not a finite number",
            ),
            ("v 1 1 0", "v 1 1", "line 6: three numbers are needed"),
            (
                "f 1",
                "f 9",
                "line 11: the face refers to vertex 9, but 4 stand before it",
            ),
            ("f 1", "f 0", "line 11: the face refers to vertex 0"),
            ("f 1", "f x", "line 11: \"x\" is not a corner of a face"),
            (
                "f 1 2/1 3 \\\n -1",
                "f 1 2",
                "line 10: the face has 2 corners",
            ),
            ("f 1 2/1 3", "f 1 2 2", "triangle 0 has no area"),
            (
                "f 1",
                "f 1//1",
                "line 11: the face refers to normal 1, but 0 stand before it",
            ),
        ] {
            assert!(SQUARE.contains(good), "{good}");
            let text = SQUARE.replacen(good, wrong, 1);
            let error = parse(text.as_bytes(), 1.0).unwrap_err().to_string();
            assert!(error.contains(expected), "{wrong}: {error}");
        }
    }
}
