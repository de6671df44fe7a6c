//! `rig evaluate next-light --session S`: the lights that would add most to a session.

use std::path::Path;

use super::capture_notices::Terminal;
use super::context::Context;
use super::error::CliError;
use super::output::write_json;
use crate::capture::light_choice;
use crate::out;
use crate::session::Session;

/// Directions that are named.
const SHOWN: usize = 5;

/// Prints the directions that would add most to a fitted session, best first.
pub fn next(root: &Path, json: bool, context: &Context) -> Result<(), CliError> {
    let session = Session::open(root)?;
    let mut terminal = Terminal::new(context, None);
    let found = light_choice::next(&session, SHOWN, &mut |notice| terminal.show(notice))?;
    terminal.finish();
    if json {
        return write_json(&serde_json::json!({
            "session": root,
            "fit": found.fit,
            "lights_taken": found.taken,
            "expected_variance_left": found.remaining,
            "next": found.next,
        }));
    }
    out!(
        "expected variance of the BRDF after the {} lights taken: {:.2}% of that without images",
        found.taken,
        100.0 * found.remaining
    )?;
    for ranked in &found.next {
        out!("  with {}: {:.2}%", ranked.light, 100.0 * ranked.remaining)?;
    }
    Ok(())
}
