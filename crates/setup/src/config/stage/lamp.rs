//! The lamp's channels, and which colours frames under them measure.

use crate::config::ConfigError;
use crate::config::reader::Section;

/// The colours that a frame under one lamp channel measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Measures {
    Red,
    Green,
    Blue,
    /// All three at once: a white lamp.
    All,
}

impl Measures {
    /// Indices of the colours: R is 0, G is 1, B is 2.
    pub fn colours(self) -> &'static [usize] {
        match self {
            Measures::Red => &[0],
            Measures::Green => &[1],
            Measures::Blue => &[2],
            Measures::All => &[0, 1, 2],
        }
    }

    /// `R`, `G`, `B` or `RGB`.
    pub fn name(self) -> &'static str {
        match self {
            Measures::Red => "R",
            Measures::Green => "G",
            Measures::Blue => "B",
            Measures::All => "RGB",
        }
    }

    /// The light's colour: `red`, `green`, `blue` or `white`.
    pub fn colour(self) -> &'static str {
        match self {
            Measures::Red => "red",
            Measures::Green => "green",
            Measures::Blue => "blue",
            Measures::All => "white",
        }
    }
}

/// Reads the `[[stage.lamp]]` tables: what each channel measures, and what
/// `switch` takes from its table.
pub fn read<T>(
    table: &mut Section,
    mut switch: impl FnMut(&mut Section) -> Result<T, ConfigError>,
) -> Result<(Vec<Measures>, Vec<T>), ConfigError> {
    let sections = table.sections("lamp")?.required()?;
    let (mut channels, mut switches) = (Vec::new(), Vec::new());
    let mut measured = [false; 3];
    for mut section in sections {
        let measures = section
            .choice(
                "measures",
                &[
                    ("R", Measures::Red),
                    ("G", Measures::Green),
                    ("B", Measures::Blue),
                    ("RGB", Measures::All),
                ],
            )?
            .required()?;
        for &colour in measures.colours() {
            if std::mem::replace(&mut measured[colour], true) {
                let allowed = "a colour that no earlier channel measures";
                return Err(section.conflict("measures", measures.name(), allowed));
            }
        }
        channels.push(measures);
        switches.push(switch(&mut section)?);
        section.finish()?;
    }
    if measured != [true; 3] {
        let names: Vec<_> = channels.iter().map(|channel| channel.name()).collect();
        let allowed = "channels that together measure R, G and B";
        return Err(table.conflict("lamp", names.join(" and "), allowed));
    }
    Ok((channels, switches))
}
