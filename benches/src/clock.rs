//! CPU time of one thread, which other programs on the machine disturb least.

use rustix::time::{ClockId, clock_gettime};

/// CPU seconds that the calling thread has used.
pub fn thread_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// CPU seconds that `work` takes on the calling thread.
pub fn cpu_s(work: impl FnOnce()) -> f64 {
    let start = thread_cpu_s();
    work();
    thread_cpu_s() - start
}

/// The middle of some values (the upper one of an even number); NaN of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The smallest of some values; infinite of none.
pub fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}
