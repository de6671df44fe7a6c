//! An experiment as a job array of Slurm.

use std::path::Path;

use crate::cells::DEFAULT_CELLS;
use crate::cluster::{JobArray, LineBreak, Resources};
use crate::evaluate::experiment::Settings;
use crate::workflow::FitWork;

/// An experiment whose cases are divided among tasks.
pub struct ArrayRequest<'a> {
    /// The experiment.
    pub name: &'a str,
    /// Folder of its results.
    pub folder: &'a Path,
    /// How many tasks, at most one for each case.
    pub tasks: usize,
    /// How many cases there are.
    pub cases: usize,
    /// Processors of a task; `None`: one.
    pub cpus: Option<usize>,
    /// Memory of a task, MiB; `None`: what a case is expected to need.
    pub memory_mib: Option<u64>,
    /// Longest time of a task, minutes.
    pub minutes: Option<u64>,
}

impl ArrayRequest<'_> {
    /// The script that submits `command`, which runs all cases, in shards from the working folder.
    ///
    /// # Errors
    /// The working folder is not known, or a name has a line break.
    pub fn script(
        &self,
        command: &str,
        settings: &Settings,
    ) -> std::io::Result<Result<String, LineBreak>> {
        let tasks = self.tasks.min(self.cases).max(1);
        let logs = format!("{}.slurm", self.folder.display());
        let (name, cases) = (self.name, self.cases);
        let array = JobArray {
            name: &format!("rig-{name}"),
            shows: &format!("rig evaluate {name}: {cases} cases as {tasks} tasks"),
            tasks,
            resources: Resources {
                cpus: self.cpus.unwrap_or(1),
                memory_mib: self.memory_mib.unwrap_or_else(|| memory_mib(settings)),
                minutes: self.minutes,
            },
            folder: &std::env::current_dir()?,
            logs: Path::new(&logs),
            task: &format!("{command} --shard \"$SLURM_ARRAY_TASK_ID\"/{tasks}"),
            afterwards: command,
        };
        Ok(array.script())
    }
}

/// Memory of a task, MiB: the fit of a case and as much for its images, for each processor.
fn memory_mib(settings: &Settings) -> u64 {
    let pixels = settings.resolution_px * settings.resolution_px;
    let work = FitWork {
        cells: pixels.min(DEFAULT_CELLS),
        lights: settings.lights.max(1),
        paths_per_cell: settings.samples_per_pixel,
        refines_bench: true,
    };
    let bytes = work.expected_bytes() + (pixels * settings.lights.max(1) * 100) as f64;
    (bytes / f64::from(1 << 20)).ceil() as u64 + 512
}
