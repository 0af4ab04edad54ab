//! Drives several scenarios at the same time, in an order that changes nothing.

use super::{Error, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Scenarios in memory at a time, for each worker.
pub(super) const CHUNK: usize = 8;

/// A pool for the network of one worker: it does too little in parallel to hand work around between threads.
pub(super) fn pool_of_worker() -> Result<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(1).build();
    pool.map_err(|error| Error::Config(format!("no thread can be started: {error}")))
}

/// The results of `work` on each item in their order, whichever worker does it.
pub(super) fn in_parallel<T: Sync, W: Send, R: Send>(
    items: &[T],
    workers: &mut [W],
    work: impl Fn(&mut W, &T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let found: Vec<Mutex<Option<Result<R>>>> = items.iter().map(|_| Mutex::new(None)).collect();
    std::thread::scope(|scope| {
        for worker in workers {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let (Some(item), Some(place)) = (items.get(at), found.get(at)) else { break };
                    let result = work(worker, item);
                    if let Ok(mut place) = place.lock() {
                        *place = Some(result);
                    }
                }
            });
        }
    });
    let found = found.into_iter().map(|place| place.into_inner().ok().flatten());
    found.map(|result| result.unwrap_or_else(|| Err(Error::Config("a drive was not finished".to_owned())))).collect()
}
