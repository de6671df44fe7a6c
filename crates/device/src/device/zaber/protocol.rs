//! The Zaber ASCII protocol, line by line. Pure functions: any bytes in, a
//! message out.

/// Longest line that is worth parsing, bytes; the protocol's default is 80.
pub const LONGEST_LINE: usize = 256;

/// A line from a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// The answer to a command.
    Reply(Reply),
    /// Said by itself: a motion has ended, a limit was hit.
    Alert(Alert),
    /// Additional text, which this program never requests.
    Info,
    /// Nothing that the protocol knows, or a wrong checksum.
    Unknown(String),
}

/// The answer to a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// Which device answers.
    pub device: u8,
    /// Which axis the command was for; 0 is all.
    pub axis: u8,
    /// The command's message id.
    pub id: Option<u8>,
    /// Accepted, or rejected for the reason in `data`.
    pub accepted: bool,
    /// An axis that the command was for moves.
    pub busy: bool,
    /// The most important warning flag, two letters.
    pub flag: Option<String>,
    /// What was requested.
    pub data: String,
}

/// Something that a device says by itself.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Alert {
    pub device: u8,
    pub axis: u8,
    /// It moves.
    pub busy: bool,
    /// The most important warning flag, two letters.
    pub flag: Option<String>,
}

/// A command with its checksum and line end.
pub fn command(device: u8, axis: u8, id: u8, words: &str) -> String {
    let space = if words.is_empty() { "" } else { " " };
    let body = format!("{device} {axis} {id}{space}{words}");
    format!("/{body}:{:02X}\n", checksum(body.as_bytes()))
}

/// What makes the sum of all bytes 0 (mod 256).
fn checksum(body: &[u8]) -> u8 {
    let sum = body.iter().fold(0_u8, |sum, &byte| sum.wrapping_add(byte));
    sum.wrapping_neg()
}

/// Reads a line, with or without its end.
pub fn parse(line: &[u8]) -> Message {
    let mut line = line.trim_ascii_start();
    // A space at the end may be a damaged digit of the checksum, and belongs to the line.
    while let [rest @ .., b'\r' | b'\n'] = line {
        line = rest;
    }
    understood(line).unwrap_or_else(|| {
        let text = String::from_utf8_lossy(line);
        Message::Unknown(text.chars().take(LONGEST_LINE).collect())
    })
}

fn understood(line: &[u8]) -> Option<Message> {
    let (&kind, body) = line.split_first()?;
    // Only the last field of a line can be a checksum: two digits after a colon.
    let body = match body {
        [body @ .., b':', high, low] => {
            let digits = [*high, *low];
            if !digits.iter().all(u8::is_ascii_hexdigit) {
                return None;
            }
            let given = u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?;
            (given == checksum(body)).then_some(body)?
        }
        body => body,
    };
    let text = std::str::from_utf8(body).ok()?;
    if !text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return None;
    }
    let mut words = text.split(' ');
    let device = number(words.next()?)?;
    let axis = number(words.next()?)?;
    match kind {
        b'@' => {
            let mut word = words.next()?;
            let id = number(word);
            if id.is_some() {
                word = words.next()?;
            }
            let accepted = match word {
                "OK" => true,
                "RJ" => false,
                _ => return None,
            };
            let (busy, flag) = state(&mut words)?;
            let data: Vec<&str> = words.collect();
            if data.is_empty() {
                return None;
            }
            Some(Message::Reply(Reply {
                device,
                axis,
                id,
                accepted,
                busy,
                flag,
                data: data.join(" "),
            }))
        }
        b'!' => {
            let (busy, flag) = state(&mut words)?;
            Some(Message::Alert(Alert {
                device,
                axis,
                busy,
                flag,
            }))
        }
        b'#' => Some(Message::Info),
        _ => None,
    }
}

/// `IDLE` or `BUSY`, and the flag: two letters, or `--`.
fn state<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<(bool, Option<String>)> {
    let busy = match words.next()? {
        "BUSY" => true,
        "IDLE" => false,
        _ => return None,
    };
    let flag = match words.next()? {
        "--" => None,
        flag if flag.len() == 2 && flag.bytes().all(|b| b.is_ascii_alphanumeric()) => {
            Some(flag.to_owned())
        }
        _ => return None,
    };
    Some((busy, flag))
}

/// An address or id of one or two digits.
fn number(text: &str) -> Option<u8> {
    let digits = (1..=2).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_digit());
    digits.then(|| text.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reply(flag: Option<&str>, data: &str) -> Reply {
        Reply {
            device: 1,
            axis: 0,
            id: None,
            accepted: true,
            busy: false,
            flag: flag.map(str::to_owned),
            data: data.to_owned(),
        }
    }

    /// Lines as the protocol manual shows them.
    #[test]
    fn lines_as_devices_send_them() {
        let cases = [
            ("@01 0 OK IDLE -- 0", Message::Reply(reply(None, "0"))),
            (
                "@01 0 OK IDLE WR 0:3E",
                Message::Reply(reply(Some("WR"), "0")),
            ),
            (
                "@01 2 33 RJ BUSY NI BADDATA",
                Message::Reply(Reply {
                    axis: 2,
                    id: Some(33),
                    accepted: false,
                    busy: true,
                    ..reply(Some("NI"), "BADDATA")
                }),
            ),
            (
                "@01 0 07 OK IDLE WR 02 WR FS",
                Message::Reply(Reply {
                    id: Some(7),
                    ..reply(Some("WR"), "02 WR FS")
                }),
            ),
            (
                "!02 1 IDLE FS",
                Message::Alert(Alert {
                    device: 2,
                    axis: 1,
                    busy: false,
                    flag: Some("FS".to_owned()),
                }),
            ),
            ("#01 0 Visit www.zaber.com", Message::Info),
        ];
        for (line, message) in cases {
            assert_eq!(parse(line.as_bytes()), message, "{line}");
            assert_eq!(parse(format!("{line}\r\n").as_bytes()), message, "{line}");
        }
    }

    #[test]
    fn damaged_lines_are_unknown_rather_than_half_read() {
        for line in [
            "",
            "@",
            "01 0 OK IDLE -- 0",
            "@01 0 OK IDLE WR 0:3F",
            "@01 0 OK IDLE WR 1:3E",
            "@01 0 OK IDLE --",
            "@01 0 OK IDLE",
            "@01 0 OX IDLE -- 0",
            "@01 0 OK HOME -- 0",
            "@01 0 OK IDLE W 0",
            "@1000 0 OK IDLE -- 0",
            "@01 0 123 OK IDLE -- 0",
            "@01 -1 OK IDLE -- 0",
            "!01 1 IDLE",
            "@01 0 OK IDLE -- \u{7f}",
            "@01 0 OK IDLE WR 0:3 ",
        ] {
            assert!(
                matches!(parse(line.as_bytes()), Message::Unknown(_)),
                "{line:?}"
            );
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed_without_panic(line in proptest::collection::vec(any::<u8>(), 0..300)) {
            parse(&line);
        }

        /// One changed character of a line with a checksum is always noticed.
        #[test]
        fn a_changed_byte_is_noticed(
            data in "[ -9;-~]{1,30}",
            place in 0..30usize,
            byte in b' '..=b'~',
        ) {
            let body = format!("01 1 15 OK IDLE -- {data}");
            let line = format!("@{body}:{:02X}", checksum(body.as_bytes()));
            let mut damaged = line.clone().into_bytes();
            let place = place % damaged.len();
            prop_assume!(!damaged[place].eq_ignore_ascii_case(&byte));
            damaged[place] = byte;
            let expected_damage = parse(&damaged) != parse(line.as_bytes());
            let noticed = matches!(parse(&damaged), Message::Unknown(_))
                // Without its colon a line claims no checksum, and its data say so.
                || (place + 3 == damaged.len())
                // Another kind of line is no reply.
                || place == 0;
            prop_assert!(!expected_damage || noticed, "{}", String::from_utf8_lossy(&damaged));
        }

        #[test]
        fn commands_sum_to_zero(device in 0..100u8, axis in 0..10u8, id in 0..100u8, words in "[ -9;-~]{0,40}") {
            let line = command(device, axis, id, &words);
            let (body, given) = line[1..].trim_end_matches('\n').rsplit_once(':').unwrap();
            let sum: u32 = body.bytes().map(u32::from).sum();
            let given = u32::from_str_radix(given, 16).unwrap();
            prop_assert_eq!((sum + given) % 256, 0);
        }
    }
}
