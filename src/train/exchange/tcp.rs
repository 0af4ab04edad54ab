//! The exchange over TCP, with a connection between every two ranks.

use super::wire::{receive_frame, send_frame};
use super::{Exchange, Lost};
use std::io::Result as IoResult;
use std::net::{Shutdown, TcpStream};
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// How long a rank may be silent: ranks wait for each other during a step, an evaluation or a saved state. The system
/// reports a lost process at once; this limit is for lost machines.
const SILENCE: Duration = Duration::from_secs(600);

/// Connections to all other ranks, neither encrypted nor authenticated.
#[derive(Debug)]
pub struct Tcp {
    rank: usize,
    /// By rank; `None` at the place of this one.
    peers: Vec<Option<TcpStream>>,
    /// Number of exchanges so far, which identifies the next one on the wire.
    n_exchanges: AtomicU64,
}

impl Tcp {
    /// An exchange over these connections, by rank, of which that of `rank` itself is missing.
    pub(super) fn new(rank: usize, peers: Vec<Option<TcpStream>>) -> IoResult<Self> {
        for peer in peers.iter().flatten() {
            peer.set_nonblocking(false)?;
            peer.set_nodelay(true)?;
            peer.set_read_timeout(Some(SILENCE))?;
            peer.set_write_timeout(Some(SILENCE))?;
        }
        Ok(Self { rank, peers, n_exchanges: AtomicU64::new(0) })
    }

    /// Does `work` with the connection to a rank.
    fn with<T>(&self, rank: usize, work: impl FnOnce(&TcpStream) -> IoResult<T>) -> Result<T, Lost> {
        let peer = self.peers[rank].as_ref().ok_or_else(|| std::io::ErrorKind::NotConnected.into());
        peer.and_then(work).map_err(|source| Lost { rank, source })
    }

    /// Ends all connections, so that ranks that wait for this one get an error now.
    fn close(&self) {
        for peer in self.peers.iter().flatten() {
            // It may be closed already.
            let _ = peer.shutdown(Shutdown::Both);
        }
    }
}

impl Exchange for Tcp {
    fn rank(&self) -> usize {
        self.rank
    }

    fn n_ranks(&self) -> usize {
        self.peers.len()
    }

    fn all_to_all(&self, slices: &[&[u8]]) -> Result<Vec<Vec<u8>>, Lost> {
        let (rank, n_ranks) = (self.rank, self.n_ranks());
        let number = self.n_exchanges.fetch_add(1, Ordering::Relaxed);
        let send = || {
            // Each rank begins with a different peer, so that no rank receives everything at once.
            (1..n_ranks)
                .map(|ahead| (rank + ahead) % n_ranks)
                .try_for_each(|to| self.with(to, |peer| send_frame(peer, number, slices[to])))
        };
        let receive = || {
            let mut received = vec![Vec::new(); n_ranks];
            received[rank] = slices[rank].to_vec();
            for from in (1..n_ranks).map(|behind| (rank + n_ranks - behind) % n_ranks) {
                received[from] = self.with(from, |peer| receive_frame(peer, number))?;
            }
            Ok(received)
        };
        // Sending and receiving are concurrent: if all ranks sent first, full buffers would block them.
        thread::scope(|scope| {
            let sending = scope.spawn(send);
            let received = receive();
            if received.is_err() {
                self.close();
            }
            let sent = sending.join().unwrap_or_else(|panic| resume_unwind(panic));
            received.and_then(|received| sent.map(|()| received))
        })
    }
}
