//! A still camera's raw file, read by LibRaw's programs: `unprocessed_raw` writes the counts
//! as a TIFF file, `raw-identify` the data about them.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use crate::device::command_camera::{Ended, Workplace, how_it_ended};
use crate::device::retake::FrameFault;
use crate::device::{DeviceError, RawFrame, image_file};
use crate::units::Seconds;

/// LibRaw's program that writes the counts of a raw file.
pub(super) const UNPROCESSED_RAW: &str = "unprocessed_raw";
/// LibRaw's program that writes what a raw file states.
pub(super) const RAW_IDENTIFY: &str = "raw-identify";

/// What a raw file states about its frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stated {
    /// Exposure time.
    pub(super) exposure: Seconds,
    /// Sensitivity; `None`: not stated.
    pub(super) iso: Option<f64>,
    /// Of the body; empty: not stated.
    pub(super) serial: String,
    /// Count without light at this sensitivity, DN; `None`: not stated.
    pub(super) black_dn: Option<f64>,
}

/// Runs LibRaw's programs on a file.
pub(super) struct RawReader<'a> {
    pub(super) workplace: &'a Workplace,
    pub(super) deadline: Instant,
    pub(super) device: &'a str,
}

impl RawReader<'_> {
    fn run(&self, program: &str, arguments: &[&str], file: &Path) -> Result<Ended, DeviceError> {
        let mut command = Command::new(program);
        command.env("LC_ALL", "C").args(arguments).arg(file);
        let ended = self.workplace.run(command, self.deadline)?;
        let complaint = ended.stderr.trim();
        match ended.status {
            None => Err(self.bad(format!("{program} did not end in time"))),
            Some(status) if !status.success() => {
                let how = how_it_ended(status);
                Err(self.bad(format!("{program} cannot read it ({how}): {complaint}")))
            }
            // Some failures end with code 0.
            Some(_) if complaint.lines().any(|line| line.starts_with("Cannot ")) => {
                Err(self.bad(format!("{program}: {complaint}")))
            }
            Some(_) => Ok(ended),
        }
    }

    fn bad(&self, what: String) -> DeviceError {
        DeviceError::BadFrame {
            device: self.device.to_owned(),
            fault: FrameFault::Undecodable(format!("the raw file: {what}")),
        }
    }

    /// What the file states.
    pub(super) fn stated(&self, file: &Path) -> Result<Stated, DeviceError> {
        let ended = self.run(RAW_IDENTIFY, &["-v"], file)?;
        parse_stated(&ended.stdout).ok_or_else(|| self.bad("it states no exposure time".to_owned()))
    }

    /// The counts of the image, without the sensor's masked border.
    pub(super) fn counts(
        &self,
        file: &Path,
        expected: [u32; 2],
        bit_depth: u32,
    ) -> Result<RawFrame, DeviceError> {
        let ended = self.run(UNPROCESSED_RAW, &["-T"], file)?;
        let area = parse_area(&ended.stdout)
            .ok_or_else(|| self.bad(format!("{UNPROCESSED_RAW} states no size")))?;
        let of_frame = |fault| DeviceError::BadFrame {
            device: self.device.to_owned(),
            fault,
        };
        if area.image != expected {
            let found = area.image;
            return Err(of_frame(FrameFault::Size {
                found,
                counts: found[0] as usize * found[1] as usize,
                expected,
            }));
        }
        let mut written = file.as_os_str().to_owned();
        written.push(".tiff");
        let whole = image_file::read(&PathBuf::from(written), area.raw, bit_depth);
        Ok(area.cropped(whole.map_err(of_frame)?))
    }
}

/// Where the image lies on the sensor, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Area {
    raw: [u32; 2],
    image: [u32; 2],
    /// From the left and from the top.
    margins: [u32; 2],
}

impl Area {
    fn cropped(&self, frame: RawFrame) -> RawFrame {
        if self.raw == self.image {
            return frame;
        }
        let [width, height] = self.image;
        let [left, top] = self.margins.map(|margin| margin as usize);
        let rows = frame.counts.chunks(self.raw[0] as usize);
        let rows = rows.skip(top).take(height as usize);
        let counts = rows
            .flat_map(|row| row.iter().skip(left).take(width as usize))
            .copied()
            .collect();
        RawFrame {
            width,
            height,
            counts,
            ..frame
        }
    }
}

/// The value after `key` in the first line that begins with it.
fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let mut lines = text.lines().map(str::trim);
    lines.find_map(|line| line.strip_prefix(key)).map(str::trim)
}

fn parse_area(text: &str) -> Option<Area> {
    let size = |key| {
        let (width, height) = value(text, key)?.split_once('x')?;
        Some([width.trim().parse().ok()?, height.trim().parse().ok()?])
    };
    let (top, left) = value(text, "Margins: top=")?.split_once(", left=")?;
    let area = Area {
        raw: size("Raw size:")?,
        image: size("Image size:")?,
        margins: [left.trim().parse().ok()?, top.trim().parse().ok()?],
    };
    let fits = |axis: usize| {
        let end = area.margins[axis].checked_add(area.image[axis]);
        end.is_some_and(|end| end <= area.raw[axis])
    };
    (fits(0) && fits(1)).then_some(area)
}

fn parse_stated(text: &str) -> Option<Stated> {
    let positive = |value: f64| (value.is_finite() && value > 0.0).then_some(value);
    // `1/60.0` or `2.0 sec`.
    let shutter = value(text, "Shutter:")?.trim_end_matches("sec").trim();
    let seconds = match shutter.split_once('/') {
        Some((above, below)) => above.parse::<f64>().ok()? / below.parse::<f64>().ok()?,
        None => shutter.parse().ok()?,
    };
    let number = |key| value(text, key)?.split(' ').next()?.parse::<f64>().ok();
    // Other numbers may follow on its line.
    let serial = value(text, "Body#:").unwrap_or_default();
    let others = [" DNG Version", " BodyAssy#:", " Lens#:", " LensAssy#:"];
    let ends = others.iter().filter_map(|other| serial.find(other));
    let serial = &serial[..ends.min().unwrap_or(serial.len())];
    Some(Stated {
        exposure: Seconds(positive(seconds)?),
        iso: number("ISO speed:").and_then(positive),
        serial: serial.trim().to_owned(),
        black_dn: number("black:"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_a_file_states_is_read() {
        let text =
            "\nBody#: S0001 DNG Version: 1.4.0.0\n\nISO speed: 100\nShutter: 1/60.0\nblack: 64\n";
        let stated = parse_stated(text).unwrap();
        assert!((stated.exposure.0 - 1.0 / 60.0).abs() < 1e-12);
        assert_eq!((stated.iso, stated.black_dn), (Some(100.0), Some(64.0)));
        assert_eq!(stated.serial, "S0001");
        let many = parse_stated("Body#: 42 A BodyAssy#: 7 Lens#: 9\nShutter: 1/60.0\n");
        assert_eq!(many.unwrap().serial, "42 A");
        let long = parse_stated("Shutter: 2.0 sec\n").unwrap();
        assert_eq!(long.exposure, Seconds(2.0));
        assert_eq!((long.iso, long.serial.as_str()), (None, ""));
        assert_eq!(parse_stated("Shutter: 0.0 sec"), None);
        assert_eq!(parse_stated("Shutter: 1/0"), None);
        assert_eq!(parse_stated("ISO speed: 100"), None);
    }

    #[test]
    fn the_masked_border_is_cut_off() {
        let text = "Image size: 2x2\nRaw size: 4x3\nMargins: top=1, left=2\n";
        let area = parse_area(text).unwrap();
        let frame = RawFrame::new(4, 3, (0..12).collect());
        let cropped = area.cropped(frame);
        assert_eq!((cropped.width, cropped.height), (2, 2));
        assert_eq!(cropped.counts, [6, 7, 10, 11]);
        let beyond = "Image size: 3x2\nRaw size: 4x3\nMargins: top=1, left=2\n";
        assert_eq!(parse_area(beyond), None);
    }

    proptest! {
        #[test]
        fn any_output_is_read_or_refused(text in "(Image size:|Raw size:|Margins: top=|Shutter:|[0-9x/., \n]|, left=){0,20}") {
            let area = parse_area(&text);
            prop_assert!(area.is_none_or(|area| area.margins[0] <= area.raw[0]));
            prop_assert!(parse_stated(&text).is_none_or(|stated| stated.exposure.0 > 0.0));
        }
    }
}
