//! `rig capture --until`: lights that are chosen as the capture goes.

use std::path::Path;

use super::resume::cut;
use crate::capture_support::content;
use crate::command_support::{json, run, run_line, workplace};
use rig::session::{Decision, Event, Journal, Session, Stop};

fn decisions(root: &Path) -> Vec<Decision> {
    Journal::read(root).unwrap().decisions().collect()
}

/// The first light is the plan's, the second the one that promises most; both decisions are in the
/// journal, and a resume before either makes them again.
#[test]
fn lights_are_chosen_until_there_are_enough_and_a_resume_chooses_alike() {
    let folder = workplace(|text| text);
    const UNTIL: &str = "capture --until 0.1% --max-lights 2 --no-fit --json";
    let planned = json(run_line(&folder, &format!("{UNTIL} --dry-run")));
    assert_eq!(planned["lights"].as_array().unwrap().len(), 1);
    assert_eq!(planned["until"]["max_lights"], 2);
    let alone = json(run_line(&folder, "capture --lights 1 --dry-run --json"));
    let seconds = |plan: &serde_json::Value| plan["estimated_s"].as_f64().unwrap();
    assert_eq!(planned["lights"], alone["lights"]);
    assert!(seconds(&planned) > 1.5 * seconds(&alone));

    let result = json(run_line(&folder, UNTIL));
    let root = folder.path().join(result["session"].as_str().unwrap());
    let [first, second] = decisions(&root)[..] else {
        panic!("{result}")
    };
    assert_eq!(result["decision"], serde_json::json!(second));
    assert_eq!([first.stop, second.stop], [None, Some(Stop::MostLights)]);
    let lights = Session::open(&root).unwrap().record().plan.lights.clone();
    assert_eq!(lights.len(), 2);
    assert_eq!(first.next(), Some(lights[1]));
    // It keeps about what it promised.
    let promised = first.best.unwrap().error / second.expected_error;
    assert!(second.expected_error < first.expected_error);
    assert!((0.7..1.4).contains(&promised), "{promised}");

    let journal = Journal::read(&root).unwrap().records;
    let is_second = |event: &Event| matches!(event, Event::Decision(d) if d.stop.is_some());
    let before = journal.iter().position(|r| is_second(&r.event)).unwrap();
    let again = folder.path().join("again");
    cut(&root, &again, before, 0);
    let resumed = ["capture", "--resume", "again", "--no-fit", "--json"];
    json(run(&folder, &resumed));
    assert_eq!(decisions(&again), [first, second]);
    assert_eq!(content(&again).len(), content(&root).len());
}
