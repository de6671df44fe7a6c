//! A page as PDF, by a browser that this machine has.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

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

/// Why there is no PDF.
#[derive(Debug, thiserror::Error)]
pub enum BrowserError {
    /// The browser could not be run, or its files not be written.
    #[error("{}: {source}", program.display())]
    Io {
        /// The program.
        program: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// It ended without a PDF.
    #[error("{} made no PDF: {fact}", program.display())]
    NoPdf {
        /// The program.
        program: PathBuf,
        /// How it ended.
        fact: String,
    },
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

    /// Prints a document as PDF and returns its bytes.
    ///
    /// # Errors
    /// The browser cannot be run, or makes no PDF within a minute.
    pub fn print(&self, html: &str) -> Result<Vec<u8>, BrowserError> {
        let failed = |source| BrowserError::Io {
            program: self.program.clone(),
            source,
        };
        // A profile of its own: a running browser of the user would take the page over.
        let folder = tempfile::tempdir().map_err(failed)?;
        let (page, pdf) = (
            folder.path().join("page.html"),
            folder.path().join("page.pdf"),
        );
        fs::write(&page, html).map_err(failed)?;
        let mut command = Command::new(&self.program);
        command
            .arg("--headless=new")
            .args(["--disable-gpu", "--disable-extensions", "--no-first-run"])
            .arg("--no-pdf-header-footer")
            .arg(option("--user-data-dir=", &folder.path().join("profile")))
            .arg(option("--print-to-pdf=", &pdf))
            .arg(option("file://", &page))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        // The browser refuses its sandbox to the administrator; the page has no scripts.
        if rustix::process::geteuid().is_root() {
            command.arg("--no-sandbox");
        }
        let mut child = command.spawn().map_err(failed)?;
        let ended = wait(&mut child).map_err(failed)?;
        match (ended, fs::read(&pdf)) {
            (Some(true), Ok(bytes)) if bytes.starts_with(b"%PDF") => Ok(bytes),
            (ended, _) => Err(BrowserError::NoPdf {
                program: self.program.clone(),
                fact: match ended {
                    Some(true) => "it wrote no file".to_owned(),
                    Some(false) => "it failed".to_owned(),
                    None => format!("it was not done after {} s", LONGEST.as_secs()),
                },
            }),
        }
    }
}

fn option(name: &str, path: &Path) -> std::ffi::OsString {
    let mut option = std::ffi::OsString::from(name);
    option.push(path);
    option
}

/// Whether it succeeded; `None` where it was ended because it took too long.
fn wait(child: &mut Child) -> io::Result<Option<bool>> {
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status.success()));
        }
        if begun.elapsed() > LONGEST {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}
