//! Why an experiment fails.

use std::path::PathBuf;

/// Why an experiment stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// No experiment of that name.
    #[error("\"{name}\" is no experiment (known: {known})")]
    UnknownExperiment {
        /// As given.
        name: String,
        /// The known ones.
        known: String,
    },
    /// A setting that the experiment does not have.
    #[error("experiment {experiment} has no setting {setting}")]
    Unused {
        /// The experiment.
        experiment: &'static str,
        /// The setting.
        setting: &'static str,
    },
    /// A material that has no such name and is no file.
    #[error("material \"{spec}\" is unknown (known: {known})")]
    UnknownMaterial {
        /// As given.
        spec: String,
        /// The known ones.
        known: String,
    },
    /// No case is called so.
    #[error("none of the {cases} cases has \"{only}\" in its name; the first is \"{first}\"")]
    NoSuchCase {
        /// What was looked for.
        only: String,
        /// How many cases there are.
        cases: usize,
        /// The name of one.
        first: String,
    },
    /// None of the materials is of a class that the experiment needs.
    #[error("no material of class {class} among those given")]
    NoMaterial {
        /// The class.
        class: &'static str,
    },
    /// Two materials of one name.
    #[error("two materials are called \"{name}\"")]
    SameName {
        /// The name.
        name: String,
    },
    /// The output folder holds something else.
    #[error("{}: not empty, and no experiment's folder", path.display())]
    ForeignFolder {
        /// The folder.
        path: PathBuf,
    },
    /// The output folder holds cases that were run with other settings.
    #[error("{}: begun with other settings: {differences}", path.display())]
    SettingsChanged {
        /// The folder.
        path: PathBuf,
        /// Each setting that differs, then and now.
        differences: String,
    },
    /// Another process writes into the folder.
    #[error("{}: another process is at work in this folder", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// The journal is damaged before its last line.
    #[error("{}, line {line}: {fact}", path.display())]
    Journal {
        /// The journal.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong.
        fact: String,
    },
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// A case failed.
    #[error("case {key}")]
    Case {
        /// The case.
        key: String,
        /// Why.
        source: Box<EvaluateError>,
    },
    /// A case has no result where there should be one.
    #[error("{0}")]
    Fact(String),
    /// A BRDF.
    #[error(transparent)]
    Brdf(#[from] crate::brdf::BrdfError),
    /// A projection.
    #[error(transparent)]
    Projection(#[from] crate::brdf::projection::ProjectionError),
    /// A quadratic programme.
    #[error(transparent)]
    Simplex(#[from] crate::simplex::SimplexError),
    /// A fit.
    #[error(transparent)]
    Fit(#[from] crate::inverse::FitError),
    /// Paths.
    #[error(transparent)]
    Cache(#[from] crate::transport::cache::CacheError),
    /// The expected error of a scene.
    #[error(transparent)]
    Prediction(#[from] crate::inverse::expected_error::PredictionError),
    /// A merge of exposures.
    #[error(transparent)]
    Merge(#[from] crate::radiometry::merge::MergeError),
    /// An edge.
    #[error(transparent)]
    Edge(#[from] crate::calibration::slanted_edge::EdgeError),
    /// A shape.
    #[error(transparent)]
    Mesh(#[from] crate::geometry::MeshError),
    /// A figure.
    #[error(transparent)]
    Plot(#[from] crate::plot::PlotError),
}
