//! Spectra for RGB values, for programs that render spectra.
//!
//! A rig measures three channels; a spectrum in a file is an assumption. The one
//! made here is linear: each channel has a basis reflectance, the three sum to one
//! at every wavelength (so grey is flat, and energy is conserved where it was), and
//! each has under the illuminant D65 the linear sRGB colour of its channel (CIE 1931
//! 2° observer). Among those it is the smoothest (least sum of squared differences
//! of neighbours): a quadratic programme solved once; the idea is Mallett & Yuksel's
//! (2019, "Spectral Primary Decomposition for Rendering with sRGB Reflectance").

/// Where the basis is given; linear between, constant beyond, nanometres.
pub const WAVELENGTHS_NM: [f32; 16] = [
    400.0, 420.0, 440.0, 460.0, 480.0, 500.0, 520.0, 540.0, 560.0, 580.0, 600.0, 620.0, 640.0,
    660.0, 680.0, 700.0,
];

/// Basis reflectances of R, G and B at [`WAVELENGTHS_NM`].
const BASIS: [[f32; 3]; 16] = [
    [0.05749, 0.0, 0.94251],
    [0.05380, 0.0, 0.94620],
    [0.02990, 0.0, 0.97010],
    [0.00463, 0.0, 0.99537],
    [0.0, 0.25875, 0.74125],
    [0.0, 0.74699, 0.25301],
    [0.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.13466, 0.79351, 0.07183],
    [0.79747, 0.20019, 0.00234],
    [1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
];

/// What an RGB value reflects at the wavelength `WAVELENGTHS_NM[band]`.
pub fn reflectance(rgb: [f32; 3], band: usize) -> f32 {
    rgb.iter().zip(BASIS[band]).map(|(v, b)| v * b).sum()
}

/// Luminance of linear sRGB (IEC 61966-2-1).
pub fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_is_flat_and_nothing_is_negative() {
        for (band, basis) in BASIS.iter().enumerate() {
            assert!((reflectance([1.0; 3], band) - 1.0).abs() < 1e-6);
            assert!(basis.iter().all(|b| (0.0..=1.0).contains(b)));
        }
    }
}
