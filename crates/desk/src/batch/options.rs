//! Options of fits, as words of a command line.

use std::collections::HashMap;

use super::BatchError;
use crate::shell_words;
use crate::workflow::FitRequest;

/// The request of a fit by its options' words; an error is a fact in one line.
pub type ParseOptions = dyn Fn(&[String]) -> Result<FitRequest, String>;

/// Reads options, equal ones once: most jobs of a batch have the same.
pub(super) struct OptionsReader<'a> {
    parse: &'a ParseOptions,
    known: HashMap<String, FitRequest>,
}

impl<'a> OptionsReader<'a> {
    pub fn new(parse: &'a ParseOptions) -> Self {
        Self {
            parse,
            known: HashMap::new(),
        }
    }

    /// The request that a job's options make.
    pub fn request(&mut self, job: usize, options: &str) -> Result<FitRequest, BatchError> {
        if let Some(request) = self.known.get(options) {
            return Ok(request.clone());
        }
        let words = shell_words::split(options).ok_or_else(|| "a quote is not closed".to_owned());
        let request = words.and_then(|words| (self.parse)(&words));
        let request = request.map_err(|fact| BatchError::Options {
            job,
            options: options.to_owned(),
            fact,
        })?;
        self.known.insert(options.to_owned(), request.clone());
        Ok(request)
    }
}
