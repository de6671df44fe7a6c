//! `rig init`: a rig file of the operator's own, from what is connected and what is asked.

use std::io::{BufRead, IsTerminal, Read, stdin};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::context::Context;
use super::error::{CliError, HintExt};
use super::output::{unwritable, write_json, write_path, write_stderr};
use crate::config::RIG_FILE;
use crate::config::draft::{
    Answers, DraftError, Found, Interviewee, Question, Step, interview, questions, write,
};
use crate::shown::escaped;
use crate::{outside_file, whole_file};

/// Answers are short; anything larger is another file.
const LARGEST_ANSWERS_BYTES: u64 = 1 << 20;

/// Writes a rig file for your own bench: finds cameras and stages, asks for the rest, and says
/// what to calibrate next
///
/// Nothing is opened, moved or lit. Press Enter for the answer in brackets; Ctrl-C leaves
/// nothing behind. A file that exists is never replaced.
#[derive(clap::Args, Debug)]
pub struct InitArgs {
    /// The rig file to write
    #[arg(long, value_name = "FILE", default_value = RIG_FILE)]
    out: PathBuf,
    /// Lists the questions, with what is connected as choices, and writes nothing (needs --json)
    #[arg(long, requires = "json", conflicts_with = "answers")]
    questions: bool,
    /// Answers as a JSON object by key, from a file or from standard input (-), instead of
    /// questions at the terminal; what is not answered takes its default
    #[arg(long, value_name = "FILE")]
    answers: Option<PathBuf>,
    /// The file and the next steps as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    file: String,
    next: Vec<&'a str>,
    steps: &'a [Step],
}

/// `rig init`.
pub fn run(args: &InitArgs, context: &Context) -> Result<(), CliError> {
    let (found, failed) = Found::look();
    for (driver, error) in &failed {
        context.warn(format!(
            "cameras of the driver {driver} could not be listed: {error}"
        ));
    }
    let questions = questions(&found);
    if args.questions {
        return write_json(&questions);
    }
    // Before the operator answers what could not be kept.
    check_free(&args.out)?;
    let written = match &args.answers {
        Some(file) => {
            let answers = read_answers(file)?;
            write(&questions, &found, &answers, &args.out).map_err(advised)?
        }
        None => {
            let terminal = Terminal::new()?;
            context.note(format_args!(
                "This makes {}. Enter takes the answer in brackets, Ctrl-C ends without a file.",
                args.out.display()
            ));
            interview(&questions, &found, &args.out, &terminal)?
        }
    };
    whole_file::create(&args.out, written.text.as_bytes())
        .map_err(|error| not_created(&args.out, &error))?;
    if args.json {
        let next = written.next.iter().map(|step| step.command.as_str());
        return write_json(&Report {
            file: args.out.display().to_string(),
            next: next.collect(),
            steps: &written.next,
        });
    }
    list_steps(&written.next, context);
    write_path(&args.out)
}

fn list_steps(steps: &[Step], context: &Context) {
    context.note_lines([
        "",
        "Next, in this order; replace the words in capitals. docs/calibration.md explains each step.",
    ]);
    for (i, step) in steps.iter().enumerate() {
        context.note_lines([
            format!("{:>3}. {}", i + 1, step.command),
            format!("     {}", step.purpose),
        ]);
    }
}

/// Refuses a file that exists, or could not be made.
fn check_free(path: &Path) -> Result<(), CliError> {
    if path.symlink_metadata().is_ok() {
        return Err(not_created(path, &std::io::ErrorKind::AlreadyExists.into()));
    }
    whole_file::check_writable(path).map_err(|error| unwritable(path, &error))
}

fn not_created(path: &Path, error: &std::io::Error) -> CliError {
    match error.kind() {
        std::io::ErrorKind::AlreadyExists => CliError::new(format!("{} exists", path.display()))
            .hint("name another file with --out; a rig file is never replaced"),
        _ => unwritable(path, error),
    }
}

fn read_answers(file: &Path) -> Result<Answers, CliError> {
    let bytes = if file == Path::new("-") {
        let mut bytes = Vec::new();
        let read = stdin()
            .lock()
            .take(LARGEST_ANSWERS_BYTES)
            .read_to_end(&mut bytes);
        read.map_err(|error| CliError::new(format!("standard input: {error}")))?;
        bytes
    } else {
        outside_file::read_regular(file, LARGEST_ANSWERS_BYTES)
            .map_err(|error| CliError::new(format!("{}: {error}", file.display())))
            .hint("name the file of answers, or - for standard input")?
    };
    serde_json::from_slice(&bytes)
        .map_err(|error| CliError::new(format!("{}: not an object of answers: {error}", file.display())))
        .hint("answers are a JSON object such as {\"name\": \"arm\", \"width_px\": 1920}; `rig init --questions --json` lists the keys")
}

fn advised(error: DraftError) -> CliError {
    match error {
        DraftError::Answer(error) => {
            CliError::new(error).hint("`rig init --questions --json` lists every question with its range; nothing was written")
        }
        DraftError::Config(error) => error.into(),
    }
}

/// The operator at the terminal.
struct Terminal;

impl Terminal {
    fn new() -> Result<Self, CliError> {
        if stdin().is_terminal() && std::io::stderr().is_terminal() {
            return Ok(Self);
        }
        Err(
            CliError::new("the questions need a terminal, and stdin or stderr is none")
                .hint("run it in a terminal, or give a file of answers with --answers"),
        )
    }
}

impl Interviewee for Terminal {
    type Error = CliError;

    fn show(&self, question: &Question) {
        write_stderr(&shown(question));
    }

    fn answer(&self, question: &Question) -> Result<String, CliError> {
        write_stderr(&format!("  {} ", escaped(&question.prompt())));
        let mut line = Vec::new();
        let read = stdin().lock().read_until(b'\n', &mut line);
        if !read.is_ok_and(|bytes| bytes > 0) {
            return Err(
                CliError::new("the input ended before all questions were answered").hint(
                    "nothing was written; run it again and answer each, Enter takes the default",
                ),
            );
        }
        // Bytes of another encoding are no reason to lose the answers before.
        Ok(String::from_utf8_lossy(&line).into_owned())
    }

    fn refuse(&self, fault: &str) {
        write_stderr(&format!("  {}\n", escaped(fault)));
    }
}

/// A question with its explanation and its choices.
fn shown(question: &Question) -> String {
    let mut text = format!("\n{}\n  {}\n", question.title, question.help);
    for (i, choice) in question.choices.iter().enumerate() {
        text += &format!("  {:>2}  {}\n", i + 1, escaped(&choice.label));
    }
    text
}
