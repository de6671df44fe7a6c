//! Which part and layer of a file is the image. A part is an image of its own; a layer is what
//! the names of a part's channels have in common before their last point, such as
//! `ViewLayer.Combined` in Blender's `ViewLayer.Combined.R`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use exr::meta::header::Header;

use super::ExrError;
use crate::shown::{MESSAGE, shortened};

/// Last parts of the names of red, green and blue, by the programs that write them.
const COLOURS: [[&str; 3]; 4] = [
    ["R", "G", "B"],
    ["r", "g", "b"],
    ["red", "green", "blue"],
    ["Red", "Green", "Blue"],
];
/// Luminance, where nothing says that it is another's: chroma, or the second of coordinates.
const GREY: &str = "Y";
const NOT_GREY: [&str; 6] = ["RY", "BY", "X", "Z", "x", "z"];
/// The layer of the variances that this program writes.
const VARIANCE: &str = "var";

/// An image in a file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layer {
    /// Index of its part.
    pub part: usize,
    /// What its channels' names begin with, with the point; often nothing.
    pub prefix: String,
    /// Names of its three colour channels, or one of grey.
    pub colours: Vec<String>,
    /// As a person calls it.
    name: String,
}

/// The path of a file and the layer that is named after a colon, as in `image.exr:C`. A file
/// whose own name has the colon is meant first.
pub(super) fn split(path: &Path) -> (PathBuf, Option<String>) {
    let whole = (path.to_owned(), None);
    if path.symlink_metadata().is_ok() {
        return whole;
    }
    let text = path.to_string_lossy();
    let mut colons = text.match_indices(':');
    let split = colons.find_map(|(at, _)| {
        let file = Path::new(&text[..at]);
        let layer = text[at + 1..].to_owned();
        (!layer.is_empty() && file.is_file()).then(|| (file.to_owned(), Some(layer)))
    });
    split.unwrap_or(whole)
}

/// The image that is meant: the one of this name, or the only one. Where a part has channels
/// without a layer's name, its other layers are not read.
///
/// # Errors
/// There is none, or none of that name, or more than one.
pub(super) fn choose(
    headers: &[Header],
    wanted: Option<&str>,
    file: &Path,
) -> Result<Layer, ExrError> {
    let mut found: Vec<Layer> = Vec::new();
    for part in 0..headers.len() {
        found.extend(layers(headers, part));
    }
    let listed = |layers: &[Layer]| {
        let names: Vec<&str> = layers.iter().map(|layer| layer.name.as_str()).collect();
        shortened(&names.join(", "), MESSAGE).into_owned()
    };
    if let Some(wanted) = wanted {
        let named = found.iter().position(|layer| layer.name == wanted);
        return match named {
            Some(index) => Ok(found.swap_remove(index)),
            None => Err(ExrError::NoSuchLayer {
                file: file.to_owned(),
                layer: wanted.to_owned(),
                known: listed(&found),
            }),
        };
    }
    for better in [
        |layer: &Layer| layer.prefix.is_empty() && layer.colours.len() == 3,
        |layer: &Layer| layer.colours.len() == 3,
        |layer: &Layer| layer.prefix.is_empty(),
    ] {
        if found.iter().any(better) {
            found.retain(better);
        }
    }
    match found.len() {
        0 => Err(ExrError::Channels {
            file: file.to_owned(),
            found: channels(headers),
            wanted: "R, G, B (or Y alone), at full resolution,",
        }),
        1 => Ok(found.swap_remove(0)),
        count => Err(ExrError::Layers {
            file: file.to_owned(),
            count,
            known: listed(&found),
        }),
    }
}

/// The images of a part.
fn layers(headers: &[Header], part: usize) -> Vec<Layer> {
    let names: Vec<String> = channel_names(&headers[part]).collect();
    let prefixes: BTreeSet<&str> = names.iter().map(|name| prefix(name)).collect();
    let is_variance = |prefix: &str| {
        let layer = prefix.trim_end_matches('.');
        layer == VARIANCE || layer.ends_with(".var")
    };
    let prefixes = prefixes.into_iter().filter(|prefix| !is_variance(prefix));
    let of_prefix = |prefix: &str| {
        let has = |last: &&str| names.contains(&format!("{prefix}{last}"));
        let grey: &[&str] = match NOT_GREY.iter().any(has) {
            false => &[GREY],
            true => &[],
        };
        let mut sets = COLOURS.iter().map(|set| &set[..]).chain([grey]);
        let set = sets.find(|set| !set.is_empty() && set.iter().all(has))?;
        Some(Layer {
            part,
            prefix: prefix.to_owned(),
            colours: set.iter().map(|last| format!("{prefix}{last}")).collect(),
            name: name(headers, part, prefix.trim_end_matches('.')),
        })
    };
    prefixes.filter_map(of_prefix).collect()
}

fn prefix(channel: &str) -> &str {
    channel.rfind('.').map_or("", |point| &channel[..=point])
}

fn channel_names(header: &Header) -> impl Iterator<Item = String> {
    let list = header.channels.list.iter();
    list.map(|channel| channel.name.to_string())
}

/// The part's name and the layer's, as far as there are several; Houdini repeats the part's.
fn name(headers: &[Header], part: usize, layer: &str) -> String {
    let own = headers[part].own_attributes.layer_name.as_ref();
    let part = own.map_or_else(|| format!("part {part}"), ToString::to_string);
    if headers.len() == 1 {
        return match layer {
            "" => part,
            layer => layer.to_owned(),
        };
    }
    match layer.strip_prefix(part.as_str()) {
        Some(rest) if rest.is_empty() || rest.starts_with('.') => layer.to_owned(),
        _ if layer.is_empty() => part,
        _ => format!("{part}.{layer}"),
    }
}

fn channels(headers: &[Header]) -> String {
    let mut names = Vec::new();
    for (part, header) in headers.iter().enumerate() {
        names.extend(channel_names(header).map(|channel| match headers.len() {
            1 => channel,
            _ => name(headers, part, &channel),
        }));
    }
    shortened(&names.join(", "), MESSAGE).into_owned()
}
