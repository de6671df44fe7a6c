//! A density over the unit square that warps uniform points into itself, as the
//! readers of RGL files warp: bilinear between nodes, rows first.

/// Positions and fraction of a coordinate in [0, 1] among `nodes` nodes.
pub fn cell(u: f64, nodes: usize) -> (usize, f64) {
    let position = u.clamp(0.0, 1.0) * (nodes - 1) as f64;
    let lower = (position as usize).min(nodes - 2);
    (lower, position - lower as f64)
}

/// A density at `width` × `height` nodes with its cumulated sums.
pub struct Warp {
    width: usize,
    height: usize,
    density: Vec<f64>,
    /// Per node: integral of its row from the left, in cells.
    along_row: Vec<f64>,
    /// Per row: integral over the rows above, in cells.
    above: Vec<f64>,
}

impl Warp {
    /// From values ≥ 0 at the nodes, row by row; at least 2 × 2, not all 0.
    pub fn new(width: usize, density: Vec<f64>) -> Self {
        let height = density.len() / width;
        let mut along_row = Vec::with_capacity(density.len());
        for row in density.chunks_exact(width) {
            let mut sum = 0.0;
            along_row.push(sum);
            for pair in row.windows(2) {
                sum += 0.5 * (pair[0] + pair[1]);
                along_row.push(sum);
            }
        }
        let mut total = 0.0;
        let mut above = vec![total];
        for y in 1..height {
            total += 0.5 * (along_row[y * width - 1] + along_row[(y + 1) * width - 1]);
            above.push(total);
        }
        Self {
            width,
            height,
            density,
            along_row,
            above,
        }
    }

    /// Where the uniform point (x, y) goes, and the density there: its integral
    /// over the unit square is one.
    pub fn sample(&self, [x, y]: [f64; 2]) -> ([f64; 2], f64) {
        let (width, height) = (self.width, self.height);
        let total = self.above[height - 1];
        let target = y.clamp(0.0, 1.0) * total;
        let row = last_at_most(&self.above, target).min(height - 2);
        let row_total = |y: usize| self.along_row[(y + 1) * width - 1];
        let ty = position(target - self.above[row], row_total(row), row_total(row + 1));
        let mix = |values: &[f64], column: usize| {
            let at = |y: usize| values[y * width + column];
            (1.0 - ty) * at(row) + ty * at(row + 1)
        };
        let target = x.clamp(0.0, 1.0) * mix(&self.along_row, width - 1);
        let sums: Vec<f64> = (0..width)
            .map(|column| mix(&self.along_row, column))
            .collect();
        let column = last_at_most(&sums, target).min(width - 2);
        let (left, right) = (mix(&self.density, column), mix(&self.density, column + 1));
        let tx = position(target - sums[column], left, right);
        let cells = ((width - 1) * (height - 1)) as f64;
        let point = [
            (column as f64 + tx) / (width - 1) as f64,
            (row as f64 + ty) / (height - 1) as f64,
        ];
        (point, (left + tx * (right - left)) * cells / total)
    }
}

/// Index of the last entry of an ascending list that `value` reaches.
fn last_at_most(ascending: &[f64], value: f64) -> usize {
    ascending.partition_point(|&v| v <= value).saturating_sub(1)
}

/// Where in a cell whose ends have the densities `a` and `b` the integral from the
/// left is `area`, 0..=1.
fn position(area: f64, a: f64, b: f64) -> f64 {
    let root = (a * a + 2.0 * area * (b - a)).max(0.0).sqrt();
    if a + root > 0.0 {
        (2.0 * area / (a + root)).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Row totals 1 and 5, as in the reader's test of the inverse.
    #[test]
    fn a_uniform_point_goes_where_the_sums_say() {
        let warp = Warp::new(3, vec![0.0, 1.0, 0.0, 2.0, 3.0, 2.0]);
        let (at, density) = warp.sample([0.5, 1.0 / 3.0]);
        assert!(
            (at[0] - 0.5).abs() < 1e-12 && (at[1] - 0.5).abs() < 1e-12,
            "{at:?}"
        );
        // Two cells of mean 3/2 over the square: 2 at its middle is 2·2/3 of uniform.
        assert!((density - 4.0 / 3.0).abs() < 1e-12, "{density}");
        assert_eq!(warp.sample([0.0, 0.0]).0, [0.0, 0.0]);
        assert_eq!(warp.sample([1.0, 1.0]).0, [1.0, 1.0]);
    }
}
