//! Runs a network on a thread of the pool that does its work.

use candle_core::Device;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Runs `work` on a thread of rayon's pool. From any other thread, each of a network's many operations would be passed
/// to the pool and waited for.
pub fn in_pool<R: Send>(device: &Device, work: impl FnOnce() -> R + Send) -> R {
    match device {
        Device::Cpu => rayon::scope(|_| work()),
        _ => work(),
    }
}

/// The results of `work` on each of `items` in their order, or the first error. On a processor, as many items as the
/// pool has threads are worked on at a time: operations of one network are too short to keep several threads busy.
///
/// A thread of its own waits for each item. A loop of the pool would begin one item after the other while the first
/// waits for parts of an operation, and hold all of them in memory.
pub fn side_by_side<T: Sync, R: Send, E: Send>(
    device: &Device,
    items: &[T],
    work: impl Fn(&T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let next = AtomicUsize::new(0);
    let works = || {
        let mut own: Vec<(usize, Result<R, E>)> = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(at) else { return own };
            let result = in_pool(device, || work(item));
            if result.is_err() {
                next.store(items.len(), Ordering::Relaxed);
            }
            own.push((at, result));
        }
    };
    // Threads of the pool must not wait for others that need them.
    let n_threads = match device {
        Device::Cpu if rayon::current_thread_index().is_none() => rayon::current_num_threads().min(items.len()),
        _ => 1,
    };
    let mut found = thread::scope(|scope| {
        // What a thread would do that cannot be started, the others do.
        let start = |_| thread::Builder::new().spawn_scoped(scope, works).ok();
        let others: Vec<_> = (1..n_threads).filter_map(start).collect();
        let mut found = works();
        for other in others {
            found.extend(other.join().unwrap_or_else(|panic| resume_unwind(panic)));
        }
        found
    });
    found.sort_by_key(|(at, _)| *at);
    found.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_an_error_ends_the_work() {
        let items: Vec<usize> = (0..50).collect();
        let doubled = side_by_side(&Device::Cpu, &items, |item| Ok::<_, ()>(2 * item)).unwrap();
        assert_eq!(doubled, items.iter().map(|item| 2 * item).collect::<Vec<_>>());
        let n_begun = AtomicUsize::new(0);
        let failed = side_by_side(&Device::Cpu, &items, |item| {
            n_begun.fetch_add(1, Ordering::Relaxed);
            thread::sleep(std::time::Duration::from_millis(2));
            if *item == 0 { Err("no") } else { Ok(()) }
        });
        assert_eq!(failed, Err("no"));
        assert!(n_begun.into_inner() < 50);
    }
}
