//! Shutter speeds: what a body lists, as gphoto2 prints it, and which one is chosen.

use crate::units::Seconds;

/// A time that was requested may be exceeded by so much, relatively: exposures are rounded
/// to the rig file's step before they come here.
const ROUNDING: f64 = 0.02;

/// A speed that the body offers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Speed {
    /// As the body lists it, and as it is set.
    pub(super) label: String,
    /// What the label means.
    pub(super) nominal: Seconds,
}

/// The time that a label means: `1/250`, `0.0040s`, `1.3`, `0"8` or `2"`. `None`: none, as
/// `bulb`, `auto` or `time`.
pub(super) fn parse(label: &str) -> Option<Seconds> {
    let text = label.trim().trim_end_matches(['s', 'S']).trim();
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let seconds = if let Some((above, below)) = text.split_once('/') {
        number(above)? / number(below)?
    } else if let Some((whole, tenths)) = text.split_once('"') {
        match tenths {
            "" => number(whole)?,
            tenths => number(&format!("{whole}.{tenths}"))?,
        }
    } else {
        number(text)?
    };
    (seconds.is_finite() && seconds > 0.0 && seconds < 3600.0).then_some(Seconds(seconds))
}

/// The speeds of a list, shortest first.
pub(super) fn of_list<'a>(labels: impl IntoIterator<Item = &'a str>) -> Vec<Speed> {
    let mut speeds: Vec<Speed> = labels
        .into_iter()
        .filter_map(|label| {
            Some(Speed {
                label: label.to_owned(),
                nominal: parse(label)?,
            })
        })
        .collect();
    speeds.sort_by(|a, b| a.nominal.0.total_cmp(&b.nominal.0));
    speeds
}

/// The longest speed that is not longer than requested, so that nothing saturates that was
/// not to; the shortest, where all are longer. `None`: there are none.
pub(super) fn choose(speeds: &[Speed], requested: Seconds) -> Option<&Speed> {
    let longest = requested.0 * (1.0 + ROUNDING);
    let fitting = speeds.iter().rfind(|speed| speed.nominal.0 <= longest);
    fitting.or(speeds.first())
}

/// The power of two, in thirds or halves of a stop, that a rounded label stands for: 1/64 s
/// for 1/60, 32 s for 30. The label 6 is of both series and read as thirds.
pub(super) fn whole_stops(nominal: Seconds) -> Seconds {
    let stops = nominal.0.log2();
    let nearest = |parts: f64| (stops * parts).round() / parts;
    let [thirds, halves] = [nearest(3.0), nearest(2.0)];
    // Halves only where the label fits them clearly better.
    let is_half = (halves - stops).abs() < 0.5 * (thirds - stops).abs();
    Seconds(if is_half { halves } else { thirds }.exp2())
}

/// Whether a file's exposure can be that of a speed: within a sixth of a stop, which is half
/// the step between speeds, or half a unit of the label's last digit.
pub(super) fn agrees(speed: &Speed, stated: Seconds) -> bool {
    let last_digit = match speed.label.split_once('.') {
        Some((_, digits)) => {
            let digits = digits.chars().take_while(char::is_ascii_digit).count();
            0.1_f64.powi(digits as i32)
        }
        None => 0.0,
    };
    let ratio = (stated.0 / speed.nominal.0).log2().abs();
    ratio < 1.0 / 6.0 || (stated.0 - speed.nominal.0).abs() <= 0.51 * last_digit
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn labels_of_all_makers_are_times() {
        for (label, seconds) in [
            ("1/250", 0.004),
            ("0.0040s", 0.004),
            ("10/4", 2.5),
            ("1.3", 1.3),
            ("30", 30.0),
            ("0\"8", 0.8),
            ("2\"", 2.0),
            (" 1/8000 ", 1.25e-4),
        ] {
            let parsed = parse(label).unwrap().0;
            assert!((parsed - seconds).abs() < 1e-12, "{label}: {parsed}");
        }
        for none in [
            "bulb", "Bulb", "auto", "time", "", "1/0", "-1", "0", "x 1/8", "1/", "nan",
        ] {
            assert_eq!(parse(none), None, "{none}");
        }
    }

    #[test]
    fn the_longest_speed_that_is_not_too_long_is_chosen() {
        let speeds = of_list(["bulb", "30", "1/60", "0.5", "1/50", "1/1000"]);
        assert_eq!(speeds.len(), 5);
        let chosen = |seconds| choose(&speeds, Seconds(seconds)).unwrap().label.as_str();
        assert_eq!(chosen(0.0001), "1/1000");
        assert_eq!(chosen(0.0199), "1/50", "rounded from 1/50");
        assert_eq!(chosen(0.0190), "1/60");
        assert_eq!(chosen(0.7), "0.5");
        assert_eq!(chosen(1000.0), "30");
        assert_eq!(choose(&[], Seconds(1.0)), None);
    }

    #[test]
    fn rounded_labels_stand_for_powers_of_two() {
        for (nominal, exact) in [
            (1.0 / 60.0, 1.0 / 64.0),
            (1.0 / 250.0, 1.0 / 256.0),
            (30.0, 32.0),
            (1.0 / 3.0, 2_f64.powf(-5.0 / 3.0)),
            (1.0 / 45.0, 2_f64.powf(-5.5)),
            (0.7, 2_f64.powf(-0.5)),
            (0.8, 2_f64.powf(-1.0 / 3.0)),
        ] {
            let is = whole_stops(Seconds(nominal)).0;
            assert!((is / exact - 1.0).abs() < 1e-9, "{nominal}: {is}, {exact}");
        }
    }

    proptest! {
        #[test]
        fn a_choice_is_never_longer_than_requested_unless_all_are(requested in 1e-5..100.0_f64) {
            let speeds = of_list(["1/8000", "1/500", "1/60", "0.3", "2", "30"]);
            let chosen = choose(&speeds, Seconds(requested)).unwrap();
            prop_assert!(chosen.nominal.0 <= requested * 1.02 || chosen == &speeds[0]);
        }

        #[test]
        fn any_text_is_a_time_or_none(text in "\\PC{0,12}") {
            if let Some(time) = parse(&text) {
                prop_assert!(time.0 > 0.0 && time.0 < 3600.0);
            }
        }
    }

    #[test]
    fn a_neighbouring_speed_does_not_agree() {
        let speed = |label: &str| of_list([label]).remove(0);
        let agree = |label: &str, stated| agrees(&speed(label), Seconds(stated));
        assert!(agree("1/60", 1.0 / 64.0) && agree("1/60", 1.0 / 60.0));
        assert!(!agree("1/60", 1.0 / 50.0) && !agree("1/60", 1.0 / 80.0));
        assert!(agree("0.0001s", 1.0 / 8000.0), "rounded by the protocol");
        assert!(!agree("0.0001s", 1.0 / 4000.0));
    }
}
