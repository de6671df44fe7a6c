//! `rig console`: the bench in a browser; also around a capture that is started with it.

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitStatus;
use std::sync::mpsc::{self, Sender};

use super::console_address::show_address;
use super::context::Context;
use super::error::{CliError, HintExt};
use super::exit::Exit;
use super::output::write_path;
use super::rig_choice::RigArg;
use super::{bench_ports, definition, interrupt};
use crate::config::{Origin, ResolvedRig};
use crate::console::jobs::{Kind, Work};
use crate::console::server::{ListenOptions, Server, is_host_name};
use crate::console::whole::{Console, Notice, Subject, Surroundings, Then, Woken};
use crate::interrupt::Signal;
use crate::session::layout::SESSIONS_FOLDER;

/// The bench in a browser: live picture, capture, progress, results
///
/// stdout's line is the page's address. Whoever has it controls the bench. Ctrl-C ends the
/// console, and a capture that runs, in good order.
#[derive(clap::Args, Debug)]
pub struct ConsoleArgs {
    #[command(flatten)]
    rig: RigArg,
    /// Folder of the sessions
    #[arg(long, value_name = "DIR", default_value = SESSIONS_FOLDER)]
    out: PathBuf,
    #[command(flatten)]
    listen: ListenArgs,
}

/// Where a console listens.
#[derive(clap::Args, Debug, Clone, Default)]
#[command(next_help_heading = "Console")]
pub struct ListenArgs {
    /// Address to listen at (default 127.0.0.1: this machine alone); other machines reach
    /// 0.0.0.0 or the machine's own, over a connection that is not encrypted
    #[arg(long, value_name = "IP[:PORT]", value_parser = parse_listen)]
    listen: Option<(IpAddr, Option<u16>)>,
    /// Port to listen at (default: a free one)
    #[arg(long, value_name = "PORT")]
    port: Option<u16>,
    /// Name that browsers reach the console by, such as that of a TLS proxy; may be repeated
    #[arg(long, value_name = "NAME", value_parser = parse_host_name)]
    host_name: Vec<String>,
}

impl ListenArgs {
    /// For the server.
    pub fn options(&self) -> Result<ListenOptions, CliError> {
        let (ip, named) = self.listen.unwrap_or((Ipv4Addr::LOCALHOST.into(), None));
        if let (Some(port), Some(other)) = (named, self.port)
            && port != other
        {
            let fact = format!("--listen names port {port} and --port {other}");
            return Err(CliError::new(fact).hint("give the port once"));
        }
        let port = named.or(self.port).unwrap_or(0);
        Ok(ListenOptions {
            address: SocketAddr::new(ip, port),
            host_names: self.host_name.clone(),
        })
    }
}

fn parse_listen(text: &str) -> Result<(IpAddr, Option<u16>), String> {
    if let Ok(address) = text.parse::<SocketAddr>() {
        return Ok((address.ip(), Some(address.port())));
    }
    let bare = text
        .strip_prefix('[')
        .and_then(|text| text.strip_suffix(']'));
    let ip = bare.unwrap_or(text).parse();
    ip.map(|ip| (ip, None))
        .map_err(|_| "an IP address, e.g. 0.0.0.0 or 192.168.1.5:8080 or [::1]:8080".to_owned())
}

fn parse_host_name(text: &str) -> Result<String, String> {
    match is_host_name(text) {
        true => Ok(text.to_owned()),
        false => Err("a name alone, as bench.example.org: letters, digits, hyphens and dots, without http:// and port; `*` stands for nothing".to_owned()),
    }
}

/// `rig console`.
pub fn run(args: &ConsoleArgs, context: &Context) -> Result<(), CliError> {
    let rig = args.rig.resolve(context)?;
    let subject = Subject {
        named: name_of(&args.rig, &rig),
        rig,
        folder: args.out.clone(),
    };
    serve(subject, &args.listen, None, context)
}

/// The console around a capture, as `rig capture --console` is: `arguments` are those of the
/// capture without what belongs to the console (`capture --rig R --lights 4`).
///
/// The capture has this terminal; the console stays when it has ended, and ends as it did.
pub fn run_with_capture(
    arguments: Vec<OsString>,
    listen: &ListenArgs,
    context: &Context,
) -> Result<(), CliError> {
    let subject = subject_of_capture(&arguments, context)?;
    let events = OsString::from("--events");
    let work = Work {
        hidden: vec![events.clone()],
        at_terminal: true,
        ..Work::new(
            Kind::Capture,
            arguments.into_iter().filter(|a| *a != events).collect(),
        )
    };
    serve(subject, listen, Some(work), context)
}

/// What a console around a capture with these arguments is about.
fn subject_of_capture(arguments: &[OsString], context: &Context) -> Result<Subject, CliError> {
    let whole = std::iter::once(OsString::from("rig")).chain(arguments.iter().cloned());
    let matches = definition().try_get_matches_from(whole)?;
    let (_, matches) = matches
        .subcommand()
        .ok_or_else(|| CliError::new("no capture to show"))?;
    if let Ok(Some(root)) = matches.try_get_one::<PathBuf>("resume") {
        return Ok(Subject::of_session(root)?);
    }
    let rig = matches.try_get_one::<String>("rig").ok().flatten();
    let rig = RigArg { rig: rig.cloned() };
    let resolved = rig.resolve(context)?;
    let folder = matches
        .try_get_one::<PathBuf>("out")
        .ok()
        .flatten()
        .cloned();
    Ok(Subject {
        named: name_of(&rig, &resolved),
        rig: resolved,
        folder: folder.unwrap_or_else(|| SESSIONS_FOLDER.into()),
    })
}

/// The rig as `--rig` takes it, so that each command line names it.
fn name_of(asked: &RigArg, resolved: &ResolvedRig) -> String {
    let environment = || std::env::var("RIG_CONFIG").unwrap_or_default();
    match (&asked.rig, resolved.origin) {
        (Some(rig), _) => rig.clone(),
        (None, Origin::Environment) => environment(),
        (None, Origin::WorkingFolder) => resolved.file.clone(),
        (None, _) => "simulated".to_owned(),
    }
}

/// Serves one console after another, as pages choose their benches, until a signal ends the last;
/// runs `work` first, if any.
fn serve(
    mut subject: Subject,
    listen: &ListenArgs,
    mut work: Option<Work>,
    context: &Context,
) -> Result<(), CliError> {
    let mut server = bind(&listen.options()?, context)?;
    // Signals, the ends of jobs and the choices of pages wake this thread.
    let (wake, woken) = mpsc::channel();
    listen_for_signals(wake.clone())?;
    let around = Surroundings {
        ports: &bench_ports::of_rig,
        advisor: bench_ports::advisor(),
        wake,
        woken,
        tell: &|notice| tell(notice, context),
        suspend: interrupt::suspend,
    };
    let is_capture = work.is_some();
    let (mut captured, mut is_first) = (None, true);
    loop {
        let console = Console::start(&subject, &mut server, &around)?;
        if is_first {
            show_address(&server.address(), context)?;
        }
        let then = console.run(work.take(), is_first, &mut captured, &around);
        is_first = false;
        if let Ok(Then::Bench(rig, named)) = then {
            console.close(|| false, &around);
            (subject.rig, subject.named) = (*rig, named);
            continue;
        }
        console.close(|| around.is_urgent(), &around);
        return match then? {
            _ if is_capture && captured.is_some() => as_it_ended(captured.flatten()),
            Then::End(Some(signal)) => Err(CliError::stated(Exit::Signal(signal))),
            _ => Ok(()),
        };
    }
}

/// What a console says, in words.
fn tell(notice: Notice<'_>, context: &Context) {
    match notice {
        Notice::Ready => context.note("Ctrl-C ends the console"),
        // Whoever reads stdout may be gone; pages may not be.
        Notice::Captured(session) => drop(write_path(session)),
        Notice::Stays => context.note("the console stays; Ctrl-C ends it"),
        Notice::Stopping(job) => context.note(format!(
            "{} is running: the console ends when it has stopped",
            job.what()
        )),
        Notice::Closed(error) => context.warn(error),
        Notice::NotClosed => {
            context.warn("the bench's devices are not closed yet; its guardian turns a lamp off");
        }
    }
}

/// Sends each signal to the main thread.
fn listen_for_signals(wake: Sender<Woken>) -> std::io::Result<()> {
    let mut signals = interrupt::signals()?;
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            for number in signals.forever() {
                if wake.send(Woken::Signal(number)).is_err() {
                    return;
                }
            }
        })?;
    Ok(())
}

/// Listens; says so if others can reach it.
pub(super) fn bind(options: &ListenOptions, context: &Context) -> Result<Server, CliError> {
    let server = Server::bind(options).hint(
        "choose another --port, or 0 for a free one; --listen takes an address of this machine",
    )?;
    if !server.socket_address().ip().is_loopback() {
        context.warn(
            "the connection is not encrypted: whoever shares the network can read the address \
             and control the bench with it; put the console behind a TLS proxy (docs/console.md)",
        );
    }
    Ok(server)
}

/// The capture has stated how it ended; the console ends alike.
fn as_it_ended(status: Option<ExitStatus>) -> Result<(), CliError> {
    let exit = match status.and_then(|status| status.code()) {
        Some(0) => return Ok(()),
        Some(2) => Exit::Internal,
        Some(code) => match Signal::from_number(code - 128) {
            Some(signal) => Exit::Signal(signal),
            None => Exit::Failed,
        },
        None => {
            let how = status.map_or_else(|| "unknown".to_owned(), |status| status.to_string());
            return Err(CliError::new(format!("the capture's process ended: {how}")).hint(
                "`rig catalogue` shows its session; `rig capture --resume SESSION` continues it",
            ));
        }
    };
    Err(CliError::stated(exit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_port_or_takes_a_free_one() {
        let options = |listen: &str, port| {
            ListenArgs {
                listen: Some(parse_listen(listen).unwrap()),
                port,
                host_name: Vec::new(),
            }
            .options()
            .map(|options| options.address.to_string())
        };
        assert_eq!(options("0.0.0.0", None).unwrap(), "0.0.0.0:0");
        assert_eq!(options("0.0.0.0", Some(80)).unwrap(), "0.0.0.0:80");
        assert_eq!(options("10.0.0.5:8080", None).unwrap(), "10.0.0.5:8080");
        assert_eq!(options("[::1]:1", Some(1)).unwrap(), "[::1]:1");
        assert_eq!(options("[::]", None).unwrap(), "[::]:0");
        assert!(options("10.0.0.5:8080", Some(1)).is_err());
        let default = ListenArgs::default().options().unwrap().address;
        assert!(default.ip().is_loopback() && default.port() == 0);
        for good in [
            "bench",
            "bench.example.org",
            "Bench-2.lab",
            "10.0.0.5",
            "my_bench.lan",
        ] {
            assert_eq!(parse_host_name(good).as_deref(), Ok(good));
        }
        let long = "a".repeat(64);
        for bad in [
            "",
            "*",
            "*.lab",
            "a\nb",
            "http://bench/",
            "bench:80",
            "bench/",
            "-a",
            "a..b",
            "a b",
            "[::1]",
            "münchen",
            &long,
        ] {
            assert!(parse_host_name(bad).is_err(), "{bad}");
        }
        for bad in ["", "localhost", "0.0.0.0:", "0.0.0.0:99999", "[::1", ":80"] {
            assert!(parse_listen(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_console_ends_as_its_capture_did() {
        use std::os::unix::process::ExitStatusExt;
        let exit = |raw| as_it_ended(Some(ExitStatus::from_raw(raw))).map_err(|e| e.exit());
        assert_eq!(exit(0), Ok(()));
        assert_eq!(exit(1 << 8), Err(Exit::Failed));
        assert_eq!(exit(2 << 8), Err(Exit::Internal));
        assert_eq!(exit(130 << 8), Err(Exit::Signal(Signal::Interrupt)));
        assert_eq!(exit(9), Err(Exit::Failed), "killed");
    }
}
