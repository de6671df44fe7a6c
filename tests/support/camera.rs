//! What the tests of several camera drivers share.

#![allow(clippy::print_stdout, reason = "figures, next to the tests' names")]
// Each test file uses a part of it.
#![allow(dead_code)]

use rig::radiance_image::RadianceImage;

/// The faults in the table of a section of docs/faults.md.
pub fn documented_faults(section: &str) -> impl Iterator<Item = &'static str> {
    let text = include_str!("../../docs/faults.md");
    let heading = format!("\n## {section}\n");
    let (_, section) = text.split_once(&heading).unwrap();
    let section = section.split("\n## ").next().unwrap();
    section
        .lines()
        .filter_map(|line| line.strip_prefix("| ")?.split(" | ").next())
        .filter(|&name| name != "fault")
}

/// Images of the same scene that differ by noise alone: of the pixels' differences over their
/// standard deviations the mean square is 1 within what 2 × 64 × 64 pixels and the lamp's own
/// differences from visit to visit allow, and the ratio of their sums is 1 within 0.5%.
pub fn assert_same_within_noise(through: &[RadianceImage], memory: &[RadianceImage]) {
    assert_eq!((through.len(), memory.len()), (2, 2));
    for (light, (a, b)) in through.iter().zip(memory).enumerate() {
        let (mut squares, mut sums, mut values) = (0.0, [0.0; 2], 0.0);
        for pixel in 0..a.mean.len() {
            if !a.valid[pixel] || !b.valid[pixel] {
                continue;
            }
            for colour in 0..3 {
                let [x, y] = [a, b].map(|image| f64::from(image.mean[pixel][colour]));
                let variances = [a, b].map(|image| f64::from(image.variance[pixel][colour]));
                squares += (x - y).powi(2) / (variances[0] + variances[1]);
                sums[0] += x;
                sums[1] += y;
                values += 1.0;
            }
        }
        let (chi, ratio) = (squares / values, sums[0] / sums[1]);
        println!("light {light}: mean square {chi:.3} over {values}, ratio {ratio:.5}");
        assert!(values > 0.9 * 3.0 * 64.0 * 64.0);
        assert!((ratio - 1.0).abs() < 0.005, "light {light}: {ratio}");
        assert!((0.8..1.3).contains(&chi), "light {light}: {chi}");
    }
}
