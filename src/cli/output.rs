//! stdout carries data, stderr everything else.
//!
//! A reader that goes away (`rig … | head`) ends the command quietly; a stderr
//! that goes away, or takes nothing any more ([`stderr`]), is no reason to stop,
//! least of all while a lamp is on. The standard `println!` and `eprintln!` panic
//! or wait in these cases, so a lint forbids them here.

use std::fmt::Arguments;
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::Path;

use super::error::CliError;
use super::hints;
use super::stderr::{self, Worth};
use crate::capture::event_lines::json_line;
use crate::shown::escaped;
use crate::whole_file;

/// Writes a line of data to stdout: `out!("{path}")?`.
#[macro_export]
macro_rules! out {
    ($($argument:tt)*) => {
        $crate::cli::output::write_line(format_args!($($argument)*))
    };
}

/// What [`out!`](crate::out) calls. Names and texts of devices are shown [`escaped`], also in
/// a pipe, which may end in a pager.
pub fn write_line(text: Arguments<'_>) -> Result<(), CliError> {
    write_bytes(format!("{}\n", escaped(&text.to_string())).as_bytes())
}

/// A line that is a path and nothing else. A program that reads it gets the path's own bytes,
/// so that it finds the file; a terminal gets it [`escaped`].
pub fn write_path(path: &Path) -> Result<(), CliError> {
    if std::io::stdout().is_terminal() {
        return write_line(format_args!("{}", path.display()));
    }
    write_bytes(&[path.as_os_str().as_encoded_bytes(), b"\n"].concat())
}

/// Writes data as it is to stdout.
pub fn write_bytes(bytes: &[u8]) -> Result<(), CliError> {
    stderr::flush_in_order();
    let mut stdout = std::io::stdout().lock();
    stdout
        .write_all(bytes)
        .and_then(|()| stdout.flush())
        .map_err(stdout_error)
}

/// Refuses a file whose name has not this ending: one of another kind would be replaced by a
/// slip, and programs that rely on endings would not read it.
pub fn check_ending(path: &Path, ending: &str) -> Result<(), CliError> {
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(ending))
    {
        return Ok(());
    }
    let fact = format!(
        "{}: the name of such a file ends in .{ending}",
        path.display()
    );
    let named = path.with_extension(ending);
    Err(CliError::new(fact).hint(format!("name it {}", named.display())))
}

/// Refuses, before the work, a file that could not be written after it.
pub fn check_writable(path: &Path) -> Result<(), CliError> {
    whole_file::check_writable(path).map_err(|error| unwritable(path, &error))
}

/// A result that cannot be written, with advice by its cause.
pub fn unwritable(path: &Path, error: &std::io::Error) -> CliError {
    CliError::new(format!("{}: {error}", path.display())).hint(hints::unwritable(error))
}

/// Writes `value` as indented JSON and a line end to stdout.
pub fn write_json(value: &impl serde::Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value)?;
    write_bytes(json_line(&text).as_bytes())
}

/// Writes text to stderr without waiting; a closed stderr is ignored.
pub fn write_stderr(text: &str) {
    stderr::write(text, Worth::Remark);
}

fn stdout_error(error: std::io::Error) -> CliError {
    if error.kind() == ErrorKind::BrokenPipe {
        CliError::stdout_closed()
    } else {
        CliError::new(format!("stdout: {error}"))
            .hint("send the output elsewhere; what the command did is done")
    }
}
