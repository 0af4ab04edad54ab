//! Who is let in, who is refused, and what becomes of those who are neither.

use super::testing::{about, seats};
use super::wire::{receive_message, send_message};
use super::{Exchange, JoinError, Seat, Tcp, join};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

type Joined = Result<Tcp, JoinError>;

/// Joins on a thread of its own with what it is about to train.
fn begin(seat: &Seat, own: &'static str, patience_ms: u64) -> JoinHandle<Joined> {
    let seat = seat.clone();
    thread::spawn(move || {
        let difference = |theirs: &String| (theirs != own).then(|| format!("it trains {theirs}, rank 0 {own}"));
        join(&seat, &about(own, &difference, patience_ms))
    })
}

fn call(seat: &Seat) -> TcpStream {
    let until = Instant::now() + Duration::from_secs(10);
    loop {
        match TcpStream::connect(SocketAddr::from(([127, 0, 0, 1], seat.port))) {
            Err(_) if Instant::now() < until => thread::sleep(Duration::from_millis(5)),
            called => return called.unwrap(),
        }
    }
}

#[test]
fn a_wrong_rank_is_refused_and_the_right_one_may_still_come() {
    let seats = seats(2);
    let first = begin(&seats[0], "plan a", 20_000);
    let error = begin(&seats[1], "plan b", 20_000).join().unwrap().unwrap_err();
    assert_eq!(error.to_string(), "rank 0 refused this process: it trains plan b, rank 0 plan a");
    for (wrong, expected) in [
        (Seat { n_ranks: 4, ..seats[1].clone() }, "it is one of 4 ranks, rank 0 one of 2"),
        (Seat { rank: 2, ..seats[1].clone() }, "its number is 2, expected 1 to 1"),
    ] {
        let error = begin(&wrong, "plan a", 20_000).join().unwrap().unwrap_err();
        assert!(error.to_string().ends_with(expected), "{error}");
    }
    // So is one that says it in words of another version.
    let other = call(&seats[0]);
    send_message(&other, &json!({ "Join": { "rank": 1, "n_ranks": 2, "about": { "plan": "a" }, "port": 9 } })).unwrap();
    let answer: Value = receive_message(&other).unwrap();
    assert_eq!(answer["Refused"]["why"], "its program describes trainings differently");
    let second = begin(&seats[1], "plan a", 20_000).join().unwrap().unwrap();
    let first = first.join().unwrap().unwrap();
    let echo = thread::spawn(move || second.all_gather(b"b").unwrap());
    assert_eq!(
        (first.all_gather(b"a").unwrap(), echo.join().unwrap()),
        (vec![b"a".to_vec(), b"b".to_vec()], vec![b"a".to_vec(), b"b".to_vec()])
    );
}

#[test]
fn those_who_do_not_come_are_named_with_those_who_were_refused() {
    let seats = seats(4);
    let began = Instant::now();
    let first = begin(&seats[0], "plan a", 1_500);
    let waiting = begin(&seats[2], "plan a", 20_000);
    assert!(matches!(begin(&seats[1], "plan b", 5_000).join().unwrap(), Err(JoinError::Refused(_))));
    let error = first.join().unwrap().unwrap_err();
    assert!(began.elapsed() < Duration::from_secs(15));
    let expected = "2 of 4 ranks did not come within 1 s: 1, 3; refused: rank 1: it trains plan b, rank 0 plan a";
    assert_eq!(error.to_string(), expected);
    // Who was let in learns that it comes to nothing.
    assert!(matches!(waiting.join().unwrap(), Err(JoinError::NoAnswer { .. })));
    let error = begin(&seats[3], "plan a", 300).join().unwrap().unwrap_err();
    assert_eq!(error.to_string(), format!("rank 0 does not answer at 127.0.0.1:{}", seats[0].port));
}

#[test]
fn strangers_are_ignored() {
    let seats = seats(3);
    let first = begin(&seats[0], "plan", 20_000);
    // Some say something else, some stop in the middle, and one says nothing but stays.
    for said in
        [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0; 100_000], b"", b"djinn ranks 1\r\n\0\xff\xff\xff\xff\xff\xff\xff\xff"]
    {
        let mut stranger = call(&seats[0]);
        // It may be thrown out before it has said all.
        let _ = stranger.write_all(said);
    }
    let silent = call(&seats[0]);
    let mut odd = call(&seats[0]);
    send_message(&odd, &"nonsense").unwrap();
    let (second, third) = (begin(&seats[1], "plan", 20_000), begin(&seats[2], "plan", 20_000));
    for rank in [first, second, third] {
        assert_eq!(rank.join().unwrap().unwrap().n_ranks(), 3);
    }
    assert_eq!(odd.read(&mut [0; 8]).unwrap(), 0, "nobody answers it");
    drop(silent);
}

#[test]
fn a_rank_that_was_killed_may_come_again_and_a_second_one_of_its_number_may_not() {
    let seats = seats(3);
    let first = begin(&seats[0], "plan", 20_000);
    let greeting = |port: u16| json!({ "Join": { "rank": 1, "n_ranks": 3, "about": "plan", "port": port } });
    let killed = call(&seats[0]);
    send_message(&killed, &greeting(9)).unwrap();
    thread::sleep(Duration::from_millis(200));
    drop(killed);
    thread::sleep(Duration::from_millis(100));
    let again = begin(&seats[1], "plan", 20_000);
    thread::sleep(Duration::from_millis(200));
    let error = begin(&seats[1], "plan", 20_000).join().unwrap().unwrap_err();
    assert!(error.to_string().ends_with("there are two processes of the number 1"), "{error}");
    let last = begin(&seats[2], "plan", 20_000);
    [first, again, last].into_iter().for_each(|rank| drop(rank.join().unwrap().unwrap()));
}
