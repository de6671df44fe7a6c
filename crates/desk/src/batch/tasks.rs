//! A batch as a job array of Slurm: how many tasks, and what each needs.

use std::path::Path;

use super::{Batch, BatchError, Job};
use crate::cluster::{JobArray, MOST_TASKS, Resources, Shard};
use crate::shell_words::quoted;

/// A task should last about this long, seconds: what a scheduler does per task costs seconds.
const TASK_S: f64 = 600.0;
/// Time asked for over the time expected, and in addition, minutes: a node may be slower.
const TIME_FACTOR: f64 = 3.0;
const MORE_MINUTES: u64 = 10;
/// Memory asked for over the memory expected, and in addition, MiB: program and report.
const MEMORY_FACTOR: f64 = 1.5;
const MORE_MIB: u64 = 256;

/// What a person may choose of an array; the rest follows from the work that is expected.
#[derive(Clone, Copy, Debug, Default)]
pub struct ArrayRequest {
    /// Number of tasks, 1 to [`MOST_TASKS`].
    pub tasks: Option<usize>,
    /// Processors of each; 1 by default, because jobs are independent.
    pub cpus: Option<usize>,
    /// Memory of each, MiB.
    pub memory_mib: Option<u64>,
    /// Longest time of each, minutes.
    pub minutes: Option<u64>,
}

/// How a batch is divided into tasks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskPlan {
    /// Number of tasks.
    pub tasks: usize,
    /// What each may have.
    pub resources: Resources,
    /// Processor time expected of the longest task, seconds.
    pub longest_cpu_s: f64,
}

impl Batch {
    /// Divides the jobs into tasks of minutes.
    ///
    /// # Errors
    /// More tasks are asked for than an array may have, or none.
    pub fn task_plan(&self, request: &ArrayRequest) -> Result<TaskPlan, BatchError> {
        let cpus = request.cpus.unwrap_or(1).max(1);
        let total_s: f64 = self.jobs.iter().map(|job| job.expected_cpu_s).sum();
        let useful = (total_s / cpus as f64 / TASK_S).ceil() as usize;
        let tasks = request.tasks.unwrap_or(useful.clamp(1, MOST_TASKS));
        if !(1..=MOST_TASKS).contains(&tasks) {
            return Err(BatchError::Tasks {
                tasks,
                most: MOST_TASKS,
            });
        }
        let tasks = tasks.min(self.jobs.len());
        let mut by_task = vec![0.0; tasks];
        for job in &self.jobs {
            by_task[job.number % tasks] += job.expected_cpu_s;
        }
        let longest_cpu_s = by_task.into_iter().fold(0.0, f64::max);
        let needs = |job: &Job| {
            let expected = (job.expected_mib as f64 * MEMORY_FACTOR) as u64;
            expected.min(job.request.memory_mib.unwrap_or(u64::MAX)) + MORE_MIB
        };
        let memory_mib = self.jobs.iter().map(needs).max().unwrap_or(MORE_MIB);
        let minutes = (TIME_FACTOR * longest_cpu_s / cpus as f64 / 60.0).ceil() as u64;
        Ok(TaskPlan {
            tasks,
            resources: Resources {
                cpus,
                memory_mib: request.memory_mib.unwrap_or(memory_mib),
                minutes: Some(request.minutes.unwrap_or(minutes + MORE_MINUTES)),
            },
            longest_cpu_s,
        })
    }

    /// The script that submits the batch; `program` is this program on the nodes.
    ///
    /// # Errors
    /// As [`Self::task_plan`]; the folder cannot be found, or the program's path has a line break.
    pub fn job_array(&self, request: &ArrayRequest, program: &str) -> Result<String, BatchError> {
        let plan = self.task_plan(request)?;
        let folder = self.folder.canonicalize();
        let folder = folder.map_err(BatchError::io(&self.folder))?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let (jobs, tasks) = (self.jobs.len(), plan.tasks);
        let shows = format!(
            "rig batch {name}: {jobs} {} as {tasks} {}, about {:.0} min each",
            if jobs == 1 { "job" } else { "jobs" },
            if tasks == 1 { "task" } else { "tasks" },
            (plan.longest_cpu_s / plan.resources.cpus as f64 / 60.0).max(1.0)
        );
        debug_assert!(tasks <= Shard::MOST);
        let program = quoted(program);
        let array = JobArray {
            name: &format!("rig-{name}"),
            shows: &shows,
            tasks,
            resources: plan.resources,
            folder: &folder,
            logs: Path::new("slurm"),
            task: &format!("{program} batch run . --shard \"$SLURM_ARRAY_TASK_ID\"/{tasks}"),
            afterwards: &format!("{program} batch collect ."),
        };
        Ok(array.script()?)
    }
}
