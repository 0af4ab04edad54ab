//! What is sent arrives, at the right rank and once, in slices of any size.

use super::testing::meet;
use super::{Alone, Exchange};
use std::thread;

/// What rank `from` sends to rank `to`: lengths differ, and some exceed what the system buffers.
fn slice(from: usize, to: usize) -> Vec<u8> {
    let n = if from == 1 { 5_000_000 } else { 1_000 * from + to };
    (0..n).map(|i| (i * 31 + from * 7 + to) as u8).collect()
}

fn exchange_all(exchange: &dyn Exchange) {
    let (rank, n_ranks) = (exchange.rank(), exchange.n_ranks());
    for _ in 0..3 {
        let own: Vec<Vec<u8>> = (0..n_ranks).map(|to| slice(rank, to)).collect();
        let received = exchange.all_to_all(&own.iter().map(Vec::as_slice).collect::<Vec<_>>()).unwrap();
        assert!((0..n_ranks).all(|from| received[from] == slice(from, rank)));
        let gathered = exchange.all_gather(&slice(rank, 0)).unwrap();
        assert!((0..n_ranks).all(|from| gathered[from] == slice(from, 0)));
        assert_eq!(exchange.broadcast(&[b'a' + rank as u8]).unwrap(), b"a");
        assert_eq!(exchange.all_gather(&[]).unwrap(), vec![Vec::<u8>::new(); n_ranks]);
    }
}

#[test]
fn everybody_gets_what_was_sent_to_it() {
    exchange_all(&Alone);
    for n_ranks in [1, 2, 3, 4] {
        let ranks = meet(n_ranks).into_iter().map(|exchange| thread::spawn(move || exchange_all(&exchange)));
        ranks.collect::<Vec<_>>().into_iter().for_each(|rank| rank.join().unwrap());
    }
}

#[test]
fn a_rank_that_is_gone_is_noticed_even_while_much_is_sent_to_it() {
    let mut ranks = meet(4).into_iter();
    drop(ranks.next_back());
    let lost: Vec<_> = ranks.map(|exchange| thread::spawn(move || exchange.all_gather(&vec![1; 8_000_000]))).collect();
    for lost in lost {
        let error = lost.join().unwrap().unwrap_err();
        assert!(error.to_string().contains("is gone or does not answer"), "{error}");
    }
}
