//! A white card with two black traps through a lens with glare.

pub use mock_devices::glare::Glare;

/// The image of a card of this radiance whose traps reflect this part of it, row by row; and the
/// regions inside the traps: first column, first row, columns, rows.
pub fn card(
    [width, height]: [usize; 2],
    [radiance, trap_reflectance]: [f64; 2],
    glare: Glare,
) -> (Vec<f32>, [[usize; 4]; 2]) {
    let shorter = width.min(height);
    let square = |x: f64, y: f64, side: f64| {
        let side = (side * shorter as f64).max(8.0) as usize;
        let left = (x * width as f64) as usize - side / 2;
        let top = (y * height as f64) as usize - side / 2;
        [left, top, side, side]
    };
    let traps = [square(0.6, 0.5, 0.4), square(0.15, 0.3, 0.12)];
    let is_in = |[left, top, columns, rows]: [usize; 4], pixel: usize| {
        let [x, y] = [pixel % width, pixel / width];
        (left..left + columns).contains(&x) && (top..top + rows).contains(&y)
    };
    let mut image: Vec<f32> = (0..width * height)
        .map(|pixel| match traps.iter().any(|&trap| is_in(trap, pixel)) {
            true => (radiance * trap_reflectance) as f32,
            false => radiance as f32,
        })
        .collect();
    glare.spread(&mut image, width);
    // Away from the edges.
    let inside = |[x, y, columns, rows]: [usize; 4]| {
        let margin = (columns / 6).max(1);
        [
            x + margin,
            y + margin,
            columns - 2 * margin,
            rows - 2 * margin,
        ]
    };
    (image, traps.map(inside))
}
