//! Brings the ranks of a training together, and rejects processes that do not belong to it.
//!
//! Rank 0 listens at an address that all know. Each other rank connects to it and sends the description of its training
//! and the port at which it listens itself. Once all have come, rank 0 sends all addresses, and each rank connects to
//! those between 0 and itself. Connections of other programs are ignored.

use super::Tcp;
use super::wire::{receive_message, send_message};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// How long a peer may take for each part of its first message.
const GREETING: Duration = Duration::from_secs(5);
/// How long one attempt to connect may take.
const CALL: Duration = Duration::from_secs(5);
/// Time between attempts to connect or to accept.
const PAUSE: Duration = Duration::from_millis(20);

/// The place of a process among the ranks of a training.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seat {
    /// Its number, from 0.
    pub rank: usize,
    /// Number of ranks.
    pub n_ranks: usize,
    /// The machine of rank 0, by name or address.
    pub host: String,
    /// The port at which rank 0 listens.
    pub port: u16,
}

/// The description that ranks compare, and how long they wait for each other.
pub struct Meeting<'a, I> {
    /// The description of this rank's training.
    pub own: I,
    /// The difference from another rank's description; `None` if they fit together.
    pub difference: &'a dyn Fn(&I) -> Option<String>,
    /// How long to wait for the others.
    pub patience: Duration,
}

impl<I: DeserializeOwned> Meeting<'_, I> {
    /// The difference from the description in another rank's message.
    fn difference(&self, about: Value) -> Option<String> {
        match serde_json::from_value(about) {
            Ok(theirs) => (self.difference)(&theirs),
            Err(_) => Some("its program describes trainings differently".to_owned()),
        }
    }
}

/// Why the ranks did not come together.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// This rank does not fit the others.
    #[error("rank 0 refused this process: {0}")]
    Refused(String),
    /// Some ranks did not come in time.
    #[error("{} of {n_ranks} ranks did not come within {seconds} s: {}{}", missing.len(), list(missing), described(refused))]
    Missing {
        /// Their numbers.
        missing: Vec<usize>,
        /// Number of ranks.
        n_ranks: usize,
        /// How long rank 0 waited.
        seconds: u64,
        /// Processes that were rejected, with the reasons.
        refused: Vec<String>,
    },
    /// Rank 0 does not answer.
    #[error("rank 0 does not answer at {address}")]
    NoAnswer {
        /// Its address.
        address: String,
        /// The cause.
        source: io::Error,
    },
    /// Rank 0 cannot listen.
    #[error("cannot listen for other ranks at {address}")]
    CannotListen {
        /// Where.
        address: String,
        /// Why not.
        source: io::Error,
    },
    /// A rank left before all had come.
    #[error("a connection between ranks broke before the training began")]
    Broken(#[from] io::Error),
}

fn list(ranks: &[usize]) -> String {
    ranks.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn described(refused: &[String]) -> String {
    if refused.is_empty() { String::new() } else { format!("; refused: {}", refused.join("; ")) }
}

/// The first message of a connection.
#[derive(Debug, Serialize, Deserialize)]
enum Greeting {
    /// To rank 0: the sender's number, the description of its training, and the port at which it listens.
    Join { rank: usize, n_ranks: usize, about: Value, port: u16 },
    /// To another rank: the sender's number, and the id of the meeting.
    Link { rank: usize, meeting: String },
}

/// The answer of rank 0.
#[derive(Debug, Serialize, Deserialize)]
enum Answer {
    /// All have come: the id of the meeting, and the addresses of the ranks from 1.
    Welcome { meeting: String, listeners: Vec<SocketAddr> },
    /// They do not fit together.
    Refused { why: String },
}

/// Brings the ranks of a training together. Call it before computing anything.
///
/// # Errors
/// When one does not come in time, or does not fit the others.
pub fn join<I: Serialize + DeserializeOwned>(seat: &Seat, meeting: &Meeting<'_, I>) -> Result<Tcp, JoinError> {
    let peers = if seat.rank == 0 { receive_ranks(seat, meeting)? } else { call_first(seat, meeting)? };
    Ok(Tcp::new(seat.rank, peers)?)
}

/// Rank 0: waits for all others and sends them each other's addresses.
fn receive_ranks<I: DeserializeOwned>(
    seat: &Seat,
    meeting: &Meeting<'_, I>,
) -> Result<Vec<Option<TcpStream>>, JoinError> {
    let Seat { n_ranks, host, port, .. } = seat;
    let door = Door::open(&addresses_to_listen_at(host, *port))
        .map_err(|source| JoinError::CannotListen { address: format!("{host}:{port}"), source })?;
    let until = Instant::now() + meeting.patience;
    let mut joined: BTreeMap<usize, (TcpStream, SocketAddr)> = BTreeMap::new();
    let mut refused = Vec::new();
    while joined.len() + 1 < *n_ranks {
        let Some((caller, greeting)) = door.next_caller(until) else {
            let missing = (1..*n_ranks).filter(|rank| !joined.contains_key(rank)).collect();
            return Err(JoinError::Missing {
                missing,
                n_ranks: *n_ranks,
                seconds: meeting.patience.as_secs(),
                refused,
            });
        };
        // Links are for other ranks, and a peer that has left has no address.
        let (Greeting::Join { rank, n_ranks: of, about, port }, Ok(address)) = (greeting, caller.peer_addr()) else {
            continue;
        };
        let earlier = joined.get(&rank).map(|(stream, _)| stream);
        match objection(seat, (rank, of), earlier).or_else(|| meeting.difference(about)) {
            None => {
                joined.insert(rank, (caller, SocketAddr::new(address.ip(), port)));
            }
            Some(why) => {
                refused.push(format!("rank {rank}: {why}"));
                // It may not wait for the answer.
                let _ = send_message(&caller, &Answer::Refused { why });
            }
        }
    }
    let listeners: Vec<SocketAddr> = joined.values().map(|(_, listener)| *listener).collect();
    let meeting = blake3::hash(format!("{listeners:?}").as_bytes()).to_hex().to_string();
    let mut peers = vec![None];
    for (stream, _) in joined.into_values() {
        send_message(&stream, &Answer::Welcome { meeting: meeting.clone(), listeners: listeners.clone() })?;
        peers.push(Some(stream));
    }
    Ok(peers)
}

/// Why rank 0 rejects a process with this number of so many ranks, if it does. A rank that was killed may come again.
fn objection(seat: &Seat, (rank, of): (usize, usize), earlier: Option<&TcpStream>) -> Option<String> {
    if of != seat.n_ranks {
        return Some(format!("it is one of {of} ranks, rank 0 one of {}", seat.n_ranks));
    }
    if !(1..of).contains(&rank) {
        return Some(format!("its number is {rank}, expected 1 to {}", of - 1));
    }
    earlier.filter(|earlier| is_there(earlier)).map(|_| format!("there are two processes of the number {rank}"))
}

/// Whether the other end of a connection, which waits for an answer, is still there.
fn is_there(stream: &TcpStream) -> bool {
    let looked = stream.set_nonblocking(true).and_then(|()| stream.peek(&mut [0]));
    matches!(looked, Err(error) if error.kind() == ErrorKind::WouldBlock) && stream.set_nonblocking(false).is_ok()
}

/// Any other rank: connects to rank 0, and then to the others.
fn call_first<I: Serialize>(seat: &Seat, meeting: &Meeting<'_, I>) -> Result<Vec<Option<TcpStream>>, JoinError> {
    let Seat { rank, n_ranks, host, port } = seat;
    let no_answer = |source| JoinError::NoAnswer { address: format!("{host}:{port}"), source };
    let resolve = || Ok((host.as_str(), *port).to_socket_addrs()?.collect());
    let first = connect(&resolve, Instant::now() + meeting.patience).map_err(no_answer)?;
    // Others reach this rank at the address at which rank 0 does.
    let door = Door::open(&[SocketAddr::new(first.local_addr()?.ip(), 0)])?;
    let about = serde_json::to_value(&meeting.own).map_err(io::Error::from)?;
    let greeting = Greeting::Join { rank: *rank, n_ranks: *n_ranks, about, port: door.port()? };
    send_message(&first, &greeting).map_err(no_answer)?;
    first.set_read_timeout(Some(meeting.patience + GREETING))?;
    let (name, listeners) = match receive_message(&first).map_err(no_answer)? {
        Answer::Welcome { meeting, listeners } => (meeting, listeners),
        Answer::Refused { why } => return Err(JoinError::Refused(why)),
    };
    let until = Instant::now() + meeting.patience;
    let mut peers: Vec<Option<TcpStream>> = (0..*n_ranks).map(|_| None).collect();
    peers[0] = Some(first);
    for (peer, listener) in peers[1..*rank].iter_mut().zip(&listeners) {
        let stream = connect(&|| Ok(vec![*listener]), until)?;
        send_message(&stream, &Greeting::Link { rank: *rank, meeting: name.clone() })?;
        *peer = Some(stream);
    }
    while let Some(missing) = (rank + 1..*n_ranks).find(|other| peers[*other].is_none()) {
        let Some((caller, greeting)) = door.next_caller(until) else {
            return Err(io::Error::new(ErrorKind::TimedOut, format!("rank {missing} did not call")).into());
        };
        match greeting {
            Greeting::Link { rank: other, meeting } if meeting == name && other > *rank && other < *n_ranks => {
                peers[other] = Some(caller);
            }
            _ => {}
        }
    }
    Ok(peers)
}

/// The addresses at which rank 0 listens: its own if that is an address, else all of its machine, because its name may
/// resolve differently on the machine itself.
fn addresses_to_listen_at(host: &str, port: u16) -> Vec<SocketAddr> {
    let any = [IpAddr::from(Ipv6Addr::UNSPECIFIED), IpAddr::from(Ipv4Addr::UNSPECIFIED)];
    let ips = match (host, host.parse::<IpAddr>()) {
        (_, Ok(ip)) => vec![ip],
        ("localhost", _) => vec![Ipv4Addr::LOCALHOST.into()],
        _ => any.to_vec(),
    };
    ips.into_iter().map(|ip| SocketAddr::new(ip, port)).collect()
}

/// Connects to one of the addresses that `resolve` returns, and retries until one answers: the peer may not listen yet,
/// and its name may not resolve yet.
fn connect(resolve: &dyn Fn() -> io::Result<Vec<SocketAddr>>, until: Instant) -> io::Result<TcpStream> {
    loop {
        let called = resolve().and_then(|addresses| {
            let mut answer = Err(ErrorKind::NotFound.into());
            for address in addresses {
                answer = TcpStream::connect_timeout(&address, CALL);
                if answer.is_ok() {
                    break;
                }
            }
            answer
        });
        match called {
            Err(_) if Instant::now() < until => thread::sleep(10 * PAUSE),
            called => return called,
        }
    }
}

/// Accepts connections. Each is read in a thread of its own, so that silent ones block nobody.
struct Door {
    listener: TcpListener,
    heard: (Sender<Caller>, Receiver<Caller>),
}

/// A connection with a valid first message.
type Caller = (TcpStream, Greeting);

impl Door {
    /// Listens at the first of these addresses that is available.
    fn open(addresses: &[SocketAddr]) -> io::Result<Self> {
        let listener = TcpListener::bind(addresses)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, heard: channel() })
    }

    fn port(&self) -> io::Result<u16> {
        Ok(self.listener.local_addr()?.port())
    }

    /// The next connection with a valid message; `None` if there is none by the deadline.
    fn next_caller(&self, until: Instant) -> Option<Caller> {
        let (say, heard) = &self.heard;
        loop {
            // Nobody waits there, or the peer has left again.
            while let Ok((caller, _)) = self.listener.accept() {
                let say = say.clone();
                thread::spawn(move || {
                    if let Ok(greeting) = listen_to(&caller) {
                        // Nobody may wait for it any more.
                        let _ = say.send((caller, greeting));
                    }
                });
            }
            match heard.recv_timeout(PAUSE) {
                Ok(caller) => return Some(caller),
                Err(_) if Instant::now() >= until => return None,
                Err(_) => {}
            }
        }
    }
}

fn listen_to(caller: &TcpStream) -> io::Result<Greeting> {
    caller.set_nonblocking(false)?;
    caller.set_read_timeout(Some(GREETING))?;
    receive_message(caller)
}
