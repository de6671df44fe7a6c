//! `rig capture --queue` and `rig catalogue` as a user runs them, on the simulated rig.

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};

use crate::command_support::*;
use rig::session::{Event, Journal, Session, SessionState};
use rustix::process::{Pid, Signal, kill_process};

const SAMPLES: &str = r#"
[[sample]]
name = "cup"

[[sample]]
name = "bowl"
material = "red paint, batch 12"
comment = "matte side up"
# Many lights: its capture lasts long enough to be interrupted.
light = [
    { azimuth_deg = 40, elevation_deg = 55 },
    { azimuth_deg = 70, elevation_deg = 55 },
    { azimuth_deg = 100, elevation_deg = 55 },
    { azimuth_deg = 130, elevation_deg = 55 },
    { azimuth_deg = 160, elevation_deg = 55 },
    { azimuth_deg = -170, elevation_deg = 55 },
]

[[sample]]
name = "jar"
repeats = 2
"#;

const QUEUE: [&str; 6] = [
    "capture",
    "--queue",
    "samples.toml",
    "--lights",
    "1",
    "--no-fit",
];

/// Starts the queue with these answers; its input stays open.
fn start(folder: &Path, answers: &str) -> Child {
    let mut child = rig(folder, &QUEUE)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let stdin = child.stdin.as_mut().unwrap();
    match stdin.write_all(answers.as_bytes()) {
        // A list that is refused is refused before anything is asked.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => {}
        written => written.unwrap(),
    }
    child
}

/// Runs the queue with these answers and no more.
fn answered(folder: &Path, answers: &str) -> Output {
    start(folder, answers).wait_with_output().unwrap()
}

/// The sessions of a sample, oldest first.
fn sessions(folder: &Path, sample: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder.join("sessions")).into_iter().flatten();
    let mut found: Vec<PathBuf> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            let name = path.file_name().unwrap().to_str().unwrap();
            !name.starts_with('.') && name.contains(&format!("_{sample}_"))
        })
        .collect();
    found.sort();
    found
}

/// Waits until `found` finds something.
fn wait_for<T>(child: &mut Child, found: impl Fn() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
        assert!(began.elapsed() < Duration::from_secs(120), "it takes long");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Three samples: one is repeated, one interrupted and resumed, one left out.
#[test]
fn a_queue_is_interrupted_and_goes_on_where_it_was() {
    let folder = workplace(|text| text);
    let folder = folder.path();
    fs::write(folder.join("samples.toml"), SAMPLES).unwrap();

    // The cup, then instead of the bowl the cup again.
    let mut child = start(folder, "\nr\n\n");
    wait_for(&mut child, || {
        (sessions(folder, "cup").len() == 2).then_some(())
    });
    // A second queue of the same file is kept out while this one waits for an answer.
    let second = answered(folder, "\n");
    assert_fails(
        &second,
        1,
        "another process works on this queue",
        "end the other one first",
    );
    // Then the bowl, and Ctrl-C in it.
    child.stdin.as_mut().unwrap().write_all(b"\n").unwrap();
    let is_frame = |event: &Event| matches!(event, Event::Frame { .. });
    let bowl = wait_for(&mut child, || {
        let bowl = sessions(folder, "bowl").pop()?;
        let journal = Journal::read(&bowl).ok()?;
        let frames = journal.records.iter().filter(|r| is_frame(&r.event));
        (frames.count() >= 3).then_some(bowl)
    });
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_fails(
        &output,
        130,
        "the queue was interrupted during a capture",
        "the same command goes on with this capture",
    );
    let asked = text(&output.stderr);
    for question in [
        "Put the sample cup on the bench, then Enter; s leaves this one out, q ends",
        "then Enter; r repeats the last one, s leaves this one out, q ends",
        "Take the sample cup off the bench and put it back (2 of 2)",
        "Put the sample bowl on the bench [red paint, batch 12; matte side up]",
    ] {
        assert!(asked.contains(question), "{asked}");
    }
    let state = |root: &Path| Session::open(root).unwrap().state();
    assert_eq!(state(&bowl), SessionState::Interrupted);

    // The same command resumes the bowl first, then leaves the jar out; its input ends.
    let output = answered(folder, "\nx\ns scratched\n");
    assert_done(&output);
    let asked = text(&output.stderr);
    let [resumed, jar] = ["The capture of bowl was interrupted", "the sample jar"]
        .map(|part| asked.find(part).expect(&asked));
    assert!(resumed < jar && asked.contains("that is none of the answers"));
    let table = text(&output.stdout);
    let rows: Vec<Vec<&str>> = table
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(rows.len(), 5, "{table}");
    assert_eq!(
        rows[4],
        ["jar", "2", "left", "out:", "scratched"],
        "{table}"
    );
    let way_back = "give the same command and answer b at its end";
    assert!(asked.contains(way_back), "{asked}");
    // It is brought back, and left out again.
    let back = text(&answered(folder, "b\n").stdout);
    assert!(
        back.lines()
            .any(|row| row.split_whitespace().eq(["jar", "2", "to", "do"])),
        "{back}"
    );
    assert_done(&answered(folder, "s scratched\n"));
    assert_eq!(sessions(folder, "bowl"), std::slice::from_ref(&bowl));
    assert_eq!(sessions(folder, "cup").len(), 2);
    for root in sessions(folder, "cup").iter().chain([&bowl]) {
        assert_eq!(state(root), SessionState::Complete);
    }
    let session = Session::open(&bowl).unwrap();
    let record = session.record();
    assert_eq!(record.material.as_deref(), Some("red paint, batch 12"));
    assert_eq!(record.plan.lights[0].azimuth_deg, 40.0);

    // Once more: nothing is left, nothing is captured again.
    let output = answered(folder, "q\n");
    assert_done(&output);
    assert_eq!(text(&output.stdout), table);
    let again = json(rig(folder, &QUEUE).arg("--json").output().unwrap());
    assert_eq!(
        (&again["left"], sessions(folder, "cup").len()),
        (&0.into(), 2)
    );
    assert_eq!(again["samples"][0]["sessions"][1]["state"], "done");

    // The catalogue has them, and finds them.
    let list = json(run(folder, &["catalogue", "--json"]));
    assert_eq!(list.as_array().unwrap().len(), 3);
    let found = json(run(
        folder,
        &["catalogue", "--search", "PAINT 12", "--json"],
    ));
    assert_eq!(found.as_array().unwrap().len(), 1);
    assert_eq!(found[0]["sample"], "bowl");
    assert_eq!(found[0]["lights_finished"], 6);
    assert!(found[0]["bytes"].as_u64().unwrap() > 10_000);
    fs::create_dir(folder.join("sessions/photos")).unwrap();
    let shown = text(&good(run(folder, &["catalogue"])).stdout);
    assert!(shown.contains("photos  cannot be read: "), "{shown}");
    assert!(
        shown.contains("no fit") && shown.contains("simulated"),
        "{shown}"
    );
    assert_fails(
        &run(folder, &["catalogue", "--repeats", "bowl"]),
        1,
        "sample \"bowl\" has 0 sessions with a trusted fit",
        "taken off the bench and put back in between",
    );
    assert_fails(
        &run(folder, &["catalogue", "--repeats", "pot"]),
        1,
        "no session of a sample \"pot\"",
        "lists the samples",
    );
}

#[test]
fn bad_lists_are_refused_before_anything_is_made() {
    let folder = workplace(|text| text);
    let folder = folder.path();
    let file = folder.join("samples.toml");
    let with_list = |text: &str| {
        fs::write(&file, text).unwrap();
        answered(folder, "\n")
    };
    // `; ` ends a line of the list.
    for [list, fact] in cases(
        r#"
        | samples.toml:1: `sample` is missing
        [[sample]]; name = "a"; [[sample]]; name = "a" | samples.toml:4: `sample[1].name` is "a", but must be another name than that of sample[0]
        [[sample]]; name = "a"; repeat = 3 | samples.toml:3: unknown key `sample[0].repeat`; known here: name, material, comment, lights, light, repeats, again
        [[sample]]; name = "a"; repeats = 0 | `sample[0].repeats` is 0, but must be an integer from 1 to 100
        [[sample]; name | not valid TOML
    "#,
    ) {
        let hint = match fact {
            "not valid TOML" => "TOML",
            _ => "the list has a table [[sample]] for each sample",
        };
        let list = &list.replace("; ", "\n");
        assert_fails(&with_list(list), 1, fact, hint);
        assert!(!folder.join("sessions").exists());
    }
    fs::write(&file, SAMPLES).unwrap();
    let without_lights = ["capture", "--queue", "samples.toml"];
    assert_fails(
        &run(folder, &without_lights),
        1,
        "`sample[0].lights` is missing, and the command names no lights",
        "add `lights = 8` to the sample",
    );
    let events = run(folder, &[&QUEUE[..], &["--events"]].concat());
    assert_fails(&events, 1, "cannot be used with '--events'", "--help");

    // A name that is taken, and the end of the input, which is no answer.
    assert_done(&answered(folder, ""));
    assert!(sessions(folder, "cup").is_empty());
    good(run(
        folder,
        &["capture", "--lights", "1", "--no-fit", "--sample", "jar"],
    ));
    assert_fails(
        &answered(folder, "\n"),
        1,
        "`sample[2].name` is \"jar\", but must be a name without a session from before",
        "one more measurement of the same sample has `again = true`",
    );
    let journal = folder.join("sessions/samples.queue.jsonl");
    fs::write(&journal, "{}\n").unwrap();
    assert_fails(
        &answered(folder, "\n"),
        1,
        "samples.queue.jsonl, line 1: ",
        "restore the queue's journal from a copy",
    );
}
