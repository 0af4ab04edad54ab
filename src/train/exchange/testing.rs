//! Ranks that meet on this machine, a thread each.

use super::{Exchange, Meeting, Seat, Tcp, join};
use std::net::TcpListener;
use std::thread;
use std::time::Duration;

/// A port of the loopback interface that nobody listens at.
pub(in crate::train) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// The places of ranks that meet at such a port.
pub(super) fn seats(n_ranks: usize) -> Vec<Seat> {
    let (host, port) = ("127.0.0.1".to_owned(), free_port());
    (0..n_ranks).map(|rank| Seat { rank, n_ranks, host: host.clone(), port }).collect()
}

/// What a rank trains in tests: a text, which is all that must agree.
pub(super) fn about<'a>(
    own: &str,
    difference: &'a dyn Fn(&String) -> Option<String>,
    patience_ms: u64,
) -> Meeting<'a, String> {
    Meeting { own: own.to_owned(), difference, patience: Duration::from_millis(patience_ms) }
}

/// The exchanges of ranks that have met, in the order of their numbers.
pub(in crate::train) fn meet(n_ranks: usize) -> Vec<Tcp> {
    let met = |seat: Seat| join(&seat, &about("plan", &|_| None, 20_000)).unwrap();
    let threads: Vec<_> = seats(n_ranks).into_iter().map(|seat| thread::spawn(move || met(seat))).collect();
    let exchanges: Vec<Tcp> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
    assert!(
        exchanges.iter().enumerate().all(|(rank, exchange)| exchange.rank() == rank && exchange.n_ranks() == n_ranks)
    );
    exchanges
}
