//! Pictures of one or more BRDFs: lobes in the plane of incidence, slices over the half
//! angle, spheres side by side, and by how much they differ.
//!
//! Of a fit, the 95% interval is a band around its curve, and what its images do not
//! constrain is grey. Away from φd = 90°, for which a fit states its intervals, they are taken
//! to be as wide, relatively, as there.

mod curve;
mod difference;
mod lobes;
mod slices;
mod spheres;

pub use difference::difference;
pub use lobes::{Axes, lobes};
pub use slices::slices;
pub use spheres::sphere_rows;

use super::Named;
use crate::plot::{Mark, NEUTRAL, Series};

/// A colour channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Red.
    R,
    /// Green.
    G,
    /// Blue.
    B,
}

impl Channel {
    /// All three.
    pub const ALL: [Self; 3] = [Self::R, Self::G, Self::B];

    fn index(self) -> usize {
        self as usize
    }

    fn name(self) -> &'static str {
        ["red", "green", "blue"][self.index()]
    }

    /// Its own colour in the palette.
    fn color(self) -> usize {
        [1, 2, 0][self.index()]
    }
}

/// Angles of incidence of the lobes unless others are asked for, degrees.
pub const INCIDENCE_DEG: [f64; 3] = [15.0, 45.0, 70.0];
/// Difference angles of the slices unless others are asked for, degrees.
pub const DIFFERENCE_DEG: [f64; 3] = [5.0, 45.0, 75.0];

/// Which curves share a panel: one BRDF's channels, or one channel of several BRDFs.
struct Panels<'a> {
    all: &'a [Named],
    /// The rows: channels drawn in each.
    rows: Vec<Vec<Channel>>,
}

impl<'a> Panels<'a> {
    fn new(all: &'a [Named], channels: &[Channel]) -> Self {
        let rows = match all {
            [_] => vec![channels.to_vec()],
            _ => channels.iter().map(|&channel| vec![channel]).collect(),
        };
        Self { all, rows }
    }

    /// BRDF, channel and colour of the curves of a row.
    fn curves(&self, row: usize) -> impl Iterator<Item = (&'a Named, Channel, usize)> + '_ {
        let several = self.all.len() > 1;
        let brdfs = self.all.iter().enumerate();
        brdfs.flat_map(move |(n, named)| {
            self.rows[row].iter().map(move |&channel| {
                let color = if several { n } else { channel.color() };
                (named, channel, color)
            })
        })
    }

    /// A panel's title: the angle, and the channel where a row has but one.
    fn title(&self, row: usize, angle: &str) -> String {
        match self.rows[row].as_slice() {
            [channel] => format!("{angle}, {}", channel.name()),
            _ => angle.to_owned(),
        }
    }

    /// What the colours mean.
    fn legend(&self) -> Vec<Series> {
        let entry = |label: &str, color, mark| Series::new(label, color, mark, Vec::new());
        let mut legend: Vec<Series> = match self.all {
            [named] if self.rows[0].len() > 1 => {
                let channels = self.rows[0].iter();
                let channels = channels.map(|c| {
                    entry(
                        &format!("{} of {}", c.name(), named.label),
                        c.color(),
                        Mark::Line,
                    )
                });
                channels.collect()
            }
            [named] => vec![entry(&named.label, self.rows[0][0].color(), Mark::Line)],
            all => {
                let lines = all.iter().enumerate();
                let lines = lines.map(|(n, named)| entry(&named.label, n, Mark::Line));
                lines.collect()
            }
        };
        let fits = || self.all.iter().filter_map(|named| named.table.as_ref());
        if fits().next().is_some() {
            let color = legend.first().map_or(0, |first| first.color);
            legend.push(entry("95% interval of a fit", color, Mark::Band));
        }
        if fits().any(|table| table.constrained_share() < 1.0) {
            legend.push(entry("not constrained by the images", NEUTRAL, Mark::Line));
        }
        legend
    }
}
