//! Wavefront OBJ: `v`, `vn` and `f` lines; all others are passed over: groups, materials,
//! texture coordinates, lines and points (Wavefront, "Advanced Visualizer" manual, appendix B1).

use std::io::Write;

use glam::{DVec3, Vec3};

use super::draft::{Corner, Draft, NO_NORMAL};
use super::mesh::{Mesh, MeshError};
use super::placement::Placement;
use super::text::{decoded, lines, vector};
use crate::shown::excerpt;

/// The mesh of a file's bytes. Normals are kept where every corner has one: positions used
/// with several normals become as many vertices.
///
/// # Errors
/// A line is wrong, or no usable mesh comes of all.
pub fn parse(bytes: &[u8], placement: &Placement) -> Result<Mesh, MeshError> {
    draft(bytes)?.mesh(placement)
}

/// The content of a file, from its bytes.
pub(super) fn draft(bytes: &[u8]) -> Result<Draft, MeshError> {
    let mut file = File::default();
    // A line that ends in a backslash goes on in the next one.
    let mut begun = String::new();
    for (number, raw) in lines(&decoded(bytes)) {
        let text = String::from_utf8_lossy(raw);
        let code = without_comment(&text);
        if let Some(head) = text.trim_end().strip_suffix('\\')
            && code.len() == text.len()
            && (!begun.is_empty() || is_read(code))
        {
            begun += head;
            begun.push(' ');
            continue;
        }
        begun += code;
        file.line(&begun, number)?;
        begun.clear();
    }
    file.line(&begun, 0)?;
    if let Some((number, line)) = file.farthest
        && number > file.draft.vertices.len() as i64
    {
        return Err(MeshError::format(format!(
            "line {line}: the face refers to vertex {number}, but there are {}",
            file.draft.vertices.len()
        )));
    }
    Ok(file.draft)
}

/// A line up to its comment. What C libraries print for no number, `1.#IND`, is none.
fn without_comment(line: &str) -> &str {
    let mut marks = line.match_indices('#').map(|(at, _)| at);
    let comment = marks.find(|&at| !line[..at].ends_with('.'));
    &line[..comment.unwrap_or(line.len())]
}

/// Whether a line is one of those that count. A path in another line may end in a backslash.
fn is_read(line: &str) -> bool {
    let word = line.split_ascii_whitespace().next().unwrap_or("");
    ["v", "vn", "f", "fo"].contains(&word.to_ascii_lowercase().as_str())
}

/// What has been read so far.
#[derive(Default)]
struct File {
    draft: Draft,
    /// The largest number of a vertex that a face refers to, and its line.
    farthest: Option<(i64, usize)>,
    corners: Vec<Corner>,
}

impl File {
    fn line(&mut self, line: &str, number: usize) -> Result<(), MeshError> {
        let mut words = line.split_ascii_whitespace();
        let keyword = words.next().unwrap_or("").to_ascii_lowercase();
        match keyword.as_str() {
            // A weight or a colour may follow.
            "v" => {
                let position = DVec3::from_array(vector(words, number)?);
                if !position.is_finite() {
                    let vertex = self.draft.vertices.len() as u32;
                    self.draft.broken_lines.push((vertex, number));
                }
                self.draft.vertices.push(position);
            }
            "vn" => {
                let normal = vector(words, number)?.map(|n| n as f32);
                self.draft.normals.push(Vec3::from_array(normal));
            }
            "f" | "fo" => {
                let mut corners = std::mem::take(&mut self.corners);
                corners.clear();
                for word in words {
                    corners.push(self.corner(word, number)?);
                }
                self.draft.push(corners.iter().copied())?;
                self.corners = corners;
            }
            _ => {}
        }
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; 1 is the first, −1 the last so far.
    fn corner(&mut self, word: &str, line: usize) -> Result<Corner, MeshError> {
        let index = |text: &str, count: usize, what: &str| -> Result<i64, MeshError> {
            let wrong = |what: String| MeshError::format(format!("line {line}: {what}"));
            let number: i64 = text
                .parse()
                .map_err(|_| wrong(format!("{:?} is not a corner of a face", excerpt(word))))?;
            let from_zero = match number {
                1.. => number - 1,
                _ => number.saturating_add(count as i64),
            };
            if number != 0 && (0..i64::from(NO_NORMAL)).contains(&from_zero) {
                Ok(from_zero)
            } else {
                Err(wrong(format!(
                    "the face refers to {what} {number}, but {count} stand before it"
                )))
            }
        };
        let mut parts = word.split('/');
        let vertex = index(
            parts.next().unwrap_or(""),
            self.draft.vertices.len(),
            "vertex",
        )?;
        if self.farthest.is_none_or(|(number, _)| vertex + 1 > number) {
            self.farthest = Some((vertex + 1, line));
        }
        // 0, which no number of OBJ is, stands for none in files of some programs.
        let normal = match parts.nth(1) {
            None | Some("" | "0") => NO_NORMAL,
            Some(text) => index(text, self.draft.normals.len(), "normal")? as u32,
        };
        Ok(Corner {
            vertex: vertex as u32,
            normal,
        })
    }
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

    fn read(text: &str) -> Result<Mesh, MeshError> {
        parse(text.as_bytes(), &Placement::default())
    }

    #[test]
    fn polygons_relative_indices_and_continued_lines_are_read() {
        let mesh = parse(SQUARE.as_bytes(), &Placement::scaled(10.0)).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_mm[2], Vec3::new(10.0, 10.0, 0.0));
        assert!(mesh.normals.is_none());
    }

    #[test]
    fn a_crease_has_a_vertex_for_each_normal() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2\n";
        let mesh = read(text).unwrap();
        assert_eq!(mesh.positions_mm.len(), 6);
        let normals = mesh.normals.as_ref().unwrap();
        for (i, corners) in mesh.triangles.iter().enumerate() {
            for &v in corners {
                assert!(mesh.face_normal(i).dot(normals[v as usize]) > 0.999);
            }
        }
    }

    /// The same square as other programs write it.
    #[test]
    fn dialects_are_read() {
        let square = read(SQUARE).unwrap();
        let joined = SQUARE.replace(" \\\n", "");
        for text in [
            SQUARE.replace('\n', "\r\n"),
            SQUARE.replace('\n', "\r"),
            format!("\u{feff}{SQUARE}"),
            joined.replace("v 0 0 0", "v 0 0 0 1.0 0.5 0.25 0.1"),
            joined.replace("f 1", "usemtl C:\\new\\\nl 1 2\np 1\ns off\nf 1"),
            joined.replace("# by hand", "# from C:\\scans\\"),
            // Faces first, capital keywords.
            "F 1 2 3 4\nV 0 0 0\nV 1 0 0\nV 1 1 0\nV 0 1 0\n".to_owned(),
            // Vertices that nothing uses, and their normals.
            joined.clone() + "v nan -1.#IND 0\nvn 0 0 0\n",
        ] {
            assert_eq!(read(&text).unwrap(), square, "{text}");
        }
        let no_length = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 0\nf 1//1 2//1 3//1\n";
        let mesh = read(no_length).unwrap();
        assert!(mesh.normals.is_none());
        assert_eq!(mesh.remarks.len(), 1);
        for none in ["1//0", "1/0/0", "1"] {
            let mesh = read(
                &no_length
                    .replace("0 0 0\nf", "0 0 1\nf")
                    .replace("1//1", none),
            )
            .unwrap();
            assert!(mesh.normals.is_none(), "{none}");
            assert_eq!(mesh.remarks.len(), 1, "{none}");
        }
        let backwards = read(&no_length.replace("vn 0 0 0", "vn 0 0 -2")).unwrap();
        assert_eq!(backwards.normals.unwrap(), [Vec3::Z; 3]);
    }

    #[test]
    fn errors_name_the_line() {
        for (good, wrong, expected) in [
            (
                "v 1 1 0",
                "v 1 nan 0",
                "line 6: vertex 2 has a coordinate that is not finite",
            ),
            ("v 1 1 0", "v 1 1", "line 6: three numbers are needed"),
            (
                "v 1 1 0",
                "v 1,5 1 0",
                "line 6: \"1,5\" has a decimal comma",
            ),
            ("v 1 1 0", "v 1 x 0", "line 6: \"x\" is not a number"),
            (
                "f 1",
                "f 9",
                "line 11: the face refers to vertex 9, but there are 4",
            ),
            ("f 1", "f 0", "line 11: the face refers to vertex 0"),
            (
                "f 1",
                "f -5",
                "line 11: the face refers to vertex -5, but 4 stand before it",
            ),
            ("f 1", "f x", "line 11: \"x\" is not a corner of a face"),
            (
                "f 1 2/1 3 \\\n -1",
                "f 1 2",
                "none of the 1 facets has an area",
            ),
        ] {
            assert!(SQUARE.contains(good), "{good}");
            let error = read(&SQUARE.replacen(good, wrong, 1))
                .unwrap_err()
                .to_string();
            assert!(error.contains(expected), "{wrong}: {error}");
        }
        let cloud = read("v 0 0 0\nv 1 0 0\nv 0 1 0\n").unwrap_err();
        assert_eq!(cloud.to_string(), "the mesh has 3 vertices and no facet");
    }
}
