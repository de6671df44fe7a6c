//! Work of a handler that waits for disks or takes long.

use super::refusal::Refusal;

/// Does the work in a thread of its own, so that no other request waits for it.
///
/// # Errors
/// A panic in it: the request fails, nothing else.
pub async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refusal> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|_| Refusal::failed("a defect of this program ended the request"))
}
