//! `rig report`: a session as one HTML file, or a certificate of it as two pages.

use std::path::PathBuf;

use super::output::{check_writable, unwritable, write_path};
use super::{CliError, Context, HintExt};
use crate::report::certificate::browser::Browser;
use crate::report::certificate::{self, CertificateError, CertificateRequest};
use crate::report::load::{FitChoice, LoadError};
use crate::report::{self, ReportError, ReportRequest};
use crate::whole_file;
use crate::workflow::StatedResult;

/// Writes a session's report: one HTML file that needs no other, or a certificate.
#[derive(clap::Args, Debug)]
pub struct ReportArgs {
    /// The session's folder
    #[arg(value_name = "SESSION")]
    session: PathBuf,
    /// Which fit to show, by its number in `fits/`, or the folder of one that `rig fit SESSION
    /// --out` wrote; the session's latest if not given
    #[arg(long, value_name = "FIT", value_parser = fit_choice)]
    fit: Option<FitChoice>,
    /// Writes here instead of report.html in the session
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// A certificate of measurement instead: two A4 pages, as .pdf where this machine has a
    /// browser that prints, else as .html; here, unless --out names a file
    #[arg(long)]
    certificate: bool,
    /// With --certificate: a folder of sessions; the scatter between those of this sample, as
    /// `rig catalogue --repeats` shows it, becomes a source of uncertainty
    #[arg(long, value_name = "DIR", requires = "certificate")]
    repeats: Option<PathBuf>,
}

/// A number, or a folder of another name.
fn fit_choice(text: &str) -> Result<FitChoice, std::convert::Infallible> {
    let number = text.parse().map(FitChoice::Number);
    Ok(number.unwrap_or_else(|_| FitChoice::Folder(text.into())))
}

/// `rig report`.
pub fn run(args: &ReportArgs, context: &Context) -> Result<(), CliError> {
    if args.certificate {
        return certificate(args, context);
    }
    let request = ReportRequest {
        session: args.session.clone(),
        fit: args.fit.clone(),
        out: args.out.clone(),
    };
    let written = report::write(&request).map_err(|error| match error {
        ReportError::Load(error) => advise(error),
        ReportError::Session(error) => error.into(),
        ReportError::Io { path, source } => unwritable(&path, &source),
        error => error.into(),
    })?;
    if !written.has_fit {
        context.note("the session has no fit yet; `rig fit SESSION` makes one");
    }
    write_path(&written.path)
}

/// Writes a certificate, as PDF where a browser can.
fn certificate(args: &ReportArgs, context: &Context) -> Result<(), CliError> {
    // Which file, and whether it can be made at all.
    let ends_in = |ending: &str| {
        let ending_of = |path: &PathBuf| {
            path.extension()
                .is_some_and(|e| e.eq_ignore_ascii_case(ending))
        };
        args.out.as_ref().map(ending_of)
    };
    let fit = match &args.fit {
        None => None,
        Some(FitChoice::Number(number)) => Some(*number),
        Some(FitChoice::Folder(folder)) => {
            let fact = format!(
                "{}: a certificate is made of a fit in its session",
                folder.display()
            );
            return Err(CliError::new(fact)
                .hint("copy the session to where it can be written, and fit it there"));
        }
    };
    let browser = Browser::find();
    let is_pdf = ends_in("pdf").unwrap_or(browser.is_some());
    if !is_pdf && ends_in("html") == Some(false) {
        let path = args.out.clone().unwrap_or_default();
        let fact = format!("{}: a certificate ends in .html or .pdf", path.display());
        return Err(CliError::new(fact).hint("for instance --out certificate.pdf"));
    }
    let path = args.out.clone();
    let path = path.unwrap_or_else(|| certificate::default_file(is_pdf).to_owned());
    check_writable(&path)?;
    let no_browser = || {
        CliError::new("no browser that prints was found (chromium, google-chrome)")
            .hint("write a .html file and print it from any browser, or install chromium")
    };
    let browser = match is_pdf {
        true => Some(browser.ok_or_else(no_browser)?),
        false => None,
    };

    // The pages.
    let request = CertificateRequest {
        session: args.session.clone(),
        fit,
        repeats: args.repeats.clone(),
    };
    let html = certificate::certificate(&request).map_err(refused)?;
    note_of_lab(&request, context);
    let bytes = match &browser {
        Some(browser) => browser
            .print(&html, Some(super::open::keeper()?))
            .hint("write a .html file instead and print it from any browser")?,
        None => html.into_bytes(),
    };
    whole_file::replace(&path, |file| file.write_all(&bytes))
        .map_err(|error| unwritable(&path, &error))?;
    if browser.is_none() {
        context.note("print it from a browser (Ctrl-P, A4, without headers and footers)");
    }
    write_path(&path)
}

/// What the certificate says is not stated, and where it would be.
fn note_of_lab(request: &CertificateRequest, context: &Context) {
    let Ok(StatedResult { config, .. }) = StatedResult::load(&request.session, request.fit) else {
        return;
    };
    let lacking = config.lab.not_stated();
    if !lacking.is_empty() {
        context.note(format!(
            "\"not stated\" in the certificate: {}; state them in [lab] of the rig file before the capture",
            lacking.join(", ")
        ));
    }
}

fn refused(error: CertificateError) -> CliError {
    let hint = match &error {
        CertificateError::NotTrusted { .. } => {
            "`rig report SESSION` shows why; a certificate is made of a fit that explains its images"
        }
        CertificateError::NotWhole { .. } => {
            "`rig session verify SESSION` lists what is wrong; `rig capture --resume SESSION` completes a capture"
        }
        CertificateError::Folder { .. } => "--repeats takes the folder that holds the sessions",
        CertificateError::Repeats { .. } => {
            "`rig catalogue DIR --repeats SAMPLE` shows which sessions count and why others do not"
        }
        CertificateError::NoBudget { .. } => "`rig fit SESSION` makes a new fit, with a budget",
        _ => {
            return match error {
                CertificateError::Result(error) => super::export::stated_result_error(error),
                CertificateError::Session(error) => error.into(),
                error => error.into(),
            };
        }
    };
    CliError::from(error).hint(hint)
}

fn advise(error: LoadError) -> CliError {
    let hint = match &error {
        LoadError::Fit(_) => "`rig fit SESSION` makes a new fit; --fit N shows another one",
        LoadError::OtherSession { .. } => {
            "give the session that `rig fit SESSION --out DIR` was given"
        }
        LoadError::NoSuchFit { .. } => {
            "leave --fit out to show the latest, or run `rig fit SESSION`"
        }
        LoadError::Image(_) => {
            "`rig capture --resume SESSION` makes the merged images again from the raw frames"
        }
        LoadError::Session(error) if error.damaged_file().is_some() => {
            "`rig session verify SESSION` lists every damaged file; `rig capture --resume SESSION` makes merged images again"
        }
        LoadError::Sidecar { .. } | LoadError::Session(_) => {
            "give the folder of a session; `rig session verify SESSION` checks every file of it"
        }
        LoadError::Brdf(_) => "`rig fit SESSION` makes a new fit",
    };
    CliError::from(error).hint(hint)
}
