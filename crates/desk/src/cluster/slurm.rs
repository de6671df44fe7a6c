//! Job arrays of the Slurm workload manager, as a shell script that submits them. The program
//! prints such a script; only a person submits it.

use std::path::Path;

use crate::shell_words::quoted;
use crate::shown::{escaped, excerpt};

/// Slurm allows task numbers up to 1000 unless `MaxArraySize` is configured otherwise.
pub const MOST_TASKS: usize = 1000;

/// An array of tasks, and one job after all of them.
#[derive(Clone, Debug)]
pub struct JobArray<'a> {
    /// Its name in the queue; letters, digits and hyphens are kept, all else becomes a hyphen.
    pub name: &'a str,
    /// What it does, a line of comment.
    pub shows: &'a str,
    /// The tasks are numbered 1 to this; at most [`MOST_TASKS`].
    pub tasks: usize,
    /// What each task may have.
    pub resources: Resources,
    /// Where the tasks run, and relative paths in the commands start.
    pub folder: &'a Path,
    /// Folder for what the tasks print, one file each; it is made.
    pub logs: &'a Path,
    /// Command line of a task; `$SLURM_ARRAY_TASK_ID` in it becomes its number.
    pub task: &'a str,
    /// Command line of the job after all tasks, however they ended.
    pub afterwards: &'a str,
}

/// A command line that no job script can hold: its end would be the script's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the command line of a job has a line break: {}", excerpt(&escaped(command)))]
pub struct LineBreak {
    /// The command line.
    pub command: String,
}

/// What a task may have of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Processors, which become the threads of the program.
    pub cpus: usize,
    /// Memory, MiB.
    pub memory_mib: u64,
    /// Longest time, minutes; `None` leaves it to the partition.
    pub minutes: Option<u64>,
}

impl JobArray<'_> {
    /// The script. It submits the array and the job afterwards, and prints how to watch them:
    /// by `squeue`, which needs no accounting.
    ///
    /// # Errors
    /// A command line with a line break.
    pub fn script(&self) -> Result<String, LineBreak> {
        let broken = [self.task, self.afterwards].into_iter();
        if let Some(command) = broken.into_iter().find(|c| c.contains(['\n', '\r'])) {
            let command = command.to_owned();
            return Err(LineBreak { command });
        }
        let name: String = self.name.chars().map(plain).collect();
        let Resources {
            cpus,
            memory_mib,
            minutes,
        } = self.resources;
        let time = minutes.map_or(String::new(), |minutes| {
            format!("#SBATCH --time={minutes}\n")
        });
        let one_line = |text: &str| text.replace(|c: char| c.is_control(), " ");
        let (shows, tasks) = (one_line(self.shows), self.tasks);
        let folder = quoted(&self.folder.to_string_lossy());
        let logs = quoted(&self.logs.to_string_lossy());
        let (task, afterwards) = (self.task, self.afterwards);
        Ok(format!(
            r#"#!/bin/sh
# {shows}
# Submitted by running this script; run again, it does only what is still open.
set -eu
cd {folder}
mkdir -p {logs}

array=$(sbatch --parsable --output={logs}/%a.txt <<'END'
#!/bin/sh
#SBATCH --job-name={name}
#SBATCH --array=1-{tasks}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task={cpus}
#SBATCH --mem={memory_mib}M
{time}#SBATCH --requeue
#SBATCH --open-mode=append
export RAYON_NUM_THREADS="${{SLURM_CPUS_PER_TASK:-1}}"
exec {task}
END
)
array=${{array%%;*}}

collect=$(sbatch --parsable --dependency=afterany:"$array" --output={logs}/collect.txt <<'END'
#!/bin/sh
#SBATCH --job-name={name}-collect
#SBATCH --ntasks=1
#SBATCH --cpus-per-task={cpus}
#SBATCH --mem={memory_mib}M
#SBATCH --open-mode=append
export RAYON_NUM_THREADS="${{SLURM_CPUS_PER_TASK:-1}}"
exec {afterwards}
END
)
collect=${{collect%%;*}}

echo "submitted: tasks $array, then $collect; squeue -j $array,$collect shows them"
"#
        ))
    }
}

fn plain(c: char) -> char {
    if c.is_ascii_alphanumeric() { c } else { '-' }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// With an `sbatch` that keeps what it is given: both jobs as they are submitted.
    #[test]
    fn the_script_submits_an_array_and_a_job_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("it's here");
        std::fs::create_dir(&place).unwrap();
        let array = JobArray {
            name: "rig batch/a",
            shows: "two\nlines",
            tasks: 7,
            resources: Resources {
                cpus: 3,
                memory_mib: 500,
                minutes: Some(12),
            },
            folder: &place,
            logs: Path::new("logs of it"),
            task: "rig run --shard \"$SLURM_ARRAY_TASK_ID\"/7",
            afterwards: "rig collect",
        };
        std::fs::write(folder.path().join("script"), array.script().unwrap()).unwrap();
        let sbatch = "#!/bin/sh\necho \"$@\" >> submitted\ncat >> submitted\necho '41;cluster'\n";
        std::fs::write(folder.path().join("sbatch"), sbatch).unwrap();
        let line = format!(
            "chmod +x sbatch && PATH={}:$PATH sh script",
            folder.path().display()
        );
        let output = Command::new("sh")
            .args(["-c", &line])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{error}");
        assert_eq!(
            String::from_utf8_lossy(&output.stdout),
            "submitted: tasks 41, then 41; squeue -j 41,41 shows them\n"
        );
        let submitted = std::fs::read_to_string(place.join("submitted")).unwrap();
        for part in [
            "--output=logs of it/%a.txt",
            "#SBATCH --job-name=rig-batch-a\n",
            "#SBATCH --array=1-7\n",
            "#SBATCH --cpus-per-task=3\n",
            "#SBATCH --mem=500M\n",
            "#SBATCH --time=12\n",
            "RAYON_NUM_THREADS=\"${SLURM_CPUS_PER_TASK:-1}\"\n",
            "exec rig run --shard \"$SLURM_ARRAY_TASK_ID\"/7\n",
            "--dependency=afterany:41",
            "exec rig collect\n",
        ] {
            assert!(submitted.contains(part), "{part} in\n{submitted}");
        }
        assert!(place.join("logs of it").is_dir());
        let broken = JobArray {
            afterwards: "rig collect 'a\nEND\n'",
            ..array
        };
        let error = broken.script().unwrap_err().to_string();
        assert!(error.ends_with(": rig collect 'a\\nEND\\n'"), "{error}");
    }
}
