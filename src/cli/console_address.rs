//! The address of a console's page, for people and their phones.

use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;

use super::context::Context;
use super::error::CliError;
use super::output::write_stderr;
use crate::out;

/// The page's address on stdout, and as a QR code at a terminal.
pub(super) fn show_address(address: &str, context: &Context) -> Result<(), CliError> {
    out!("{address}")?;
    if context.shows_progress()
        && let Some(picture) = qr_code(address)
    {
        write_stderr(&picture);
    }
    Ok(())
}

/// Black on white whatever the terminal's colours, as phones read it: light modules are
/// white blocks, dark ones the black background. `None` where the terminal is too narrow.
fn qr_code(address: &str) -> Option<String> {
    let code = QrCode::new(address).ok()?;
    let picture = code
        .render::<Dense1x2>()
        .dark_color(Dense1x2::Light)
        .light_color(Dense1x2::Dark)
        .quiet_zone(true)
        .build();
    let width = picture.lines().map(|line| line.chars().count()).max()?;
    let columns = rustix::termios::tcgetwinsize(std::io::stderr()).map_or(80, |size| size.ws_col);
    if columns > 0 && width > usize::from(columns) {
        return None;
    }
    let lines = picture.lines();
    Some(
        lines
            .map(|line| format!("\x1b[97;40m{line}\x1b[0m\n"))
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_is_black_on_white_with_a_margin() {
        let picture = qr_code("http://127.0.0.1:8080/abc/").unwrap();
        let lines: Vec<Vec<char>> = picture
            .lines()
            .map(|line| {
                let line = line.strip_prefix("\x1b[97;40m").unwrap();
                line.strip_suffix("\x1b[0m").unwrap().chars().collect()
            })
            .collect();
        assert!(lines[0].iter().all(|&c| c == '█'), "the margin is white");
        // The ring of the first finder pattern is black, its inside white, its core black.
        let first: String = lines[2][..12].iter().collect();
        assert_eq!(first, "████ ▄▄▄▄▄ █");
    }
}
