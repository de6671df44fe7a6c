//! A captured image, its prediction, and their difference with its scale.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::Picture;
use super::canvas::{Figure, INK, MUTED, TEXT_PX, draw, fitting_style, units};
use super::colors::diverging;
use super::radiance::{averaged_to, tone_mapped, white_level};
use crate::radiance_image::RadianceImage;

/// Pixels a side of an image at most.
const LARGEST_PX: usize = 400;
/// Pixels of the PNG that a side of an image takes at most, where it has fewer than half of them.
const SHOWN_PX: usize = 500;
/// Pixels of the PNG per CSS pixel, so that a pixel becomes a whole number of them.
const SCALE: f64 = 2.5;
/// Part of the pixels whose difference the scale holds.
const SHOWN_PART: f64 = 0.98;
/// Where nothing is compared.
const LEFT_OUT: [u8; 4] = [200, 200, 200, 255];

/// Draws a captured image, its prediction in the same exposure, and predicted minus captured: the
/// mean of the channels, relative to the radiance shown as white. Both images have one size. The
/// figure is cropped to the pixels that are valid in `captured`; invalid ones inside are grey.
pub fn comparison(name: &str, captured: &RadianceImage, predicted: &RadianceImage) -> Figure {
    const GAP_PX: f64 = 12.0;
    const TOP_PX: f64 = 26.0;
    const BOTTOM_PX: f64 = 24.0;
    const BAR_PX: f64 = 12.0;
    const LABELS_PX: f64 = 52.0;

    // The pictures.
    let around = bounds(captured);
    let [captured, predicted] =
        [captured, predicted].map(|image| averaged_to(&cropped(image, &around), LARGEST_PX));
    let white = white_level(&captured);
    let differences = differences(&captured, &predicted, white);
    let range = scale_of(differences.iter().flatten().copied());
    let colors = differences.iter().map(|difference| match difference {
        Some(difference) => diverging((difference / range) as f32),
        None => [LEFT_OUT[0], LEFT_OUT[1], LEFT_OUT[2]],
    });
    let shown = |image: &RadianceImage| {
        let mut picture = tone_mapped(image, white);
        for pixel in &mut picture.pixels {
            if pixel[3] == 0 {
                *pixel = LEFT_OUT;
            }
        }
        picture
    };
    let pictures = [
        ("captured", shown(&captured)),
        ("predicted", shown(&predicted)),
        (
            "predicted − captured",
            Picture::opaque(captured.width, colors),
        ),
    ];

    // Where they stand.
    let repeats = (SHOWN_PX / captured.width.max(captured.height).max(1)).max(1) as f64;
    let cell_px = [captured.width, captured.height].map(|side| side as f64 * repeats / SCALE);
    let column_px = cell_px[0].max(120.0) + GAP_PX;
    let bar_left_px = GAP_PX + 3.0 * column_px;
    let bar_height_px = cell_px[1].max(60.0);
    let size_px = [
        bar_left_px + BAR_PX + LABELS_PX,
        TOP_PX + bar_height_px + BOTTOM_PX,
    ];
    let at = |x_px: f64, y_px: f64| (units(x_px), units(y_px));
    draw(name, size_px, |root, images| {
        for (column, (title, picture)) in pictures.iter().enumerate() {
            let left_px = GAP_PX + column as f64 * column_px;
            images.put(at(left_px, TOP_PX), at(cell_px[0], cell_px[1]), picture);
            let room_px = column_px - GAP_PX;
            let style = fitting_style(title, room_px, INK, HPos::Left, VPos::Center);
            root.draw(&Text::new(*title, at(left_px, 0.5 * TOP_PX), style))?;
        }

        // The scale, and what white is.
        let bar = Picture::opaque(1, (0..128).map(|n| diverging(1.0 - n as f32 / 63.5)));
        images.put(at(bar_left_px, TOP_PX), at(BAR_PX, bar_height_px), &bar);
        let percent = 100.0 * range;
        for (part, label) in [
            (0.0, format!("+{percent}%")),
            (0.5, "0".to_owned()),
            (1.0, format!("−{percent}%")),
        ] {
            let inside = part * (bar_height_px - TEXT_PX) + 0.5 * TEXT_PX;
            let place = at(bar_left_px + BAR_PX + 5.0, TOP_PX + inside);
            let style = fitting_style(&label, LABELS_PX - 5.0, INK, HPos::Left, VPos::Center);
            root.draw(&Text::new(label, place, style))?;
        }
        let note = format!(
            "difference in % of white, radiance {}; grey: left out",
            short(white)
        );
        let room_px = size_px[0] - 2.0 * GAP_PX;
        let style = fitting_style(&note, room_px, MUTED, HPos::Left, VPos::Center);
        let below = at(GAP_PX, size_px[1] - 0.5 * BOTTOM_PX);
        root.draw(&Text::new(note, below, style))
    })
}

/// With three significant digits.
fn short(value: f32) -> String {
    match f64::from(value).log10() {
        log if (-3.0..3.0).contains(&log) => {
            format!("{value:.*}", (2 - log.floor() as i32).max(0) as usize)
        }
        _ => format!("{value:.2e}"),
    }
}

/// Columns and rows around the valid pixels, with a narrow margin; all without any.
fn bounds(image: &RadianceImage) -> [std::ops::Range<usize>; 2] {
    let valid = (0..image.valid.len()).filter(|&pixel| image.valid[pixel]);
    let mut around: Option<[[usize; 2]; 2]> = None;
    for pixel in valid {
        let place = [pixel % image.width, pixel / image.width];
        let all = around.get_or_insert([place, place]);
        for axis in 0..2 {
            all[0][axis] = all[0][axis].min(place[axis]);
            all[1][axis] = all[1][axis].max(place[axis]);
        }
    }
    let sides = [image.width, image.height];
    let margin = sides[0].max(sides[1]) / 100;
    [0, 1].map(|axis| match around {
        Some([first, last]) => {
            first[axis].saturating_sub(margin)..(last[axis] + margin + 1).min(sides[axis])
        }
        None => 0..sides[axis],
    })
}

/// A part of an image, without its variance.
fn cropped(image: &RadianceImage, [columns, rows]: &[std::ops::Range<usize>; 2]) -> RadianceImage {
    let mut part = RadianceImage::new(columns.len(), rows.len());
    for at in 0..part.mean.len() {
        let row = rows.start + at / part.width;
        let from = row * image.width + columns.start + at % part.width;
        (part.mean[at], part.valid[at]) = (image.mean[from], image.valid[from]);
    }
    part
}

/// Predicted less captured by pixel, the mean of the channels over `white`.
fn differences(
    captured: &RadianceImage,
    predicted: &RadianceImage,
    white: f32,
) -> Vec<Option<f64>> {
    let pixel = |at: usize| {
        let sum: f32 = (0..3)
            .map(|c| predicted.mean[at][c] - captured.mean[at][c])
            .sum();
        let difference = f64::from(sum / 3.0 / white);
        (captured.valid[at] && predicted.valid[at] && difference.is_finite()).then_some(difference)
    };
    (0..captured.mean.len()).map(pixel).collect()
}

/// 1, 2 or 5 times a power of ten that nearly all differences stay below; at least 1%.
pub fn scale_of(differences: impl Iterator<Item = f64>) -> f64 {
    let mut sizes: Vec<f64> = differences.map(f64::abs).collect();
    sizes.sort_by(f64::total_cmp);
    let place = (SHOWN_PART * sizes.len().saturating_sub(1) as f64) as usize;
    let held = sizes.get(place).copied().unwrap_or(0.0);
    let steps = (-2..=3).flat_map(|power| [1.0, 2.0, 5.0].map(|n| n * 10f64.powi(power)));
    let mut steps = steps.skip_while(|&step| step < held);
    steps.next().unwrap_or(1e4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_difference_is_stated_over_white_with_a_scale_that_holds_it() {
        let mut captured = RadianceImage::new(9, 7);
        captured.valid.fill(false);
        for pixel in [20, 21, 30] {
            captured.valid[pixel] = true;
            captured.mean[pixel] = [2.0; 3];
        }
        assert_eq!(bounds(&captured), [2..4, 2..4]);
        let mut predicted = captured.clone();
        predicted.mean[21] = [2.0, 2.3, 2.0];
        let around = bounds(&captured);
        let [captured, predicted] = [&captured, &predicted].map(|i| cropped(i, &around));
        let white = white_level(&captured);
        let found = differences(&captured, &predicted, white);
        assert_eq!((found[0], found[2]), (Some(0.0), None));
        assert!((found[1].unwrap() - 0.05).abs() < 1e-6, "{found:?}");
        assert_eq!(scale_of([-0.049, 0.049].into_iter()), 0.05);
        assert_eq!(scale_of(std::iter::empty()), 0.01);
        assert!(comparison("light", &captured, &predicted).png().is_ok());
    }
}
