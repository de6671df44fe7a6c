//! Work on files that other programs or machines may hold up for ever: a file
//! system that hangs, a disk that is asleep.

use std::sync::mpsc;
use std::time::Duration;

use super::DeviceError;
use crate::units::Seconds;

/// What handing a result over may take beyond the time that the work itself is given.
pub const HANDOVER: Duration = Duration::from_millis(200);

/// A camera's frame, with what belongs to it, by `work`, which ends by itself within `timeout` unless a file holds it up.
///
/// # Errors
/// Those of `work`; [`DeviceError::NoReply`] to what was `sent` where it took longer.
pub fn frame_within<T: Send + 'static>(
    device: String,
    timeout: Seconds,
    sent: &str,
    work: impl FnOnce() -> Result<T, DeviceError> + Send + 'static,
) -> Result<T, DeviceError> {
    match within(timeout.to_duration() + HANDOVER, work) {
        Ok(Some(taken)) => taken,
        Ok(None) => Err(DeviceError::NoReply {
            device,
            timeout,
            sent: sent.to_owned(),
        }),
        Err(source) => Err(DeviceError::Io { device, source }),
    }
}

/// Does `work` on a thread of its own and waits for it, `longest` at most. `None`:
/// it took longer and was abandoned; its thread ends whenever the work does.
///
/// # Errors
/// If no thread can be started.
pub fn within<T: Send + 'static>(
    longest: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> std::io::Result<Option<T>> {
    let (done, result) = mpsc::sync_channel(1);
    std::thread::Builder::new()
        .name("outside".to_owned())
        .spawn(move || drop(done.send(work())))?;
    match result.recv_timeout(longest) {
        Ok(result) => Ok(Some(result)),
        Err(mpsc::RecvTimeoutError::Timeout) => Ok(None),
        Err(mpsc::RecvTimeoutError::Disconnected) => {
            Err(std::io::Error::other("the work ended unexpectedly"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn what_hangs_is_abandoned() {
        assert_eq!(within(Duration::from_secs(60), || 7).unwrap(), Some(7));
        let (held, never) = mpsc::channel::<()>();
        let began = Instant::now();
        let hangs = within(Duration::from_millis(20), move || never.recv().is_ok());
        assert_eq!(hangs.unwrap(), None);
        assert!(began.elapsed() < Duration::from_secs(30));
        drop(held);
        assert!(within(Duration::from_secs(60), || panic!("a defect")).is_err());
    }
}
