//! `rig evaluate next-light --session S`: the lights that would add most to a session.

use std::path::Path;

use super::capture_notices::Terminal;
use super::context::Context;
use super::error::CliError;
use super::output::write_json;
use super::table::percent;
use crate::capture::light_choice;
use crate::out;
use crate::session::Session;

/// Directions that are named.
const SHOWN: usize = 5;

/// Prints the directions that would add most to a fitted session, best first.
pub fn next(root: &Path, json: bool, context: &Context) -> Result<(), CliError> {
    let session = Session::open(root)?;
    let mut terminal = Terminal::new(context, None);
    let (fit, found) = light_choice::next(&session, SHOWN, &mut |notice| terminal.show(notice))?;
    terminal.finish();
    if json {
        return write_json(&serde_json::json!({
            "session": root,
            "fit": fit,
            "lights_taken": found.taken,
            "expected_error": found.error,
            "next": found.next,
        }));
    }
    out!(
        "expected environment error after the {} lights taken: {}",
        found.taken,
        percent(found.error)
    )?;
    for ranked in &found.next {
        out!("  with {}: {}", ranked.light, percent(ranked.error))?;
    }
    Ok(())
}
