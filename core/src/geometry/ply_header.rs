//! The header of a PLY file: which elements there are, and how they are stored.

use super::mesh::MeshError;
use super::text::split_line;
use crate::shown::excerpt;

/// How one number is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Result<Self, MeshError> {
        Ok(match name.to_ascii_lowercase().as_str() {
            "char" | "int8" => Scalar::I8,
            "uchar" | "uint8" => Scalar::U8,
            "short" | "int16" => Scalar::I16,
            "ushort" | "uint16" => Scalar::U16,
            "int" | "int32" => Scalar::I32,
            "uint" | "uint32" => Scalar::U32,
            "int64" | "long" => Scalar::I64,
            "uint64" | "ulong" => Scalar::U64,
            "float" | "float32" => Scalar::F32,
            "double" | "float64" => Scalar::F64,
            _ => {
                return Err(MeshError::format(format!(
                    "{:?} is no type of a property",
                    excerpt(name)
                )));
            }
        })
    }
}

/// What each row of an element holds. Names are in small letters.
pub enum Property {
    Single(String, Scalar),
    /// The kinds of its count and of its items.
    List(String, Scalar, Scalar),
}

/// Rows of one form.
pub struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

/// How the numbers after the header are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// The content of the header, and where the body begins.
pub struct Header<'a> {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    pub body: &'a [u8],
    /// The number of the body's first line, from 1.
    pub first_line: usize,
}

/// Reads the header. Comments may hold any bytes, lines may end in LF, CR LF or CR.
pub fn parse(bytes: &[u8]) -> Result<Header<'_>, MeshError> {
    let mut elements: Vec<Element> = Vec::new();
    let mut encoding = None;
    let mut rest = bytes;
    // The first line says how lines end: where in CR, a body may begin with the byte LF.
    let first = split_line(bytes).0.len();
    let ends_in_cr = bytes.get(first) == Some(&b'\r') && bytes.get(first + 1) != Some(&b'\n');
    for number in 1.. {
        let (line, after) = split_line(rest);
        let Some(after) = after else {
            return Err(match number {
                1 => MeshError::format("the file does not begin with \"ply\""),
                _ => MeshError::CutShort {
                    what: "its header has no end_header line".to_owned(),
                },
            });
        };
        rest = match ends_in_cr {
            true => &rest[line.len() + 1..],
            false => after,
        };
        // What the line declares; comments and unknown lines are skipped.
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let keyword = words.first().map(|word| word.to_ascii_lowercase());
        match (
            keyword.as_deref().unwrap_or(""),
            words.get(1..).unwrap_or(&[]),
        ) {
            ("ply", []) => {}
            _ if number == 1 => {
                return Err(MeshError::format("the file does not begin with \"ply\""));
            }
            ("format", [name, ..]) => encoding = Some(encoding_of(name)?),
            ("element", [name, count]) => {
                let count = count.parse().map_err(|_| {
                    MeshError::format(format!(
                        "element {} has count {:?}",
                        excerpt(name),
                        excerpt(count)
                    ))
                })?;
                elements.push(Element {
                    name: name.to_ascii_lowercase(),
                    count,
                    properties: Vec::new(),
                });
            }
            ("property", words) => {
                let property = property(words)?;
                let element = elements
                    .last_mut()
                    .ok_or_else(|| MeshError::format("a property before any element"))?;
                element.properties.push(property);
            }
            ("end_header", _) => {
                let encoding =
                    encoding.ok_or_else(|| MeshError::format("the header has no format line"))?;
                check_vertices(&elements)?;
                return Ok(Header {
                    encoding,
                    elements,
                    body: rest,
                    first_line: number + 1,
                });
            }
            _ => {}
        }
    }
    Err(MeshError::format("the header does not end"))
}

fn encoding_of(name: &str) -> Result<Encoding, MeshError> {
    match name.to_ascii_lowercase().as_str() {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::LittleEndian),
        "binary_big_endian" => Ok(Encoding::BigEndian),
        _ => Err(MeshError::format(format!(
            "format {} is not ascii, binary_little_endian or binary_big_endian",
            excerpt(name)
        ))),
    }
}

fn property(words: &[&str]) -> Result<Property, MeshError> {
    match words {
        [list, count, kind, name] if list.eq_ignore_ascii_case("list") => Ok(Property::List(
            name.to_ascii_lowercase(),
            Scalar::parse(count)?,
            Scalar::parse(kind)?,
        )),
        [kind, name] => Ok(Property::Single(
            name.to_ascii_lowercase(),
            Scalar::parse(kind)?,
        )),
        _ => Err(MeshError::format(format!(
            "property {:?} is not a type and a name",
            excerpt(&words.join(" "))
        ))),
    }
}

fn check_vertices(elements: &[Element]) -> Result<(), MeshError> {
    let Some(vertex) = elements.iter().find(|e| e.name == "vertex") else {
        return Ok(());
    };
    for axis in ["x", "y", "z"] {
        let given = |p: &Property| matches!(p, Property::Single(name, _) if name == axis);
        if !vertex.properties.iter().any(given) {
            return Err(MeshError::format(format!("the vertices have no {axis}")));
        }
    }
    Ok(())
}
