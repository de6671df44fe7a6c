//! What can be wrong with a mesh, and what is worth a remark though it can be used.

use glam::DVec3;

use super::seams::OpenSeam;

/// Largest coordinate that a mesh may have, millimetres.
pub const MAX_DISTANCE_MM: f32 = 1e7;

/// What a file is by its first bytes; each shows as its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// A kind of mesh that is read.
    Mesh(&'static str),
    /// Something that holds the mesh.
    Packed(&'static str),
    /// What a download gives in place of the file.
    WebPage,
    /// What a checkout without Git LFS gives in place of the file.
    LfsPointer,
    /// A kind that is not read.
    Other(&'static str),
}

impl std::fmt::Display for Content {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Self::Mesh(name) | Self::Packed(name) | Self::Other(name) => name,
            Self::WebPage => "a web page",
            Self::LfsPointer => "a pointer of Git LFS",
        })
    }
}

/// Why a mesh cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// The file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file's name does not end like that of a known format.
    #[error("{path}: the file name does not end in .ply, .obj or .stl")]
    Kind {
        /// The file.
        path: String,
    },
    /// What is wrong within a file.
    #[error("{path}: {error}")]
    InFile {
        /// The file.
        path: String,
        /// What, without the file's name.
        error: Box<MeshError>,
    },
    /// The file's content is not what its name says.
    #[error("the file is {found} by its content, not {expected}")]
    OtherKind {
        /// By the file's name.
        expected: &'static str,
        /// By its first bytes.
        found: Content,
    },
    /// The file does not follow its format.
    #[error("{what}")]
    Format {
        /// What was found and where.
        what: String,
    },
    /// A word that should be a number is none.
    #[error("{location}: \"{word}\" is not a number")]
    Number {
        /// Line of the file.
        location: String,
        /// The word.
        word: String,
    },
    /// A number is written with a decimal comma.
    #[error("{location}: \"{word}\" has a decimal comma")]
    DecimalComma {
        /// Line of the file.
        location: String,
        /// The word.
        word: String,
    },
    /// The file ends within what it says that it holds.
    #[error("the file is cut short: {what}")]
    CutShort {
        /// What is missing.
        what: String,
    },
    /// No triangle.
    #[error("the mesh has {vertices} vertices and no facet")]
    Empty {
        /// Vertices: many are a cloud of points.
        vertices: usize,
    },
    /// More than indices can address or memory should hold.
    #[error("the mesh has {triangles} triangles; at most {limit} are supported")]
    TooLarge {
        /// Triangles found.
        triangles: usize,
        /// The limit.
        limit: usize,
    },
    /// A coordinate of a corner is NaN or infinite.
    #[error("{location} has a coordinate that is not finite, and a facet uses it")]
    NotFinite {
        /// Index from 0, and the line where it is known.
        location: String,
    },
    /// A coordinate is so large that rays lose their precision.
    #[error(
        "vertex {vertex} lies {distance_mm} mm from the origin; at most {} mm are supported",
        MAX_DISTANCE_MM
    )]
    TooFar {
        /// Index from 0.
        vertex: usize,
        /// Its largest coordinate, absolute.
        distance_mm: f32,
    },
    /// A normal is NaN, infinite, without length, or missing.
    #[error("vertex {vertex} has no usable normal")]
    Normal {
        /// Index from 0.
        vertex: usize,
    },
    /// A facet refers to a vertex that does not exist.
    #[error("facet {facet} refers to vertex {vertex}, but there are {vertices}")]
    NoSuchVertex {
        /// Index from 0.
        facet: usize,
        /// The index it holds, from 0.
        vertex: i64,
        /// Number of vertices.
        vertices: usize,
    },
    /// A triangle without area.
    #[error("triangle {triangle} has no area")]
    Degenerate {
        /// Index from 0.
        triangle: usize,
    },
    /// No facet of a file has an area.
    #[error("none of the {facets} facets has an area")]
    NoArea {
        /// Facets of the file.
        facets: usize,
    },
}

/// How coarse single precision is for a mesh far from the origin.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "coordinates reach {}, where 32-bit numbers are {} apart, {}% of the mesh's size of {}",
    brief(*distance), brief(*step), brief(100.0 * step / size), brief(*size)
)]
pub struct Steps {
    /// Largest coordinate, absolute.
    pub distance: f64,
    /// From there to the next number.
    pub step: f64,
    /// Largest extent.
    pub size: f64,
}

/// With three digits, or all before the point.
fn brief(value: f64) -> String {
    let decimals = (2.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

impl Steps {
    /// Steps of which this part of the size is worth a remark.
    const COARSE: f64 = 1e-4;

    /// Of these positions, where the steps are coarse.
    pub fn of(positions: impl Iterator<Item = DVec3>) -> Option<Self> {
        let first = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let [low, high] = positions.fold(first, |[low, high], p| [low.min(p), high.max(p)]);
        let distance = low.abs().max(high.abs()).max_element();
        let size = (high - low).max_element();
        let single = distance as f32;
        let step = f64::from(single.next_up() - single);
        (step > Self::COARSE * size).then_some(Self {
            distance,
            step,
            size,
        })
    }
}

/// What is worth a remark about a mesh file that can be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshRemark {
    /// Facets left out.
    #[error("facets without area are left out ({facets})")]
    NoArea {
        /// How many.
        facets: usize,
    },
    /// Facets left out.
    #[error("facets that the file holds twice are left out ({facets})")]
    Doubled {
        /// How many.
        facets: usize,
    },
    /// Facets left out.
    #[error(
        "facets that lie exactly on another and face the other way are left out ({facets}): the first of each two in the file is kept, whose front reflects"
    )]
    TwoSided {
        /// How many are left out.
        facets: usize,
    },
    /// Neighbours of which one shows its back.
    #[error(
        "neighbouring facets face opposite ways ({edges} edges): some are turned, and their backs are black"
    )]
    Turned {
        /// How many edges.
        edges: usize,
    },
    /// Polygons whose outline crosses itself.
    #[error(
        "polygons that cross themselves are cut into triangles as far as possible ({polygons})"
    )]
    Crossing {
        /// How many.
        polygons: usize,
    },
    /// Normals are not used.
    #[error("normals of the file are not used: vertex {vertex} has none of any length")]
    Normals {
        /// The first, from 0.
        vertex: usize,
    },
    /// Normals that point backwards.
    #[error(
        "the file's normals point to the backs of its facets and are turned: the order of a facet's corners defines its front"
    )]
    NormalsTurned,
    /// Open edges whose vertices nearly meet.
    #[error(
        "{} vertices of open edges nearly meet another, at most {:.1e} of the mesh's size apart: such a seam is an opening, and smooth shading has a crease there", _0.vertices, _0.apart
    )]
    OpenSeam(OpenSeam),
    /// Coordinates that have lost their digits in the file.
    #[error(
        "{0} (in the file's unit); moved to the origin before its export, the mesh keeps its digits"
    )]
    Far(Steps),
    /// Coordinates that lose their digits where the mesh is placed.
    #[error("{0} (mm); `translate_mm` brings the mesh to the origin")]
    PlacedFar(Steps),
    /// A binary file that goes on after its facets.
    #[error("{bytes} bytes after the {facets} facets are passed over")]
    BytesAfter {
        /// How many.
        bytes: usize,
        /// Facets read.
        facets: usize,
    },
    /// A binary file with a wrong count.
    #[error("the file declares {declared} facets and holds {facets}, which are read")]
    Count {
        /// By the header.
        declared: usize,
        /// Facets read.
        facets: usize,
    },
    /// A text that goes on after its last row.
    #[error("lines after the last declared element are passed over, from line {line}")]
    LinesAfter {
        /// From 1.
        line: usize,
    },
    /// A text without its last line.
    #[error("the file ends after a whole facet but without \"endsolid\": it may be cut short")]
    NoEnd,
    /// Edges that stay sharp although smooth shading was requested.
    #[error(
        "{edges} of {all} edges turn by {least_deg:.1}° or more, up to {most_deg:.1}°, and stay creases: crease_deg is {crease_deg}"
    )]
    SharpEdges {
        /// That stay sharp but are no true creases.
        edges: usize,
        /// Edges between two facets.
        all: usize,
        /// Least and largest turn of these, degrees.
        least_deg: f32,
        /// Degrees.
        most_deg: f32,
        /// Degrees.
        crease_deg: f32,
    },
}

/// A remark about one file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {what}")]
pub struct FileRemark {
    /// The file.
    pub file: String,
    /// What is remarkable.
    pub what: MeshRemark,
}
