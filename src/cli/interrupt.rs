//! Ctrl-C, SIGTERM and SIGHUP become requests on an [`Interrupt`].
//!
//! Only commands that hold hardware or a session listen; every other command
//! keeps the system's default and ends at once.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::CliError;
use crate::interrupt::{Interrupt, Signal};

/// Starts to listen; from now on the command must poll what this returns.
pub fn listen() -> Result<Interrupt, CliError> {
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    let interrupt = Interrupt::new();
    let raised = interrupt.clone();
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            for signal in signals.forever().filter_map(Signal::from_number) {
                raised.raise(signal);
            }
        })?;
    Ok(interrupt)
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::interrupt::StopLevel;

    /// Every signal to the process makes the request more urgent.
    #[test]
    fn signals_become_requests() {
        let interrupt = listen().unwrap();
        let steps = [
            (SIGTERM, StopLevel::AfterThisFrame, Signal::Terminate),
            (SIGINT, StopLevel::Now, Signal::Interrupt),
        ];
        for (number, level, signal) in steps {
            signal_hook::low_level::raise(number).unwrap();
            let patience = Instant::now() + Duration::from_secs(20);
            while interrupt.level() != level && Instant::now() < patience {
                std::thread::yield_now();
            }
            assert_eq!(interrupt.level(), level);
            assert_eq!(interrupt.signal(), Some(signal));
        }
    }
}
