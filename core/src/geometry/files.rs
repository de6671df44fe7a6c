//! Mesh files of all kinds; the end of the name selects the format.
//!
//! The files carry no unit and have axes of their own; a [`Placement`] says what theirs are.
//! Whatever the format, a mesh that comes out has been tidied and passed [`Mesh::new`];
//! errors name the file and what is wrong where. No line or count of a file is trusted to
//! allocate more than the file can hold.

use std::io::Write;
use std::path::Path;

use super::draft::Draft;
use super::mesh::{Mesh, MeshError};
use super::mesh_error::Content;
use super::placement::Placement;
use super::{obj, ply, stl};
use crate::outside_file::{self, ends_in};
use crate::whole_file;

/// Largest file that is read, bytes: more than the most triangles take in any format.
const MAX_BYTES: u64 = 4 << 30;

/// A kind of mesh file.
///
/// ```
/// use rig_core::geometry::files::MeshFormat;
/// use rig_core::geometry::{Placement, Shape};
///
/// let bowl = Shape::Bowl { radius_mm: 10.0, segments: 16 }.mesh()?;
/// let mut file = Vec::new();
/// MeshFormat::Stl.write(&bowl, &mut file)?;
/// // Read as if its unit were the centimetre.
/// let larger = MeshFormat::Stl.parse(&file, &Placement::scaled(10.0))?;
/// assert_eq!(larger.triangles.len(), bowl.triangles.len());
/// assert!((larger.bounds_mm()[0].z + 100.0).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Stanford polygons.
    Ply,
    /// Wavefront objects.
    Obj,
    /// Stereolithography.
    Stl,
}

impl MeshFormat {
    /// By the end of the file's name, in capitals or not.
    pub fn of(path: &Path) -> Result<Self, MeshError> {
        let known = [("ply", Self::Ply), ("obj", Self::Obj), ("stl", Self::Stl)];
        let found = known.into_iter().find(|(ending, _)| ends_in(path, ending));
        found
            .map(|(_, format)| format)
            .ok_or_else(|| MeshError::Kind {
                path: path.display().to_string(),
            })
    }

    /// The mesh of a file's bytes.
    ///
    /// # Errors
    /// What is wrong within the file; its name is not known here.
    pub fn parse(self, bytes: &[u8], placement: &Placement) -> Result<Mesh, MeshError> {
        self.draft(bytes)?.mesh(placement)
    }

    /// The content of a file, from its bytes.
    fn draft(self, bytes: &[u8]) -> Result<Draft, MeshError> {
        self.check_content(bytes)?;
        match self {
            Self::Ply => ply::draft(bytes),
            Self::Obj => obj::draft(bytes),
            Self::Stl => stl::draft(bytes),
        }
    }

    /// Refuses what is plainly another kind of file.
    fn check_content(self, bytes: &[u8]) -> Result<(), MeshError> {
        let known = CONTENTS.iter().find(|(start, _)| {
            let head = bytes.get(..start.len());
            head.is_some_and(|head| head.eq_ignore_ascii_case(start))
        });
        let expected = match self {
            Self::Ply => "PLY",
            Self::Obj => "OBJ",
            Self::Stl => "STL",
        };
        match known {
            Some(&(_, found)) if found != Content::Mesh(expected) => {
                Err(MeshError::OtherKind { expected, found })
            }
            _ => Ok(()),
        }
    }

    /// Writes a mesh, millimetres.
    pub fn write(self, mesh: &Mesh, out: &mut dyn Write) -> std::io::Result<()> {
        match self {
            Self::Ply => ply::write(mesh, out),
            Self::Obj => obj::write(mesh, out),
            Self::Stl => stl::write(mesh, out),
        }
    }
}

/// How files begin that are met under names of others.
const CONTENTS: [(&[u8], Content); 14] = [
    (b"ply\n", Content::Mesh("PLY")),
    (b"ply\r", Content::Mesh("PLY")),
    (b"solid ", Content::Mesh("STL")),
    (b"\x1f\x8b", Content::Packed("compressed by gzip")),
    (
        b"PK\x03\x04",
        Content::Packed("a ZIP archive (3MF and others)"),
    ),
    (b"7z\xbc\xaf", Content::Packed("a 7z archive")),
    (b"glTF", Content::Other("glTF")),
    (b"ISO-10303", Content::Other("STEP")),
    (b"OFF\n", Content::Other("OFF")),
    (b"#VRML", Content::Other("VRML")),
    (b"<?xml", Content::Other("XML (AMF, COLLADA or another)")),
    (b"<!doctype", Content::WebPage),
    (b"<html", Content::WebPage),
    (b"version https://git-lfs", Content::LfsPointer),
];

/// Reads a mesh file and places it in the sample's frame.
///
/// # Errors
/// The file cannot be read, is of no known kind, or no usable mesh; all name it.
pub fn read(path: &Path, placement: &Placement) -> Result<Mesh, MeshError> {
    within(path, |draft| draft.mesh(placement))
}

/// What becomes of a file's draft; errors and remarks get the file's name.
pub(super) fn within(
    path: &Path,
    make: impl FnOnce(Draft) -> Result<Mesh, MeshError>,
) -> Result<Mesh, MeshError> {
    let format = MeshFormat::of(path)?;
    let name = path.display().to_string();
    let bytes = outside_file::read_regular(path, MAX_BYTES).map_err(|source| MeshError::Io {
        path: name.clone(),
        source,
    })?;
    match format.draft(&bytes).and_then(make) {
        Ok(mut mesh) => {
            for remark in &mut mesh.remarks {
                remark.file.clone_from(&name);
            }
            Ok(mesh)
        }
        Err(error) => Err(MeshError::InFile {
            path: name,
            error: Box::new(error),
        }),
    }
}

/// Writes a mesh in millimetres, whole or not at all, in place of any file of that name.
pub fn write(path: &Path, mesh: &Mesh) -> Result<(), MeshError> {
    let format = MeshFormat::of(path)?;
    whole_file::replace(path, |out| format.write(mesh, out)).map_err(|source| MeshError::Io {
        path: path.display().to_string(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Shape;
    use glam::Vec3;
    use proptest::prelude::*;

    const ALL: [MeshFormat; 3] = [MeshFormat::Ply, MeshFormat::Obj, MeshFormat::Stl];

    fn bytes(format: MeshFormat, mesh: &Mesh) -> Vec<u8> {
        let mut bytes = Vec::new();
        format.write(mesh, &mut bytes).unwrap();
        bytes
    }

    fn bowl() -> Mesh {
        Shape::Bowl {
            radius_mm: 1.7,
            segments: 12,
        }
        .mesh()
        .unwrap()
    }

    /// Corners of every triangle, in order.
    fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
        (0..mesh.triangles.len()).map(|i| mesh.corners(i)).collect()
    }

    #[test]
    fn every_format_keeps_the_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = bowl();
        for name in ["a.ply", "a.OBJ", "a.Stl"] {
            let path = folder.path().join(name);
            write(&path, &mesh).unwrap();
            let back = read(&path, &Placement::default()).unwrap();
            assert_eq!(corners(&back), corners(&mesh), "{name}");
            assert_eq!(
                back.positions_mm.len(),
                mesh.positions_mm.len(),
                "{name}: shared corners stay shared"
            );
            if !name.ends_with("Stl") {
                assert_eq!(back.triangles, mesh.triangles, "{name}");
                let (was, is) = (mesh.normals.as_ref().unwrap(), back.normals.unwrap());
                let worst = was.iter().zip(&is).map(|(a, b)| (*a - *b).length());
                assert!(worst.fold(0.0, f32::max) < 1e-6, "{name}");
            }
            let inches = read(&path, &Placement::scaled(25.4)).unwrap();
            let ratio = inches.bounds_mm()[0].z / mesh.bounds_mm()[0].z;
            assert!((ratio - 25.4).abs() < 1e-4, "{name}: {ratio}");
        }
    }

    #[test]
    fn what_is_no_mesh_file_is_refused_with_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let error = |name: &str| {
            read(&folder.path().join(name), &Placement::default())
                .unwrap_err()
                .to_string()
        };
        assert!(error("a.step").contains("a.step: the file name does not end in .ply"));
        assert!(error("missing.stl").contains("missing.stl: No such file"));
        std::fs::create_dir(folder.path().join("folder.obj")).unwrap();
        assert!(error("folder.obj").contains("folder.obj: Is a directory"));
        std::fs::write(folder.path().join("a.stl"), "ply\nformat ascii 1.0\n").unwrap();
        assert!(error("a.stl").contains("a.stl: the file is PLY by its content, not STL"));
        std::fs::write(folder.path().join("empty.obj"), "# nothing\n").unwrap();
        assert!(error("empty.obj").contains("empty.obj: the mesh has 0 vertices and no facet"));
    }

    proptest! {
        #[test]
        fn broken_files_never_panic(
            flips in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
            cut in proptest::option::of(any::<prop::sample::Index>()),
        ) {
            for format in ALL {
                let mut bytes = bytes(format, &bowl());
                for (at, value) in &flips {
                    let at = at.index(bytes.len());
                    bytes[at] = *value;
                }
                if let Some(cut) = &cut {
                    bytes.truncate(cut.index(bytes.len()));
                }
                if let Ok(mesh) = format.parse(&bytes, &Placement::default()) {
                    prop_assert!(mesh.positions_mm.iter().all(|p| p.is_finite()));
                }
            }
        }

        #[test]
        fn any_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            for format in ALL {
                // A binary STL whose count disagrees with its length is read, and bytes at random
                // may be the coordinates of a facet.
                if let Ok(mesh) = format.parse(&bytes, &Placement::default()) {
                    prop_assert!(mesh.positions_mm.iter().all(|p| p.is_finite()));
                }
            }
        }

        /// Any finite coordinates survive, in every format, to the last bit.
        #[test]
        fn coordinates_survive(
            values in proptest::array::uniform9(-1e6f32..1e6),
        ) {
            let p: Vec<Vec3> = values.chunks(3).map(Vec3::from_slice).collect();
            if let Ok(mesh) = Mesh::new(p, vec![[0, 1, 2]]) {
                for format in ALL {
                    let back = format.parse(&bytes(format, &mesh), &Placement::default()).unwrap();
                    prop_assert_eq!(back.corners(0), mesh.corners(0));
                }
            }
        }
    }
}
