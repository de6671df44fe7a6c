//! PLY meshes, ascii and binary of either byte order; binary little-endian is written.

use std::io::Write;

use glam::{DVec3, Vec3};

use super::draft::{Corner, Draft, NO_NORMAL};
use super::mesh::{Mesh, MeshError};
use super::mesh_error::MeshRemark;
use super::placement::Placement;
use super::ply_header::{self, Element, Encoding, Property, Scalar};
use super::text;

/// The mesh of a file's bytes: polygons and triangle strips. Declared counts are never
/// trusted beyond the bytes present.
///
/// # Errors
/// The file does not follow the format, or no usable mesh comes of it.
pub fn parse(bytes: &[u8], placement: &Placement) -> Result<Mesh, MeshError> {
    draft(bytes)?.mesh(placement)
}

/// The content of a file, from its bytes.
pub(super) fn draft(bytes: &[u8]) -> Result<Draft, MeshError> {
    let bytes = text::decoded(bytes);
    let header = ply_header::parse(&bytes)?;
    let body = match header.encoding {
        Encoding::Ascii => Body::Ascii(Words::new(header.body, header.first_line)),
        Encoding::LittleEndian => Body::Binary(header.body, false),
        Encoding::BigEndian => Body::Binary(header.body, true),
    };
    let of_vertices = || {
        let vertices = header.elements.iter().filter(|e| e.name == "vertex");
        vertices.flat_map(|e| &e.properties)
    };
    let names =
        |axis: &str| of_vertices().any(|p| matches!(p, Property::Single(name, _) if name == axis));
    let is_single = |p: &Property| matches!(p, Property::Single(name, Scalar::F32) if name == "x");
    let mut reader = Reader {
        body,
        has_normals: ["nx", "ny", "nz"].into_iter().all(names),
        draft: Draft::default(),
    };
    reader.draft.are_single = of_vertices().any(is_single);
    for element in &header.elements {
        // Rows of nothing take no bytes, whatever their number.
        if element.properties.is_empty() {
            continue;
        }
        for row in 0..element.count {
            reader.row(element, row)?;
        }
    }
    let Reader {
        body, mut draft, ..
    } = reader;
    match body {
        Body::Ascii(mut words) => {
            if let Some(line) = words.next_line() {
                draft.remarks.push(MeshRemark::LinesAfter { line });
            }
        }
        Body::Binary([], _) => {}
        Body::Binary(rest, _) => draft.remarks.push(MeshRemark::BytesAfter {
            bytes: rest.len(),
            facets: draft.polygons(),
        }),
    }
    Ok(draft)
}

/// The body's numbers in order, whatever the encoding.
enum Body<'a> {
    Ascii(Words<'a>),
    /// And whether its numbers are big-endian.
    Binary(&'a [u8], bool),
}

impl Body<'_> {
    /// The next number; `None` at the end.
    fn next(&mut self, kind: Scalar) -> Result<Option<f64>, MeshError> {
        let (bytes, big) = match self {
            Body::Ascii(words) => return words.next(),
            Body::Binary(bytes, big) => (bytes, *big),
        };
        macro_rules! take {
            ($t:ty) => {{
                let Some((head, rest)) = bytes.split_first_chunk() else {
                    return Ok(None);
                };
                *bytes = rest;
                match big {
                    true => <$t>::from_be_bytes(*head) as f64,
                    false => <$t>::from_le_bytes(*head) as f64,
                }
            }};
        }
        Ok(Some(match kind {
            Scalar::I8 => take!(i8),
            Scalar::U8 => take!(u8),
            Scalar::I16 => take!(i16),
            Scalar::U16 => take!(u16),
            Scalar::I32 => take!(i32),
            Scalar::U32 => take!(u32),
            Scalar::I64 => take!(i64),
            Scalar::U64 => take!(u64),
            Scalar::F32 => take!(f32),
            Scalar::F64 => take!(f64),
        }))
    }
}

/// Words of a text, line by line.
struct Words<'a> {
    /// What is left of the line that is being read.
    here: &'a [u8],
    /// The lines after it.
    rest: Option<&'a [u8]>,
    /// Its number, from 1.
    line: usize,
}

impl<'a> Words<'a> {
    fn new(text: &'a [u8], first_line: usize) -> Self {
        Self {
            here: &[],
            rest: Some(text),
            line: first_line - 1,
        }
    }

    /// Goes to the next line that holds anything, and says its number.
    fn next_line(&mut self) -> Option<usize> {
        loop {
            let (line, rest) = text::split_line(self.rest?);
            self.rest = rest;
            self.line += 1;
            self.here = line.trim_ascii();
            if !self.here.is_empty() && !self.here.starts_with(b"comment") {
                return Some(self.line);
            }
        }
    }

    fn next(&mut self) -> Result<Option<f64>, MeshError> {
        if self.here.is_empty() && self.next_line().is_none() {
            return Ok(None);
        }
        let end = self.here.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = self.here.split_at(end.unwrap_or(self.here.len()));
        self.here = rest.trim_ascii_start();
        text::number(&String::from_utf8_lossy(word), self.line).map(Some)
    }
}

/// A file while it is read.
struct Reader<'a> {
    body: Body<'a>,
    /// Whether every vertex has a normal, which then has its index.
    has_normals: bool,
    draft: Draft,
}

impl Reader<'_> {
    /// Reads one row of an element; of a vertex its position and normal, of a face or a strip its
    /// corners, of anything else nothing.
    fn row(&mut self, element: &Element, row: usize) -> Result<(), MeshError> {
        let mut vertex = [[f64::NAN; 3]; 2];
        for property in &element.properties {
            match property {
                Property::Single(name, kind) => {
                    let value = self.next(*kind, element, row)?;
                    match name.as_str() {
                        "x" => vertex[0][0] = value,
                        "y" => vertex[0][1] = value,
                        "z" => vertex[0][2] = value,
                        "nx" => vertex[1][0] = value,
                        "ny" => vertex[1][1] = value,
                        "nz" => vertex[1][2] = value,
                        _ => {}
                    }
                }
                Property::List(name, count, kind) => {
                    self.list([*count, *kind], Use::of(&element.name, name), element, row)?;
                }
            }
        }
        if element.name == "vertex" {
            self.vertex(vertex);
        }
        // A row is a line: more words on it are columns that the header does not know.
        match &self.body {
            Body::Ascii(words) if !words.here.is_empty() => Err(MeshError::format(format!(
                "line {}: it goes on after the {} numbers of {} {row} that the header declares",
                words.line,
                element.properties.len(),
                element.name
            ))),
            _ => Ok(()),
        }
    }

    fn next(&mut self, kind: Scalar, element: &Element, row: usize) -> Result<f64, MeshError> {
        let number = self.body.next(kind)?;
        number.ok_or_else(|| MeshError::CutShort {
            what: format!("it ends in {} {row} of {}", element.name, element.count),
        })
    }

    fn vertex(&mut self, [position, normal]: [[f64; 3]; 2]) {
        let position = DVec3::from_array(position);
        if let Body::Ascii(words) = &self.body
            && !position.is_finite()
        {
            let vertex = self.draft.vertices.len() as u32;
            self.draft.broken_lines.push((vertex, words.line));
        }
        self.draft.vertices.push(position);
        if self.has_normals {
            let normal = normal.map(|n| n as f32);
            self.draft.normals.push(Vec3::from_array(normal));
        }
    }

    fn list(
        &mut self,
        [count, kind]: [Scalar; 2],
        of: Use,
        element: &Element,
        row: usize,
    ) -> Result<(), MeshError> {
        let wrong = |what: String| MeshError::format(format!("{} {row} {what}", element.name));
        let count = self.next(count, element, row)?;
        if !(0.0..=1e9).contains(&count) || count.fract() != 0.0 {
            return Err(wrong(format!("has a list of {count} items")));
        }
        let mut strip = Strip::default();
        let mut polygon = Vec::new();
        for _ in 0..count as u64 {
            let value = self.next(kind, element, row)?;
            if of == Use::Nothing {
                continue;
            }
            if of == Use::Strips && value == -1.0 {
                strip = Strip::default();
                continue;
            }
            if !(0.0..f64::from(NO_NORMAL)).contains(&value) || value.fract() != 0.0 {
                return Err(wrong(format!("refers to vertex {value}")));
            }
            let vertex = value as u32;
            let corner = Corner {
                vertex,
                normal: if self.has_normals { vertex } else { NO_NORMAL },
            };
            match of {
                Use::Strips => {
                    if let Some(triangle) = strip.triangle(corner) {
                        self.draft.push(triangle)?;
                    }
                }
                _ => polygon.push(corner),
            }
        }
        match of {
            Use::Polygon => self.draft.push(polygon),
            _ => Ok(()),
        }
    }
}

/// A strip of triangles: each corner makes one with the two before it, every other one
/// with the opposite sense.
#[derive(Default)]
struct Strip {
    last: [Option<Corner>; 2],
    is_odd: bool,
}

impl Strip {
    fn triangle(&mut self, corner: Corner) -> Option<[Corner; 3]> {
        let [a, b] = self.last;
        self.last = [b, Some(corner)];
        let (a, b) = (a?, b?);
        self.is_odd = !self.is_odd;
        let triangle = match self.is_odd {
            true => [a, b, corner],
            false => [b, a, corner],
        };
        // A corner twice in a row leads on to the next part of the strip.
        let is_link =
            a.vertex == b.vertex || b.vertex == corner.vertex || a.vertex == corner.vertex;
        (!is_link).then_some(triangle)
    }
}

/// What a list is for.
#[derive(Clone, Copy, PartialEq)]
enum Use {
    Polygon,
    Strips,
    Nothing,
}

impl Use {
    fn of(element: &str, list: &str) -> Self {
        let is_indices = list.starts_with("vertex_ind") || list.starts_with("vertex_idx");
        match element {
            "face" if is_indices || list == "vertices" || list == "indices" => Self::Polygon,
            "tristrips" if is_indices => Self::Strips,
            _ => Self::Nothing,
        }
    }
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

    const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const BODY: &str = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";

    fn read(bytes: impl AsRef<[u8]>) -> Result<Mesh, MeshError> {
        parse(bytes.as_ref(), &Placement::default())
    }

    fn square() -> Mesh {
        read(format!("{HEADER}{BODY}")).unwrap()
    }

    #[test]
    fn polygons_are_cut() {
        let mesh = parse(
            format!("{HEADER}{BODY}").as_bytes(),
            &Placement::scaled(10.0),
        )
        .unwrap();
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
        let little_bytes = file("little", f32::to_le_bytes, i32::to_le_bytes);
        let little = read(&little_bytes).unwrap();
        let big = read(file("big", f32::to_be_bytes, i32::to_be_bytes)).unwrap();
        assert_eq!(little, big);
        assert_eq!(big.positions_mm[2], Vec3::new(0.0, 3.0, 1.5));
        // A header whose lines end in CR, before a body that begins with LF.
        let end = little_bytes.len() - 36 - 13;
        let (header, body) = little_bytes.split_at(end);
        let mut ends_in_cr: Vec<u8> = header.to_vec();
        ends_in_cr
            .iter_mut()
            .filter(|b| **b == b'\n')
            .for_each(|b| *b = b'\r');
        ends_in_cr.extend(body);
        ends_in_cr[end] = b'\n';
        assert!((read(&ends_in_cr).unwrap().positions_mm[0].x - 1.4e-44).abs() < 1e-44);
        let cut = read(&little_bytes[..little_bytes.len() - 3]).unwrap_err();
        assert!(matches!(cut, MeshError::CutShort { .. }), "{cut}");
        let longer = read([&little_bytes[..], b"more"].concat()).unwrap();
        assert!(matches!(
            longer.remarks[0].what,
            MeshRemark::BytesAfter {
                bytes: 4,
                facets: 1
            }
        ));
    }

    #[test]
    fn dialects_are_read() {
        let plain = format!("{HEADER}{BODY}");
        let with = |from: &str, to: &str| {
            assert!(plain.contains(from), "{from}");
            plain.replace(from, to).into_bytes()
        };
        let mut comment = with(
            "element vertex",
            "comment ?? texture\nobj_info ??\nelement vertex",
        );
        comment
            .iter_mut()
            .filter(|b| **b == b'?')
            .for_each(|b| *b = 0xe9);
        for bytes in [
            with("\n", "\r\n"),
            with("\n", "\r"),
            with("ply", "\u{feff}ply"),
            comment,
            with("float", "double"),
            with("uchar int vertex_indices", "float uint64 vertex_index"),
            with("ply\nformat ascii 1.0\nelement vertex", "PLY\nFORMAT ASCII 1.0\nELEMENT VERTEX"),
            // Elements and columns that say nothing of the shape.
            plain.replace("element face", "element camera 1\nproperty float fov\nproperty list uchar float matrix\nelement face")
                .replace("4 0 1 2 3", "50.0 2 1.0 0.0\n4 0 1 2 3").into_bytes(),
            plain.replace("property float z\n", "property float z\nproperty uchar red\n").replace(" 0\n", " 0 255\n").into_bytes(),
            // A vertex that nothing uses.
            plain.replace("vertex 4", "vertex 5").replace("4 0 1 2 3", "nan -1.#IND 0\n4 0 1 2 3").into_bytes(),
        ] {
            let text = String::from_utf8_lossy(&bytes).into_owned();
            let mesh = read(&bytes).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(mesh, square(), "{text}");
        }
        let with_normals = HEADER.replace(
            "element face",
            "property float nx\nproperty float ny\nproperty float nz\nelement face",
        );
        let body = BODY.replace(" 0\n", " 0 0 0 2\n");
        let mesh = read(format!("{with_normals}{body}")).unwrap();
        assert_eq!(mesh.normals.unwrap(), [Vec3::Z; 4]);
    }

    #[test]
    fn strips_alternate_and_begin_anew() {
        let header = HEADER
            .replace("face 1", "tristrips 1")
            .replace("uchar int", "int int");
        let text = format!("{header}0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 0 2 -1\n");
        let mesh = read(text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [2, 1, 3]]);
        assert!(mesh.remarks.is_empty());
        for facet in 0..2 {
            assert_eq!(mesh.face_normal(facet), Vec3::Z);
        }
    }

    #[test]
    fn errors_name_the_place() {
        for (good, wrong, expected) in [
            ("property float z\n", "", "the vertices have no z"),
            (
                "1 1 0",
                "1,000 1 0",
                "line 12: \"1,000\" has a decimal comma",
            ),
            ("1 1 0", "1 one 0", "line 12: \"one\" is not a number"),
            (
                "1 1 0",
                "1 nan 0",
                "line 12: vertex 2 has a coordinate that is not finite",
            ),
            (
                "1 1 0",
                "1 1 0 7",
                "line 12: it goes on after the 3 numbers of vertex 2",
            ),
            ("4 0 1 2 3", "4 0 1 2", "cut short: it ends in face 0 of 1"),
            (
                "4 0 1 2 3",
                "4 0 1 2 7",
                "facet 0 refers to vertex 7, but there are 4",
            ),
            ("4 0 1 2 3", "4 0 1 2 -3", "face 0 refers to vertex -3"),
            ("4 0 1 2 3", "-4 0 1 2 3", "face 0 has a list of -4 items"),
            (
                "end_header\n",
                "",
                "cut short: its header has no end_header line",
            ),
            ("float x", "quad x", "\"quad\" is no type of a property"),
            ("face 1", "faces 1", "the mesh has 4 vertices and no facet"),
            ("ascii", "text", "format text is not ascii"),
        ] {
            let text = format!("{HEADER}{BODY}");
            assert!(text.contains(good), "{good}");
            let error = read(text.replace(good, wrong)).unwrap_err().to_string();
            assert!(error.contains(expected), "{wrong}: {error}");
        }
        let more = read(format!("{HEADER}{BODY}1 2 3\n")).unwrap();
        assert_eq!(more.remarks[0].what, MeshRemark::LinesAfter { line: 15 });
    }
}
