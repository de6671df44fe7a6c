//! `rig completions` and `rig man`: completion scripts and manual pages,
//! generated from the command line's own definition.

use std::path::PathBuf;

use super::output::{write_bytes, write_path};
use super::{CliError, Context, definition};

/// Prints a shell's completion script
///
/// For bash: `rig completions bash > ~/.local/share/bash-completion/completions/rig`.
#[derive(clap::Args, Debug)]
pub struct CompletionsArgs {
    /// The shell that will read the script
    shell: clap_complete::Shell,
}

/// Writes the manual pages
#[derive(clap::Args, Debug)]
pub struct ManArgs {
    /// Folder that receives rig.1, rig-doctor.1, …; made if it is missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// `rig completions`.
pub fn run(args: &CompletionsArgs, _: &Context) -> Result<(), CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut definition(), "rig", &mut script);
    write_bytes(&script)
}

/// `rig man`.
pub fn run_man(args: &ManArgs, _: &Context) -> Result<(), CliError> {
    let failed = |error: std::io::Error| {
        CliError::new(format!("{}: {error}", args.out.display()))
            .hint("choose another folder with --out")
    };
    std::fs::create_dir_all(&args.out).map_err(failed)?;
    clap_mangen::generate_to(definition(), &args.out).map_err(failed)?;
    write_path(&args.out)
}
