//! One block of G-code: words in, meaning or GRBL's error code out.
//!
//! The subset: G0 G1 G4 G10 (L2, L20) G17–G21 G40 G49 G53 G54–G59 G61 G80
//! G90 G91 G91.1 G92 G92.1 G94, M0 M1 M2 M30 M3 M4 M5 M7 M8 M9, F N P L S T X Y
//! Z. Arcs, probing, canned positions (G28, G30), inverse-time feed (G93) and
//! tool length offsets, which GRBL has, are refused here as unsupported (20).

/// Which motion mode is in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Motion {
    Seek,
    Feed,
    None,
}

/// Commands that act once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Once {
    Dwell,
    SetOffset { from_position: bool },
    ShiftOrigin,
    ClearShift,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Spindle {
    Clockwise,
    Counterclockwise,
    Off,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coolant {
    Mist,
    Flood,
    Off,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Program {
    Pause,
    End(u8),
}

/// What a block means; `None` where it means nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Block {
    pub motion: Option<Motion>,
    pub once: Option<Once>,
    pub machine_coordinates: bool,
    pub inches: Option<bool>,
    pub relative: Option<bool>,
    pub plane: Option<u8>,
    /// 0 for G54 to 5 for G59.
    pub coordinates: Option<usize>,
    pub program: Option<Program>,
    pub spindle: Option<Spindle>,
    pub coolant: Option<Coolant>,
    pub feed: Option<f64>,
    pub speed: Option<f64>,
    pub tool: Option<f64>,
    pub p: Option<f64>,
    pub l: Option<f64>,
    pub axes: [Option<f64>; 3],
    /// Whether a word stood there that a jog does not allow.
    pub not_for_jog: bool,
}

impl Block {
    pub(super) fn has_axes(&self) -> bool {
        self.axes.iter().any(Option::is_some)
    }
}

/// Modal groups, for "more than one of the same group" (21).
#[derive(Clone, Copy)]
enum Group {
    Once,
    Motion,
    Plane,
    Distance,
    ArcDistance,
    FeedMode,
    Units,
    Cutter,
    ToolLength,
    Coordinates,
    Control,
    Program,
    Spindle,
    Coolant,
}

/// Reads a block that has neither spaces nor comments and is in upper case.
pub(super) fn parse(line: &str) -> Result<Block, u8> {
    let mut block = Block::default();
    let mut groups = 0_u32;
    let mut words = 0_u32;
    let mut claim = |group: Group| {
        let bit = 1 << group as u32;
        let taken = groups & bit != 0;
        groups |= bit;
        if taken { Err(21) } else { Ok(()) }
    };
    // Word by word; each letter and group once.
    let mut rest = line;
    while let Some(letter) = rest.chars().next() {
        if !letter.is_ascii_uppercase() {
            return Err(1);
        }
        let (value, after) = read_number(&rest[1..]).ok_or(2_u8)?;
        rest = after;
        let number = value.trunc() as i64;
        let hundredths = ((value - value.trunc()) * 100.0).round() as i64;
        match letter {
            'G' => {
                let (group, jog) = g_word(&mut block, number, hundredths)?;
                claim(group)?;
                block.not_for_jog |= !jog;
            }
            'M' => {
                if hundredths != 0 {
                    return Err(23);
                }
                claim(m_word(&mut block, number)?)?;
                block.not_for_jog = true;
            }
            _ => {
                let slot = match letter {
                    'F' => &mut block.feed,
                    'S' => &mut block.speed,
                    'T' => &mut block.tool,
                    'P' => &mut block.p,
                    'L' => &mut block.l,
                    'X' => &mut block.axes[0],
                    'Y' => &mut block.axes[1],
                    'Z' => &mut block.axes[2],
                    'N' | 'I' | 'J' | 'K' | 'R' => &mut None,
                    _ => return Err(20),
                };
                let bit = 1 << (letter as u32 - 'A' as u32);
                if words & bit != 0 {
                    return Err(25);
                }
                words |= bit;
                if value < 0.0 && matches!(letter, 'F' | 'N' | 'P' | 'T' | 'S') {
                    return Err(4);
                }
                *slot = Some(value);
            }
        }
    }
    // What the words must not be together.
    let word = |letter: char| words >> (letter as u32 - 'A' as u32) & 1 == 1;
    // Nothing in this subset uses I, J, K or R: left over.
    if "IJKR".chars().any(word) {
        return Err(36);
    }
    if block.once == Some(Once::Dwell) && block.p.is_none() {
        return Err(28);
    }
    if matches!(block.once, Some(Once::SetOffset { .. })) {
        if !block.has_axes() {
            return Err(26);
        }
        match (block.p, block.l) {
            (Some(p), Some(l)) if p > 6.0 => return Err(if l == 2.0 { 29 } else { 20 }),
            (Some(_), Some(2.0)) => {}
            (Some(_), Some(20.0)) => {
                block.once = Some(Once::SetOffset {
                    from_position: true,
                });
            }
            (Some(_), Some(_)) => return Err(20),
            _ => return Err(28),
        }
    } else if block.l.is_some() || (block.p.is_some() && block.once != Some(Once::Dwell)) {
        return Err(36);
    }
    if block.once == Some(Once::ShiftOrigin) && !block.has_axes() {
        return Err(26);
    }
    Ok(block)
}

/// Group of a G word and whether a jog allows it.
fn g_word(block: &mut Block, number: i64, hundredths: i64) -> Result<(Group, bool), u8> {
    let mut jog = false;
    let group = match (number, hundredths) {
        (0, 0) => {
            block.motion = Some(Motion::Seek);
            Group::Motion
        }
        (1, 0) => {
            block.motion = Some(Motion::Feed);
            Group::Motion
        }
        (80, 0) => {
            block.motion = Some(Motion::None);
            Group::Motion
        }
        (4, 0) => {
            block.once = Some(Once::Dwell);
            Group::Once
        }
        (10, 0) => {
            block.once = Some(Once::SetOffset {
                from_position: false,
            });
            Group::Once
        }
        (92, 0) => {
            block.once = Some(Once::ShiftOrigin);
            Group::Once
        }
        (92, 10) => {
            block.once = Some(Once::ClearShift);
            Group::Once
        }
        (53, 0) => {
            block.machine_coordinates = true;
            jog = true;
            Group::Once
        }
        (17..=19, 0) => {
            block.plane = Some(number as u8);
            Group::Plane
        }
        (20 | 21, 0) => {
            block.inches = Some(number == 20);
            jog = true;
            Group::Units
        }
        (90 | 91, 0) => {
            block.relative = Some(number == 91);
            jog = true;
            Group::Distance
        }
        (91, 10) => Group::ArcDistance,
        (94, 0) => Group::FeedMode,
        (40, 0) => Group::Cutter,
        (49, 0) => Group::ToolLength,
        (54..=59, 0) => {
            block.coordinates = Some((number - 54) as usize);
            Group::Coordinates
        }
        (59, 10 | 20 | 30) => return Err(29),
        (61, 0) => Group::Control,
        (0 | 1 | 80 | 4 | 10 | 53 | 17..=21 | 90 | 94 | 40 | 49 | 54..=59 | 61, _) => {
            return Err(23);
        }
        _ => return Err(20),
    };
    Ok((group, jog))
}

fn m_word(block: &mut Block, number: i64) -> Result<Group, u8> {
    Ok(match number {
        0 => {
            block.program = Some(Program::Pause);
            Group::Program
        }
        1 => Group::Program,
        2 | 30 => {
            block.program = Some(Program::End(number as u8));
            Group::Program
        }
        3 => {
            block.spindle = Some(Spindle::Clockwise);
            Group::Spindle
        }
        4 => {
            block.spindle = Some(Spindle::Counterclockwise);
            Group::Spindle
        }
        5 => {
            block.spindle = Some(Spindle::Off);
            Group::Spindle
        }
        7 => {
            block.coolant = Some(Coolant::Mist);
            Group::Coolant
        }
        8 => {
            block.coolant = Some(Coolant::Flood);
            Group::Coolant
        }
        9 => {
            block.coolant = Some(Coolant::Off);
            Group::Coolant
        }
        _ => return Err(20),
    })
}

/// A decimal number without exponent at the beginning of a text, and what follows it.
pub(super) fn read_number(text: &str) -> Option<(f64, &str)> {
    let sign = usize::from(text.starts_with(['+', '-']));
    let mut seen_point = false;
    let end = text[sign..]
        .find(|c: char| {
            !(c.is_ascii_digit() || (c == '.' && !std::mem::replace(&mut seen_point, true)))
        })
        .map_or(text.len(), |length| sign + length);
    if !text[sign..end].contains(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let value: f64 = text[..end].parse().ok()?;
    Some((value, &text[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_blocks_and_their_codes() {
        for (line, code) in [
            ("10", 1),
            ("G", 2),
            ("GX", 2),
            ("X1.2.3", 1),
            ("G0X-", 2),
            ("G2X1Y1I1J0", 20),
            ("G28", 20),
            ("Q1", 20),
            ("M10", 20),
            ("G0G1X1", 21),
            ("G90G91", 21),
            ("M3M5", 21),
            ("M7M8", 21),
            ("G0.5X1", 23),
            ("M3.1", 23),
            ("X1X2", 25),
            ("G92", 26),
            ("G10L2P1", 26),
            ("G4", 28),
            ("G10P1X0", 28),
            ("G59.1", 29),
            ("G0X1R2", 36),
            ("G0X1P2", 36),
            ("G1X1F-5", 4),
            ("S-1", 4),
        ] {
            assert_eq!(parse(line), Err(code), "{line}");
        }
    }

    #[test]
    fn an_accepted_block_says_what_it_says() {
        let block = parse("G91G1X-1.5Y+.25F300M3S500").unwrap();
        assert_eq!(block.motion, Some(Motion::Feed));
        assert_eq!(block.relative, Some(true));
        assert_eq!(block.axes, [Some(-1.5), Some(0.25), None]);
        assert_eq!(block.feed, Some(300.0));
        assert_eq!(block.spindle, Some(Spindle::Clockwise));
        assert_eq!(block.speed, Some(500.0));
    }

    proptest::proptest! {
        #[test]
        fn any_line_is_parsed_or_refused_with_a_known_code(line in "[ -~]{0,80}") {
            if let Err(code) = parse(&line) {
                proptest::prop_assert!((1..=38).contains(&code));
            }
        }

        #[test]
        fn numbers_are_read_back(value in -1.0e6..1.0e6_f64) {
            let text = format!("{value:.3}X");
            let (read, rest) = read_number(&text).unwrap();
            proptest::prop_assert!((read - value).abs() < 1e-3);
            proptest::prop_assert_eq!(rest, "X");
        }
    }
}
