//! Axes: ranges, round ticks and their labels.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

use super::canvas::text_width;

/// One axis: its range, and the positions and labels of its ticks.
#[derive(Clone, Debug)]
pub struct Axis {
    pub(super) range: Range<f64>,
    ticks: Vec<(f64, String)>,
    pub(super) label: String,
}

impl Axis {
    /// Linear, with about five round ticks.
    pub fn linear(range: Range<f64>, label: &str) -> Self {
        let span = (range.end - range.start).max(f64::MIN_POSITIVE);
        let power = 10f64.powf((span / 5.0).log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0]
            .map(|factor| factor * power)
            .into_iter()
            .find(|step| span / step <= 6.0)
            .unwrap_or(span);
        Self::with_step(range, step, label)
    }

    /// Linear, with a tick at every multiple of `step`.
    pub fn with_step(range: Range<f64>, step: f64, label: &str) -> Self {
        let number = |value: f64| {
            let digits = (2.0 - step.log10()).clamp(0.0, 12.0) as i32;
            let scale = 10f64.powi(digits);
            format!("{}", (value * scale).round() / scale).replace('-', "−")
        };
        let ticks = multiples(&range, step).map(|value| (value, number(value)));
        Self::with_ticks(range.clone(), ticks.collect(), label)
    }

    /// Logarithmic: the range is in powers of ten, and so is what is plotted.
    pub fn decades(range: Range<f64>, label: &str) -> Self {
        let step = ((range.end - range.start) / 6.0).ceil().max(1.0);
        let whole = multiples(&range, step);
        let mut ticks: Vec<_> = whole
            .map(|value| (value, power_of_ten(value.round() as i32)))
            .collect();
        if ticks.len() < 3 {
            // Less than two decades: 1, 2 and 5 of each, as plain numbers.
            let exponents = range.start.floor() as i32..=range.end.ceil() as i32;
            let fine = exponents.flat_map(|n| [1.0, 2.0, 5.0].map(|digit| (digit, n)));
            ticks = fine
                .map(|(digit, n)| (f64::log10(digit) + f64::from(n), plain(digit, n)))
                .filter(|(position, _)| range.contains(position) || *position == range.end)
                .collect();
        }
        Self::with_ticks(range, ticks, label)
    }

    /// Half angles on the square-root scale of the MERL tables, which shows a
    /// narrow highlight; positions are [`Self::half_angle`].
    pub fn half_angles(label: &str) -> Self {
        let ticks = [0.0, 2.0, 10.0, 25.0, 45.0, 90.0];
        let ticks = ticks.map(|deg| (Self::half_angle(deg), format!("{deg}°")));
        Self::with_ticks(0.0..1.0, ticks.into(), label)
    }

    /// The position 0..=1 of a half angle in degrees on [`Self::half_angles`].
    pub fn half_angle(theta_h_deg: f64) -> f64 {
        (theta_h_deg.max(0.0) / 90.0).sqrt()
    }

    /// With given ticks: positions and their labels.
    pub fn with_ticks(range: Range<f64>, ticks: Vec<(f64, String)>, label: &str) -> Self {
        Self {
            range,
            ticks,
            label: label.to_owned(),
        }
    }

    /// The same axis the other way round: its start at the right or the top.
    #[must_use]
    pub fn reversed(mut self) -> Self {
        std::mem::swap(&mut self.range.start, &mut self.range.end);
        self
    }

    /// No ticks, no label.
    pub(super) fn bare(range: Range<f64>) -> Self {
        Self::with_ticks(range, Vec::new(), "")
    }

    /// Whether it has neither ticks nor a label.
    pub(super) fn is_bare(&self) -> bool {
        self.ticks.is_empty() && self.label.is_empty()
    }

    /// About how wide its longest tick label is, CSS pixels.
    pub(super) fn tick_width(&self) -> f64 {
        let widths = self.ticks.iter().map(|(_, text)| text_width(text));
        widths.fold(0.0, f64::max)
    }

    /// A value, or the end of the axis that is nearest to it.
    pub(super) fn inside(&self, value: f64) -> f64 {
        let Range { start, end } = self.range;
        value.clamp(start.min(end), start.max(end))
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let part = (value - self.range.start) / (self.range.end - self.range.start);
        limit.0 + (part * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.iter().map(|(position, _)| *position).collect()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, position: &f64) -> String {
        let tick = self.ticks.iter().find(|(at, _)| at == position);
        tick.map_or_else(String::new, |(_, text)| text.clone())
    }
}

/// The multiples of `step` in `range`, at most a hundred.
fn multiples(range: &Range<f64>, step: f64) -> impl Iterator<Item = f64> + use<> {
    let first = (range.start / step - 1e-9).ceil() as i64;
    let last = (range.end / step + 1e-9).floor() as i64;
    (first..=last.min(first.saturating_add(100))).map(move |n| n as f64 * step)
}

/// digit · 10ⁿ as a number where that is short.
fn plain(digit: f64, exponent: i32) -> String {
    if (-4..5).contains(&exponent) {
        let digits = (-exponent).max(0) as usize;
        format!("{:.digits$}", digit * 10f64.powi(exponent))
    } else {
        format!("{digit}·{}", power_of_ten(exponent))
    }
}

/// `10⁻³` and the like.
pub fn power_of_ten(exponent: i32) -> String {
    let digits = exponent.to_string();
    let raised = digits.chars().map(|c| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        digit => char::from_u32('⁰' as u32 + digit as u32 - '0' as u32).unwrap_or(digit),
    });
    std::iter::once("10".to_owned())
        .chain(raised.map(String::from))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let texts = |axis: &Axis| {
            axis.ticks
                .iter()
                .map(|(_, text)| text.clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(
            texts(&Axis::linear(0.0..0.87, "x")),
            ["0", "0.2", "0.4", "0.6", "0.8"]
        );
        assert_eq!(
            texts(&Axis::linear(-0.001..0.001, "x")),
            ["−0.001", "−0.0005", "0", "0.0005", "0.001"]
        );
        assert_eq!(
            texts(&Axis::decades(-1.5..0.0, "y")),
            ["0.05", "0.1", "0.2", "0.5", "1"]
        );
        assert_eq!(
            texts(&Axis::decades(-2.5..1.0, "y")),
            ["10⁻²", "10⁻¹", "10⁰", "10¹"]
        );
        assert_eq!(power_of_ten(-12), "10⁻¹²");
    }
}
