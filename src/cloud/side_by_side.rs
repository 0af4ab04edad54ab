//! Transfers many objects at once.

use super::error::Result;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Requests wait for the network far longer than they compute.
const N_AT_ONCE: usize = 16;

/// Applies `act` to each of `items`, several at a time. Returns the results in the order of the items.
///
/// # Errors
/// The first error; no further item is begun after it.
pub(super) fn side_by_side<I: Sync, T: Send>(items: &[I], act: &(impl Fn(&I) -> Result<T> + Sync)) -> Result<Vec<T>> {
    let next = AtomicUsize::new(0);
    let work = || -> Result<Vec<(usize, T)>> {
        let mut done = Vec::new();
        loop {
            let idx = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(idx) else { return Ok(done) };
            match act(item) {
                Ok(result) => done.push((idx, result)),
                Err(error) => {
                    next.store(items.len(), Ordering::Relaxed);
                    return Err(error);
                }
            }
        }
    };
    let mut done = std::thread::scope(|scope| -> Result<Vec<(usize, T)>> {
        let threads: Vec<_> = (0..N_AT_ONCE.min(items.len())).map(|_| scope.spawn(work)).collect();
        let mut done = Vec::with_capacity(items.len());
        for thread in threads {
            done.extend(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?);
        }
        Ok(done)
    })?;
    done.sort_by_key(|(idx, _)| *idx);
    Ok(done.into_iter().map(|(_, result)| result).collect())
}
