//! Events of the library: warnings are shown as the program's own, the rest on demand.

use std::fmt;

use tracing::{Event, Level, Subscriber};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

use super::stderr;

/// Shows warnings; with --verbose or RUST_LOG more, each with its time and module.
pub(super) fn start(quiet: bool, verbose: u8, color: bool) {
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (_, 0) => "warn",
        (_, 1) => "info,rig=debug,rig_core=debug",
        _ => "trace",
    };
    let wanted = std::env::var("RUST_LOG").ok();
    let wanted = wanted.filter(|text| !text.trim().is_empty());
    let shows_places = wanted.is_some() || verbose > 0;
    let parsed = wanted.as_deref().unwrap_or(level).parse();
    let (targets, fault) = match parsed {
        Ok(targets) => (targets, None),
        Err(error) => (Targets::new().with_default(Level::WARN), Some(error)),
    };
    let subscriber = tracing_subscriber::fmt()
        .with_max_level(Level::TRACE)
        .with_writer(|| stderr::Trace)
        .with_ansi(color)
        .log_internal_errors(false);
    // Fails where there is one already, which is as good.
    let _ = match shows_places {
        true => subscriber.finish().with(targets).try_init(),
        false => {
            let subscriber = subscriber.event_format(AsWarning { color });
            subscriber.finish().with(targets).try_init()
        }
    };
    if let (Some(wanted), Some(fault)) = (wanted, fault) {
        tracing::warn!("RUST_LOG is {wanted:?}, no filter such as \"rig=debug\": {fault}");
    }
}

/// `warning: …`, as the program's own warnings are shown.
struct AsWarning {
    color: bool,
}

impl<S, N> FormatEvent<S, N> for AsWarning
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let (word, begin) = match *event.metadata().level() {
            Level::ERROR => ("error:", "\x1b[1;31m"),
            _ => ("warning:", "\x1b[1;33m"),
        };
        match self.color {
            true => write!(writer, "{begin}{word}\x1b[0m ")?,
            false => write!(writer, "{word} ")?,
        }
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}
