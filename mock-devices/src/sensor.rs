//! From radiance to raw counts: the linear sensor of EMVA 1288 (release 4.0),
//! with its non-uniformities and its limits.

use crate::random;

/// What a sensor is. Every value is true, and known to tests.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorConfig {
    /// Width and height, pixels.
    pub resolution_px: [u32; 2],
    /// Electrons per second and per W/(m² sr) of radiance, all of lens, pixel
    /// area and quantum efficiency together.
    pub responsivity: f64,
    /// Mean dark current, e⁻/s.
    pub dark_current_e_s: f64,
    /// Standard deviation of the dark current over the pixels, e⁻/s.
    pub dsnu_e_s: f64,
    /// Standard deviation of the offset over the pixels, e⁻ (DSNU at no exposure).
    pub offset_dsnu_e: f64,
    /// Relative standard deviation of the responsivity over the pixels.
    pub prnu: f64,
    /// Standard deviation of the read noise, e⁻.
    pub read_noise_e: f64,
    /// Relative departure of the signal from proportionality at the full well,
    /// above -0.5: `n` electrons of `N` read as `n (1 + nonlinearity n / N)`.
    pub nonlinearity: f64,
    /// Most electrons a pixel holds.
    pub full_well_e: f64,
    /// System gain K at gain 1, DN/e⁻.
    pub gain_dn_per_e: f64,
    /// Count without any electron, DN.
    pub black_level_dn: f64,
    /// What differs between the pixels of a cell of 2 × 2, such as those behind filters of
    /// different colours whose counts were multiplied to balance white; `None`: nothing.
    pub cell: Option<[PixelCounts; 4]>,
    /// Bits of a count, 1 to 16; it saturates at 2^bits − 1.
    pub bit_depth: u32,
    /// Fraction of pixels that are hot.
    pub hot_fraction: f64,
    /// Pixels that are hot besides, by index.
    pub hot_pixels: Vec<u32>,
    /// Extra dark current of a hot pixel, e⁻/s (each between half and one and a
    /// half times this).
    pub hot_current_e_s: f64,
    /// Key of the fixed patterns: which sensor this is.
    pub seed: u64,
}

/// How the electrons of a pixel become counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelCounts {
    /// In place of [`SensorConfig::gain_dn_per_e`].
    pub gain_dn_per_e: f64,
    /// In place of [`SensorConfig::read_noise_e`].
    pub read_noise_e: f64,
    /// In place of [`SensorConfig::black_level_dn`].
    pub black_level_dn: f64,
}

impl SensorConfig {
    /// A typical 12-bit machine-vision sensor of this size, as EMVA 1288 data
    /// sheets of the 3.45 µm class have it: 10,500 e⁻ full well, 2.4 e⁻ read
    /// noise, PRNU 0.6%, DSNU 0.6 e⁻/s.
    pub fn typical(resolution_px: [u32; 2], seed: u64) -> Self {
        Self {
            resolution_px,
            responsivity: 1.0e6,
            dark_current_e_s: 3.0,
            dsnu_e_s: 0.6,
            offset_dsnu_e: 0.5,
            prnu: 0.006,
            read_noise_e: 2.4,
            nonlinearity: 0.0,
            full_well_e: 10_500.0,
            gain_dn_per_e: 0.38,
            black_level_dn: 64.0,
            cell: None,
            bit_depth: 12,
            hot_fraction: 2e-4,
            hot_pixels: Vec::new(),
            hot_current_e_s: 2_000.0,
            seed,
        }
    }
}

/// What a frame's noise depends on: equal keys give equal frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct NoiseKey {
    /// Seed of all noise of a session.
    pub seed: u64,
    /// Place of the frame.
    pub frame: FrameKey,
}

/// The place of a frame in a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub struct FrameKey {
    pub light: u32,
    pub exposure: u32,
    /// Repeat at the same settings.
    pub repeat: u32,
    /// Kind of frame: 0 light, 1 ambient, 2 dark.
    pub kind: u32,
}

/// A sensor with its fixed patterns.
#[derive(Clone, Debug)]
pub struct SensorModel {
    config: SensorConfig,
    relative_response: Vec<f32>,
    dark_current_e_s: Vec<f32>,
    offset_e: Vec<f32>,
    hot: Vec<u32>,
}

impl SensorModel {
    /// Draws the fixed patterns that the config's seed stands for.
    pub fn new(config: SensorConfig) -> Self {
        let pixels = config.resolution_px[0] as usize * config.resolution_px[1] as usize;
        let mut sensor = Self {
            relative_response: Vec::with_capacity(pixels),
            dark_current_e_s: Vec::with_capacity(pixels),
            offset_e: Vec::with_capacity(pixels),
            hot: Vec::new(),
            config,
        };
        let config = &sensor.config;
        for pixel in 0..pixels {
            let mut numbers = random::stream(&[config.seed, 10, pixel as u64]);
            let response = 1.0 + config.prnu * numbers.normal();
            let mut dark = (config.dark_current_e_s + config.dsnu_e_s * numbers.normal()).max(0.0);
            let offset = config.offset_dsnu_e * numbers.normal();
            let listed = config.hot_pixels.contains(&(pixel as u32));
            if numbers.uniform() < config.hot_fraction || listed {
                dark += config.hot_current_e_s * (0.5 + numbers.uniform());
                sensor.hot.push(pixel as u32);
            }
            sensor.relative_response.push(response.max(0.0) as f32);
            sensor.dark_current_e_s.push(dark as f32);
            sensor.offset_e.push(offset as f32);
        }
        sensor
    }

    /// What the sensor is.
    pub fn config(&self) -> &SensorConfig {
        &self.config
    }

    /// Width and height, pixels.
    pub fn resolution_px(&self) -> [u32; 2] {
        self.config.resolution_px
    }

    /// Largest count, DN.
    pub fn saturation_dn(&self) -> u16 {
        (((1_u32 << self.config.bit_depth.clamp(1, 16)) - 1) & 0xffff) as u16
    }

    /// True responsivity of each pixel relative to the mean, row by row (PRNU).
    pub fn relative_response(&self) -> &[f32] {
        &self.relative_response
    }

    /// True dark current of each pixel, e⁻/s, hot pixels included (DSNU).
    pub fn dark_current_e_s(&self) -> &[f32] {
        &self.dark_current_e_s
    }

    /// True offset of each pixel from the black level, e⁻.
    pub fn offset_e(&self) -> &[f32] {
        &self.offset_e
    }

    /// Indices of the hot pixels, ascending.
    pub fn hot_pixels(&self) -> &[u32] {
        &self.hot
    }

    /// True expectation of a pixel's electrons under this radiance, W/(m² sr).
    pub fn mean_electrons(&self, pixel: usize, radiance: f32, exposure_s: f64) -> f64 {
        let light = f64::from(radiance.max(0.0))
            * self.config.responsivity
            * f64::from(self.relative_response[pixel]);
        (light + f64::from(self.dark_current_e_s[pixel])) * exposure_s
    }

    /// One frame of raw counts, DN: Poisson electrons clipped at the full well,
    /// Gaussian read noise, gain, black level, rounding and saturation. The
    /// radiance is one value per pixel, W/(m² sr), row by row.
    ///
    /// # Panics
    /// If `radiance` has another length than the sensor has pixels.
    pub fn expose(&self, radiance: &[f32], exposure_s: f64, gain: f64, key: NoiseKey) -> Vec<u16> {
        assert_eq!(
            radiance.len(),
            self.offset_e.len(),
            "one radiance per sensor pixel"
        );
        let mut counts = vec![0_u16; radiance.len()];
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        let chunk = radiance.len().div_ceil(threads).max(4096);
        std::thread::scope(|scope| {
            for (index, part) in counts.chunks_mut(chunk).enumerate() {
                scope.spawn(move || {
                    for (offset, count) in part.iter_mut().enumerate() {
                        let pixel = index * chunk + offset;
                        *count = self.count(pixel, radiance[pixel], exposure_s, gain, key);
                    }
                });
            }
        });
        counts
    }

    fn counts_of(&self, pixel: usize) -> PixelCounts {
        let config = &self.config;
        let width = config.resolution_px[0] as usize;
        match &config.cell {
            Some(cell) => cell[pixel / width % 2 * 2 + pixel % width % 2],
            None => PixelCounts {
                gain_dn_per_e: config.gain_dn_per_e,
                read_noise_e: config.read_noise_e,
                black_level_dn: config.black_level_dn,
            },
        }
    }

    fn count(&self, pixel: usize, radiance: f32, exposure_s: f64, gain: f64, key: NoiseKey) -> u16 {
        let FrameKey {
            light,
            exposure,
            repeat,
            kind,
        } = key.frame;
        let mut numbers = random::stream(&[
            key.seed,
            11,
            u64::from(light) << 32 | u64::from(exposure),
            u64::from(repeat) << 32 | u64::from(kind),
            pixel as u64,
        ]);
        let full_well = self.config.full_well_e;
        let mean = self.mean_electrons(pixel, radiance, exposure_s);
        // Beyond ten deviations above the full well the draw is decided.
        let electrons = if mean > full_well + 10.0 * full_well.sqrt() + 100.0 {
            full_well
        } else {
            numbers.poisson(mean).min(full_well)
        };
        let counts = self.counts_of(pixel);
        let read = f64::from(self.offset_e[pixel]) + counts.read_noise_e * numbers.normal();
        let read_as = electrons * (1.0 + self.config.nonlinearity * electrons / full_well);
        let dn = counts.black_level_dn + counts.gain_dn_per_e * gain * (read_as + read);
        dn.round().clamp(0.0, f64::from(self.saturation_dn())) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(repeat: u32) -> NoiseKey {
        NoiseKey {
            seed: 5,
            frame: FrameKey {
                light: 1,
                exposure: 2,
                repeat,
                kind: 0,
            },
        }
    }

    fn uniform_sensor() -> SensorConfig {
        SensorConfig {
            dsnu_e_s: 0.0,
            offset_dsnu_e: 0.0,
            prnu: 0.0,
            hot_fraction: 0.0,
            dark_current_e_s: 20.0,
            ..SensorConfig::typical([160, 120], 3)
        }
    }

    /// Mean = black + K μ and variance = K² (μ + σ_r²) + 1/12 (quantisation) from
    /// few electrons to half the full well, at two gains. Both statistics within
    /// 5 of their own standard deviations: 1 − (1 − 6e-7)^16 < 1e-5.
    #[test]
    fn mean_and_variance_follow_the_photon_transfer_law() {
        let config = uniform_sensor();
        let sensor = SensorModel::new(config.clone());
        let n = f64::from(config.resolution_px[0] * config.resolution_px[1]);
        for (case, (electrons, gain)) in [
            (0.0, 1.0),
            (4.0, 1.0),
            (60.0, 1.0),
            (900.0, 1.0),
            (5000.0, 1.0),
            (4.0, 2.5),
            (60.0, 2.5),
            (900.0, 2.5),
        ]
        .into_iter()
        .enumerate()
        {
            let exposure_s = 0.02;
            let radiance = vec![(electrons / exposure_s / config.responsivity) as f32; n as usize];
            let counts = sensor.expose(&radiance, exposure_s, gain, key(case as u32));
            let k = config.gain_dn_per_e * gain;
            let mu = sensor.mean_electrons(0, radiance[0], exposure_s);
            let mean_expected = config.black_level_dn + k * mu;
            let variance_expected = k * k * (mu + config.read_noise_e.powi(2)) + 1.0 / 12.0;
            let mean = counts.iter().map(|&c| f64::from(c)).sum::<f64>() / n;
            let chi2 = counts
                .iter()
                .map(|&c| (f64::from(c) - mean_expected).powi(2) / variance_expected)
                .sum::<f64>();
            assert!(
                (mean - mean_expected).abs() < 5.0 * (variance_expected / n).sqrt(),
                "{electrons} e, gain {gain}: mean {mean}, expected {mean_expected}"
            );
            // Excess kurtosis of a Poisson is 1/μ; it widens the chi-square.
            let spread = (n * (2.0 + 1.0 / mu.max(1.0))).sqrt();
            assert!(
                (chi2 - n).abs() < 5.0 * spread,
                "{electrons} e, gain {gain}: chi2 {chi2} over {n}"
            );
        }
    }

    #[test]
    fn each_pixel_of_a_cell_counts_in_its_own_way() {
        let pixel = |place: usize| PixelCounts {
            gain_dn_per_e: 0.1 * (place + 1) as f64,
            read_noise_e: 0.0,
            black_level_dn: 10.0 * place as f64 - 0.5,
        };
        let sensor = SensorModel::new(SensorConfig {
            cell: Some([0, 1, 2, 3].map(pixel)),
            dark_current_e_s: 0.0,
            full_well_e: 1000.0,
            resolution_px: [3, 3],
            ..uniform_sensor()
        });
        // Every pixel is full.
        let counts = sensor.expose(&[1e9; 9], 1.0, 1.0, key(0));
        let [a, b, c, d] = [0, 1, 2, 3].map(|place| {
            (pixel(place).black_level_dn + 1000.0 * pixel(place).gain_dn_per_e).round() as u16
        });
        assert_eq!(counts, [a, b, a, c, d, c, a, b, a]);
    }

    #[test]
    fn fixed_patterns_have_the_stated_spread_and_hot_pixels_burn() {
        let config = SensorConfig {
            prnu: 0.01,
            hot_fraction: 1e-3,
            hot_pixels: vec![77],
            ..SensorConfig::typical([300, 200], 8)
        };
        let sensor = SensorModel::new(config.clone());
        let n = 60_000.0;
        let response = sensor.relative_response();
        let spread = (response
            .iter()
            .map(|&r| f64::from(r - 1.0).powi(2))
            .sum::<f64>()
            / n)
            .sqrt();
        // The relative error of a standard deviation from n samples is 1/√(2n).
        assert!(
            (spread / 0.01 - 1.0).abs() < 5.0 / (2.0_f64 * n).sqrt(),
            "{spread}"
        );
        // Binomial: 60 ± 5 √60.
        let hot = sensor.hot_pixels().len() as f64;
        assert!(
            (hot - 60.0).abs() < 5.0 * 60.0_f64.sqrt(),
            "{hot} hot pixels"
        );
        assert!(sensor.hot_pixels().contains(&77));
        let dark = sensor.expose(&vec![0.0; 60_000], 1.0, 1.0, key(0));
        for &pixel in sensor.hot_pixels() {
            assert!(f64::from(dark[pixel as usize]) > 64.0 + 0.38 * 800.0);
        }
        assert_ne!(
            SensorModel::new(SensorConfig { seed: 9, ..config }).relative_response(),
            response,
            "another seed is another sensor"
        );
    }

    #[test]
    fn counts_end_at_the_full_well_and_at_the_converter() {
        let config = uniform_sensor();
        let sensor = SensorModel::new(config.clone());
        let bright = vec![1e9_f32; 160 * 120];
        // 64 + 0.38 × 10,500 = 4054: the well is full before the converter saturates.
        let counts = sensor.expose(&bright, 0.1, 1.0, key(0));
        assert!(counts.iter().all(|&c| (4040..4070).contains(&c)));
        let counts = sensor.expose(&bright, 0.1, 2.0, key(0));
        assert!(counts.iter().all(|&c| c == 4095));
        // Neither a negative radiance nor one that is not a number lights a pixel.
        for odd in [-5.0, f32::NAN] {
            let counts = sensor.expose(&vec![odd; 160 * 120], 0.1, 1.0, key(0));
            assert!(counts.iter().all(|&c| c < 90));
        }
    }

    #[test]
    fn equal_keys_give_equal_frames_and_each_part_of_the_key_matters() {
        let sensor = SensorModel::new(uniform_sensor());
        let radiance = vec![0.01_f32; 160 * 120];
        let frame = |key| sensor.expose(&radiance, 0.02, 1.0, key);
        let base = key(0);
        let first = frame(base);
        assert_eq!(first, frame(base));
        let with = |change: fn(&mut NoiseKey)| {
            let mut key = base;
            change(&mut key);
            frame(key)
        };
        for other in [
            with(|k| k.seed += 1),
            with(|k| k.frame.light += 1),
            with(|k| k.frame.exposure += 1),
            with(|k| k.frame.repeat += 1),
            with(|k| k.frame.kind += 1),
        ] {
            let equal = other.iter().zip(&first).filter(|(a, b)| a == b).count();
            // With σ ≈ 5.5 DN two independent counts agree in about 5% of pixels.
            assert!(equal < 160 * 120 / 10, "{equal} pixels agree");
        }
    }
}
