//! Command lines as a person can copy them into a shell.

use std::ffi::OsStr;

/// The program's name and the arguments, each quoted where a POSIX shell needs it.
pub fn shown(program: &str, arguments: &[impl AsRef<OsStr>]) -> String {
    let arguments = arguments
        .iter()
        .map(|a| quoted(&a.as_ref().to_string_lossy()));
    std::iter::once(quoted(program))
        .chain(arguments)
        .collect::<Vec<_>>()
        .join(" ")
}

fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=+./,:@%".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    // Within single quotes only a single quote is special.
    format!("'{}'", text.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn a_shell_reads_the_same_arguments() {
        let arguments = [
            "capture",
            "--sample=it's $(touch x); `id` \\ \"a\" *\n~",
            "--out=my sessions",
            "",
            "--light=40,35",
            "Größe",
        ];
        let line = shown("printf", &[&["%s\\0"], &arguments[..]].concat());
        assert!(
            line.contains(" capture ") && line.contains(" --light=40,35 "),
            "{line}"
        );
        let output = Command::new("sh").args(["-c", &line]).output().unwrap();
        let expected: String = arguments.map(|argument| format!("{argument}\0")).concat();
        assert_eq!(String::from_utf8(output.stdout).unwrap(), expected);
    }
}
