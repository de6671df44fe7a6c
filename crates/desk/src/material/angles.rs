//! Values of a BRDF at the angles of a table.

use std::path::Path;
use std::str::FromStr;

use glam::DVec3;
use serde::Serialize;

use super::MaterialError;
use crate::brdf::Brdf;
use crate::{outside_file, outside_table};

/// Largest angles file, bytes: some millions of lines.
const LARGEST_ANGLES_BYTES: u64 = 1 << 28;

/// One line of an angles file, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Angles {
    /// Polar angle of the light, 0..=90.
    pub theta_i_deg: f64,
    /// Polar angle of the viewer, 0..=90.
    pub theta_o_deg: f64,
    /// Azimuth between the two.
    pub phi_deg: f64,
}

impl Angles {
    /// Of polar angles of light and viewer and the azimuth between them, degrees.
    ///
    /// # Errors
    /// A polar angle outside 0..=90.
    pub fn new([theta_i_deg, theta_o_deg, phi_deg]: [f64; 3]) -> Result<Self, String> {
        for theta in [theta_i_deg, theta_o_deg] {
            if !(0.0..=90.0).contains(&theta) {
                return Err(format!("polar angle {theta}, allowed is 0 to 90"));
            }
        }
        Ok(Self {
            theta_i_deg,
            theta_o_deg,
            phi_deg,
        })
    }

    fn directions(self) -> (DVec3, DVec3) {
        let direction = |theta_deg: f64, phi_deg: f64| {
            let (sin, cos) = theta_deg.to_radians().sin_cos();
            let (sin_phi, cos_phi) = phi_deg.to_radians().sin_cos();
            DVec3::new(sin * cos_phi, sin * sin_phi, cos)
        };
        (
            direction(self.theta_i_deg, 0.0),
            direction(self.theta_o_deg, self.phi_deg),
        )
    }
}

/// `theta_i,theta_o,phi` in degrees.
impl FromStr for Angles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let fields: Vec<&str> = text.split(',').map(str::trim).collect();
        let [theta_i, theta_o, phi] = fields[..] else {
            return Err("three angles in degrees are needed: theta_i,theta_o,phi".to_owned());
        };
        let number = |field| outside_table::number(field).map_err(|error| error.to_string());
        Self::new([number(theta_i)?, number(theta_o)?, number(phi)?])
    }
}

/// The lines of an angles file.
///
/// # Errors
/// A column or number that is missing or wrong, with its line.
pub fn parse_angles(text: &str) -> Result<Vec<Angles>, String> {
    let rows = outside_table::rows(text).map_err(|error| error.to_string())?;
    let (header, rows) = rows
        .split_first()
        .ok_or("no column theta_i_deg in the first line: it is empty")?;
    let column = |name: &str| {
        let column = header.column(name);
        column.ok_or_else(|| format!("no column {name} in the first line"))
    };
    let columns = [
        column("theta_i_deg")?,
        column("theta_o_deg")?,
        column("phi_deg")?,
    ];
    rows.iter()
        .map(|row| {
            let mut values = [0.0; 3];
            for (value, &column) in values.iter_mut().zip(&columns) {
                *value = outside_table::number(row.field(column))
                    .map_err(|error| format!("line {}: {error}", row.line))?;
            }
            Angles::new(values).map_err(|fact| format!("line {}: {fact}", row.line))
        })
        .collect()
}

/// The lines of an angles file on disk.
///
/// # Errors
/// A file that cannot be read, or as [`parse_angles`].
pub fn read_angles(path: &Path) -> Result<Vec<Angles>, MaterialError> {
    let unread = |fact: String| MaterialError::File {
        path: path.to_owned(),
        fact,
    };
    let text = outside_file::read_text(path, LARGEST_ANGLES_BYTES);
    let text = text.map_err(|error| unread(error.to_string()))?;
    parse_angles(&text).map_err(|fact| MaterialError::Angles {
        path: path.to_owned(),
        fact,
    })
}

/// f at one pair of directions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evaluated {
    /// The directions.
    #[serde(flatten)]
    pub angles: Angles,
    /// R, G, B; 1/sr, cosine excluded.
    pub f: [f32; 3],
}

/// f at every pair of directions.
pub fn evaluate(brdf: &dyn Brdf, angles: Vec<Angles>) -> Vec<Evaluated> {
    let one = |angles: Angles| {
        let (to_light, to_viewer) = angles.directions();
        let f = brdf.eval(to_light.as_vec3(), to_viewer.as_vec3());
        Evaluated { angles, f }
    };
    angles.into_iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_read_by_column_name() {
        let text = "phi_deg, theta_o_deg,theta_i_deg,note\n180,30,20,x\n\n0,0,90,y\n";
        let rows = parse_angles(text).unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!(
            (rows[0].theta_i_deg, rows[0].theta_o_deg, rows[0].phi_deg),
            (20.0, 30.0, 180.0)
        );
        for (bad, said) in [
            ("", "no column theta_i_deg"),
            ("theta_i_deg,theta_o_deg,phi_deg\n1,2", "\"\" is no number"),
            (
                "theta_i_deg,theta_o_deg,phi_deg\n1,95,0",
                "line 2: polar angle 95",
            ),
            ("theta_i_deg,theta_o_deg,phi_deg\nnan,9,0", "\"nan\""),
        ] {
            assert!(parse_angles(bad).unwrap_err().contains(said), "{bad}");
        }
    }
}
