//! Pictures and heat maps in rows, with what they show.

use super::Figure;
use super::svg::{Anchor, INK, Svg, TEXT};

/// A picture with an optional smaller one in its lower right corner.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Below it.
    pub caption: String,
    /// Pixels across.
    pub width: usize,
    /// sRGB, row 0 at the top.
    pub pixels: Vec<[u8; 3]>,
    /// Pixels across and pixels of the inset.
    pub inset: Option<(usize, Vec<[u8; 3]>)>,
}

const GAP: f64 = 10.0;

/// Rows of pictures, `size` units wide each, every row with a title at its left and the
/// columns with titles above.
pub fn pictures(
    name: &str,
    size: f64,
    columns: &[String],
    rows: &[(String, Vec<Picture>)],
) -> Figure {
    let left = 26.0;
    let top = 26.0;
    let cell = [size + GAP, size + 24.0];
    let across = rows.iter().map(|(_, row)| row.len()).max().unwrap_or(0);
    let mut svg = Svg::new(
        left + across as f64 * cell[0] + GAP,
        top + rows.len() as f64 * cell[1] + 4.0,
    );
    for (index, title) in columns.iter().enumerate() {
        let x = left + index as f64 * cell[0] + 0.5 * size;
        svg.text([x, top - 9.0], Anchor::Middle, TEXT, title);
    }
    for (index, (title, row)) in rows.iter().enumerate() {
        let y = top + index as f64 * cell[1];
        svg.turned([17.0, y + 0.5 * size], Anchor::Middle, TEXT, -90.0, title);
        for (column, picture) in row.iter().enumerate() {
            let x = left + column as f64 * cell[0];
            svg.image([x, y], [size; 2], picture.width, &picture.pixels);
            if let Some((width, pixels)) = &picture.inset {
                let side = 0.36 * size;
                let at = [x + size - side, y + size - side];
                svg.image(at, [side; 2], *width, pixels);
                svg.rectangle(at, [side; 2], "none", "#ffffff");
            }
            let middle = [x + 0.5 * size, y + size + 14.0];
            svg.text(middle, Anchor::Middle, TEXT - 1.0, &picture.caption);
        }
    }
    Figure {
        name: name.to_owned(),
        svg: svg.finish(),
    }
}

/// One panel of [`heat_maps`].
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// Above it.
    pub title: String,
    /// Columns of cells.
    pub width: usize,
    /// Cells, row 0 at the top; NaN is left white.
    pub values: Vec<f64>,
}

/// The common scale of heat maps, at their right.
pub struct HeatScale {
    /// Value of the darkest and the brightest colour.
    pub range: [f64; 2],
    /// Along the scale.
    pub label: String,
    /// Positions and their texts.
    pub ticks: Vec<(f64, String)>,
}

/// Heat maps of equal axes in rows of `columns`, with a common scale; ticks of `x` and
/// `y` are parts 0..=1 from the left and from the top.
pub fn heat_maps(
    name: &str,
    columns: usize,
    [x_label, y_label]: [&str; 2],
    [x_ticks, y_ticks]: [&[(f64, String)]; 2],
    scale: &HeatScale,
    maps: &[HeatMap],
) -> Figure {
    let columns = columns.clamp(1, maps.len().max(1));
    let rows = maps.len().div_ceil(columns);
    let side = 170.0;
    let cell = [side + 22.0, side + 56.0];
    let (left, top) = (50.0, 26.0);
    let width = left + columns as f64 * cell[0] + 70.0;
    let mut svg = Svg::new(width, top + rows as f64 * cell[1]);
    let [low, high] = scale.range;
    for (index, map) in maps.iter().enumerate() {
        let x = left + (index % columns) as f64 * cell[0];
        let y = top + (index / columns) as f64 * cell[1];
        let pixels: Vec<[u8; 3]> = map
            .values
            .iter()
            .map(|&v| {
                if v.is_nan() {
                    [255; 3]
                } else {
                    color((v - low) / (high - low))
                }
            })
            .collect();
        svg.image([x, y], [side; 2], map.width, &pixels);
        svg.rectangle([x, y], [side; 2], "none", INK);
        svg.text([x + 0.5 * side, y - 8.0], Anchor::Middle, TEXT, &map.title);
        for (part, text) in x_ticks {
            let at = x + part * side;
            svg.line([at, y + side], [at, y + side + 4.0], INK, 0.8);
            svg.text([at, y + side + 16.0], Anchor::Middle, TEXT - 1.0, text);
        }
        svg.text(
            [x + 0.5 * side, y + side + 32.0],
            Anchor::Middle,
            TEXT,
            x_label,
        );
        if index % columns == 0 {
            for (part, text) in y_ticks {
                let at = y + part * side;
                svg.line([x - 4.0, at], [x, at], INK, 0.8);
                svg.text([x - 7.0, at + 4.0], Anchor::End, TEXT - 1.0, text);
            }
            svg.turned(
                [x - 36.0, y + 0.5 * side],
                Anchor::Middle,
                TEXT,
                -90.0,
                y_label,
            );
        }
    }
    // The scale.
    let x = left + columns as f64 * cell[0];
    let bar: Vec<[u8; 3]> = (0..128)
        .map(|i| color(1.0 - f64::from(i) / 127.0))
        .collect();
    svg.image([x, top], [12.0, side], 1, &bar);
    svg.rectangle([x, top], [12.0, side], "none", INK);
    for (value, text) in &scale.ticks {
        let y = top + side * (1.0 - (value - low) / (high - low));
        svg.line([x + 12.0, y], [x + 15.0, y], INK, 0.8);
        svg.text([x + 18.0, y + 4.0], Anchor::Start, TEXT - 1.0, text);
    }
    svg.turned(
        [x + 58.0, top + 0.5 * side],
        Anchor::Middle,
        TEXT,
        -90.0,
        &scale.label,
    );
    Figure {
        name: name.to_owned(),
        svg: svg.finish(),
    }
}

/// Dark blue over green to yellow, of steadily rising lightness; `part` 0..=1.
pub fn color(part: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 6] = [
        [13.0, 8.0, 84.0],
        [52.0, 65.0, 145.0],
        [33.0, 120.0, 140.0],
        [53.0, 166.0, 116.0],
        [152.0, 206.0, 70.0],
        [252.0, 236.0, 60.0],
    ];
    let at = part.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let low = (at as usize).min(STOPS.len() - 2);
    let t = at - low as f64;
    [0, 1, 2].map(|c| (STOPS[low][c] * (1.0 - t) + STOPS[low + 1][c] * t).round() as u8)
}
