//! Drives several scenarios at the same time, in an order that changes nothing.

use super::{Error, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::Builder;

/// Scenarios in memory at a time, for each worker.
pub(crate) const CHUNK: usize = 8;

/// A pool for the network of one worker: it does too little in parallel to hand work around between threads.
pub(crate) fn pool_of_worker() -> Result<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(1).build();
    pool.map_err(|error| no_thread(&error))
}

fn no_thread(error: &dyn std::error::Error) -> Error {
    Error::Machine(format!("no thread can be started: {error}"))
}

/// The results of `work` on each item in their order, whichever worker does it. The first error ends the work.
pub(crate) fn in_parallel<T: Sync, W: Send, R: Send, E: From<Error> + Send>(
    items: &[T],
    workers: &mut [W],
    work: impl Fn(&mut W, &T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let (next, has_failed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let found: Vec<Mutex<Option<Result<R, E>>>> = items.iter().map(|_| Mutex::new(None)).collect();
    let started = std::thread::scope(|scope| {
        for worker in workers {
            let works = || {
                while !has_failed.load(Ordering::Relaxed) {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let (Some(item), Some(place)) = (items.get(at), found.get(at)) else { break };
                    let result = work(worker, item);
                    has_failed.fetch_or(result.is_err(), Ordering::Relaxed);
                    if let Ok(mut place) = place.lock() {
                        *place = Some(result);
                    }
                }
            };
            let started = Builder::new().spawn_scoped(scope, works);
            started.inspect_err(|_| has_failed.store(true, Ordering::Relaxed))?;
        }
        Ok(())
    });
    started.map_err(|error: std::io::Error| no_thread(&error))?;
    let found = found.into_iter().filter_map(|place| place.into_inner().ok().flatten());
    let results = found.collect::<Result<Vec<R>, E>>()?;
    match results.len() == items.len() {
        true => Ok(results),
        false => Err(Error::Config("a drive was not finished".to_owned()).into()),
    }
}
