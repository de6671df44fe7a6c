//! What the output of `gphoto2` means.

/// A setting of the body, as gphoto2 prints it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Setting {
    pub is_read_only: bool,
    pub current: String,
    pub choices: Vec<String>,
}

/// The table of `gphoto2 --auto-detect`: two columns below a line of dashes.
pub fn parse_detected(text: &str) -> Vec<(String, String)> {
    text.lines()
        .skip_while(|line| !line.starts_with("---"))
        .skip(1)
        .filter_map(|line| {
            let (model, port) = line.trim_end().rsplit_once(' ')?;
            Some((model.trim().to_owned(), port.to_owned()))
        })
        .collect()
}

pub(super) fn is_busy(complaint: &str) -> bool {
    ["Device Busy", "-110:", "I/O in progress"]
        .iter()
        .any(|words| complaint.contains(words))
}

/// Whether gphoto2 reports an error on stderr: other lines are notes of the loader, of
/// libraries and of itself.
pub(super) fn has_error(stderr: &str) -> bool {
    let mut lines = stderr.lines();
    lines.any(|line| line.trim_start().starts_with("*** Error"))
}

/// What gphoto2 wrote to stderr, without the advice on debugging that it appends.
pub(super) fn complaint(stderr: &str) -> String {
    let text = stderr
        .split("For debugging messages")
        .next()
        .unwrap_or_default();
    let lines = text.lines().map(str::trim);
    let messages: Vec<&str> = lines
        .filter(|line| !line.is_empty() && *line != "*** Error ***")
        .collect();
    messages.join("; ")
}

pub(super) fn one_line(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    lines.join("; ").chars().take(300).collect()
}

/// The blocks of `gphoto2 --get-config`, each up to its line `END`.
pub fn parse_settings(text: &str) -> Vec<Setting> {
    let mut settings = Vec::new();
    let mut setting = None;
    for line in text.lines() {
        if line.starts_with("Label:") {
            setting = Some(Setting {
                is_read_only: false,
                current: String::new(),
                choices: Vec::new(),
            });
        }
        let Some(open) = &mut setting else { continue };
        if let Some(value) = line.strip_prefix("Readonly:") {
            open.is_read_only = value.trim() == "1";
        } else if let Some(value) = line.strip_prefix("Current:") {
            value.trim().clone_into(&mut open.current);
        } else if let Some(value) = line.strip_prefix("Choice:") {
            // `Choice: 3 1/250`.
            let numbered = value.trim().split_once(' ');
            open.choices
                .extend(numbered.map(|(_, value)| value.trim().to_owned()));
        } else if line == "END" {
            settings.extend(setting.take());
        }
    }
    settings
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn detected_bodies_are_listed() {
        let text = "Model                          Port            \n\
            ----------------------------------------------------------\n\
            Canon EOS 5D Mark IV           usb:001,004     \n\
            Nikon DSC D850                 usb:001,005     \n";
        let detected = parse_detected(text);
        assert_eq!(
            detected[0],
            ("Canon EOS 5D Mark IV".to_owned(), "usb:001,004".to_owned())
        );
        assert_eq!(detected[1].1, "usb:001,005");
        assert!(parse_detected("no table").is_empty());
    }

    #[test]
    fn settings_are_read_with_their_choices() {
        let text = "Label: Shutter Speed\nReadonly: 0\nType: RADIO\nCurrent: 1/60\n\
            Choice: 0 bulb\nChoice: 1 1/60\nEND\nLabel: Serial Number\nReadonly: 1\n\
            Type: TEXT\nCurrent: 42 A\nEND\n";
        let settings = parse_settings(text);
        assert_eq!(settings[0].choices, ["bulb", "1/60"]);
        assert_eq!(settings[0].current, "1/60");
        assert!(settings[1].is_read_only && settings[1].current == "42 A");
    }

    #[test]
    fn notes_are_no_errors() {
        for (stderr, expected) in [
            ("", false),
            (
                "gphoto2: libjpeg.so.8: no version information available\n",
                false,
            ),
            ("Error loading a library, which is not needed\n", false),
            ("\n*** Error ***\nAn error occurred\n", true),
            ("a note\n*** Error (-1: 'Unspecified error') ***\n", true),
            ("*** Error: No camera found. ***\n", true),
        ] {
            assert_eq!(has_error(stderr), expected, "{stderr}");
        }
    }

    proptest! {
        #[test]
        fn any_output_is_read(text in "(Label:|Current:|Choice: |END|[a-z0-9 \n]){0,30}") {
            let ends = text.lines().filter(|line| *line == "END").count();
            prop_assert!(parse_settings(&text).len() <= ends);
            parse_detected(&text);
        }
    }
}
