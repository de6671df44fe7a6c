//! The parameters of the models, and the limits that a fit keeps.

/// Number of values of [`Parameters`].
pub const COUNT: usize = 16;

/// What describes a material in the models of this module. The names are OpenPBR's; what each
/// value means in a model is that model's convention.
///
/// Colours are linear Rec. 709, 0 to 1. A roughness is the square root of the lobe's width α.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Parameters {
    /// Of the diffuse base, and of metal at normal incidence.
    pub base_color: [f64; 3],
    /// Share of metal in the base, 0 to 1.
    pub metalness: f64,
    /// Of the diffuse base, 0 (Lambertian) to 1.
    pub diffuse_roughness: f64,
    /// Of the reflection at metal and dielectric base.
    pub roughness: f64,
    /// Index of refraction of the dielectric base, 1 to 3.
    pub ior: f64,
    /// Tint of the dielectric's reflection, and of metal's at grazing incidence.
    pub specular_color: [f64; 3],
    /// Share of the surface under a clear coat, 0 to 1.
    pub coat_weight: f64,
    /// Of the coat, whose index is [`COAT_IOR`].
    pub coat_roughness: f64,
    /// Weight × colour of the fibres on top: their largest value is the weight.
    pub fuzz: [f64; 3],
    /// Of the fibres.
    pub fuzz_roughness: f64,
}

/// Index of refraction of every coat.
pub const COAT_IOR: f64 = 1.5;

/// Index of refraction of a dielectric base that a model does not let one choose.
pub const USUAL_IOR: f64 = 1.5;

/// Least roughness: α = 0.0025. Renderers widen narrower lobes, or make mirrors of them.
pub const LEAST_ROUGHNESS: f64 = 0.05;

/// Least and largest value of each parameter, in the order of [`Parameters::to_array`].
pub const LIMITS: [[f64; 2]; COUNT] = [
    [0.0, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [LEAST_ROUGHNESS, 1.0],
    [1.0, 3.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [LEAST_ROUGHNESS, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [0.0, 1.0],
    [0.1, 1.0],
];

impl Default for Parameters {
    /// Grey, half rough, without coat and fibres.
    fn default() -> Self {
        Self {
            base_color: [0.5; 3],
            metalness: 0.0,
            diffuse_roughness: 0.0,
            roughness: 0.5,
            ior: USUAL_IOR,
            specular_color: [1.0; 3],
            coat_weight: 0.0,
            coat_roughness: 0.1,
            fuzz: [0.0; 3],
            fuzz_roughness: 0.5,
        }
    }
}

impl Parameters {
    /// The values in the order of the fields.
    pub fn to_array(self) -> [f64; COUNT] {
        let [r, g, b] = self.base_color;
        let [specular_r, specular_g, specular_b] = self.specular_color;
        let [fuzz_r, fuzz_g, fuzz_b] = self.fuzz;
        [
            r,
            g,
            b,
            self.metalness,
            self.diffuse_roughness,
            self.roughness,
            self.ior,
            specular_r,
            specular_g,
            specular_b,
            self.coat_weight,
            self.coat_roughness,
            fuzz_r,
            fuzz_g,
            fuzz_b,
            self.fuzz_roughness,
        ]
    }

    /// From values in the order of [`Self::to_array`], each brought within [`LIMITS`].
    pub fn from_array(values: [f64; COUNT]) -> Self {
        let within: [f64; COUNT] =
            std::array::from_fn(|k| values[k].clamp(LIMITS[k][0], LIMITS[k][1]));
        let three = |first: usize| [within[first], within[first + 1], within[first + 2]];
        Self {
            base_color: three(0),
            metalness: within[3],
            diffuse_roughness: within[4],
            roughness: within[5],
            ior: within[6],
            specular_color: three(7),
            coat_weight: within[10],
            coat_roughness: within[11],
            fuzz: three(12),
            fuzz_roughness: within[15],
        }
    }

    /// Width α of the base's reflection.
    pub fn alpha(&self) -> f64 {
        self.roughness * self.roughness
    }

    /// The share of the surface under fibres, and their colour with the largest value 1.
    pub fn fuzz_weight_and_color(&self) -> (f64, [f64; 3]) {
        weight_and_color(self.fuzz)
    }

    /// The specular colour as a weight and a colour with the largest value 1.
    pub fn specular_weight_and_color(&self) -> (f64, [f64; 3]) {
        weight_and_color(self.specular_color)
    }

    /// With every value rounded to `digits` decimals, as a file holds them.
    pub fn rounded(self, digits: i32) -> Self {
        let scale = 10f64.powi(digits);
        Self::from_array(self.to_array().map(|value| (value * scale).round() / scale))
    }
}

fn weight_and_color(product: [f64; 3]) -> (f64, [f64; 3]) {
    let weight = product.into_iter().fold(0.0, f64::max);
    if weight > 0.0 {
        (weight, product.map(|value| value / weight))
    } else {
        (0.0, [1.0; 3])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_keep_their_order_and_limits() {
        let values: [f64; COUNT] = std::array::from_fn(|k| {
            let [low, high] = LIMITS[k];
            low + (high - low) * (k as f64 + 1.0) / (COUNT as f64 + 1.0)
        });
        assert_eq!(Parameters::from_array(values).to_array(), values);
        let beyond = Parameters::from_array([7.0; COUNT]);
        assert_eq!((beyond.base_color, beyond.ior), ([1.0; 3], 3.0));
        let (weight, color) = Parameters {
            fuzz: [0.1, 0.2, 0.0],
            ..Parameters::default()
        }
        .fuzz_weight_and_color();
        assert_eq!((weight, color), (0.2, [0.5, 1.0, 0.0]));
    }
}
