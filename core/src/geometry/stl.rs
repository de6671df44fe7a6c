//! STL: binary (80 bytes of any text, a count, 50 bytes per triangle, little-endian)
//! and ascii (3D Systems, "StereoLithography Interface Specification", 1989).
//!
//! The format shares no vertices; corners at exactly equal positions become one. The
//! front follows from the order of the corners; the stored normals are passed over, and so
//! are the two bytes after each binary facet, in which some programs keep a colour.

use std::collections::HashMap;
use std::io::Write;

use glam::DVec3;

use super::draft::{Corner, Draft};
use super::mesh::{Mesh, MeshError};
use super::mesh_error::MeshRemark;
use super::placement::Placement;
use super::text::{decoded, lines, vector};
use crate::shown::excerpt;

const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// The mesh of a file's bytes. A file whose length fits its binary count is binary,
/// whatever its first word: many binary files begin with "solid" too.
///
/// # Errors
/// The bytes follow neither form, or no usable mesh comes of them.
pub fn parse(bytes: &[u8], placement: &Placement) -> Result<Mesh, MeshError> {
    draft(bytes)?.mesh(placement)
}

/// The content of a file, from its bytes.
pub(super) fn draft(bytes: &[u8]) -> Result<Draft, MeshError> {
    let mut weld = Weld::default();
    let text = decoded(bytes);
    if declared(bytes).is_some_and(|count| HEADER + count * TRIANGLE == bytes.len()) {
        binary(bytes, &mut weld)?;
    } else if is_text(&text) {
        ascii(&text, &mut weld)?;
    } else {
        binary(bytes, &mut weld)?;
    }
    Ok(weld.draft)
}

/// Whether a file is of the ascii form: text that begins with "solid", or says "facet" soon.
fn is_text(bytes: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(1024)];
    let lower = start.trim_ascii_start().to_ascii_lowercase();
    let is_control = |b: &u8| matches!(b, 0..=8 | 14..=31);
    !start.iter().any(is_control)
        && (lower.starts_with(b"solid") || lower.windows(5).any(|word| word == b"facet"))
}

/// The count in a binary file's header.
fn declared(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(HEADER - 4..)?.first_chunk()?;
    Some(u32::from_le_bytes(*count) as usize)
}

/// Reads one solid after the other: some programs put several in one file.
fn binary(mut bytes: &[u8], weld: &mut Weld) -> Result<(), MeshError> {
    weld.draft.are_single = true;
    loop {
        let Some(count) = declared(bytes) else {
            return Err(MeshError::format(format!(
                "the file has {} bytes: neither \"solid\" nor a binary header of {HEADER}",
                bytes.len()
            )));
        };
        let body = &bytes[HEADER..];
        let (whole, rest) = (body.len() / TRIANGLE, body.len() % TRIANGLE);
        let take = match count {
            _ if whole == count => count,
            // Without a remainder, what is there are facets; 0 and the largest number stand
            // in files whose writer did not know the count.
            _ if rest == 0 && (count > whole || count == 0) => whole,
            0 | 0xffff_ffff => whole,
            _ if count > whole => {
                return Err(MeshError::CutShort {
                    what: format!(
                        "it declares {count} facets, which take {} bytes, and has {}",
                        HEADER + count * TRIANGLE,
                        bytes.len()
                    ),
                });
            }
            _ => count,
        };
        if take != count {
            weld.draft.remarks.push(MeshRemark::Count {
                declared: count,
                facets: take,
            });
        }
        for record in body.chunks_exact(TRIANGLE).take(take) {
            weld.push(record_corners(record).map(|p| (p, None)))?;
        }
        let after = &body[take * TRIANGLE..];
        let next = declared(after).filter(|&n| n > 0 && HEADER + n * TRIANGLE <= after.len());
        if next.is_some() {
            bytes = after;
            continue;
        }
        if !after.is_empty() {
            weld.draft.remarks.push(MeshRemark::BytesAfter {
                bytes: after.len(),
                facets: weld.draft.polygons(),
            });
        }
        return Ok(());
    }
}

fn record_corners(record: &[u8]) -> [DVec3; 3] {
    let number = |at: usize| {
        let four = record[at..].first_chunk().copied().unwrap_or_default();
        f64::from(f32::from_le_bytes(four))
    };
    [12, 24, 36].map(|at| DVec3::new(number(at), number(at + 4), number(at + 8)))
}

fn ascii(bytes: &[u8], weld: &mut Weld) -> Result<(), MeshError> {
    let mut corners: Vec<(DVec3, Option<usize>)> = Vec::with_capacity(3);
    let mut in_loop = false;
    let mut ended = true;
    for (number, raw) in lines(bytes) {
        let wrong = |what: String| MeshError::format(format!("line {number}: {what}"));
        // Names of solids may be in any encoding.
        let line = String::from_utf8_lossy(raw);
        let mut words = line.split_ascii_whitespace().peekable();
        // Some programs write a facet on one line.
        while let Some(word) = words.next() {
            let mut keyword = word.to_ascii_lowercase();
            if keyword == "end" {
                // Some write "end solid".
                keyword.extend(words.next().map(str::to_ascii_lowercase));
            }
            match keyword.as_str() {
                // A name follows, of any words.
                "solid" => {
                    ended = false;
                    break;
                }
                "facet" => {
                    ended = false;
                    while words
                        .next_if(|next| !next.eq_ignore_ascii_case("outer"))
                        .is_some()
                    {}
                }
                "outer" if !in_loop => {
                    in_loop = true;
                    words.next_if(|next| next.eq_ignore_ascii_case("loop"));
                }
                "vertex" if in_loop => {
                    let position = DVec3::from_array(vector(&mut words, number)?);
                    corners.push((position, Some(number)));
                }
                "endloop" if in_loop => {
                    if corners.len() < 3 {
                        return Err(wrong(format!(
                            "the loop has {} corners; 3 are needed",
                            corners.len()
                        )));
                    }
                    weld.push(corners.drain(..))?;
                    in_loop = false;
                }
                "endfacet" if !in_loop => {}
                "endsolid" if !in_loop => {
                    ended = true;
                    break;
                }
                // Colours and comments of some programs.
                "color" | "colour" if !in_loop => break,
                comment if !in_loop && comment.starts_with(['#', ';', '/']) => break,
                _ => {
                    return Err(wrong(format!("{:?} is out of place here", excerpt(word))));
                }
            }
        }
    }
    if in_loop {
        return Err(MeshError::CutShort {
            what: "it ends within a facet".to_owned(),
        });
    }
    if !ended {
        weld.draft.remarks.push(MeshRemark::NoEnd);
    }
    Ok(())
}

/// Facets whose corners at exactly equal positions are one vertex.
#[derive(Default)]
struct Weld {
    draft: Draft,
    vertex_at: HashMap<[u64; 3], u32>,
}

impl Weld {
    /// Adds a facet of these corners, each with its line in a text.
    fn push(
        &mut self,
        corners: impl IntoIterator<Item = (DVec3, Option<usize>)>,
    ) -> Result<(), MeshError> {
        let vertices = &mut self.draft.vertices;
        let broken = &mut self.draft.broken_lines;
        let corners: Vec<Corner> = corners
            .into_iter()
            .map(|(p, line)| {
                // Adding zero makes −0 and 0 one.
                let key = (p + DVec3::ZERO).to_array().map(f64::to_bits);
                Corner::bare(*self.vertex_at.entry(key).or_insert_with(|| {
                    broken.extend(
                        line.filter(|_| !p.is_finite())
                            .map(|l| (vertices.len() as u32, l)),
                    );
                    vertices.push(p);
                    (vertices.len() - 1) as u32
                }))
            })
            .collect();
        self.draft.push(corners)
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
    use glam::Vec3;

    const SQUARE: &str = "solid a square\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 1e0 1 0\n  endloop\n endfacet\n facet normal 0 0 1\n  outer loop\n   vertex 0 -0.0 0\n   vertex 1 1 0\n   vertex 0 1 0\n  endloop\n endfacet\nendsolid a square\n";

    fn read(bytes: &[u8]) -> Result<Mesh, MeshError> {
        parse(bytes, &Placement::default())
    }

    fn square() -> Mesh {
        read(SQUARE.as_bytes()).unwrap()
    }

    fn square_bytes() -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&square(), &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn equal_corners_are_welded() {
        let mesh = parse(SQUARE.as_bytes(), &Placement::scaled(2.0)).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_mm[2], Vec3::new(2.0, 2.0, 0.0));
    }

    #[test]
    fn a_binary_file_may_begin_with_solid() {
        let mut bytes = square_bytes();
        assert_eq!(bytes.len(), 84 + 2 * 50);
        bytes[..5].copy_from_slice(b"solid");
        // A colour in the attribute bytes.
        bytes[84 + 48] = 0xff;
        assert_eq!(read(&bytes).unwrap(), square());
    }

    #[test]
    fn dialects_are_read() {
        for text in [
            SQUARE.to_uppercase(),
            SQUARE.replace('\n', "\r\n"),
            SQUARE.replace('\n', "\r"),
            format!("\u{feff}{SQUARE}"),
            SQUARE.replace("solid a square", "solid"),
            SQUARE.replace("end", "end "),
            SQUARE.replace("0 0 1\n", "nan nan -1.#IND\n"),
            SQUARE.replace(" facet", " color 1 0 0\n facet"),
            SQUARE.replace(" facet", "endsolid a\nsolid facet of two words\n facet"),
            // Each facet on one line.
            SQUARE
                .replace("\n  ", " ")
                .replace("\n endfacet", " endfacet"),
        ] {
            let mesh = read(text.as_bytes()).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(mesh, square(), "{text}");
        }
        let open = SQUARE.replace("endsolid a square\n", "");
        let mesh = read(open.as_bytes()).unwrap();
        assert_eq!(mesh.triangles, square().triangles);
        assert_eq!(mesh.remarks[0].what, MeshRemark::NoEnd);
        let quad = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid";
        assert_eq!(read(quad.as_bytes()).unwrap(), square());
    }

    #[test]
    fn counts_and_lengths_that_disagree_are_remarked_on() {
        let remarks = |bytes: &[u8]| {
            let mesh = read(bytes).unwrap();
            assert_eq!(mesh.triangles, square().triangles);
            mesh.remarks.into_iter().map(|r| r.what).collect::<Vec<_>>()
        };
        let bytes = square_bytes();
        let with = |count: u32, more: &[u8]| {
            let mut bytes = [&bytes[..], more].concat();
            bytes[80..84].copy_from_slice(&count.to_le_bytes());
            bytes
        };
        let after = |bytes| MeshRemark::BytesAfter { bytes, facets: 2 };
        let count = |declared| MeshRemark::Count {
            declared,
            facets: 2,
        };
        assert_eq!(remarks(&with(2, &[7; 16])), [after(16)]);
        assert_eq!(remarks(&with(2, &[0; 50])), [after(50)]);
        assert_eq!(remarks(&with(0, &[])), [count(0)]);
        assert_eq!(remarks(&with(0, &[1; 3])), [count(0), after(3)]);
        assert_eq!(remarks(&with(u32::MAX, &[])), [count(u32::MAX as usize)]);
        assert_eq!(remarks(&with(3, &[])), [count(3)]);
        // Two solids, one after the other.
        let mut second = with(2, &[]);
        let (header, body) = second.split_at_mut(HEADER);
        header[0] = b'x';
        for record in body.chunks_exact_mut(TRIANGLE) {
            for at in [20, 32, 44] {
                record[at..at + 4].copy_from_slice(&5f32.to_le_bytes());
            }
        }
        let two = [bytes.clone(), second].concat();
        let mesh = read(&two).unwrap();
        assert_eq!((mesh.triangles.len(), mesh.remarks.len()), (4, 0));
        let short = read(&bytes[..bytes.len() - 7]).unwrap_err();
        assert!(matches!(short, MeshError::CutShort { .. }), "{short}");
    }

    #[test]
    fn errors_name_the_place() {
        for (good, wrong, expected) in [
            (
                "vertex 1 0 0",
                "vertex 1 inf 0",
                "line 5: vertex 1 has a coordinate that is not finite",
            ),
            (
                "vertex 1 0 0",
                "vertex 1,0 0 0",
                "line 5: \"1,0\" has a decimal comma",
            ),
            (
                "vertex 1 0 0",
                "vertex 1 0",
                "line 5: three numbers are needed",
            ),
            ("   vertex 1 0 0\n", "", "line 6: the loop has 2 corners"),
            (
                "  endloop\n",
                "",
                "line 7: \"endfacet\" is out of place here",
            ),
            (
                "endsolid",
                "endsolids",
                "line 16: \"endsolids\" is out of place",
            ),
        ] {
            assert!(SQUARE.contains(good), "{good}");
            let text = SQUARE.replacen(good, wrong, 1);
            let error = read(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(expected), "{wrong}: {error}");
        }
        let flat = SQUARE.replace("1e0 1 0", "1 0 0").replace("0 1 0", "2 2 0");
        let error = read(flat.as_bytes()).unwrap_err().to_string();
        assert!(
            error.contains("none of the 2 facets has an area"),
            "{error}"
        );
        let mut bytes = vec![0; 84];
        bytes[80..].copy_from_slice(&5u32.to_le_bytes());
        bytes.extend([0; 49]);
        let error = read(&bytes).unwrap_err().to_string();
        assert!(
            error.contains("it declares 5 facets, which take 334 bytes"),
            "{error}"
        );
        let mut bytes = square_bytes();
        bytes[84 + 16..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        let error = read(&bytes).unwrap_err().to_string();
        assert!(
            error.contains("has a coordinate that is not finite"),
            "{error}"
        );
    }
}
