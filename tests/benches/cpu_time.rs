//! How much time did it take, on the clock and of the processor?

use std::time::Instant;

/// Time of one call, seconds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Elapsed {
    pub(crate) wall_s: f64,
    /// CPU time of all threads of the process together; says more than the clock on a machine that others use, too. Not
    /// a number where the system does not report it.
    pub(crate) cpu_s: f64,
}

/// Calls `work`, and says what it took.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (T, Elapsed) {
    let (start, cpu_start_s) = (Instant::now(), cpu_s());
    let result = work();
    (result, Elapsed { wall_s: start.elapsed().as_secs_f64(), cpu_s: cpu_s() - cpu_start_s })
}

/// Processor time of the process so far: the nanoseconds that Linux gives for each of its threads.
fn cpu_s() -> f64 {
    let Ok(threads) = fs_err::read_dir("/proc/self/task") else { return f64::NAN };
    let nanoseconds = threads.flatten().filter_map(|thread| {
        let text = fs_err::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    });
    nanoseconds.sum::<f64>() * 1e-9
}
