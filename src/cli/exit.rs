//! Exit codes of the program.

use crate::interrupt::Signal;

/// How the program ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// What was asked for is done.
    Done,
    /// It failed, or the input was bad (usage errors too).
    Failed,
    /// A defect of the program itself.
    Internal,
    /// A signal ended it after an orderly stop.
    Signal(Signal),
}

impl Exit {
    /// 0, 1, 2, or 128 plus the signal's number (130 SIGINT, 143 SIGTERM, 129 SIGHUP).
    pub fn code(self) -> u8 {
        match self {
            Exit::Done => 0,
            Exit::Failed => 1,
            Exit::Internal => 2,
            Exit::Signal(signal) => 128 + signal.number() as u8,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_a_shell_would_show() {
        assert_eq!(Exit::Signal(Signal::Interrupt).code(), 130);
        assert_eq!(Exit::Signal(Signal::Terminate).code(), 143);
        assert_eq!(Exit::Signal(Signal::HangUp).code(), 129);
    }
}
