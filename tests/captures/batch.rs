//! `rig batch`: many sessions by one process, by shards, by single jobs, killed and repeated;
//! and the input that it refuses.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::command_support::{
    assert_done, assert_fails, cases, copy, good, rig, run, session_of, text, workplace,
};
use rig::session::{Session, fit_record, lock_for_job};
use tempfile::TempDir;

/// Few paths, and the same numbers everywhere.
const OPTIONS: &str = "--spp 4 --cells 256 --dictionary few.toml --kernel portable";
/// A dictionary with which the comparison with the truth is quick.
const DICTIONARY: &str = r#"atoms = [
  { type = "lambertian", albedo = 1.0 },
  { type = "ggx", alpha = 0.3, eta = 1.5 },
  { type = "black" },
]"#;

/// A session of one light, captured once for all tests.
fn captured() -> &'static Path {
    static SESSION: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, session) = SESSION.get_or_init(|| {
        let folder = workplace(|text| text);
        let capture = ["capture", "--lights", "1", "--no-fit", "--sample", "cup"];
        let output = good(run(&folder, &capture));
        let session = session_of(&folder, &output);
        (folder, session)
    });
    session
}

/// A folder with copies of the session of these names.
fn sessions(names: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("few.toml"), DICTIONARY).unwrap();
    for name in names {
        copy(captured(), &folder.path().join(name));
    }
    folder
}

/// Runs `rig batch` with these words in a folder; `OPTIONS` stands for the options of fits.
fn batch(folder: impl AsRef<Path>, words: &str) -> Output {
    run(folder, &words_of(words))
}

fn words_of(words: &str) -> Vec<&str> {
    let words = words.split(' ').map(|word| match word {
        "OPTIONS" => OPTIONS,
        word => word,
    });
    ["batch"].into_iter().chain(words).collect()
}

/// What must be the same, wherever the jobs were done.
fn results(folder: &TempDir) -> [String; 3] {
    ["table.csv", "table.json", "index.html"]
        .map(|file| fs::read_to_string(folder.path().join("out").join(file)).unwrap())
}

fn fits(session: &Path) -> usize {
    fit_record::numbers_in(&Session::open(session).unwrap()).len()
}

/// Spoils a merged image, so that its fit is refused.
fn spoil(session: &Path) {
    fs::write(session.join("derived/radiance_L000.exr"), "no image").unwrap();
}

/// Runs a child for at most this long, then kills it; whether it ended by itself.
fn ended_within(mut child: Child, patience: Duration) -> bool {
    let began = Instant::now();
    while began.elapsed() < patience {
        if child.try_wait().unwrap().is_some() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    false
}

fn start(folder: &TempDir, words: &str) -> Child {
    let mut command = rig(folder, &words_of(words));
    let command = command.stderr(Stdio::piped()).stdout(Stdio::piped());
    command.spawn().unwrap()
}

#[test]
fn shards_and_killed_jobs_give_the_tables_of_one_process() {
    let names = ["a", "b", "c"];
    let (alone, divided) = (sessions(&names), sessions(&names));
    for folder in [&alone, &divided] {
        spoil(&folder.path().join("b"));
    }

    // One process, with a failure that stops nobody else.
    let output = batch(&alone, "a b c --out out --parallel 2 --fit OPTIONS");
    assert_fails(
        &output,
        1,
        "1 of 3 jobs failed",
        "table.csv has the reasons; the same command tries them again",
    );
    assert_eq!(
        text(&output.stderr)
            .lines()
            .filter(|line| line.starts_with(char::is_numeric))
            .collect::<Vec<_>>(),
        ["2 fits are not to be trusted", "1 job failed"]
    );
    let [csv, json, page] = results(&alone);
    let rows: Vec<&str> = csv.lines().collect();
    assert!(rows[0].starts_with("job,session,sample,simulated,status,verdict,"));
    let starts = [
        "1,a,cup,yes,done,",
        "2,b,cup,yes,failed,",
        "3,c,cup,yes,done,",
    ];
    for (row, start) in rows[1..].iter().zip(starts) {
        assert!(row.starts_with(start), "{row}");
    }
    let reason = "b/derived/radiance_L000.exr has 8 bytes";
    assert!(rows[2].contains(reason), "{}", rows[2]);
    assert!(!csv.contains(alone.path().to_str().unwrap()));
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["failed"], &json["open"]), (&1.into(), &0.into()));
    let page = page.replace("&#x2f;", "/");
    assert!(page.contains("href=\"../a/report.html\"") && !page.contains("../b/report.html"));
    assert!(alone.path().join("a/report.html").is_file());
    let times = fs::read_to_string(alone.path().join("out/times.csv")).unwrap();
    assert_eq!(times.lines().count(), 4);

    // Job 1 is killed at its beginning and in its midst, then done; what it began is no fit.
    assert_done(&batch(&divided, "new a b c --out out --fit OPTIONS"));
    assert_eq!(fits(&divided.path().join("a")), 0);
    for patience_ms in [30, 400] {
        let child = start(&divided, "run out --index 1");
        assert!(!ended_within(child, Duration::from_millis(patience_ms)));
    }
    assert_done(&batch(&divided, "run out --index 1"));
    assert_eq!(fits(&divided.path().join("a")), 1);

    // As if it had died between its fit and its record: the fit is found.
    fs::remove_file(divided.path().join("out/records/00001.json")).unwrap();
    assert_done(&batch(&divided, "run out --index 1"));
    assert_eq!(fits(&divided.path().join("a")), 1);
    let output = batch(&divided, "run out/jobs.toml --index 1");
    assert_done(&output);
    assert!(text(&output.stderr).contains("1 job done before"));

    // Another process is at work on a session: of this batch, or of another one.
    assert_done(&batch(&divided, "new c --out other --fit OPTIONS"));
    let lock = lock_for_job(&divided.path().join("c")).unwrap();
    for (words, fact) in [
        ("run out --index 3", "at work on the session of job 3"),
        ("run other", "at work on the session of job 1"),
    ] {
        let hint = "this batch or another one is being run elsewhere";
        assert_fails(&batch(&divided, words), 1, fact, hint);
    }
    drop(lock);

    // What is open so far; then two shards at once.
    let output = batch(&divided, "collect out");
    let hint = "`rig batch run` does them, unless another process";
    assert_fails(&output, 1, "2 of 3 jobs are open", hint);
    let shards = ["run out --shard 1/2", "run out --shard 2/2"].map(|w| start(&divided, w));
    let [first, second] = shards.map(|child| child.wait_with_output().unwrap());
    assert_done(&first);
    let hint = "puts the reasons into the table; the same command tries those jobs again";
    assert_fails(
        &second,
        1,
        "job 2 failed: b/derived/radiance_L000.exr has 8 bytes",
        hint,
    );
    let output = batch(&divided, "collect out");
    assert_fails(
        &output,
        1,
        "1 of 3 jobs failed",
        "the same command tries them again",
    );
    assert_eq!(results(&divided), results(&alone));

    // The other batch finds the fit that this one made, since it wants the same.
    assert_done(&batch(&divided, "run other"));
    for (name, count) in [("a", 1), ("b", 0), ("c", 1)] {
        assert_eq!(fits(&divided.path().join(name)), count, "{name}");
    }
    assert_done(&run(&divided, &["session", "verify", "c"]));

    // As a job array, whose tasks find it done.
    as_job_array(&divided);
    assert_eq!(results(&divided), results(&alone));
}

/// Runs the script that is printed for `out`, with an `sbatch` that does at once what it is
/// given.
fn as_job_array(folder: &TempDir) {
    let output = batch(folder, "slurm out --tasks 2 --cpus 1 --time 5");
    assert_done(&output);
    let script = text(&output.stdout);
    for part in [
        "#SBATCH --array=1-2\n",
        "#SBATCH --time=5\n",
        "#SBATCH --cpus-per-task=1\n",
    ] {
        assert!(script.contains(part), "{part} in\n{script}");
    }
    fs::write(folder.path().join("script"), script).unwrap();
    let sbatch = r#"#!/bin/sh
job=$(mktemp -p "$PLACE")
cat > "$job"
tasks=$(sed -n 's/^#SBATCH --array=1-//p' "$job")
for task in $(seq "${tasks:-1}"); do
    SLURM_CPUS_PER_TASK=1 SLURM_ARRAY_TASK_ID=$task sh "$job" >> "$PLACE/said" 2>&1
done
echo 7
"#;
    fs::write(folder.path().join("sbatch"), sbatch).unwrap();
    fs::remove_file(folder.path().join("out/table.csv")).unwrap();
    let line = "chmod +x sbatch; PLACE=$PWD PATH=$PWD:$PATH sh script";
    let mut command = std::process::Command::new("sh");
    let output = command.args(["-c", line]).current_dir(folder).output();
    assert_done(&output.unwrap());
    let said = fs::read_to_string(folder.path().join("said")).unwrap();
    for part in ["2 jobs done before", "job 2 failed", "1 of 3 jobs failed"] {
        assert!(said.contains(part), "{part} in\n{said}");
    }
    let output = batch(folder, "slurm out --tasks 1001");
    let fact = "a job array has 1 to 1000 tasks, not 1001";
    assert_fails(&output, 1, fact, "a task does as many jobs as it has to");
}

/// A list with options of its own for one session.
#[test]
fn a_list_states_options_for_each_session() {
    let folder = sessions(&["a", "b"]);
    let write = |text: &str| fs::write(folder.path().join("list.toml"), text).unwrap();
    write(
        "fit = \"--spp 4\"\n[[job]]\nsession = \"a\"\n[[job]]\nsession = \"b\"\nfit = \"--seed 3\"\n",
    );
    assert_done(&batch(&folder, "new --list list.toml --out out"));
    let jobs = fs::read_to_string(folder.path().join("out/jobs.toml")).unwrap();
    let jobs: toml::Value = toml::from_str(&jobs).unwrap();
    for (at, (name, options)) in [("a", "--spp 4"), ("b", "--seed 3")].iter().enumerate() {
        let job = &jobs["job"][at];
        assert_eq!(job["fit"].as_str(), Some(*options));
        assert!(
            job["session"]
                .as_str()
                .unwrap()
                .ends_with(&format!("/{name}"))
        );
    }
    for (change, fact, hint) in [
        (
            "fitt = 3\n",
            "list.toml, line 1: unknown field `fitt`",
            "a list is TOML: `fit` for all",
        ),
        (
            "fit = \"--spp 'x\"\n",
            "job 1, fit \"--spp 'x\": a quote is not closed",
            "`--pose`, `--out` and the like belong to single fits",
        ),
    ] {
        write(&format!("{change}[[job]]\nsession = \"a\"\n"));
        let output = batch(&folder, "--list list.toml --out bad");
        assert_fails(&output, 1, fact, hint);
        assert!(!folder.path().join("bad").exists());
    }
    write("");
    let output = batch(&folder, "--list list.toml --out bad");
    assert_fails(
        &output,
        1,
        "no session is named",
        "or a list of them with --list",
    );
}

/// What the program itself puts next to sessions is no session: `sessions/*` names it, too.
#[test]
fn what_is_the_programs_own_is_passed_over() {
    let folder = sessions(&["a"]);
    let at = |name: &str| folder.path().join(name);
    fs::write(at("samples.queue.jsonl"), "{}").unwrap();
    assert_done(&batch(&folder, "new a --out first --fit OPTIONS"));
    let words = "new a samples.queue.jsonl first --out out --fit OPTIONS";
    let output = batch(&folder, words);
    assert_done(&output);
    let said = text(&output.stderr);
    let queue = "samples.queue.jsonl: passed over (what was done of a queue)";
    assert!(
        said.contains(queue) && said.contains("first: passed over (a batch)"),
        "{said}"
    );
    let jobs = fs::read_to_string(at("out/jobs.toml")).unwrap();
    assert_eq!(jobs.matches("[[job]]").count(), 1);

    // Killed before it had written the jobs.
    fs::remove_file(at("out/jobs.toml")).unwrap();
    fs::write(at("out/.jobs.toml.rig-part"), "half").unwrap();
    assert_done(&batch(&folder, words));
    assert!(!at("out/.jobs.toml.rig-part").exists());
}

/// With its sessions it is found again; without them, the path that is missing is named.
#[test]
fn a_batch_that_was_moved_finds_its_sessions() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("then/sessions")).unwrap();
    fs::write(at("then/few.toml"), DICTIONARY).unwrap();
    copy(captured(), &at("then/sessions/a"));
    let options = OPTIONS.replace("few.toml", at("few.toml").to_str().unwrap());
    fs::write(at("few.toml"), DICTIONARY).unwrap();
    let new = [
        "batch",
        "new",
        "sessions/a",
        "--out",
        "batch",
        "--fit",
        &options,
    ];
    assert_done(&run(at("then"), &new));
    fs::rename(at("then"), at("now")).unwrap();
    assert_done(&batch(&folder, "run now/batch --index 1"));
    assert_eq!(fits(&at("now/sessions/a")), 1);

    // Its verdict, for scripts.
    for (fail_on, is_bad) in [
        ("", false),
        (" --fail-on not-to-be-trusted", true),
        (" --fail-on reservations", true),
    ] {
        let output = batch(&folder, &format!("collect now/batch{fail_on}"));
        let said = text(&output.stderr);
        assert!(said.contains("1 fit is not to be trusted"), "{said}");
        if is_bad {
            let fact = "1 of 1 fit has such a verdict or a worse one";
            assert_fails(
                &output,
                1,
                fact,
                "table.csv has each fit's verdict and reason",
            );
        } else {
            assert_done(&output);
        }
    }

    fs::remove_file(at("now/batch/records/00001.json")).unwrap();
    fs::rename(at("now/sessions"), at("elsewhere")).unwrap();
    let stated = at("then")
        .canonicalize()
        .unwrap_or(at("then"))
        .join("sessions/a");
    assert_fails(
        &batch(&folder, "run now/batch --index 1"),
        1,
        &format!(
            "there is no {}, where jobs.toml states the session",
            stated.display()
        ),
        "the same command tries those jobs again",
    );
}

/// Everything is refused before any work, in one line.
#[test]
fn what_cannot_be_done_is_refused_at_once() {
    let folder = sessions(&["a", "b", "cut"]);
    let at = |name: &str| folder.path().join(name);

    // A capture that did not come to its end: without what follows the last light.
    let journal = fs::read_to_string(at("cut/journal.jsonl")).unwrap();
    let lines = journal.lines().filter(|line| !line.contains("\"stop\""));
    let cut: String = lines.map(|line| format!("{line}\n")).collect();
    assert_ne!(cut, journal);
    fs::write(at("cut/journal.jsonl"), cut).unwrap();
    fs::create_dir(at("full")).unwrap();
    fs::write(at("full/note"), "a note").unwrap();
    std::os::unix::fs::symlink(at("a"), at("link")).unwrap();

    for [words, fact, hint] in cases("
        a b link --out out | is job 1 already | name each session once; other options need a batch of their own
        a cut --out out | job 2: cut is not captured completely | captures the rest; or leave it out
        a none --out out | job 2: none is not a session | name the session's own folder
        a --out full | full: not empty, and no batch's folder | give a folder with --out that is empty or does not exist
        a --out out --fit --spp=x | invalid value 'x' for '--spp <N>' | belong to single fits
        a --out out --fit --pose=x | `rig fit` has no option '--pose' that a batch could give | belong to single fits
        a --out out --fit --dictionary=none | job 1: | a file needs its path; names are listed above
        run full | full: there is no batch (no jobs.toml) | `rig batch new SESSIONS… --out DIR` makes one
        run out --shard 5/4 | of 4 shards the first is 1/4 and the last 4/4 | rig batch run --help
    ") {
        assert_fails(&batch(&folder, words), 1, fact, hint);
        assert!(!at("out").exists(), "{words}");
    }

    // What is there stays as it is.
    assert_done(&batch(&folder, "new a b --out out --fit OPTIONS"));
    spoil(&at("a"));
    assert_eq!(batch(&folder, "run out --index 1").status.code(), Some(1));
    let jobs = fs::read_to_string(at("out/jobs.toml")).unwrap();
    for [words, fact, hint] in cases(
        r#"
        a --out out --fit OPTIONS | a batch of other jobs: it had 2 sessions, has 1 | `rig batch run DIR` completes what is there
        b a --out out --fit OPTIONS | a batch of other jobs: job 1 was | give the earlier sessions and options
        a b --out out | the options of job 1 were "--spp 4 | give the earlier sessions and options
        run out --index 3 | there is no job 3: out/jobs.toml has jobs 1 to 2 | jobs are counted from 1
        run out --index 0 | there is no job 0 | jobs are counted from 1
    "#,
    ) {
        assert_fails(&batch(&folder, words), 1, fact, hint);
    }
    for [from, to, fact, hint] in cases(
        r#"
        rig = " | rig = "0.0 | its jobs are of rig 0.0 | or begin another batch in a folder of its own
        --spp 4 | --spp 5 | records/00001.json: job 1 was done with other options than it has now | or jobs.toml has changed since: put it back
        /b" | /a" | is job 1 already | name each session once
    "#,
    ) {
        fs::write(at("out/jobs.toml"), jobs.replace(from, to)).unwrap();
        for words in ["run out", "collect out"] {
            assert_fails(&batch(&folder, words), 1, fact, hint);
        }
    }
    fs::write(at("out/jobs.toml"), jobs).unwrap();

    // A damaged record, and another session in the place of one that is not done.
    fs::write(at("out/records/00002.json"), "{").unwrap();
    assert_fails(
        &batch(&folder, "run out"),
        1,
        "records/00002.json: ",
        "remove the file: the job finds its fit again",
    );
    fs::remove_file(at("out/records/00002.json")).unwrap();
    // One that is no file is neither waited for nor read without end.
    for (there, fact) in [
        ("/dev/zero", "a device"),
        ("full", "directory"),
        ("pipe", "a named pipe"),
    ] {
        let record = at("out/records/00002.json");
        match there {
            "pipe" => {
                let mode = rustix::fs::Mode::RUSR;
                rustix::fs::mkfifoat(rustix::fs::CWD, &record, mode).unwrap();
            }
            _ => std::os::unix::fs::symlink(at(there), &record).unwrap(),
        }
        for words in ["run out", "collect out"] {
            let output = batch(&folder, words);
            let said = text(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{said}");
            assert!(
                said.contains("00002.json: ") && said.contains(fact),
                "{said}"
            );
        }
        fs::remove_file(&record).unwrap();
    }
    let session = fs::read_to_string(at("b/session.toml")).unwrap();
    fs::write(at("b/session.toml"), session.replace("cup", "cap")).unwrap();
    let output = batch(&folder, "run out");
    assert_fails(
        &output,
        1,
        "is another session than the one that the batch was made with",
        "put the session back, or begin another batch",
    );
    assert!(!at("b/fits").exists());
}
