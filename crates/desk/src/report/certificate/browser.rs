//! A page as PDF, by a browser that this machine has.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::device::DeviceError;
use crate::device::command_camera::Workplace;
use crate::outside_file::read_regular;
use crate::whole_file;

/// Programs that print a page without showing it, in the order in which they are tried.
const NAMES: [&str; 5] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
];

/// A page of two sheets takes a second; a browser's first start some more.
const LONGEST: Duration = Duration::from_secs(60);

/// Two sheets have some 100 kB.
const LARGEST_PDF_BYTES: u64 = 256 << 20;

/// Why there is no PDF.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum BrowserError {
    /// The browser could not be run.
    #[error(transparent)]
    Run(#[from] DeviceError),
    /// The page could not be written for it.
    #[error("{}: {source}", path.display())]
    Page {
        path: PathBuf,
        source: std::io::Error,
    },
    /// It ended without a PDF.
    #[error("{} made no PDF: {fact}", program.display())]
    NoPdf { program: PathBuf, fact: String },
}

/// A browser that can print pages.
#[derive(Clone, Debug)]
pub struct Browser {
    program: PathBuf,
}

impl Browser {
    /// The first one in the folders of `PATH`.
    pub fn find() -> Option<Self> {
        let path = std::env::var_os("PATH")?;
        let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
        NAMES.iter().find_map(|name| {
            let mut programs = folders.iter().map(|folder| folder.join(name));
            let program = programs.find(|program| program.is_file())?;
            Some(Self { program })
        })
    }

    /// Prints a document as PDF and returns its bytes. However this process ends meanwhile, the
    /// browser ends with all that it has started, and its files go: by `keeper`, which is this
    /// program as its [`keep`](crate::device::command_camera::keep).
    ///
    /// # Errors
    /// The browser cannot be run, or makes no PDF within a minute.
    pub fn print(&self, html: &str, keeper: Option<Command>) -> Result<Vec<u8>, BrowserError> {
        // A profile of its own: a running browser of the user would take the page over.
        let workplace = Workplace::new(keeper)?;
        let folder = workplace.place()?;
        let [page, pdf] = ["page.html", "page.pdf"].map(|name| folder.path().join(name));
        whole_file::create(&page, html.as_bytes()).map_err(|source| BrowserError::Page {
            path: page.clone(),
            source,
        })?;
        let mut command = Command::new(&self.program);
        command
            .arg("--headless=new")
            .args(["--disable-gpu", "--disable-extensions", "--no-first-run"])
            .arg("--no-pdf-header-footer")
            .arg(option("--user-data-dir=", &folder.path().join("profile")))
            .arg(option("--print-to-pdf=", &pdf))
            .arg(option("file://", &page));
        // The browser refuses its sandbox to the administrator; the page has no scripts.
        if rustix::process::geteuid().is_root() {
            command.arg("--no-sandbox");
        }
        let ended = workplace.run(command, Instant::now() + LONGEST)?;
        let fact = match (ended.status, read_regular(&pdf, LARGEST_PDF_BYTES)) {
            (None, _) => format!("it was not done after {} s", LONGEST.as_secs()),
            (Some(status), _) if !status.success() => format!("it failed ({status})"),
            (_, Ok(bytes)) if bytes.starts_with(b"%PDF") => return Ok(bytes),
            (_, Ok(_)) => "what it wrote is none".to_owned(),
            (_, Err(error)) if error.kind() == std::io::ErrorKind::NotFound => {
                "it wrote no file".to_owned()
            }
            (_, Err(error)) => format!("its file cannot be read: {error}"),
        };
        Err(BrowserError::NoPdf {
            program: self.program.clone(),
            fact,
        })
    }
}

fn option(name: &str, path: &Path) -> std::ffi::OsString {
    let mut option = std::ffi::OsString::from(name);
    option.push(path);
    option
}
