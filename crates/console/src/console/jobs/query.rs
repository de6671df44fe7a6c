//! Short commands of the program whose JSON the page shows.

use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;

/// What a command may print (bytes).
const LONGEST_OUTPUT: u64 = 8 << 20;
/// What of its messages is read (bytes).
const LONGEST_MESSAGES: u64 = 256 << 10;
/// How often is looked whether it has ended.
const POLL: Duration = Duration::from_millis(10);

/// Why a command gave no answer.
#[derive(Debug, thiserror::Error)]
pub enum QueryError {
    /// It did not begin.
    #[error("rig {command}: {source}")]
    Begin {
        /// Its first argument.
        command: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// It did not begin: too many wait.
    #[error("too many pages wait for the program")]
    Many,
    /// It was ended.
    #[error("rig {command} did not end within {limit_s} s")]
    Slow {
        /// Its first argument.
        command: String,
        /// What it may take.
        limit_s: u64,
    },
    /// It failed and stated why.
    #[error("{fact}")]
    Failed {
        /// The fact.
        fact: String,
        /// Its advice.
        hint: Option<String>,
    },
}

/// What a command printed.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// On stdout.
    pub value: Value,
    /// The fact and the advice on stderr, where it failed nevertheless.
    pub failure: Option<(String, Option<String>)>,
}

/// Runs the program with these arguments and this text on stdin, for so long at most.
///
/// # Errors
/// If it does not begin or end in time, or prints no JSON.
pub fn query(
    program: &Path,
    arguments: &[OsString],
    stdin: &[u8],
    limit: Duration,
) -> Result<Answer, QueryError> {
    let command = arguments
        .first()
        .map_or_else(String::new, |first| first.to_string_lossy().into_owned());
    let failed = |source| QueryError::Begin {
        command: command.clone(),
        source,
    };
    let mut child = Command::new(program)
        .args(arguments)
        .env("NO_COLOR", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(failed)?;
    // Threads that end with the pipes.
    let text = stdin.to_vec();
    let input = child.stdin.take();
    std::thread::spawn(move || input.map(|mut input| drop(input.write_all(&text))));
    let output = read(child.stdout.take(), LONGEST_OUTPUT);
    let messages = read(child.stderr.take(), LONGEST_MESSAGES);
    let status = match end(&mut child, limit).map_err(failed)? {
        Some(status) => status,
        None => {
            let limit_s = limit.as_secs();
            return Err(QueryError::Slow { command, limit_s });
        }
    };
    let output = output.join().unwrap_or_default();
    let messages = messages.join().unwrap_or_default();
    let stated = || {
        let (fact, hint) = stated(&String::from_utf8_lossy(&messages));
        let silent = || format!("rig {command} ended with {status}");
        (fact.unwrap_or_else(silent), hint)
    };
    match serde_json::from_slice(&output) {
        Ok(value) => Ok(Answer {
            value,
            failure: (!status.success()).then(stated),
        }),
        Err(_) => {
            let (fact, hint) = stated();
            Err(QueryError::Failed { fact, hint })
        }
    }
}

/// All that comes, in a thread.
fn read(stream: Option<impl Read + Send + 'static>, most: u64) -> JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(stream) = stream {
            let _ = stream.take(most).read_to_end(&mut bytes);
        }
        bytes
    })
}

/// How it ended; `None` if it had to be.
fn end(child: &mut Child, limit: Duration) -> std::io::Result<Option<std::process::ExitStatus>> {
    let latest = Instant::now() + limit;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if Instant::now() >= latest {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(POLL);
    }
}

/// The last fact and the last advice among the messages of a command.
pub fn stated(messages: &str) -> (Option<String>, Option<String>) {
    let last = |mark: &str| {
        let mut lines = messages.lines().rev();
        lines
            .find_map(|line| line.strip_prefix(mark))
            .map(str::to_owned)
    };
    (last("error: "), last("hint: "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str, stdin: &str, limit: Duration) -> Result<Answer, QueryError> {
        let arguments = ["-c", script].map(OsString::from);
        query(Path::new("/bin/sh"), &arguments, stdin.as_bytes(), limit)
    }

    const LONG: Duration = Duration::from_secs(60);

    #[test]
    fn json_is_the_answer_also_of_a_command_that_fails() {
        let answer = shell("cat", "{\"a\": 1}", LONG).unwrap();
        assert_eq!((&answer.value["a"], &answer.failure), (&1.into(), &None));
        let script = "echo '[]'; printf 'error: 2 checks failed\\n\\nhint: look\\n' >&2; exit 1";
        let failure = shell(script, "", LONG).unwrap().failure.unwrap();
        assert_eq!(failure, ("2 checks failed".into(), Some("look".into())));
    }

    #[test]
    fn a_command_without_json_or_end_is_an_error() {
        let error = shell("echo 'error: no such rig' >&2; exit 1", "", LONG).unwrap_err();
        assert_eq!(error.to_string(), "no such rig");
        let error = shell("exit 3", "", LONG).unwrap_err();
        assert_eq!(error.to_string(), "rig -c ended with exit status: 3");
        let began = Instant::now();
        let error = shell("exec sleep 60", "", Duration::from_millis(50)).unwrap_err();
        assert!(matches!(error, QueryError::Slow { .. }), "{error}");
        assert!(began.elapsed() < Duration::from_secs(30));
        let error = query(Path::new("/nonexistent"), &["doctor".into()], b"", LONG);
        assert!(error.unwrap_err().to_string().starts_with("rig doctor: "));
    }
}
