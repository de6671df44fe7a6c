//! Messages of the Zaber ASCII protocol, as a device reads and writes them.

/// A command as it came: `/[device [axis [id]]] words…[:checksum]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Command {
    /// 0: every device.
    pub device: u8,
    /// 0: the device itself, or all of its axes.
    pub axis: u8,
    /// To be repeated in the reply.
    pub id: Option<u8>,
    pub words: Vec<String>,
}

/// Reads a line without its end; `None` is what a device ignores: no command,
/// or one whose checksum is wrong.
pub(super) fn parse(line: &[u8]) -> Option<Command> {
    let body = line.strip_prefix(b"/")?;
    let body = match body.iter().position(|&byte| byte == b':') {
        None => body,
        Some(colon) => {
            let given = std::str::from_utf8(&body[colon + 1..]).ok()?.trim();
            let given = u8::from_str_radix(given, 16).ok()?;
            (given == checksum(&body[..colon])).then_some(&body[..colon])?
        }
    };
    let text = std::str::from_utf8(body).ok()?;
    let mut words: Vec<String> = text.split_ascii_whitespace().map(str::to_owned).collect();
    let mut numbers = [None; 3];
    for slot in &mut numbers {
        let number = words.first().and_then(|word| word.parse::<u8>().ok());
        let Some(number) = number.filter(|&number| number <= 99) else {
            break;
        };
        *slot = Some(number);
        words.remove(0);
    }
    Some(Command {
        device: numbers[0].unwrap_or(0),
        axis: numbers[1].unwrap_or(0),
        id: numbers[2],
        words,
    })
}

/// Two's complement of the sum of all bytes.
pub(super) fn checksum(body: &[u8]) -> u8 {
    body.iter()
        .fold(0_u8, |sum, &byte| sum.wrapping_add(byte))
        .wrapping_neg()
}

/// A line to the host: `kind` is `@` (reply), `#` (info) or `!` (alert).
pub(super) fn line(kind: char, body: &str, with_checksum: bool) -> Vec<u8> {
    let mut line = format!("{kind}{body}");
    if with_checksum {
        line += &format!(":{:02X}", checksum(body.as_bytes()));
    }
    line += "\r\n";
    line.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_optional_and_wrong_checksums_ignored() {
        let words = |words: &[&str]| words.iter().map(|&w| w.to_owned()).collect::<Vec<_>>();
        let command = parse(b"/01 2 33 move abs 1000").unwrap();
        assert_eq!((command.device, command.axis, command.id), (1, 2, Some(33)));
        assert_eq!(command.words, words(&["move", "abs", "1000"]));
        let command = parse(b"/").unwrap();
        assert_eq!((command.device, command.axis, command.id), (0, 0, None));
        assert!(command.words.is_empty());
        let command = parse(b"/1 home").unwrap();
        assert_eq!((command.device, command.axis), (1, 0));
        // The sum of the bytes of "1 1 home" is 0x24b.
        assert!(parse(b"/1 1 home:B5").is_some());
        assert!(parse(b"/1 1 home:B4").is_none());
        assert!(parse(b"1 home").is_none());
        assert!(parse(b"/1 home:zz").is_none());
        assert!(parse(b"/\xff").is_none());
    }
}
