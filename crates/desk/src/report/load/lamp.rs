//! Every comparison of the lamp's level at two times, for the report's provenance.

use crate::report::ProvenanceGroup;
use crate::session::Session;
use crate::session::drift::{LampChange, NOTABLE, Span};
use crate::shown::nth;

/// The lamp's changes within each light and over the session, channel by channel.
pub(super) fn group(session: &Session) -> ProvenanceGroup {
    let drift = session.lamp_drift().unwrap_or_default();
    let plan = &session.record().plan;
    let notable = drift.notable();
    let judged = match notable.first() {
        None => "none".to_owned(),
        Some(largest) => format!("{}; the largest: {largest}", notable.len()),
    };
    let judged = format!(
        "{judged} (of {} comparisons; beyond {:.1} standard uncertainties and {}%)",
        drift.changes.len(),
        drift.significant_beyond(),
        100.0 * NOTABLE,
    );
    let mut entries = vec![("Notable changes".to_owned(), judged)];
    for light in 0..plan.lights.len() as u32 {
        let of_light = |change: &&LampChange| change.span == Span::WithinLight(light);
        let changes = channels(drift.changes.iter().filter(of_light));
        entries.push((
            format!("During {light}", light = nth("light", light)),
            changes,
        ));
    }
    if plan.revisit_first {
        let second_visit = "Between light 1 and its second visit".to_owned();
        entries.push((second_visit, channels(drift.over_session())));
    }
    ProvenanceGroup {
        title: "Drift of the lamp, by channel".to_owned(),
        entries,
    }
}

fn channels<'a>(changes: impl Iterator<Item = &'a LampChange>) -> String {
    let known: Vec<String> = changes.map(LampChange::percent).collect();
    match known.is_empty() {
        true => "not known".to_owned(),
        false => known.join(", "),
    }
}
