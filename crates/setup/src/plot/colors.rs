//! Colour maps.

/// Blue below, pale at zero, red above; −1..=1. The nine colours of "RdBu"
/// (C. Brewer, ColorBrewer 2.0), which people with colour-blindness can tell apart.
pub fn diverging(value: f32) -> [u8; 3] {
    const ANCHORS: [[u8; 3]; 9] = [
        [33, 102, 172],
        [67, 147, 195],
        [146, 197, 222],
        [209, 229, 240],
        [247, 247, 247],
        [253, 219, 199],
        [244, 165, 130],
        [214, 96, 77],
        [178, 24, 43],
    ];
    blend(&ANCHORS, (value + 1.0) / 2.0)
}

/// Dark blue to yellow with even steps of lightness; 0..=1. Nine samples of
/// "viridis" (S. van der Walt, N. Smith, CC0).
pub fn sequential(value: f32) -> [u8; 3] {
    const ANCHORS: [[u8; 3]; 9] = [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ];
    blend(&ANCHORS, value)
}

fn blend(anchors: &[[u8; 3]], position: f32) -> [u8; 3] {
    let last = anchors.len() - 1;
    let scaled = position.clamp(0.0, 1.0) * last as f32;
    let at = (scaled as usize).min(last - 1);
    let part = scaled - at as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(anchors[at][c]), f32::from(anchors[at + 1][c]));
        (a + (b - a) * part).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lightness must rise (or fall towards both ends) so that the maps also
    /// read in grey print.
    #[test]
    fn colour_maps_are_ordered_by_lightness() {
        let luma = |[r, g, b]: [u8; 3]| {
            0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
        };
        let lightness = |map: fn(f32) -> [u8; 3]| -> Vec<f64> {
            (0..64).map(|n| luma(map(n as f32 / 63.0))).collect()
        };
        let viridis = lightness(sequential);
        assert!(viridis.windows(2).all(|pair| pair[1] > pair[0]));
        let red_half = lightness(diverging);
        assert!(red_half.windows(2).all(|pair| pair[1] < pair[0]));
    }
}
