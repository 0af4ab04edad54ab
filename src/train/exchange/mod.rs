//! Exchanges bytes among the ranks of a training.
//!
//! A rank is one of several processes that train one model together, numbered from 0. An exchange carries bytes and
//! computes nothing, so the model does not depend on the transport. [`Tcp`] uses the network; between GPUs, a transport
//! such as NCCL would implement the same trait.

mod join;
#[cfg(test)]
mod join_tests;
mod tcp;
#[cfg(test)]
pub(super) mod testing;
#[cfg(test)]
mod tests;
mod wire;

pub use join::{JoinError, Meeting, Seat, join};
pub use tcp::Tcp;

use std::io;

/// Another rank is gone or does not answer.
#[derive(Debug, thiserror::Error)]
#[error("rank {rank} of this training is gone or does not answer")]
pub struct Lost {
    /// Its number.
    pub rank: usize,
    /// The cause.
    pub source: io::Error,
}

/// An exchange of bytes among ranks. All of them make the same calls in the same order.
pub trait Exchange: Sync {
    /// The number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Number of ranks.
    fn n_ranks(&self) -> usize;

    /// Sends `slices[j]` to rank j, and returns what each rank has sent to this one, by rank. Slices may be of any length.
    ///
    /// # Errors
    /// When a rank is gone.
    fn all_to_all(&self, slices: &[&[u8]]) -> Result<Vec<Vec<u8>>, Lost>;

    /// Sends `bytes` to every rank, and returns what each rank has sent, by rank.
    ///
    /// # Errors
    /// When a rank is gone.
    fn all_gather(&self, bytes: &[u8]) -> Result<Vec<Vec<u8>>, Lost> {
        self.all_to_all(&vec![bytes; self.n_ranks()])
    }

    /// Returns the `bytes` of rank 0 on every rank; those of the others are ignored.
    ///
    /// # Errors
    /// When a rank is gone.
    fn broadcast(&self, bytes: &[u8]) -> Result<Vec<u8>, Lost> {
        let own = if self.rank() == 0 { bytes } else { &[] };
        Ok(self.all_gather(own)?.swap_remove(0))
    }
}

/// The exchange of a process that trains alone.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Exchange for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn n_ranks(&self) -> usize {
        1
    }

    fn all_to_all(&self, slices: &[&[u8]]) -> Result<Vec<Vec<u8>>, Lost> {
        Ok(slices.iter().map(|slice| slice.to_vec()).collect())
    }
}
