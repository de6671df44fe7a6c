//! What commands that print a job array have in common.

use super::{CliError, HintExt};

/// What each task of a job array may have.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Resources of a task of Slurm")]
pub struct SlurmArgs {
    /// Processors of a task, 1 to 1024 (default 1: jobs are independent)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    cpus: Option<u16>,
    /// Memory of a task, MiB (default: what the work is expected to need, and a half more)
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(16..=1_048_576))]
    task_memory: Option<u64>,
    /// Longest time of a task, minutes (default: thrice what is expected)
    #[arg(long, value_name = "MIN", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    time: Option<u64>,
}

impl SlurmArgs {
    /// Processors of a task.
    pub fn cpus(&self) -> Option<usize> {
        self.cpus.map(usize::from)
    }

    /// Memory of a task, MiB.
    pub fn memory_mib(&self) -> Option<u64> {
        self.task_memory
    }

    /// Longest time of a task, minutes.
    pub fn minutes(&self) -> Option<u64> {
        self.time
    }
}

/// This program, as the nodes find it.
pub fn program() -> Result<String, CliError> {
    let path = std::env::current_exe().hint("install the program where every node finds it")?;
    Ok(path.to_string_lossy().into_owned())
}
