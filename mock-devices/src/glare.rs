//! Veiling glare: a lens puts a part of the light elsewhere in the image.

/// How much light goes elsewhere, and where.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Glare {
    /// Share that is spread evenly over the image.
    pub uniform: f64,
    /// Share that goes into a halo.
    pub halo: f64,
    /// Length over which the halo falls to 1/e along rows and columns, part of the image's
    /// diagonal.
    pub halo_width: f64,
}

impl Glare {
    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        self.uniform == 0.0 && self.halo == 0.0
    }

    /// Spreads the light of an image, row by row. What lies outside of it is black, and what the
    /// halo carries out of it is lost.
    pub fn spread(&self, image: &mut [f32], width: usize) {
        if self.is_none() || image.is_empty() {
            return;
        }
        let height = image.len() / width;
        let diagonal_px = (width as f64).hypot(height as f64);
        let mut halo: Vec<f64> = image.iter().map(|&v| f64::from(v)).collect();
        let mean = halo.iter().sum::<f64>() / halo.len() as f64;
        if self.halo > 0.0 {
            let step = (-1.0 / (self.halo_width * diagonal_px).max(1e-3)).exp();
            for row in 0..height {
                smooth(&mut halo, row * width, 1, width, step);
            }
            for column in 0..width {
                smooth(&mut halo, column, width, height, step);
            }
        }
        let kept = 1.0 - self.uniform - self.halo;
        for (value, halo) in image.iter_mut().zip(halo) {
            *value = (kept * f64::from(*value) + self.uniform * mean + self.halo * halo) as f32;
        }
    }
}

/// Convolves a line with (1 − a)/(1 + a) a^|n|, by a recursion forwards and one backwards.
fn smooth(values: &mut [f64], start: usize, stride: usize, count: usize, a: f64) {
    let at = |i: usize| start + i * stride;
    let mut backwards = vec![0.0; count];
    for i in (0..count.saturating_sub(1)).rev() {
        backwards[i] = a * (values[at(i + 1)] + backwards[i + 1]);
    }
    let mut forwards = 0.0;
    for (i, backwards) in backwards.into_iter().enumerate() {
        forwards = values[at(i)] + a * forwards;
        values[at(i)] = (1.0 - a) / (1.0 + a) * (forwards + backwards);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A white card with a black hole: the hole has the share times the mean. A point's halo
    /// falls to 1/e over its width and keeps its light.
    #[test]
    fn glare_is_what_its_shares_say() {
        let mut card = vec![2.0f32; 400];
        card[..40].fill(0.0);
        let uniform = Glare {
            uniform: 0.01,
            ..Glare::default()
        };
        uniform.spread(&mut card, 20);
        assert!((card[5] - 0.01 * 1.8).abs() < 1e-6, "{}", card[5]);
        assert!((card[300] - (0.99 * 2.0 + 0.018)).abs() < 1e-5);

        let mut point = vec![0.0f32; 201 * 201];
        let middle = 100 * 201 + 100;
        point[middle] = 1.0;
        let halo = Glare {
            halo: 0.02,
            halo_width: 10.0 / (201.0 * 2f64.sqrt()),
            ..Glare::default()
        };
        halo.spread(&mut point, 201);
        let sum: f32 = point.iter().sum();
        assert!((sum - 1.0).abs() < 1e-4, "{sum}");
        let ratio = point[middle + 20] / point[middle + 10];
        assert!((ratio - (-1f32).exp()).abs() < 1e-4, "{ratio}");
    }
}
