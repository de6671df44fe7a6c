//! Exposures as people and programs write them: in the fields of a table and in the names of
//! frames. What can be read in two ways is never guessed.

use unicode_normalization::UnicodeNormalization;

use crate::outside_table;

/// Units by their spellings, in seconds. NFKC makes the micro sign the Greek letter.
const UNITS: [(&[&str], f64); 3] = [
    (&["us", "\u{3bc}s", "usec", "\u{3bc}sec"], 1e-6),
    (&["ms", "msec", "msecs", "millisec"], 1e-3),
    (&["s", "sec", "secs", "second", "seconds"], 1.0),
];

/// Endings of frames that are not part of the name.
const ENDINGS: [&str; 5] = ["png", "tif", "tiff", "jpg", "jpeg"];

/// A name that may state more than one exposure.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("its name may mean an exposure of {}", listed(readings_s))]
pub struct Ambiguous {
    /// The exposures that it may mean, seconds, ascending.
    pub readings_s: Vec<f64>,
}

fn listed(readings_s: &[f64]) -> String {
    let words: Vec<String> = readings_s.iter().map(|s| format!("{s} s")).collect();
    words.join(" or ")
}

/// The exposure in a field of a table: a number, a fraction of two, or either with its unit;
/// `unit_s` is the unit where it has none. Seconds, finite and > 0.
///
/// # Errors
/// For messages, after the field: it is no such thing, or could be either of two.
pub fn seconds(text: &str, unit_s: f64) -> Result<f64, String> {
    let text: String = text.nfkc().collect();
    let letters = text.trim_end_matches(|c: char| c.is_alphabetic()).len();
    let (value, word) = text.split_at(letters);
    let unit_s = match word {
        "" => Some(unit_s),
        word => unit(word),
    };
    let values = match value.split_once(['/', '\u{2044}']) {
        None => outside_table::readings(value),
        Some((above, below)) => {
            let [above, below] = [above, below].map(outside_table::number);
            above
                .ok()
                .zip(below.ok())
                .map(|(a, b)| a / b)
                .into_iter()
                .collect()
        }
    };
    let values: Vec<f64> = values
        .iter()
        .map(|v| round(v * unit_s.unwrap_or(f64::NAN)))
        .collect();
    match values[..] {
        [one] if one.is_finite() && one > 0.0 => Ok(one),
        [_, _] if unit_s.is_some() => Err(format!("and may be {}", listed(&values))),
        _ => Err("and must be a number of seconds above 0".into()),
    }
}

fn unit(word: &str) -> Option<f64> {
    let word = word.to_lowercase();
    let known = UNITS
        .iter()
        .find(|(names, _)| names.contains(&word.as_str()));
    known.map(|(_, unit_s)| *unit_s)
}

/// Without the last bits of a product with a power of ten.
fn round(value: f64) -> f64 {
    format!("{value:.14e}").parse().unwrap_or(value)
}

/// The exposure that a file's name states by a number with its unit: `scene_0.25s.png`,
/// `t20ms_02.tif`, `probe_0,02s.png` or, as a fraction, `scene_1-250s.jpg`. Seconds, > 0.
///
/// # Errors
/// The name may be read in more than one way.
pub fn from_name(name: &str) -> Result<Option<f64>, Ambiguous> {
    let stem = match name.rsplit_once('.') {
        Some((stem, ending)) if ENDINGS.contains(&ending.to_lowercase().as_str()) => stem,
        _ => name,
    };
    let text: Vec<char> = stem.nfkc().collect();
    let mut readings_s: Vec<f64> = Vec::new();
    let mut at = 0;
    while at < text.len() {
        let end = number_end(&text, at);
        if end > at {
            readings_s.extend(statement(&text, at, end));
        }
        at = end.max(at + 1);
    }
    readings_s.retain(|s| s.is_finite() && *s > 0.0);
    readings_s.sort_by(f64::total_cmp);
    readings_s.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * b.abs());
    match readings_s[..] {
        [] => Ok(None),
        [one] => Ok(Some(one)),
        _ => Err(Ambiguous { readings_s }),
    }
}

/// Where a number that begins at `start` ends: digits with points or commas between them, and
/// an exponent. `start` itself where none begins.
fn number_end(text: &[char], start: usize) -> usize {
    let digit = |at: usize| text.get(at).is_some_and(char::is_ascii_digit);
    let is = |at: usize, chars: &[char]| text.get(at).is_some_and(|c| chars.contains(c));
    let mut end = start;
    while digit(end) || end > start && is(end, &['.', ',']) && digit(end + 1) {
        end += 1;
    }
    if end > start && is(end, &['e', 'E']) {
        let sign = usize::from(is(end + 1, &['+', '-']));
        let mut exponent = end + 1 + sign;
        while digit(exponent) {
            exponent += 1;
        }
        // 1e3s is a number, 12e5x a name.
        let has_unit = unit_after(text, exponent).is_some();
        if exponent > end + 1 + sign && has_unit {
            return exponent;
        }
    }
    end
}

/// The letters that begin at `at`.
fn word_after(text: &[char], at: usize) -> String {
    let rest = text.get(at..).unwrap_or_default();
    rest.iter().take_while(|c| c.is_alphabetic()).collect()
}

/// The letters that end before `at`.
fn word_before(text: &[char], at: usize) -> String {
    let letters = text[..at].iter().rev().take_while(|c| c.is_alphabetic());
    let reversed: Vec<&char> = letters.collect();
    reversed.into_iter().rev().collect()
}

/// The unit after a number that ends at `end`, in seconds, and where it ends itself. One blank
/// or dash may stand between them, but before a bare `s` only a blank.
fn unit_after(text: &[char], end: usize) -> Option<(f64, usize)> {
    let word = word_after(text, end);
    if !word.is_empty() {
        return Some((unit(&word)?, end + word.chars().count()));
    }
    let gap = text.get(end).filter(|c| [' ', '_', '-'].contains(c))?;
    let word = word_after(text, end + 1);
    let after = end + 1 + word.chars().count();
    let alone = !text.get(after).is_some_and(char::is_ascii_digit);
    let clear = *gap == ' ' || word.chars().count() > 1;
    (alone && clear).then_some((unit(&word)?, after))
}

/// What the number from `start` to `end` may mean as an exposure, seconds: nothing, one thing, or
/// several.
fn statement(text: &[char], start: usize, end: usize) -> Vec<f64> {
    let Some((unit_s, after)) = unit_after(text, end) else {
        return Vec::new();
    };
    let number: String = text[start..end].iter().collect();
    let before = |back: usize| start.checked_sub(back).and_then(|at| text.get(at)).copied();
    let label = word_before(text, start);
    let before_label = before(label.chars().count() + 1);

    // A minus sign; a name such as A7S.
    let is_sign = before(1) == Some('-') && before(2).is_none_or(|c| " _-".contains(c));
    let is_model = !label.is_empty()
        && text.get(end) == Some(&'S')
        && !["t", "exp", "exposure", "time"].contains(&label.to_lowercase().as_str());
    if is_sign || is_model {
        return Vec::new();
    }

    // The number itself, and its last part where points or commas may separate.
    let mut values = outside_table::readings(&number);
    let parts: Vec<&str> = number.split(['.', ',']).collect();
    let separates = before(1).is_some_and(|c| ".,".contains(c))
        || parts[0].len() > 1 && parts[0].starts_with('0')
        || parts.len() > 2;
    let certain = parts.len() == 2 && parts[0] == "0" && parts[1].starts_with('0');
    if parts.len() > 1 && separates && !certain {
        let last_two = number
            .rsplitn(3, ['.', ','])
            .take(2)
            .map(str::len)
            .sum::<usize>()
            + 1;
        let tails = [&number[number.len() - last_two..], parts[parts.len() - 1]];
        values.extend(tails.into_iter().flat_map(outside_table::readings));
    }
    if parts.len() == 1 && !number.contains(['e', 'E']) {
        values = with_number_before(text, start, &number, unit_s);
    }

    // 1m30s, 0p5s, 2x20ms; 2s5.
    let joint = label.to_lowercase();
    if before_label.is_some_and(|c| c.is_ascii_digit())
        && let Some(value) = values.first().copied()
        && let whole = number_before(text, start - label.chars().count())
        && let Ok(first) = whole.parse::<f64>()
    {
        values.extend(match joint.as_str() {
            "h" => Some(first * 3600.0 + value),
            "m" | "min" => Some(first * 60.0 + value),
            "x" | "\u{d7}" => Some(first * value),
            "p" | "d" => format!("{whole}.{number}").parse().ok(),
            _ => None,
        });
    }
    let tail: String = text[after..]
        .iter()
        .take_while(|c| c.is_ascii_digit())
        .collect();
    if !tail.is_empty() {
        values.extend(outside_table::readings(&format!("{number}.{tail}")));
    }
    values.iter().map(|value| round(value * unit_s)).collect()
}

/// The number that ends before `at`, empty where none does.
fn number_before(text: &[char], at: usize) -> String {
    let digits = text[..at].iter().rev().take_while(|c| c.is_ascii_digit());
    let reversed: Vec<&char> = digits.collect();
    reversed.into_iter().rev().collect()
}

/// A whole number of a unit, and what it may mean with the number before it: `1-250s` is a
/// fraction, `1_250s` may be one, and `0_5s` may be 0.5 s.
fn with_number_before(text: &[char], start: usize, number: &str, unit_s: f64) -> Vec<f64> {
    let values = outside_table::readings(number);
    let Some(mark) = start.checked_sub(1).and_then(|at| text.get(at)) else {
        return values;
    };
    let other = number_before(text, start - 1);
    let value = values.first().copied().unwrap_or(0.0);
    let Ok(whole) = other.parse::<f64>() else {
        return values;
    };
    let is_index = other.len() > 3 || other.len() > 1 && other.starts_with('0');
    let fraction = whole / value;
    let point = format!("{other}.{number}").parse().unwrap_or(value);
    match mark {
        '\u{2044}' | '\u{2215}' | '/' => vec![fraction],
        '-' | ':' | '_' if other == "0" => vec![value, point],
        '-' | ':' if unit_s < 1.0 || is_index => values,
        '-' | ':' if whole == 1.0 => vec![fraction],
        '-' | ':' => vec![value, fraction],
        '_' if unit_s == 1.0 && other == "1" && value > 1.0 => vec![value, fraction],
        _ => values,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{prop_assert, proptest};

    #[test]
    fn names_state_the_exposure() {
        for (name, s) in [
            ("scene_0.25s.png", 0.25),
            ("scene_0.25s", 0.25),
            ("t20ms_02.tif", 0.02),
            ("scene_1-250s.jpg", 0.004),
            ("scene_1\u{2215}250s.jpg", 0.004),
            ("1:250s.jpg", 0.004),
            ("exp2s.png", 2.0),
            ("probe_0,02s.png", 0.02),
            ("probe_0,125s.TIF", 0.125),
            ("probe_2,5s.png", 2.5),
            ("probe.0.02s.png", 0.02),
            ("probe_0.02s.raw.tif", 0.02),
            ("2024-05-12_14-03-22_20ms.png", 0.02),
            ("DSC_2041-4s.png", 4.0),
            ("frame_0012_500\u{b5}s.png", 5e-4),
            ("frame_0012_500\u{3bc}s.png", 5e-4),
            ("scene 20 ms.png", 0.02),
            ("scene_20_ms.png", 0.02),
            ("scene_20MS.PNG", 0.02),
            ("scene_2sec.png", 2.0),
            ("scene_3-20ms.png", 0.02),
            ("scene_2e-05s.png", 2e-5),
            ("scene_20ms_0.02s.png", 0.02),
            ("scene_12_5s.png", 5.0),
            ("a,3s.png", 3.0),
            ("A7S_0001_4ms.png", 4e-3),
            ("iso100_f8_20ms.png", 0.02),
            ("img_1_20ms.png", 0.02),
        ] {
            assert_eq!(from_name(name), Ok(Some(s)), "{name}");
        }
        for name in [
            "bracket.png",
            "img_0001.jpg",
            "s.png",
            "_0s.png",
            "-3s.png",
            "A7S_0001.png",
            "frame_20_s1.png",
            "12shots.png",
        ] {
            assert_eq!(from_name(name), Ok(None), "{name}");
        }
    }

    #[test]
    fn names_that_may_mean_several_exposures_are_refused_with_them() {
        for (name, readings_s) in [
            ("a_3s_500us.png", &[5e-4, 3.0][..]),
            ("probe_1,250ms.png", &[1.25e-3, 1.25]),
            ("img.1.20ms.png", &[1.2e-3, 0.02]),
            ("img_05.20ms.png", &[5.2e-3, 0.02]),
            ("img_1_250s.png", &[0.004, 250.0]),
            ("img_2-4s.png", &[0.5, 4.0]),
            ("img_0_5s.png", &[0.5, 5.0]),
            ("img_0p5s.png", &[0.5, 5.0]),
            ("img_2s5.png", &[2.0, 2.5]),
            ("img_1m30s.png", &[30.0, 90.0]),
            ("img_2x20ms.png", &[0.02, 0.04]),
        ] {
            let error = from_name(name).unwrap_err();
            assert_eq!(error.readings_s, readings_s, "{name}");
        }
        let text = from_name("img_2s5.png").unwrap_err().to_string();
        assert_eq!(text, "its name may mean an exposure of 2 s or 2.5 s");
    }

    #[test]
    fn fields_are_numbers_fractions_and_times() {
        for (text, unit_s, s) in [
            ("0.02", 1.0, 0.02),
            ("0,02", 1.0, 0.02),
            ("20", 1e-3, 0.02),
            ("20 ms", 1.0, 0.02),
            ("1/250", 1.0, 0.004),
            ("1/250 s", 1e-3, 0.004),
            ("2e-3", 1.0, 0.002),
        ] {
            assert_eq!(seconds(text, unit_s), Ok(s), "{text}");
        }
        for text in ["", "0", "-1", "1/0", "inf", "2 m", "1/2/3", "20 mm"] {
            assert!(seconds(text, 1.0).is_err(), "{text}");
        }
        assert!(
            seconds("1,250", 1.0)
                .unwrap_err()
                .contains("1.25 s or 1250 s")
        );
    }

    proptest! {
        #[test]
        fn any_name_is_an_exposure_none_or_several(name in "[ a-z0-9._,é-]{0,20}") {
            match from_name(&name) {
                Ok(found) => prop_assert!(found.is_none_or(|s| s > 0.0)),
                Err(error) => prop_assert!(error.readings_s.len() > 1),
            }
            let _ = seconds(&name, 1.0);
        }
    }
}
