//! Serial numbers of one body. Its maker has several for it: Canon's bodies report one of 32
//! hexadecimal digits over PTP (`serialnumber`) and the printed one as `eosserialnumber`, which
//! their raw files have too; Nikon's and Sony's fill the printed one up with zeros; Fujifilm's
//! report another than they print.

/// A serial number without what fills it up; `None`: it is none.
fn bare(text: &str) -> Option<String> {
    // Old Nikon files have `NO= ` before it.
    let text = text.trim();
    let number = text.strip_prefix("NO=").unwrap_or(text).trim();
    let number = number.trim_start_matches('0');
    (!number.is_empty()).then(|| number.to_ascii_uppercase())
}

/// Whether both are one number.
pub(super) fn is_same(a: &str, b: &str) -> bool {
    bare(a).is_some_and(|a| bare(b) == Some(a))
}

/// Whether both are of one kind, printed numbers of as many digits, and differ: then they are
/// of two bodies. Numbers of two kinds tell nothing of each other.
fn is_other(a: &str, b: &str) -> bool {
    let is_number = |text: &String| text.bytes().all(|byte| byte.is_ascii_digit());
    match (bare(a), bare(b)) {
        (Some(a), Some(b)) => is_number(&a) && is_number(&b) && a.len() == b.len() && a != b,
        _ => false,
    }
}

/// All that is known of one body's serial numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Serials {
    /// As the body reports them, the printed one first, and the rig file's.
    pub(super) of_body: Vec<String>,
    /// In its raw files; `None`: none of them stated one yet.
    pub(super) of_files: Option<String>,
}

/// Whether one of them is one of these.
pub(super) fn is_any(serials: &[String], wanted: &[String]) -> bool {
    let is_wanted = |is: &String| wanted.iter().any(|wanted| is_same(is, wanted));
    serials.iter().any(is_wanted)
}

impl Serials {
    /// Notes what a raw file states. All files of a body state the same; the first may state
    /// another number than the body reports.
    ///
    /// # Errors
    /// The number that was expected.
    pub(super) fn note_file(&mut self, stated: &str) -> Result<(), String> {
        if bare(stated).is_none() {
            return Ok(());
        }
        if let Some(before) = &self.of_files {
            return match is_same(before, stated) {
                true => Ok(()),
                false => Err(before.clone()),
            };
        }
        let differs = |is: &&String| is_other(is, stated);
        if !is_any(&self.of_body, &[stated.to_owned()])
            && let Some(other) = self.of_body.iter().find(differs)
        {
            return Err(other.clone());
        }
        self.of_files = Some(stated.to_owned());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_one_body_are_one() {
        let canon = "6e1c42d90fab4c3e8d27b5a1907f3c64";
        // What the body reports, its first file, whether that can be, and the next file.
        for (of_body, file, can_be, next, stays) in [
            (vec!["12345678", canon], "12345678", true, "12345678", true),
            (vec!["12345678", canon], "12345679", false, "", true),
            (vec![canon], "12345678", true, "12345679", false),
            (
                vec!["00000000000012345678"],
                "12345678",
                true,
                "0012345678",
                true,
            ),
            (vec!["6012345"], "NO= 06012345", true, "6012346", false),
            // Fujifilm: text in hexadecimal digits, and the printed one.
            (
                vec!["5932363036160F2B4C20DA0C4B7C"],
                "42001234",
                true,
                "42001235",
                false,
            ),
            // Neither states one, and then a file does.
            (vec![], "", true, "12345678", true),
            (vec![], "12345678", true, "87654321", false),
            (vec!["00000000"], "12345678", true, "", true),
        ] {
            let of_body = of_body.into_iter().map(str::to_owned).collect();
            let mut serials = Serials {
                of_body,
                of_files: None,
            };
            let noted = serials.note_file(file);
            assert_eq!(noted.is_ok(), can_be, "{serials:?} {file}");
            if can_be {
                assert_eq!(serials.note_file(next).is_ok(), stays, "{serials:?} {next}");
            }
        }
        assert!(!is_same("0000", "0") && !is_same("", ""));
    }
}
