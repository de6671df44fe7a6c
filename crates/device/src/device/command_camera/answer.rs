//! What a camera's program reports on its standard output: a JSON object, or nothing.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::device::stated::Stated;
use crate::units::Seconds;

/// Longest serial number, characters.
const LONGEST_SERIAL: usize = 80;
/// So much of an answer is quoted, characters.
const QUOTED: usize = 60;
/// Keys that begin so are the program's own.
const OWN: &str = "_";

/// Why what a program wrote is no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum AnswerFault {
    /// Not JSON, or a value of another type than its key's.
    #[error("its answer is not a JSON object of the expected form: {0}")]
    Malformed(String),
    #[error("its answer has the unknown key {0:?}")]
    UnknownKey(String),
    /// A value outside its range.
    #[error("its answer has {key} = {is}, and {allowed} is allowed")]
    Range {
        key: &'static str,
        is: String,
        allowed: String,
    },
}

/// The object as it is written. A key that is absent or null reports nothing.
#[derive(Deserialize)]
struct Written {
    exposure_s: Option<f64>,
    gain: Option<f64>,
    serial: Option<String>,
    sensor_c: Option<f64>,
    #[serde(flatten)]
    others: BTreeMap<String, IgnoredAny>,
}

/// What `stdout` reports. The answer begins with the first line that begins with `{` and
/// goes to the end; what stands before is for people. Where no line begins so, what stands
/// between braces is the answer, because one that is not seen would leave settings unchecked;
/// without any nothing is reported. Keys that begin with `_` are not read.
///
/// # Errors
/// An answer that is no object, has an unknown key, or a value outside its range.
pub fn parse(stdout: &str) -> Result<Stated, AnswerFault> {
    // What encodings leave behind: byte order marks, the zeros of UTF-16.
    let stdout = stdout.replace(['\u{feff}', '\0'], "");
    let Some(text) = answer_in(&stdout) else {
        return Ok(Stated::default());
    };
    let written: Written = serde_json::from_str(text).map_err(|error| {
        let begin: String = text.trim().chars().take(QUOTED).collect();
        AnswerFault::Malformed(format!("{error}, in {begin:?}"))
    })?;
    if let Some(unknown) = written.others.keys().find(|key| !key.starts_with(OWN)) {
        return Err(AnswerFault::UnknownKey(unknown.clone()));
    }
    within("exposure_s", written.exposure_s, [1e-9, 1e5])?;
    within("gain", written.gain, [1e-6, 1e6])?;
    within("sensor_c", written.sensor_c, [-150.0, 200.0])?;
    let serial = written.serial.map(|serial| serial.trim().to_owned());
    if let Some(serial) = &serial
        && !(1..=LONGEST_SERIAL).contains(&serial.chars().count())
    {
        return Err(AnswerFault::Range {
            key: "serial",
            is: format!("{serial:?}"),
            allowed: format!("1 to {LONGEST_SERIAL} characters"),
        });
    }
    Ok(Stated {
        exposure: written.exposure_s.map(Seconds),
        gain: written.gain,
        serial,
        sensor_c: written.sensor_c,
    })
}

/// From the first line that begins with `{`, or else from the first brace to the last.
fn answer_in(stdout: &str) -> Option<&str> {
    let mut start = 0;
    for line in stdout.split_inclusive('\n') {
        if line.trim_start().starts_with('{') {
            return Some(&stdout[start..]);
        }
        start += line.len();
    }
    let from = stdout.find('{')?;
    match stdout[from..].rfind('}') {
        Some(length) => Some(&stdout[from..=from + length]),
        // One that was cut.
        None => stdout[from + 1..]
            .trim_start()
            .starts_with('"')
            .then(|| &stdout[from..]),
    }
}

fn within(key: &'static str, is: Option<f64>, [from, to]: [f64; 2]) -> Result<(), AnswerFault> {
    match is {
        Some(is) if !(from..=to).contains(&is) => Err(AnswerFault::Range {
            key,
            is: is.to_string(),
            allowed: format!("{from} to {to}"),
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn an_answer_is_read_and_what_is_none_is_passed_over() {
        let whole = "opening the camera\n{\n \"exposure_s\": 0.0201, \"gain\": 1.5,\n \
            \"serial\": \" 42 A \", \"sensor_c\": -7.5, \"_driver\": {\"version\": [1, 2]}}\n";
        let expected = Stated {
            exposure: Some(Seconds(0.0201)),
            gain: Some(1.5),
            serial: Some("42 A".to_owned()),
            sensor_c: Some(-7.5),
        };
        assert_eq!(parse(whole), Ok(expected));
        // However it is encoded, and wherever it stands.
        for text in [
            "\u{feff}{\"gain\":2}",
            "\0{\"gain\":2}\r\n",
            "{\0\"\0g\0a\0i\0n\0\"\0:\0\x32\0}\0",
            "done {\"gain\":2}",
            "done\r\nanswer: {\"gain\":\r\n2}\r\nbye\r\n",
            "mode {fast}\n{\"gain\":2}\n",
        ] {
            assert_eq!(
                parse(text).map(|stated| stated.gain),
                Ok(Some(2.0)),
                "{text:?}"
            );
        }
        for nothing in ["", "done\n", "saved 3 files [ok]", "{}", "{\"gain\": null}"] {
            assert_eq!(parse(nothing), Ok(Stated::default()), "{nothing:?}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, part) in [
            ("{\"exposure_s\": 0.02", "EOF while parsing"),
            ("{\"exposure_s\": \"0.02\"}", "invalid type: string"),
            ("{\"exposure_s\": NaN}", "expected value"),
            ("{\"gain\": 1e999}", "number out of range"),
            ("{\"gain\": 1} {\"gain\": 1}", "trailing characters"),
            ("{\"gain\": 1}\n{\"gain\": 1}\n", "trailing characters"),
            ("got {\"gain\": 1} {\"gain\": 1}", "trailing characters"),
            ("mode {fast}", "in \"{fast}\""),
            ("got {\"gain\": 1", "EOF while parsing"),
            ("{\"gain\": 1, \"gain\": 2}", "duplicate field `gain`"),
            ("{\"exposure\": 0.02}", "unknown key \"exposure\""),
            (
                "{\"exposure_s\": -1}",
                "exposure_s = -1, and 0.000000001 to 100000",
            ),
            ("{\"gain\": 0}", "gain = 0, and"),
            ("{\"sensor_c\": -300}", "sensor_c = -300, and -150 to 200"),
            (
                "{\"serial\": \" \"}",
                "serial = \"\", and 1 to 80 characters",
            ),
        ] {
            let fault = parse(text).unwrap_err().to_string();
            assert!(fault.contains(part), "{text}: {fault}");
        }
    }

    proptest! {
        #[test]
        fn any_output_is_read(text in "(\\{|\\}|\"gain\"|:|,|\n|[ -~]|1e5|null){0,30}") {
            let _ = parse(&text);
        }
    }
}
