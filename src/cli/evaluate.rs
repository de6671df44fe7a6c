//! `rig evaluate`: experiments against a known truth.

use std::path::PathBuf;

use super::interrupt::{end_on_signal, listen};
use super::slurm_args::{SlurmArgs, program};
use super::{CliError, Context, light_choice, output};
use crate::cluster::{MOST_TASKS, Shard};
use crate::evaluate::experiment::{Overrides, Run, Settings, run as run_experiment};
use crate::evaluate::lab::Lab;
use crate::evaluate::{EXPERIMENTS, find};
use crate::job_array::ArrayRequest;
use crate::out;
use crate::shell_words;

/// Runs an experiment against a known truth: a table (CSV, JSON) and figures (SVG, PNG).
#[derive(clap::Args, Debug)]
pub struct EvaluateArgs {
    /// Name of the experiment, see --list
    #[arg(
        value_name = "NAME",
        required_unless_present = "list",
        conflicts_with = "list"
    )]
    name: Option<String>,
    /// Lists all experiments with what they show
    #[arg(long)]
    list: bool,
    /// Folder for the results; a further run with the same settings completes what it holds
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present_any = ["list", "session"],
        conflicts_with_all = ["list", "session"]
    )]
    out: Option<PathBuf>,
    /// With next-light: a fitted session, to find the lights that would add most to it
    #[arg(long, value_name = "SESSION", conflicts_with = "list")]
    session: Option<PathBuf>,
    /// Materials: bundled, mirrors, synthetic, in-span, nbrdf:NAME, synthetic:NAME, in-span:NN, or files (.binary, .bsdf, …)
    #[arg(long, value_name = "M", num_args = 1.., value_delimiter = ',')]
    materials: Option<Vec<String>>,
    /// paper42, rig65, rig26, or a dictionary file; by default rig65 where the experiment measures
    /// what a fit gives by default, else paper42
    #[arg(long, value_name = "D")]
    dictionary: Option<String>,
    /// Pixels per side of the captured images, 4 to 4096
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..=4096))]
    resolution: Option<u64>,
    /// Light paths per pixel of the fit, 2 to 65536; those of the true images change in proportion
    /// unless --truth-spp is given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=65_536))]
    spp: Option<u32>,
    /// Light paths per pixel of the true images, 2 to 1048576; misalignment takes four times these
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1_048_576))]
    truth_spp: Option<u32>,
    /// Pixels per side of the spheres of the environment error, 8 to 512
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(8..=512))]
    sphere: Option<u64>,
    /// Most lights, 1 to 64
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    lights: Option<u64>,
    /// Seed of all random numbers
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    seed: Option<u64>,
    /// A small version that shows the experiment works
    #[arg(long)]
    quick: bool,
    /// Only cases whose name contains this, such as a material's or a shape's; further runs add others
    #[arg(
        long,
        value_name = "TEXT",
        default_value = "",
        hide_default_value = true
    )]
    only: String,
    /// Only every n-th of the cases, such as 3/8: for several processes or machines with one
    /// folder; a run without it joins what they did
    #[arg(long, value_name = "I/N", conflicts_with_all = ["list", "session", "restart", "json"])]
    shard: Option<Shard>,
    /// Prints a script that submits the run as a job array of Slurm with so many tasks, 1 to 1000
    #[arg(long, value_name = "N", conflicts_with_all = ["list", "session", "shard", "restart", "json"], value_parser = clap::value_parser!(u16).range(1..=MOST_TASKS as i64))]
    slurm: Option<u16>,
    #[command(flatten)]
    task: SlurmArgs,
    /// Forget what the folder holds of an earlier run
    #[arg(long)]
    restart: bool,
    /// Only instructions that every machine has: the same numbers anywhere
    #[arg(long)]
    portable: bool,
    /// The table as JSON on stdout
    #[arg(long)]
    json: bool,
}

/// `rig evaluate`.
pub fn run(args: &EvaluateArgs, context: &Context) -> Result<(), CliError> {
    if let Some(session) = &args.session {
        return match args.name.as_deref() {
            Some("next-light") => light_choice::next(session, args.json, context),
            _ => Err(CliError::new("--session belongs to next-light alone")
                .hint("`rig evaluate next-light --session SESSION`")),
        };
    }
    let (Some(name), Some(folder)) = (&args.name, &args.out) else {
        return list(args.json);
    };
    // The experiment with its settings.
    let experiment = find(name)?;
    let overrides = Overrides {
        materials: args.materials.clone(),
        resolution_px: args.resolution.map(|n| n as usize),
        samples_per_pixel: args.spp,
        truth_samples_per_pixel: args.truth_spp,
        sphere_px: args.sphere.map(|n| n as usize),
        lights: args.lights.map(|n| n as usize),
        seed: args.seed,
        dictionary: args.dictionary.clone(),
        quick: args.quick,
        portable: args.portable,
    };
    let settings = Settings::new(experiment, &overrides)?;
    let lab = Lab::new(settings, overrides.portable)?;
    if let Some(tasks) = args.slurm {
        let cases = (experiment.cases)(&lab)?.len();
        let request = ArrayRequest {
            name,
            folder,
            tasks: usize::from(tasks),
            cases,
            cpus: args.task.cpus(),
            memory_mib: args.task.memory_mib(),
            minutes: args.task.minutes(),
        };
        let command = shell_words::command_line(&program()?, &words_without_slurm());
        let script = request.script(&command, &lab.settings)??;
        return output::write_bytes(script.as_bytes());
    }
    // Finished cases are on disk already: the run may end at any moment.
    let shown = folder.display().to_string();
    end_on_signal(context, &listen()?, move |signal| {
        CliError::interrupted(signal, format!("stopped; {shown} keeps what is finished"))
            .hint("the same command completes it")
    })?;
    // The run.
    let bar = context.bar(0, "cases");
    let outcome = run_experiment(
        &Run {
            experiment,
            lab: &lab,
            folder,
            restart: args.restart,
            only: &args.only,
            shard: args.shard,
        },
        &|done| {
            bar.set_length(done.total as u64);
            bar.set_position(done.finished as u64);
            if let Some(case) = done.case {
                bar.set_message(crate::shown::escaped(case).into_owned());
            }
        },
    );
    bar.finish_and_clear();
    let outcome = outcome?;
    // What it left.
    match outcome.resumed {
        0 => {}
        1 => context.note("1 case was finished before"),
        n => context.note(format!("{n} cases were finished before")),
    }
    match outcome.left {
        0 if args.shard.is_some() => {
            context.note("all cases are done; the same command without --shard joins them");
        }
        0 => {}
        n if args.shard.is_some() => context.note(format!("{n} cases of other shards are open")),
        1 => context.note("1 other case is open; figures are drawn when all are done"),
        n => context.note(format!(
            "{n} other cases are open; figures are drawn when all are done"
        )),
    }
    for file in &outcome.files {
        context.note(file.display());
    }
    if args.json {
        return output::write_json(&outcome.json);
    }
    output::write_path(folder)
}

/// The arguments of this process but those that are about Slurm.
fn words_without_slurm() -> Vec<String> {
    const ABOUT_SLURM: [&str; 4] = ["--slurm", "--cpus", "--task-memory", "--time"];
    let mut kept = Vec::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        if ABOUT_SLURM.contains(&word.as_str()) {
            words.next();
        } else if !ABOUT_SLURM.iter().any(|name| {
            let value = word.strip_prefix(name);
            value.is_some_and(|value| value.starts_with('='))
        }) {
            kept.push(word);
        }
    }
    kept
}

fn list(json: bool) -> Result<(), CliError> {
    if json {
        let all: Vec<_> = EXPERIMENTS
            .iter()
            .map(|e| serde_json::json!({ "name": e.name, "shows": e.shows }))
            .collect();
        return output::write_json(&serde_json::json!({ "experiments": all }));
    }
    for experiment in EXPERIMENTS {
        out!("{:20} {}", experiment.name, experiment.shows)?;
    }
    Ok(())
}
