//! Why a program cannot be run, found from its file.

use std::fs::Metadata;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{Access, access};
use rustix::io::Errno;

use crate::device::ProgramFault;

/// A first line that is longer names no interpreter: the kernel reads 256 bytes.
const LONGEST_FIRST_LINE: u64 = 256;
/// Bytes that a binary begins with.
const ELF: &[u8] = b"\x7fELF";
/// A shell's and `env`'s exit code for what they cannot find, and the loader's.
const NOT_FOUND: i32 = 127;

/// Why the program of this name could not be run, from what starting it met.
/// `None`: not because of its file.
pub fn fault_of(name: &str, error: &std::io::Error) -> Option<ProgramFault> {
    let is_of_the_file = matches!(
        error.kind(),
        ErrorKind::NotFound | ErrorKind::PermissionDenied | ErrorKind::NotADirectory
    );
    let is_no_program = Errno::from_io_error(error) == Some(Errno::NOEXEC);
    if !is_of_the_file && !is_no_program {
        return None;
    }
    Some(fault(name).unwrap_or(match error.kind() {
        ErrorKind::NotFound => ProgramFault::NoLoader,
        _ if is_no_program => ProgramFault::NotAProgram,
        _ => ProgramFault::Denied,
    }))
}

/// Why a program that ran ended with this code without having begun its work, where its
/// file or its last lines show.
pub fn fault_at_end(name: &str, code: i32, said: &str) -> Option<ProgramFault> {
    let is_of_loader = [
        "error while loading shared libraries",
        "symbol lookup error",
    ]
    .iter()
    .any(|words| said.contains(words));
    if code == NOT_FOUND && is_of_loader {
        return Some(ProgramFault::NoLibrary {
            said: said.to_owned(),
        });
    }
    // `env` was found, and then not what the line names after it.
    let fault = fault(name)?;
    matches!(fault, ProgramFault::WindowsLineEnds { .. }).then_some(fault)
}

/// What is wrong with the file of this program, as far as that shows without running it.
pub fn fault(name: &str) -> Option<ProgramFault> {
    let looked_in_path = !name.contains('/');
    let Some((path, meta)) = found(name) else {
        return Some(ProgramFault::Missing { looked_in_path });
    };
    if meta.is_dir() {
        return Some(ProgramFault::Folder);
    }
    let mode = meta.permissions().mode() & 0o7777;
    if mode & 0o111 == 0 {
        return Some(ProgramFault::NotExecutable { mode });
    }
    if access(&path, Access::EXEC_OK).is_err() {
        return Some(match mode & 0o111 {
            0o111 => ProgramFault::Denied,
            _ => ProgramFault::NotExecutable { mode },
        });
    }
    let line = first_line(&path)?;
    if line.starts_with(ELF) {
        return None;
    }
    let Some(interpreter) = line.strip_prefix(b"#!") else {
        return Some(ProgramFault::NotAProgram);
    };
    let text = String::from_utf8_lossy(interpreter);
    let text = text.trim_end_matches('\n').trim_start_matches([' ', '\t']);
    let interpreter = text.split([' ', '\t']).next().unwrap_or("").to_owned();
    if text.ends_with('\r') {
        return Some(ProgramFault::WindowsLineEnds { interpreter });
    }
    let can_run = access(Path::new(&interpreter), Access::EXEC_OK).is_ok();
    (!can_run).then_some(ProgramFault::NoInterpreter { interpreter })
}

/// The file that is meant, as a shell finds it: of several in `PATH`, the first that may
/// be executed.
fn found(name: &str) -> Option<(PathBuf, Metadata)> {
    let with_meta = |path: PathBuf| {
        let meta = std::fs::metadata(&path).ok()?;
        Some((path, meta))
    };
    if name.contains('/') {
        return with_meta(name.into());
    }
    let paths = std::env::var_os("PATH").unwrap_or_default();
    let all: Vec<_> = std::env::split_paths(&paths)
        .filter_map(|folder| with_meta(folder.join(name)))
        .filter(|(_, meta)| meta.is_file())
        .collect();
    let runs = |(path, _): &(PathBuf, Metadata)| access(path, Access::EXEC_OK).is_ok();
    let first = all.iter().position(runs).unwrap_or(0);
    all.into_iter().nth(first)
}

fn first_line(path: &Path) -> Option<Vec<u8>> {
    let file = crate::outside_file::open_regular(path).ok()?;
    let mut line = Vec::new();
    let mut reader = BufReader::new(file.take(LONGEST_FIRST_LINE));
    reader.read_until(b'\n', &mut line).ok()?;
    Some(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &Path, bytes: &[u8], mode: u32) -> String {
        let path = folder.join("program");
        drop(std::fs::remove_file(&path));
        std::fs::write(&path, bytes).unwrap();
        std::fs::set_permissions(&path, PermissionsExt::from_mode(mode)).unwrap();
        path.display().to_string()
    }

    #[test]
    fn the_file_tells_why_it_does_not_run() {
        let folder = tempfile::tempdir().unwrap();
        let of = |bytes: &[u8], mode| fault(&file(folder.path(), bytes, mode));
        let interpreter = |name: &str| name.to_owned();
        for (bytes, mode, expected) in [
            (&b"#!/bin/sh\nexit"[..], 0o755, None),
            (b"#! /bin/sh -e\n", 0o755, None),
            (b"#!/usr/bin/env sh\n", 0o755, None),
            (
                b"#!/bin/sh\n",
                0o644,
                Some(ProgramFault::NotExecutable { mode: 0o644 }),
            ),
            (
                b"#!/bin/sh\r\nexit\r\n",
                0o755,
                Some(ProgramFault::WindowsLineEnds {
                    interpreter: interpreter("/bin/sh\r"),
                }),
            ),
            (
                b"#!/usr/bin/env python3\r\n",
                0o755,
                Some(ProgramFault::WindowsLineEnds {
                    interpreter: interpreter("/usr/bin/env"),
                }),
            ),
            (
                b"#!/no/such/python\n",
                0o755,
                Some(ProgramFault::NoInterpreter {
                    interpreter: interpreter("/no/such/python"),
                }),
            ),
            (
                b"\xef\xbb\xbf#!/bin/sh\n",
                0o755,
                Some(ProgramFault::NotAProgram),
            ),
            (b"MZ\x90\0", 0o755, Some(ProgramFault::NotAProgram)),
        ] {
            assert_eq!(of(bytes, mode), expected, "{}", bytes.escape_ascii());
        }
        let path = folder.path().display().to_string();
        assert_eq!(fault(&path), Some(ProgramFault::Folder));
        let missing = |looked_in_path| Some(ProgramFault::Missing { looked_in_path });
        assert_eq!(fault(&format!("{path}/none")), missing(false));
        assert_eq!(fault("no-such-program-anywhere"), missing(true));
        assert_eq!(fault("sh"), None);
    }

    #[test]
    fn what_was_met_tells_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        let elf = file(folder.path(), b"\x7fELF\x02\x01\x01", 0o755);
        let error = |errno: Errno| std::io::Error::from(errno);
        let of = |errno| fault_of(&elf, &error(errno));
        assert_eq!(of(Errno::NOENT), Some(ProgramFault::NoLoader));
        assert_eq!(of(Errno::NOEXEC), Some(ProgramFault::NotAProgram));
        assert_eq!(of(Errno::ACCESS), Some(ProgramFault::Denied));
        assert_eq!(of(Errno::NOMEM), None);
        let said = "cam: error while loading shared libraries: libcam.so.3: cannot open";
        assert!(matches!(
            fault_at_end(&elf, 127, said),
            Some(ProgramFault::NoLibrary { .. })
        ));
        assert_eq!(fault_at_end(&elf, 3, said), None);
        assert_eq!(fault_at_end(&elf, 127, "sh: cam: not found"), None);
        let script = file(folder.path(), b"#!/usr/bin/env sh\r\n", 0o755);
        assert!(fault_at_end(&script, 127, "").is_some());
    }
}
