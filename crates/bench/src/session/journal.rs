//! The journal: one JSON object per line, each with the CRC-32 of its record
//! and a running number.
//!
//! ```text
//! {"crc":"1c291ca3","record":{"number":0,"utc":"…","event":"start",…}}
//! ```
//!
//! The CRC (IEEE 802.3) is over the record's bytes as they stand in the line,
//! and the frame around them is compared byte by byte, so that no flipped bit is
//! accepted. A line counts when its newline is there: what follows the last
//! newline is a torn line and is ignored. Anything else that does not check is
//! refused.

use std::io::ErrorKind;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::SessionError;
use super::decision::Decision;
use super::layout::{self, JOURNAL_FILE};
use crate::checksum::sha256_hex;
use crate::device::FrameKey;
use crate::outside_file::read_regular;

/// Far more than the longest capture writes.
pub const LARGEST_JOURNAL_BYTES: u64 = 256 << 20;

/// Version of the session's layout that this program writes and reads.
pub const FORMAT: u32 = 1;

/// A file and what it held when it was journalled.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileDigest {
    /// Relative to the session, with `/` between names.
    pub path: String,
    /// Length.
    pub bytes: u64,
    /// Lowercase hexadecimal.
    pub sha256: String,
}

impl FileDigest {
    /// Of these bytes.
    pub fn of(path: impl Into<String>, bytes: &[u8]) -> Self {
        Self {
            path: path.into(),
            bytes: bytes.len() as u64,
            sha256: sha256_hex(bytes),
        }
    }
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum Event {
    /// The session exists; nothing has moved yet.
    Start {
        /// [`FORMAT`].
        format: u32,
        /// `session.toml`.
        session: FileDigest,
    },
    /// Work goes on after an interruption.
    Resume {
        /// Files without a record that were moved to the quarantine folder.
        quarantined: u32,
    },
    /// The stage was homed, so that its position is known.
    Homed,
    /// After the last light: where the stage found its reference switches.
    Reference {
        /// Found minus expected of each axis, degrees or mm as the axis has it.
        off: [f64; 2],
        /// More than the stage's tolerance allows: steps were lost, and the
        /// directions of lights before are not what they claim to be.
        suspect: bool,
    },
    /// The computer's clock was set: times before and after are of two clocks.
    ClockStep {
        /// Later by so much, s.
        by_s: f64,
    },
    /// Frames of a light direction follow.
    LightStart {
        light: u32,
        /// Read back after the move, degrees.
        azimuth_deg: f64,
        /// Read back after the move, degrees.
        elevation_deg: f64,
    },
    /// A raw frame and its sidecar are on the disk.
    Frame {
        /// Its place in the plan.
        key: FrameKey,
        /// 16-bit PNG.
        image: FileDigest,
        /// How it was taken.
        sidecar: FileDigest,
    },
    /// All frames of a light direction are journalled.
    LightStop { light: u32 },
    /// Of a capture that chooses its lights: what was decided after those so far.
    Decision(Decision),
    /// Something that a reader of the session should know.
    Warning {
        /// Index of the light direction in the plan.
        light: u32,
        text: String,
    },
    /// Any other file is on the disk; a later record of the same path replaces it.
    File {
        #[serde(flatten)]
        file: FileDigest,
    },
    /// The operator has paused the capture; the lamp is off.
    Paused,
    /// The capture goes on after a pause.
    Continued,
    /// The operator or an error ended the work before its end.
    Interrupted { reason: String },
    /// The capture is complete.
    Stop,
}

/// One line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Running number from 0, without gaps.
    pub number: u64,
    /// When, RFC 3339, UTC.
    pub utc: String,
    /// What.
    #[serde(flatten)]
    pub event: Event,
}

/// All that a journal says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Journal {
    /// In order.
    pub records: Vec<Record>,
    /// Length of the lines that count.
    pub whole_bytes: u64,
    /// Length of the torn line after them; 0 if there is none.
    pub torn_bytes: u64,
}

const BEFORE_CRC: &[u8] = b"{\"crc\":\"";
const AFTER_CRC: &[u8] = b"\",\"record\":";

/// The line of a record, with its newline.
pub fn encode(record: &Record) -> Vec<u8> {
    let json = serde_json::to_string(record).expect("a record has only string keys");
    let crc = crc32fast::hash(json.as_bytes());
    format!("{{\"crc\":\"{crc:08x}\",\"record\":{json}}}\n").into_bytes()
}

/// The record of a line without its newline, or what is wrong with it.
pub fn decode(line: &[u8]) -> Result<Record, String> {
    let parts = || {
        let rest = line.strip_prefix(BEFORE_CRC)?;
        let (crc, rest) = rest.split_at_checked(8)?;
        let json = rest.strip_prefix(AFTER_CRC)?.strip_suffix(b"}")?;
        Some((crc, json))
    };
    let (crc, json) = parts().ok_or("the line has not the form {\"crc\":…,\"record\":…}")?;
    let actual = format!("{:08x}", crc32fast::hash(json));
    if actual.as_bytes() != crc {
        let stated = String::from_utf8_lossy(crc);
        return Err(format!("the CRC is {actual}, the line records {stated}"));
    }
    serde_json::from_slice(json).map_err(|e| e.to_string())
}

impl Journal {
    /// Reads the journal of the session in `root`.
    ///
    /// # Errors
    /// [`SessionError::NotASession`] without a journal or a whole first line;
    /// [`SessionError::CorruptJournal`] for any whole line that does not check.
    pub fn read(root: &Path) -> Result<Self, SessionError> {
        let path = root.join(JOURNAL_FILE);
        let bytes = read_regular(&path, LARGEST_JOURNAL_BYTES).map_err(|e| match e.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory => SessionError::NotASession {
                path: root.to_owned(),
                why: if root.exists() {
                    format!("it has no {JOURNAL_FILE}")
                } else {
                    "there is no such folder".into()
                },
            },
            _ => SessionError::io("read", &path, e),
        })?;
        let journal = Self::parse(&bytes).map_err(|(line, why)| SessionError::CorruptJournal {
            path: path.clone(),
            line,
            why,
        })?;
        if journal.records.is_empty() {
            return Err(SessionError::NotASession {
                path: root.to_owned(),
                why: format!("{JOURNAL_FILE} holds no record"),
            });
        }
        Ok(journal)
    }

    /// Parses a journal's bytes; an error is a line number, from 1, and a reason.
    pub fn parse(bytes: &[u8]) -> Result<Self, (usize, String)> {
        let whole = bytes
            .iter()
            .rposition(|&b| b == b'\n')
            .map_or(0, |at| at + 1);
        let mut records = Vec::new();
        for (index, line) in bytes[..whole].split_inclusive(|&b| b == b'\n').enumerate() {
            let bad = |why: String| (index + 1, why);
            let record = decode(&line[..line.len() - 1]).map_err(bad)?;
            if record.number != index as u64 {
                return Err(bad(format!("record {} stands in its place", record.number)));
            }
            match (&record.event, index) {
                (Event::Start { format, .. }, 0) if *format == FORMAT => {}
                (Event::Start { format, .. }, 0) => {
                    return Err(bad(format!(
                        "the session has format {format}, this program reads {FORMAT}"
                    )));
                }
                (Event::Start { .. }, _) => return Err(bad("a second start".into())),
                (_, 0) => return Err(bad("the first record is not a start".into())),
                _ => {}
            }
            if let Some(file) = record
                .files()
                .into_iter()
                .find(|f| !layout::is_inside(&f.path))
            {
                return Err(bad(format!("{:?} leaves the session", file.path)));
            }
            records.push(record);
        }
        Ok(Self {
            records,
            whole_bytes: whole as u64,
            torn_bytes: (bytes.len() - whole) as u64,
        })
    }

    /// Every journalled file as its last record says, in the order of first mention.
    pub fn files(&self) -> Vec<&FileDigest> {
        let mut place = std::collections::HashMap::new();
        let mut files: Vec<&FileDigest> = Vec::new();
        for file in self.records.iter().flat_map(Record::files) {
            match place.get(file.path.as_str()) {
                Some(&at) => files[at] = file,
                None => {
                    place.insert(file.path.as_str(), files.len());
                    files.push(file);
                }
            }
        }
        files
    }

    /// Whether the capture ran to its end.
    pub fn is_complete(&self) -> bool {
        self.records.iter().any(|r| r.event == Event::Stop)
    }

    /// What was decided after the lights, in order.
    pub fn decisions(&self) -> impl Iterator<Item = Decision> {
        self.records.iter().filter_map(|record| match record.event {
            Event::Decision(decision) => Some(decision),
            _ => None,
        })
    }

    /// Time on the bench: between the records, but for what was between two runs.
    pub fn spent_s(&self) -> f64 {
        let time = |record: &Record| record.utc.parse::<jiff::Timestamp>().ok();
        let between = |pair: &[Record]| match pair[1].event {
            Event::Resume { .. } => None,
            _ => Some(time(&pair[1])?.duration_since(time(&pair[0])?)),
        };
        let spans = self.records.windows(2).filter_map(between);
        spans.map(|span| span.as_secs_f64().max(0.0)).sum()
    }

    /// How far off each axis was where the stage was found to have lost steps,
    /// degrees or mm as the axis has it; `None` where it was not. Such a session
    /// is suspect: nobody knows when they were lost.
    pub fn steps_lost(&self) -> Option<[f64; 2]> {
        self.records.iter().find_map(|record| match record.event {
            Event::Reference { off, suspect: true } => Some(off),
            _ => None,
        })
    }

    /// What is known of the computer's clock having been set while the session was written;
    /// `None`: nothing.
    pub fn clock_step(&self) -> Option<String> {
        let noticed = self.records.iter().filter_map(|record| match record.event {
            Event::ClockStep { by_s } => Some(by_s),
            _ => None,
        });
        // The largest is the one that tells most.
        let largest = noticed.max_by(|a, b| a.abs().total_cmp(&b.abs()));
        largest.or_else(|| self.step_back()).map(clock_fact)
    }

    /// The first record that is earlier than the one before it, by so much, s.
    fn step_back(&self) -> Option<f64> {
        let time = |record: &Record| record.utc.parse::<jiff::Timestamp>().ok();
        self.records.windows(2).find_map(|pair| {
            let by_s = time(&pair[1])?
                .duration_since(time(&pair[0])?)
                .as_secs_f64();
            (by_s < -LEAST_STEP_BACK_S).then_some(by_s)
        })
    }

    /// What a person reads of it.
    pub fn suspicion(&self) -> Option<String> {
        self.steps_lost().map(|[first, second]| {
            format!(
                "the stage had lost steps when its reference was checked after the last light (its axes were off by {first:.4} and {second:.4}): the directions of the lights are suspect"
            )
        })
    }
}

/// A clock that is slewed does not go back by so much, s.
const LEAST_STEP_BACK_S: f64 = 1.0;

/// The fact that the computer's clock was set, forwards by so many seconds.
pub fn clock_fact(by_s: f64) -> String {
    let by = match by_s.abs() {
        seconds if seconds < 120.0 => format!("{by_s:+.1} s"),
        seconds if seconds < 7200.0 => format!("{:+.1} min", by_s / 60.0),
        seconds if seconds < 172_800.0 => format!("{:+.1} h", by_s / 3600.0),
        _ => format!("{:+.1} days", by_s / 86_400.0),
    };
    format!(
        "this computer's clock was set by {by} while the session was written: its times before and after are not one clock's"
    )
}

impl Record {
    /// The files that this record vouches for.
    pub fn files(&self) -> Vec<&FileDigest> {
        match &self.event {
            Event::Start { session, .. } => vec![session],
            Event::Frame { image, sidecar, .. } => vec![image, sidecar],
            Event::File { file } => vec![file],
            _ => vec![],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::FrameKind;
    use crate::session::Ranked;
    use crate::units::StageAngles;
    use proptest::prelude::*;

    fn example() -> Vec<u8> {
        let events = [
            Event::Start {
                format: FORMAT,
                session: FileDigest::of("session.toml", b"plan"),
            },
            Event::Homed,
            Event::LightStart {
                light: 0,
                azimuth_deg: -12.5,
                elevation_deg: 81.0,
            },
            Event::Frame {
                key: FrameKey::new(0, 3, 1, FrameKind::Ambient),
                image: FileDigest::of("raw/a.png", b"counts"),
                sidecar: FileDigest::of("raw/a.toml", b"sidecar"),
            },
            Event::LightStop { light: 0 },
            Event::Decision(Decision {
                seed: 1,
                is_trusted: true,
                expected_error: 0.07,
                best: Some(Ranked {
                    light: StageAngles::new(-40.0, 35.5),
                    error: 0.05,
                }),
                stop: None,
            }),
            Event::ClockStep { by_s: 1.5e9 },
            Event::Reference {
                off: [0.0125, -1.5],
                suspect: true,
            },
            Event::File {
                file: FileDigest::of("derived/radiance_L000.exr", b"radiance"),
            },
            Event::Interrupted {
                reason: "\"quoted\"\nand broken".into(),
            },
            Event::Resume { quarantined: 2 },
            Event::Paused,
            Event::Continued,
            Event::Stop,
        ];
        events
            .into_iter()
            .enumerate()
            .flat_map(|(number, event)| {
                encode(&Record {
                    number: number as u64,
                    utc: "2026-11-21T02:34:00Z".into(),
                    event,
                })
            })
            .collect()
    }

    #[test]
    fn what_is_written_is_read() {
        let bytes = example();
        let journal = Journal::parse(&bytes).unwrap();
        assert_eq!(journal.records.len(), 14);
        assert_eq!(journal.decisions().count(), 1);
        assert_eq!(journal.spent_s(), 0.0);
        assert_eq!(journal.torn_bytes, 0);
        assert!(journal.is_complete());
        assert_eq!(journal.files().len(), 4);
        let again: Vec<u8> = journal.records.iter().flat_map(encode).collect();
        assert_eq!(again, bytes);
    }

    #[test]
    fn a_clock_that_was_set_is_told() {
        let at = |events: &[(&str, Event)]| {
            let records = events
                .iter()
                .enumerate()
                .map(|(number, (utc, event))| Record {
                    number: number as u64,
                    utc: (*utc).to_owned(),
                    event: event.clone(),
                });
            let records = records.collect();
            let journal = Journal {
                records,
                ..Journal::default()
            };
            journal.clock_step().unwrap_or_default()
        };
        let (early, late) = ("1972-02-01T00:00:00.000Z", "2026-11-21T02:34:00.500Z");
        let homed = |utc| (utc, Event::Homed);
        let set = |by_s| (late, Event::ClockStep { by_s });
        // A resume can come as late as it likes.
        for events in [&[homed(early), homed(late), homed(late)][..], &[]] {
            assert_eq!(at(events), "");
        }
        assert!(at(&[homed(late), homed("2026-11-21T02:34:00.100Z")]).is_empty());
        for (events, by) in [
            (
                &[homed(early), set(2.0), set(-1.728e9)][..],
                "by -20000.0 days",
            ),
            (&[homed(late), set(3.0)], "by +3.0 s"),
            (
                &[homed(late), homed("2026-11-21T01:04:00.500Z")],
                "by -90.0 min",
            ),
        ] {
            assert!(at(events).contains(by), "{}", at(events));
        }
    }

    /// Every bit of every byte, one at a time: never the same records again
    /// unless the reader says that the tail is torn.
    #[test]
    fn no_flipped_bit_is_accepted() {
        let bytes = example();
        let whole = Journal::parse(&bytes).unwrap();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut broken = bytes.clone();
                broken[at] ^= 1 << bit;
                if let Ok(read) = Journal::parse(&broken) {
                    assert_eq!(at, bytes.len() - 1, "byte {at}, bit {bit} was accepted");
                    assert!(read.torn_bytes > 0);
                    assert_eq!(read.records, whole.records[..whole.records.len() - 1]);
                }
            }
        }
    }

    #[test]
    fn lines_lost_doubled_or_exchanged_are_refused() {
        let bytes = example();
        let lines: Vec<&[u8]> = bytes.split_inclusive(|&b| b == b'\n').collect();
        let mut lost = lines.clone();
        lost.remove(3);
        let mut doubled = lines.clone();
        doubled.insert(4, lines[4]);
        let mut exchanged = lines.clone();
        exchanged.swap(2, 5);
        for (name, broken) in [
            ("lost", lost),
            ("doubled", doubled),
            ("exchanged", exchanged),
        ] {
            assert!(Journal::parse(&broken.concat()).is_err(), "{name}");
        }
    }

    proptest! {
        /// Cut anywhere, it gives the records before the cut.
        #[test]
        fn a_torn_journal_gives_its_whole_lines(cut in 0usize..4000) {
            let bytes = example();
            let cut = cut.min(bytes.len());
            let lines = bytes[..cut].iter().filter(|&&b| b == b'\n').count();
            let journal = Journal::parse(&bytes[..cut]).unwrap();
            prop_assert_eq!(journal.records.len(), lines);
            prop_assert_eq!(journal.whole_bytes + journal.torn_bytes, cut as u64);
        }

        /// Bytes replaced anywhere never panic, and never change a record.
        #[test]
        fn a_corrupted_journal_never_gives_another_record(
            at in 0usize..4000,
            garbage in prop::collection::vec(any::<u8>(), 1..40),
        ) {
            let bytes = example();
            let at = at % bytes.len();
            let mut broken = bytes.clone();
            for (old, new) in broken[at..].iter_mut().zip(&garbage) {
                *old = *new;
            }
            let whole = Journal::parse(&bytes).unwrap();
            if let Ok(read) = Journal::parse(&broken) {
                prop_assert_eq!(&read.records[..], &whole.records[..read.records.len()]);
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = Journal::parse(&bytes);
        }
    }
}
