//! The dome line protocol, line by line. Pure functions: any bytes in, an
//! answer out.

use super::Lit;

/// Longest line that is worth parsing, bytes.
pub const LONGEST_LINE: usize = 128;

/// A line from a dome.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// The answer to the request with this number.
    Answer {
        /// 1 to 999.
        number: u16,
        /// The words after `ok`, or the reason after `error`.
        outcome: Result<String, String>,
    },
    /// The dome has restarted, with all lights off.
    Restarted,
    /// Nothing that the protocol knows, or a wrong checksum.
    Unknown(String),
}

/// What a dome reports of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Info {
    /// Number of lights.
    pub lights: usize,
    /// Colour channels of a light.
    pub channels: u8,
    /// Silence of the host, in seconds, after which it turns its lights off; 0: never.
    pub watchdog_s: f64,
    /// Version.
    pub firmware: String,
}

/// What a dome reports of its lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// All off.
    Off,
    /// One driven.
    Driven {
        /// Which.
        lit: Lit,
        /// Whether current flows.
        shines: bool,
    },
}

/// A request with its number, checksum and line end.
pub fn request(number: u16, words: &str) -> String {
    let body = format!("{number} {words}");
    format!("{body}*{:02X}\n", checksum(body.as_bytes()))
}

/// All bytes, exclusive-or.
fn checksum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum ^ byte)
}

/// Reads a line, with or without its end.
pub fn parse(line: &[u8]) -> Line {
    let line = line.trim_ascii();
    understood(line).unwrap_or_else(|| {
        let text = String::from_utf8_lossy(line);
        Line::Unknown(text.chars().take(LONGEST_LINE).collect())
    })
}

fn understood(line: &[u8]) -> Option<Line> {
    let [body @ .., b'*', high, low] = line else {
        return None;
    };
    let digits = [*high, *low];
    if !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    let given = u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?;
    let body = (given == checksum(body)).then_some(body)?;
    let text = std::str::from_utf8(body).ok()?;
    if !text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return None;
    }
    let (number, rest) = text.split_once(' ')?;
    let number: u16 = number.parse().ok().filter(|&number| number <= 999)?;
    let (word, data) = rest.split_once(' ').unwrap_or((rest, ""));
    match (number, word) {
        (0, "restarted") => Some(Line::Restarted),
        (0, _) => None,
        (_, "ok") => Some(Line::Answer {
            number,
            outcome: Ok(data.to_owned()),
        }),
        (_, "error") => Some(Line::Answer {
            number,
            outcome: Err(data.to_owned()),
        }),
        _ => None,
    }
}

/// The data of `info`: `lights=45 channels=3 watchdog=2.5 firmware=1.0`.
pub fn info(data: &str) -> Option<Info> {
    let value = |key: &str| {
        let mut words = data.split(' ');
        words.find_map(|word| word.strip_prefix(key)?.strip_prefix('='))
    };
    Some(Info {
        lights: value("lights")?.parse().ok()?,
        channels: value("channels")?.parse().ok()?,
        watchdog_s: value("watchdog")?
            .parse()
            .ok()
            .filter(|seconds| (0.0..=3600.0).contains(seconds))?,
        firmware: value("firmware")?.to_owned(),
    })
}

/// The data of `state`: `off`, or `light 7 1 255 shines` (light, channel, level;
/// `dark` where no current flows).
pub fn state(data: &str) -> Option<State> {
    let words: Vec<&str> = data.split(' ').collect();
    match words[..] {
        ["off"] => Some(State::Off),
        ["light", light, channel, level, current] => Some(State::Driven {
            lit: Lit {
                light: light.parse().ok()?,
                channel: channel.parse().ok()?,
                level: level.parse().ok()?,
            },
            shines: match current {
                "shines" => true,
                "dark" => false,
                _ => return None,
            },
        }),
        _ => None,
    }
}

/// The data of `temperature`: `41.5`, degrees Celsius of the lights' driver or heat sink.
pub fn temperature_c(data: &str) -> Option<f64> {
    let value: f64 = data.parse().ok()?;
    (-100.0..=500.0).contains(&value).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn with_checksum(body: &str) -> String {
        format!("{body}*{:02X}\r\n", checksum(body.as_bytes()))
    }

    #[test]
    fn lines_of_the_description() {
        // By hand: the exclusive-or of the bytes of "7 ok off" is 0x5c.
        assert_eq!(request(7, "ok off"), "7 ok off*5C\n");
        let answer = |outcome: Result<&str, &str>| Line::Answer {
            number: 7,
            outcome: outcome.map(str::to_owned).map_err(str::to_owned),
        };
        for (body, line) in [
            ("7 ok off", answer(Ok("off"))),
            ("7 ok", answer(Ok(""))),
            ("7 error no such light", answer(Err("no such light"))),
            ("0 restarted", Line::Restarted),
        ] {
            assert_eq!(parse(with_checksum(body).as_bytes()), line, "{body}");
        }
        for body in ["7 okay", "x ok", "1000 ok", "-1 ok", "7", "0 ok", ""] {
            let line = parse(with_checksum(body).as_bytes());
            assert!(matches!(line, Line::Unknown(_)), "{body}");
        }
        assert!(matches!(parse(b"7 ok off*5D"), Line::Unknown(_)));
        assert!(matches!(parse(b"7 ok off"), Line::Unknown(_)));
        assert_eq!(
            info("lights=45 channels=3 watchdog=2.5 firmware=1.0"),
            Some(Info {
                lights: 45,
                channels: 3,
                watchdog_s: 2.5,
                firmware: "1.0".to_owned(),
            })
        );
        assert_eq!(info("lights=45 channels=3 watchdog=nan firmware=1"), None);
        assert_eq!(state("off"), Some(State::Off));
        let lit = Lit {
            light: 7,
            channel: 1,
            level: 255,
        };
        let driven = |shines| Some(State::Driven { lit, shines });
        assert_eq!(state("light 7 1 255 shines"), driven(true));
        assert_eq!(state("light 7 1 255 dark"), driven(false));
        assert_eq!(state("light 7 1 256 dark"), None);
        assert_eq!(temperature_c("41.5"), Some(41.5));
        assert_eq!(temperature_c("-3"), Some(-3.0));
        for bad in ["", "warm", "nan", "inf", "41.5 C", "1e9"] {
            assert_eq!(temperature_c(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed_without_panic(line in proptest::collection::vec(any::<u8>(), 0..200)) {
            parse(&line);
            let text = String::from_utf8_lossy(&line);
            info(&text);
            state(&text);
            temperature_c(&text);
        }

        /// A line with one changed byte never counts as another line.
        #[test]
        fn a_changed_byte_is_noticed(
            number in 1..999u16,
            data in "[ -)+-~]{0,30}",
            place in 0..40usize,
            byte in any::<u8>(),
        ) {
            let line = with_checksum(&format!("{number} ok {data}"));
            let mut damaged = line.clone().into_bytes();
            let place = place % (damaged.len() - 2);
            prop_assume!(!damaged[place].eq_ignore_ascii_case(&byte));
            damaged[place] = byte;
            let damaged = parse(&damaged);
            prop_assert!(matches!(damaged, Line::Unknown(_)), "{damaged:?}");
        }
    }
}
