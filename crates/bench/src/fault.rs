//! What went wrong, as a page shows it: the fact, and advice where there is some.

use std::error::Error;
use std::fmt;
use std::sync::Arc;

use serde::Serialize;

/// A fact with its advice.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[allow(missing_docs)]
pub struct Fault {
    pub error: String,
    pub hint: Option<String>,
}

impl Fault {
    /// A fact without advice.
    pub fn new(error: impl Into<String>) -> Self {
        Self {
            error: error.into(),
            hint: None,
        }
    }
}

/// Advice on typed errors. The library states facts; whoever starts the console knows what
/// to do about them.
#[derive(Clone)]
pub struct Advisor(Arc<Advise>);

type Advise = dyn Fn(&(dyn Error + 'static)) -> Option<String> + Send + Sync;

impl Advisor {
    /// From a function that knows the advice on an error, as that of the command line.
    pub fn new(
        advise: impl Fn(&(dyn Error + 'static)) -> Option<String> + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(advise))
    }

    /// One that has no advice.
    pub fn silent() -> Self {
        Self::new(|_| None)
    }

    /// The error's fact with its advice.
    pub fn fault(&self, error: &(dyn Error + 'static)) -> Fault {
        Fault {
            error: error.to_string(),
            hint: (self.0)(error),
        }
    }
}

impl fmt::Debug for Advisor {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Advisor")
    }
}
