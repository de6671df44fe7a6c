//! `rig session`: is a session whole, and what does it hold?

use std::path::{Path, PathBuf};

use serde_json::json;

use super::context::Context;
use super::error::CliError;
use super::output::{write_json, write_line, write_path};
use crate::out;
use crate::session::archive;
use crate::session::layout;
use crate::session::verify::{LightState, Summary, verify};
use crate::session::{Session, SessionError};
use crate::shown::excerpt;
use crate::shown::nth;

/// Checks sessions and lists what they hold.
#[derive(clap::Args, Debug)]
pub struct SessionArgs {
    #[command(subcommand)]
    command: SessionCommand,
}

#[derive(clap::Subcommand, Debug)]
enum SessionCommand {
    /// Compares every byte with the journal's checksums
    ///
    /// Exit code 1 if a file is missing, changed or unknown. An interrupted
    /// session can be intact.
    Verify(VerifyArgs),
    /// Lists the lights of a session
    List(ListArgs),
    /// Writes a session into one file (tar), which another machine verifies and unpacks
    ///
    /// The same bytes for the same session; what the journal does not know is left out.
    Pack(PackArgs),
    /// Makes a session's folder of such a file, which is checked first
    Unpack(UnpackArgs),
}

#[derive(clap::Args, Debug)]
struct PackArgs {
    /// The session's folder
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// The file to write (default: the session's name with .tar, here)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(clap::Args, Debug)]
struct UnpackArgs {
    /// The file that `rig session pack` wrote
    #[arg(value_name = "FILE")]
    archive: PathBuf,
    /// The session's folder to make (default: the file's name without .tar, here)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(clap::Args, Debug)]
struct VerifyArgs {
    /// The session's folder, or the file that `rig session pack` made of it
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// The findings as JSON
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args, Debug)]
struct ListArgs {
    /// The session's folder
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// The list as JSON
    #[arg(long)]
    json: bool,
}

/// `rig session`.
pub fn run(args: &SessionArgs, context: &Context) -> Result<(), CliError> {
    match &args.command {
        SessionCommand::Verify(args) => run_verify(args),
        SessionCommand::List(args) => list_lights(&args.session, args.json),
        SessionCommand::Pack(args) => run_pack(args, context),
        SessionCommand::Unpack(args) => run_unpack(args),
    }
}

fn run_pack(args: &PackArgs, context: &Context) -> Result<(), CliError> {
    let here = || {
        let root = std::path::absolute(&args.session)?;
        let mut name = root.file_name().unwrap_or_default().to_owned();
        name.push(".tar");
        Ok::<_, std::io::Error>(PathBuf::from(name))
    };
    let out = match &args.out {
        Some(out) => out.clone(),
        None => here()?,
    };
    let packed = archive::pack(&args.session, &out)?;
    if let [first, more @ ..] = &*packed.strays {
        let more = match more.len() {
            0 => String::new(),
            count => format!(" and {count} more"),
        };
        context.note(format_args!(
            "{}{more} left out: in no journal record",
            first.display()
        ));
    }
    write_path(&out)
}

fn run_unpack(args: &UnpackArgs) -> Result<(), CliError> {
    let out = match (&args.out, args.archive.file_stem()) {
        (Some(out), _) => out.clone(),
        (None, Some(stem)) => PathBuf::from(stem),
        (None, None) => return Err(CliError::new("the file has no name")),
    };
    archive::unpack(&args.archive, &out)?;
    write_path(&out)
}

fn run_verify(args: &VerifyArgs) -> Result<(), CliError> {
    let found = match args.session.is_file() {
        true => archive::check(&args.session)?,
        false => verify(&args.session)?,
    };
    if args.json {
        write_json(&found.stated_of(&args.session))?;
    } else {
        found.lines().iter().try_for_each(|line| out!("{line}"))?;
    }
    let can_be_made_again = found.problems.iter().all(|p| is_derived(p, &args.session));
    if let Some(problem) = found.problems.into_iter().next() {
        let error = CliError::from(problem);
        return Err(if can_be_made_again {
            error.hint("the raw frames are whole: `rig capture --resume SESSION` makes merged images and the manifest again, `rig fit` fits, `rig report` the report")
        } else {
            error
        });
    }
    if found.strays.is_empty() && found.torn_bytes == 0 {
        return Ok(());
    }
    let session = args.session.display();
    Err(
        CliError::new(format!("{session} holds what its journal does not know")).hint(
            "`rig capture --resume SESSION` sets such files aside and goes on; journalled files are whole",
        ),
    )
}

/// Whether what is damaged or gone can be made from the raw frames.
fn is_derived(problem: &SessionError, root: &Path) -> bool {
    problem
        .damaged_file()
        .and_then(|path| path.strip_prefix(root).ok())
        .is_some_and(|relative| layout::is_derived(&relative.to_string_lossy()))
}

fn list_lights(root: &Path, as_json: bool) -> Result<(), CliError> {
    let session = Session::open(root)?;
    let lights: Vec<_> = session.lights().collect();
    let summary = session.summary();
    if as_json {
        return write_json(&json!({ "summary": summary, "lights": lights }));
    }
    print(&summary)?;
    for LightState {
        light,
        angles,
        frames,
        finished,
    } in lights
    {
        let state = if finished { "finished" } else { "open" };
        out!(
            "  {light}: {angles}: {frames} frames, {state}",
            light = nth("light", light)
        )?;
    }
    Ok(())
}

fn print(summary: &Summary) -> Result<(), CliError> {
    let state = if summary.complete {
        "complete"
    } else {
        "interrupted"
    };
    let simulated = if summary.simulated { ", simulated" } else { "" };
    let suspect = if summary.suspect { ", suspect" } else { "" };
    let clocks = if summary.clock_step {
        ", times not of one clock"
    } else {
        ""
    };
    write_line(format_args!(
        "{}  {}, {} of {} lights, {} frames, {state}{simulated}{suspect}{clocks}",
        summary.session.display(),
        excerpt(&summary.sample),
        summary.lights_finished,
        summary.lights_planned,
        summary.frames
    ))
}
