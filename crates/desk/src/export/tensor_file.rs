//! The container of RGL `.bsdf` files: named arrays in one file.
//!
//! Little-endian: `tensor_file\0`, two bytes of version (1, 0), u32 number of
//! fields; per field its name (u16 length), u16 rank, u8 type, u64 offset of its
//! data from the start of the file, and the extent of each dimension as u64; then
//! the data, each field at a multiple of 8 bytes.

/// An array with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    name: &'static str,
    kind: u8,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

const KIND_U8: u8 = 1;
const KIND_F32: u8 = 10;
const ALIGNMENT: usize = 8;

impl Field {
    /// A list of bytes.
    pub fn bytes(name: &'static str, bytes: &[u8]) -> Self {
        Self {
            name,
            kind: KIND_U8,
            shape: vec![bytes.len()],
            bytes: bytes.to_vec(),
        }
    }

    /// Numbers in order of `shape`, the last dimension fastest.
    ///
    /// # Panics
    /// The shape is not that of the values: a defect of the caller.
    pub fn floats(name: &'static str, shape: &[usize], values: &[f32]) -> Self {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "{name}");
        Self {
            name,
            kind: KIND_F32,
            shape: shape.to_vec(),
            bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        }
    }
}

/// The bytes of a file of these fields, in their order.
pub fn encode(fields: &[Field]) -> Vec<u8> {
    let entry = |field: &Field| 2 + field.name.len() + 2 + 1 + 8 + 8 * field.shape.len();
    let header = 12 + 2 + 4 + fields.iter().map(entry).sum::<usize>();
    let mut file = Vec::new();
    file.extend(b"tensor_file\0");
    file.extend([1, 0]);
    file.extend((fields.len() as u32).to_le_bytes());
    let mut offset = header.next_multiple_of(ALIGNMENT);
    for field in fields {
        file.extend((field.name.len() as u16).to_le_bytes());
        file.extend(field.name.as_bytes());
        file.extend((field.shape.len() as u16).to_le_bytes());
        file.push(field.kind);
        file.extend((offset as u64).to_le_bytes());
        for &extent in &field.shape {
            file.extend((extent as u64).to_le_bytes());
        }
        offset = (offset + field.bytes.len()).next_multiple_of(ALIGNMENT);
    }
    for field in fields {
        file.resize(file.len().next_multiple_of(ALIGNMENT), 0);
        file.extend(&field.bytes);
    }
    file
}
