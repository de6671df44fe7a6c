//! Writes a fitted material for other programs: `cargo run --release --example export -- FIT
//! OUT`, where FIT is the folder of a fit, or a session (its newest fit); OUT.binary is a MERL
//! table, OUT.xml a Mitsuba 3 scene fragment.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program that prints its result"
)]

use std::path::{Path, PathBuf};

use rig::export::{Format, export};
use rig::session::fit_record;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [fit, out] = arguments.as_slice() else {
        return Err("usage: export FIT OUT".into());
    };
    let record = fit_record::find(fit)?;
    println!("{}", record.verdict().sentence());
    for format in ["merl", "mitsuba"] {
        let format = &Format::named(format).ok_or("no such format")?;
        let file: &Path = &out.with_extension(format.ending);
        for written in export(&record, format, file)?.files {
            println!("wrote {}", written.display());
        }
    }
    Ok(())
}
