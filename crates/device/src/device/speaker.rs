//! Who answers on a serial port, as far as one line tells.

/// A kind of controller, by what it reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Speaker {
    /// GRBL or a relative.
    Grbl,
    /// Zaber's ASCII protocol.
    Zaber,
    /// Marlin or other firmware of 3D printers.
    Marlin,
    /// Klipper, the program or its board.
    Klipper,
    /// RepRapFirmware.
    RepRap,
    /// Smoothieware.
    Smoothie,
    /// TinyG or g2core.
    TinyG,
}

impl std::fmt::Display for Speaker {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Self::Grbl => "a GRBL controller",
            Self::Zaber => "a Zaber device",
            Self::Marlin => "a 3D printer's firmware (Marlin)",
            Self::Klipper => "Klipper",
            Self::RepRap => "RepRapFirmware",
            Self::Smoothie => "Smoothieware",
            Self::TinyG => "TinyG or g2core",
        })
    }
}

impl Speaker {
    /// Who says such a line; `None` where it could be anybody, or is damaged.
    pub fn of(line: &str) -> Option<Self> {
        let line = line.trim();
        let is_status = line.starts_with('<') && line.ends_with('>') && line.contains("Pos:");
        let error = line.strip_prefix("error:").map(str::parse::<u16>);
        let is_error = matches!(error, Some(Ok(_)));
        if is_status || is_error || line.starts_with("Grbl ") || line.ends_with("for help]") {
            return Some(Self::Grbl);
        }
        if is_zaber(line) {
            return Some(Self::Zaber);
        }
        if line.starts_with("Smoothie") {
            return Some(Self::Smoothie);
        }
        // Klipper's answers are comments; its errors have two exclamation marks.
        if ["// ", "!! "].iter().any(|start| line.starts_with(start)) {
            return Some(Self::Klipper);
        }
        if line.starts_with("Error: Bad command") || line.contains("RepRapFirmware") {
            return Some(Self::RepRap);
        }
        if ["echo:", "FIRMWARE_NAME:", "Marlin "]
            .iter()
            .any(|start| line.starts_with(start))
        {
            return Some(Self::Marlin);
        }
        let is_json = line.starts_with("{\"") && line.ends_with('}');
        is_json.then_some(Self::TinyG)
    }
}

/// `@01 0 OK IDLE -- 0`, `!01 1 IDLE --`, with a message id or without.
fn is_zaber(line: &str) -> bool {
    let Some(rest) = line.strip_prefix(['@', '!']) else {
        return false;
    };
    let words: Vec<&str> = rest.split_whitespace().collect();
    let is_number = |word: &&str| !word.is_empty() && word.bytes().all(|b| b.is_ascii_digit());
    let is_state = |word: &&str| ["IDLE", "BUSY"].contains(word);
    words.iter().take(2).filter(|word| is_number(word)).count() == 2 && words.iter().any(is_state)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_known_by_a_line_of_its_own() {
        for (line, speaker) in [
            ("<Idle|MPos:0.000,0.000,0.000|FS:0,0>", Some(Speaker::Grbl)),
            (
                "<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>",
                Some(Speaker::Grbl),
            ),
            ("Grbl 1.1h ['$' for help]", Some(Speaker::Grbl)),
            ("error:2", Some(Speaker::Grbl)),
            ("@01 0 OK IDLE -- 0", Some(Speaker::Zaber)),
            ("@01 0 12 OK BUSY WR 0:5A", Some(Speaker::Zaber)),
            ("!02 1 IDLE --", Some(Speaker::Zaber)),
            ("echo:Unknown command: \"$I\"", Some(Speaker::Marlin)),
            ("// Unknown command:\"????\"", Some(Speaker::Klipper)),
            ("!! Must home axis first", Some(Speaker::Klipper)),
            ("Error: Bad command: ????", Some(Speaker::RepRap)),
            (
                "FIRMWARE_NAME: RepRapFirmware for Duet 3",
                Some(Speaker::RepRap),
            ),
            ("Smoothie", Some(Speaker::Smoothie)),
            ("{\"r\":{\"fv\":0.97},\"f\":[1,0,10]}", Some(Speaker::TinyG)),
            ("ok", None),
            ("@0x IDLE", None),
            ("!k2;9 IDLE", None),
            ("<Idle|MP", None),
            ("", None),
        ] {
            assert_eq!(Speaker::of(line), speaker, "{line}");
        }
    }
}
