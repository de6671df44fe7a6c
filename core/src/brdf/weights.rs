//! Mixture weights as a table in a file: `weights.csv`.
//!
//! Columns by name: `atom` (index in the dictionary), `kind`, `alpha`, `eta` (where
//! present, they must be the dictionary's), `weight_r`, `weight_g`, `weight_b`, and optionally the standard
//! deviations `sd_r`, `sd_g`, `sd_b`. Weights alone are not identifiable: atoms
//! resemble each other, so their deviations are large where the BRDF's are not.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

use super::BrdfError;
use super::dictionary::Dictionary;
use super::mixture::Mixture;
use crate::outside_table;
use crate::shown::excerpt;

/// The text of `weights.csv`; `deviations` are standard deviations, indexed as the weights.
///
/// ```
/// use std::sync::Arc;
/// use rig_core::brdf::{Dictionary, Mixture, weights};
///
/// let dictionary = Arc::new(Dictionary::rig26());
/// let mut only_white = vec![0.0; 26];
/// only_white[24] = 1.0;
/// let mixture = Mixture::grey(dictionary.clone(), only_white)?;
///
/// let csv = weights::to_csv(&mixture, None);
/// assert_eq!(&weights::parse(&csv, &dictionary)?, mixture.weights());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn to_csv(mixture: &Mixture, deviations: Option<&[Vec<f64>; 3]>) -> String {
    let mut text = String::from("atom,kind,alpha,eta,weight_r,weight_g,weight_b");
    if deviations.is_some() {
        text += ",sd_r,sd_g,sd_b";
    }
    text.push('\n');
    for (index, atom) in mixture.dictionary().atoms().iter().enumerate() {
        let [alpha, eta] =
            [atom.alpha(), atom.eta()].map(|value| value.map_or(String::new(), |v| v.to_string()));
        let _ = write!(text, "{index},{},{alpha},{eta}", atom.kind());
        for columns in [Some(mixture.weights()), deviations].into_iter().flatten() {
            for channel in columns {
                let _ = write!(text, ",{}", channel.get(index).copied().unwrap_or(f64::NAN));
            }
        }
        text.push('\n');
    }
    text
}

/// Reads `weights.csv`; every atom of `dictionary` must stand once, with the
/// kind it has there, and the weights must be on the simplex.
pub fn read(path: &Path, dictionary: Arc<Dictionary>) -> Result<Mixture, BrdfError> {
    let text =
        crate::outside_file::read_text(path, super::LARGEST_TEXT_BYTES).map_err(|source| {
            BrdfError::Io {
                path: path.into(),
                source,
            }
        })?;
    let weights = parse(&text, &dictionary).map_err(|fact| BrdfError::File {
        path: path.into(),
        fact,
    })?;
    Mixture::new(dictionary, weights).map_err(|error| BrdfError::File {
        path: path.into(),
        fact: error.to_string(),
    })
}

/// R, G, B weights in the dictionary's order, from the text of a `weights.csv`.
///
/// # Errors
/// In words: a column, atom or number that is missing or wrong.
pub fn parse(text: &str, dictionary: &Dictionary) -> Result<[Vec<f64>; 3], String> {
    let (header, rows) = outside_table::with_header(text)?;
    // The columns.
    let column = |name: &str| header.needed_column(name);
    let atom_column = column("atom")?;
    let kind_column = column("kind")?;
    let weight_columns = [
        column("weight_r")?,
        column("weight_g")?,
        column("weight_b")?,
    ];
    let shape_columns = (column("alpha").ok(), column("eta").ok());
    // One atom a row, which must be the dictionary's.
    let mut weights = [0, 1, 2].map(|_| vec![f64::NAN; dictionary.len()]);
    for row in &rows {
        let line = row.line;
        let text = row.field(atom_column);
        let index = text
            .parse::<usize>()
            .ok()
            .filter(|&index| index < dictionary.len())
            .ok_or_else(|| {
                let (last, text) = (dictionary.len() - 1, excerpt(text));
                format!("line {line}: atom {text}, allowed is 0 to {last}")
            })?;
        let atom = dictionary.atoms()[index];
        let kind = atom.kind();
        if row.field(kind_column) != kind {
            return Err(format!(
                "line {line}: atom {index} is {}, in {} it is {kind}",
                excerpt(row.field(kind_column)),
                dictionary.name()
            ));
        }
        for (name, column, value) in [
            ("alpha", shape_columns.0, atom.alpha()),
            ("eta", shape_columns.1, atom.eta()),
        ] {
            let (Some(column), Some(value)) = (column, value) else {
                continue;
            };
            let text = row.field(column);
            if outside_table::number(text) != Ok(value) {
                return Err(format!(
                    "line {line}: atom {index} has {name} {}, in {} it is {value}",
                    excerpt(text),
                    dictionary.name()
                ));
            }
        }
        // Its weights, once.
        for (channel, &column) in weights.iter_mut().zip(&weight_columns) {
            if !channel[index].is_nan() {
                return Err(format!("line {line}: atom {index} stands twice"));
            }
            channel[index] = outside_table::number(row.field(column))
                .map_err(|error| format!("line {line}: the weight {error}"))?;
        }
    }
    // All atoms must be there.
    if let Some(missing) = weights[0].iter().position(|w| w.is_nan()) {
        return Err(format!(
            "atom {missing} of {} is missing",
            dictionary.name()
        ));
    }
    Ok(weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn example() -> Mixture {
        let dictionary = Arc::new(Dictionary::paper42());
        let weights = [3, 17, 40].map(|k| {
            let mut w = vec![0.0; 42];
            (w[k], w[41]) = (1.0 / 3.0, 2.0 / 3.0);
            w
        });
        Mixture::new(dictionary, weights).unwrap()
    }

    #[test]
    fn what_is_written_reads_back() {
        let mixture = example();
        for deviations in [None, Some(mixture.weights())] {
            let text = to_csv(&mixture, deviations);
            assert_eq!(
                &parse(&text, mixture.dictionary()).unwrap(),
                mixture.weights()
            );
        }
        let other = Arc::new(Dictionary::rig26());
        let even = Mixture::grey(other.clone(), vec![1.0 / 26.0; 26]).unwrap();
        let text = to_csv(&even, None);
        assert_eq!(&parse(&text, &other).unwrap(), even.weights());
        let bad = text.replace("coated,,1.5", "coated,,1.6");
        let error = parse(&bad, &other).unwrap_err();
        assert!(error.contains("eta 1.6"), "{error}");
    }

    #[test]
    fn faults_are_named() {
        let (mixture, good) = (example(), to_csv(&example(), None));
        for (bad, said) in [
            (String::new(), "empty"),
            (good.replace("weight_g", "green"), "weight_g"),
            (good.replace("\n41,", "\n42,"), "atom 42"),
            (
                good.replace("\n41,", "\n40,"),
                "black, in paper42 it is lambertian",
            ),
            (good.replace("\n1,ggx,0.5,1.7", "\n0,ggx,0.01,10"), "twice"),
            (good.replace("\n1,ggx,0.5,", "\n1,ggx,0.6,"), "alpha 0.6"),
            (good.replace("0.33", "zero"), "no number"),
            (good.rsplit_once("\n41").unwrap().0.to_owned(), "atom 41"),
        ] {
            let error = parse(&bad, mixture.dictionary()).unwrap_err();
            assert!(error.contains(said), "{said}: {error}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[a-z0-9_,.\n-]{0,200}") {
            let _ = parse(&text, &Dictionary::paper42());
            let _ = parse(&format!("atom,kind,weight_r,weight_g,weight_b\n{text}"), &Dictionary::paper42());
        }
    }
}
