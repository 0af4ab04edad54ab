//! A planner's process and all that it starts: lines to it and from it, what it says to people, and its end.

use crate::simulate::{Error, Result};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use std::collections::BTreeSet;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// The longest line that a planner may send, bytes.
const MOST_BYTES: u64 = 1 << 20;
/// Lines that wait to be read; a planner that sends more is blocked.
const MOST_LINES: usize = 4;
/// How much of the end of what a planner says in a scenario is kept, bytes.
const KEPT_BYTES: usize = 64 << 10;
/// How long a planner may take to end after its input has ended, seconds. Then it is killed.
const END_S: f64 = 2.0;
/// How often to look whether it has ended.
const LOOK: Duration = Duration::from_millis(5);

/// The process groups of planners that run. Each has the number of its shell.
static RUNNING: Mutex<BTreeSet<i32>> = Mutex::new(BTreeSet::new());

/// Kills every planner with all that it has started. For a program that is about to end by a signal.
pub fn kill_planners() {
    for group in lock(&RUNNING).iter().filter_map(|raw| Pid::from_raw(*raw)) {
        // Fails only if nobody is left in the group.
        let _ = kill_process_group(group, Signal::KILL);
    }
}

/// A running planner.
pub(super) struct Process {
    child: Child,
    to: Sender<String>,
    from: Receiver<Result<String, String>>,
    said: Arc<Mutex<Vec<u8>>>,
    /// Disconnected once the planner's standard error has been read to its end.
    is_heard: Receiver<()>,
    started: Instant,
    has_answered: bool,
}

/// Why there is no answer.
pub(super) enum Silence {
    /// Its output has ended.
    Ended,
    /// It took too long.
    TimedOut,
    /// It sent what is no line of text.
    Nonsense(String),
}

impl Process {
    /// Starts a command as a shell does.
    ///
    /// # Errors
    /// [`Error::Machine`]: `sh` runs whatever the command is.
    pub(super) fn start(command: &str) -> Result<Self> {
        let short = |error: io::Error| Error::Machine(format!("no process can be started for the planner: {error}"));
        let mut shell = Command::new("sh");
        // A group of its own, so that what the command starts can be ended with it.
        shell.arg("-c").arg(command).process_group(0);
        let mut child =
            shell.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(short)?;
        lock(&RUNNING).insert(Pid::from_child(&child).as_raw_pid());
        let streams = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (to, lines) = channel();
        let (answers, from) = sync_channel(MOST_LINES);
        let (hearing, is_heard) = channel();
        let said = Arc::default();
        let process =
            Self { child, to, from, said: Arc::clone(&said), is_heard, started: Instant::now(), has_answered: false };
        let (Some(input), Some(output), Some(messages)) = streams else {
            return Err(Error::Machine("the planner has no standard streams".to_owned()));
        };
        // Each thread ends with its stream, which ends with the process.
        let thread = |work: Box<dyn FnOnce() + Send>| thread::Builder::new().spawn(work).map_err(short);
        thread(Box::new(move || feed(input, &lines)))?;
        thread(Box::new(move || listen(output, &answers)))?;
        thread(Box::new(move || hear(messages, &said, &hearing)))?;
        Ok(process)
    }

    /// Whether it has sent a line.
    pub(super) const fn has_answered(&self) -> bool {
        self.has_answered
    }

    /// Time since its start.
    pub(super) fn age(&self) -> Duration {
        self.started.elapsed()
    }

    /// Sends it a line. A planner that has ended is noticed when it does not answer.
    pub(super) fn send(&self, line: String) {
        drop(self.to.send(line));
    }

    /// A line that it has sent already, or what is no line.
    pub(super) fn waiting(&self) -> Option<Result<String, String>> {
        self.from.try_recv().ok()
    }

    /// The next line that it sends within a time.
    pub(super) fn line(&mut self, limit: Duration) -> Result<String, Silence> {
        let line = self.from.recv_timeout(limit).map_err(|error| match error {
            RecvTimeoutError::Disconnected => Silence::Ended,
            RecvTimeoutError::Timeout => Silence::TimedOut,
        })?;
        self.has_answered = true;
        line.map_err(Silence::Nonsense)
    }

    /// What it has said since the last time, the end of it if that is long.
    pub(super) fn said(&self) -> String {
        String::from_utf8_lossy(&std::mem::take(&mut *lock(&self.said))).into_owned()
    }

    /// Closes its input and gives it the time to end; then kills whatever is left of it. Returns how it ended if it did
    /// so by itself, in words, and what it said.
    pub(super) fn end(mut self) -> (Option<String>, String) {
        // Its input ends once all lines are written, and its output is read no more.
        self.to = channel().0;
        self.from = channel().1;
        let pid = Pid::from_child(&self.child);
        // It must not be reaped before its group is killed: until then, no other group has its number.
        let look = || waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT);
        let closed = Instant::now();
        let has_ended = loop {
            match look() {
                Ok(None) if closed.elapsed().as_secs_f64() < END_S => thread::sleep(LOOK),
                looked => break !matches!(looked, Ok(None)),
            }
        };
        let status = self.kill().filter(|_| has_ended);
        // Somebody who left the group may hold the stream.
        let _ = self.is_heard.recv_timeout(Duration::from_secs(1));
        (status.map(words), self.said())
    }

    /// Kills what is left of the group, and returns the status of its shell.
    fn kill(&mut self) -> Option<ExitStatus> {
        let pid = Pid::from_child(&self.child);
        if !lock(&RUNNING).remove(&pid.as_raw_pid()) {
            return None;
        }
        // Fails only if nobody is left.
        let _ = kill_process_group(pid, Signal::KILL);
        self.child.wait().ok()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// How a shell ended.
fn words(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code @ 129..=192), _) => format!("with exit status {code}, as after signal {}", code - 128),
        (Some(code), _) => format!("with exit status {code}"),
        (None, Some(signal)) => format!("by signal {signal}"),
        (None, None) => "in an unknown way".to_owned(),
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn feed(mut input: ChildStdin, lines: &Receiver<String>) {
    for line in lines {
        if input.write_all(line.as_bytes()).and_then(|()| input.write_all(b"\n")).and_then(|()| input.flush()).is_err()
        {
            break;
        }
    }
}

/// Passes on the lines of the planner until one is too long or the receiver is gone.
fn listen(output: ChildStdout, answers: &SyncSender<Result<String, String>>) {
    let mut output = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        let answer = match output.by_ref().take(MOST_BYTES + 1).read_until(b'\n', &mut line) {
            Ok(0) => break,
            Ok(_) if line.len() as u64 > MOST_BYTES => Err(format!("it sent a line of more than {MOST_BYTES} bytes")),
            Ok(_) => String::from_utf8(line).map_err(|_| "it sent what is no text".to_owned()),
            Err(error) => Err(format!("its output cannot be read: {error}")),
        };
        let is_last = answer.is_err();
        if answers.send(answer).is_err() || is_last {
            break;
        }
    }
}

/// Keeps the end of what the planner says, until it says no more; nothing is ever sent to `_hearing`.
fn hear(mut messages: ChildStderr, said: &Mutex<Vec<u8>>, _hearing: &Sender<()>) {
    let mut bytes = [0; 4096];
    while let Ok(n @ 1..) = messages.read(&mut bytes) {
        let mut said = lock(said);
        said.extend_from_slice(&bytes[..n]);
        let n_old = said.len().saturating_sub(KEPT_BYTES);
        said.drain(..n_old);
    }
}
