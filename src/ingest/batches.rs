//! The bounded stream of units from the reading thread to the parsers.

use super::error::Error;
use super::raw::{RawUnit, Reject};
use std::ops::ControlFlow;
use std::sync::mpsc::SyncSender;

/// Units to be parsed together.
pub(super) type Batch = Vec<Result<RawUnit, Reject>>;

/// Maximum number of units of a batch.
const MAX_UNITS: usize = 64;

/// Bytes at which a batch ends. Two batches are in memory at a time, one being filled and one parsed, and the scenes
/// that are being made, wait, or are being stored.
const MAX_BYTES: u64 = 32 << 20;

/// Collects units into batches and sends them. The end of a batch depends only on its own units, so batches are the
/// same whether or not earlier ones were skipped.
pub(super) struct BatchSender {
    sender: SyncSender<Result<Batch, Error>>,
    n_to_skip: u64,
    batch: Batch,
    n_bytes: u64,
}

impl BatchSender {
    /// Skips the first `n_to_skip` units, which must end with a batch.
    pub(super) const fn new(sender: SyncSender<Result<Batch, Error>>, n_to_skip: u64) -> Self {
        Self { sender, n_to_skip, batch: Vec::new(), n_bytes: 0 }
    }

    /// Adds a unit that takes about `n_bytes` when parsed; `Break` when the receiver is gone.
    pub(super) fn push(&mut self, unit: Result<RawUnit, Reject>, n_bytes: u64) -> ControlFlow<()> {
        if self.n_to_skip > 0 {
            self.n_to_skip -= 1;
            return ControlFlow::Continue(());
        }
        self.n_bytes += n_bytes;
        self.batch.push(unit);
        if self.batch.len() < MAX_UNITS && self.n_bytes < MAX_BYTES {
            return ControlFlow::Continue(());
        }
        self.n_bytes = 0;
        self.send(Ok)
    }

    /// Sends the last batch, or the error that ended reading.
    pub(super) fn finish(mut self, result: Result<(), Error>) {
        // A failed send means that the receiver is gone.
        let _ = match result {
            Ok(()) if self.batch.is_empty() => ControlFlow::Continue(()),
            Ok(()) => self.send(Ok),
            Err(error) => self.send(|_| Err(error)),
        };
    }

    fn send(&mut self, message: impl FnOnce(Batch) -> Result<Batch, Error>) -> ControlFlow<()> {
        match self.sender.send(message(std::mem::take(&mut self.batch))) {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    /// Sizes of the batches for units of these sizes.
    fn batch_sizes(n_to_skip: u64, unit_bytes: &[u64]) -> Vec<usize> {
        let (sender, receiver) = sync_channel(unit_bytes.len() + 1);
        let mut batches = BatchSender::new(sender, n_to_skip);
        for n_bytes in unit_bytes {
            assert!(batches.push(Ok(RawUnit::default()), *n_bytes).is_continue());
        }
        batches.finish(Ok(()));
        receiver.into_iter().map(|batch| batch.expect("no error was sent").len()).collect()
    }

    #[test]
    fn batches_are_cut_by_count_and_by_size() {
        assert_eq!(batch_sizes(0, &[10; 150]), [64, 64, 22]);
        assert_eq!(batch_sizes(0, &[10; 64]), [64]);
        assert_eq!(batch_sizes(0, &[17 << 20, 17 << 20, 40 << 20, 1]), [2, 1, 1]);
        assert_eq!(batch_sizes(0, &[]), Vec::<usize>::new());
    }

    #[test]
    fn skipping_whole_batches_leaves_the_others_alone() {
        assert_eq!(batch_sizes(64, &[10; 150]), [64, 22]);
        assert_eq!(batch_sizes(128, &[10; 150]), [22]);
        assert_eq!(batch_sizes(150, &[10; 150]), Vec::<usize>::new());
    }

    #[test]
    fn the_reader_learns_that_nobody_listens() {
        let (sender, receiver) = sync_channel(1);
        drop(receiver);
        let mut batches = BatchSender::new(sender, 0);
        let flows: Vec<bool> = (0..64).map(|_| batches.push(Ok(RawUnit::default()), 1).is_break()).collect();
        assert!(!flows[62] && flows[63]);
    }
}
