//! Command lines as a person can copy them into a shell, and options as a person writes them
//! there.

use std::ffi::OsStr;

/// The program's name and the arguments, each quoted where a POSIX shell needs it.
pub fn command_line(program: &str, arguments: &[impl AsRef<OsStr>]) -> String {
    let arguments = arguments
        .iter()
        .map(|a| quoted(&a.as_ref().to_string_lossy()));
    std::iter::once(quoted(program))
        .chain(arguments)
        .collect::<Vec<_>>()
        .join(" ")
}

/// One argument, quoted where a POSIX shell needs it: fewer than a library quotes, because
/// people read it.
pub fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=+./,:@%".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    // Within single quotes only a single quote is special.
    format!("'{}'", text.replace('\'', "'\\''"))
}

/// The words of a text as a POSIX shell splits it, without expansions: at blanks, with single
/// quotes, double quotes and backslashes. `None` where a quote or a backslash is left open.
///
/// ```
/// use rig_setup::shell_words::split;
/// let words = split("--mask 'my mask.png' --seed 3").unwrap();
/// assert_eq!(words, ["--mask", "my mask.png", "--seed", "3"]);
/// assert_eq!(split("--mask 'my"), None);
/// ```
pub fn split(text: &str) -> Option<Vec<String>> {
    shlex::split(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    const ARGUMENTS: [&str; 6] = [
        "capture",
        "--sample=it's $(touch x); `id` \\ \"a\" *\n~",
        "--out=my sessions",
        "",
        "--light=40,35",
        "Größe",
    ];

    /// The words that a shell makes of a text.
    fn by_shell(text: &str) -> String {
        let line = format!("printf '%s\\0' {text}");
        let output = Command::new("sh").args(["-c", &line]).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    }

    #[test]
    fn a_shell_reads_the_same_arguments() {
        let line = command_line("printf", &[&["%s\\0"], &ARGUMENTS[..]].concat());
        assert!(
            line.contains(" capture ") && line.contains(" --light=40,35 "),
            "{line}"
        );
        let output = Command::new("sh").args(["-c", &line]).output().unwrap();
        let expected: String = ARGUMENTS.map(|argument| format!("{argument}\0")).concat();
        assert_eq!(String::from_utf8(output.stdout).unwrap(), expected);
    }

    #[test]
    fn words_are_those_of_a_shell() {
        let quoted = command_line("x", &ARGUMENTS);
        let texts = [
            quoted.as_str(),
            "--seed 3",
            "  a\t b  ",
            "a'b c'd",
            r#""a \" \\ \x b"c"#,
            r"a\ b \'c",
            "''",
            "a'' ''b",
        ];
        for text in texts {
            let words = split(text).unwrap();
            let joined: String = words.iter().map(|word| format!("{word}\0")).collect();
            assert_eq!(joined, by_shell(text), "{text}");
        }
        assert_eq!(split(" "), Some(Vec::new()));
        for open in ["'a", "\"a", "a\\"] {
            assert_eq!(split(open), None, "{open}");
        }
    }
}
