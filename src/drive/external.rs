//! A planner as a child process: it may be slow, die, flood or answer nonsense, which costs one scenario at most.

use super::action;
use super::peek::MOST_FUTURES;
use super::protocol::{Done, FromPlanner, Hello, Observation, Peek, Peeked, ToPlanner};
use super::{Driver, Failed, Fault, Outcome, Peeker, RolloutConfig, Situation, World};
use crate::scene::State;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// The longest line that a planner may send, bytes.
const MOST_BYTES: u64 = 1 << 20;
/// Lines that wait to be read; a planner that sends more is blocked.
const MOST_LINES: usize = 4;
/// How often a planner may peek before an action.
const MOST_PEEKS: usize = 8;
/// How much of the end of the planner's standard error is kept, bytes.
const KEPT_BYTES: usize = 2000;
/// Additional time for the first answer of a process, which has to start, seconds.
const START_S: f64 = 30.0;

/// The driver that queries a planner. Its process is started for the first scenario, serves many, and is restarted
/// after a failure.
pub(super) struct External {
    command: String,
    rollout: RolloutConfig,
    limit_s: f64,
    process: Option<Process>,
    /// The first timestep that the planner has not seen.
    unseen: usize,
    plan: VecDeque<State>,
}

/// A running planner.
struct Process {
    child: Child,
    to: Sender<String>,
    from: Receiver<Result<String, String>>,
    said: Arc<Mutex<Vec<u8>>>,
    has_answered: bool,
}

impl External {
    /// A planner that is started with `sh -c` and has `limit_s` seconds for an answer.
    pub(super) fn new(command: &str, rollout: RolloutConfig, limit_s: f64) -> Self {
        Self { command: command.to_owned(), rollout, limit_s, process: None, unseen: 0, plan: VecDeque::new() }
    }

    fn send(&mut self, message: &ToPlanner) -> Result<(), Failed> {
        let line = serde_json::to_string(message).map_err(|error| Failed::because(error.to_string()))?;
        match &self.process {
            // A planner that has ended is noticed when it does not answer.
            Some(process) => drop(process.to.send(line)),
            None => return Err(Failed::because("the planner does not run")),
        }
        Ok(())
    }

    /// The answer of the planner, which must not have sent any line before.
    fn answer(&mut self, message: &ToPlanner) -> Result<String, Failed> {
        match self.process.as_ref().map(|process| process.from.try_recv()) {
            Some(Ok(Ok(_))) => return Err(self.give_up(Fault::Failed, "it sends more lines than it is asked for")),
            Some(Ok(Err(why))) => return Err(self.give_up(Fault::Failed, &why)),
            Some(Err(_)) | None => {}
        }
        self.send(message)?;
        let Some(process) = &mut self.process else { return Err(Failed::because("the planner does not run")) };
        let limit_s = self.limit_s + if process.has_answered { 0.0 } else { START_S };
        let answer = process.from.recv_timeout(Duration::from_secs_f64(limit_s));
        process.has_answered = true;
        match answer {
            Ok(Ok(line)) => Ok(line),
            Ok(Err(why)) => Err(self.give_up(Fault::Failed, &why)),
            Err(RecvTimeoutError::Disconnected) => Err(self.give_up(Fault::Failed, "it ended")),
            Err(RecvTimeoutError::Timeout) => {
                Err(self.give_up(Fault::TimedOut, &format!("it did not answer within {limit_s} s")))
            }
        }
    }

    /// Ends the process and returns the failure, with the last line of the planner's standard error.
    fn give_up(&mut self, fault: Fault, why: &str) -> Failed {
        let said = self.process.take().map(Process::end).unwrap_or_default();
        let why = if said.is_empty() { why.to_owned() } else { format!("{why}; its last words: {said}") };
        Failed { fault, why }
    }
}

impl Driver for External {
    fn begin(&mut self, situation: &Situation, world: &World) -> Result<(), Failed> {
        self.plan.clear();
        self.unseen = world.n_timesteps().saturating_sub(situation.scene.n_history);
        if self.process.is_none() {
            self.process = Some(Process::start(&self.command)?);
        }
        let RolloutConfig { horizon_s, replan_s } = self.rollout;
        self.send(&ToPlanner::Hello(Box::new(Hello::of(situation, [horizon_s, replan_s]))))
    }

    fn plan(&mut self, situation: &Situation, world: &World, n_steps: usize, peek: &Peeker<'_>) -> Result<(), Failed> {
        let mut message = ToPlanner::Observation(Observation::of(situation, world, self.unseen));
        self.unseen = world.n_timesteps();
        for _ in 0..=MOST_PEEKS {
            let line = self.answer(&message)?;
            let answer = serde_json::from_str(&line).map_err(|error| {
                let begins: String = line.chars().take(80).collect();
                self.give_up(Fault::Failed, &format!("expected an action, found \"{begins}\": {error}"))
            })?;
            match answer {
                FromPlanner::Peek(Peek { n }) if (1..=MOST_FUTURES).contains(&n) => {
                    message = ToPlanner::Futures(Peeked::of(situation, world, &peek(n)?));
                }
                FromPlanner::Peek(Peek { n }) => {
                    let why = format!("it peeks into {n} futures, expected 1 to {MOST_FUTURES}");
                    return Err(self.give_up(Fault::Failed, &why));
                }
                FromPlanner::Action(action) => {
                    let scene = &situation.scene;
                    let now = world.present(situation.ego_idx).unwrap_or_default();
                    let states = action::states(&action, &now, &scene.world_from_scene, scene.dt_s, n_steps);
                    self.plan = states.map_err(|why| self.give_up(Fault::Failed, &why))?.into();
                    return Ok(());
                }
            }
        }
        Err(self.give_up(Fault::Failed, &format!("it peeks more than {MOST_PEEKS} times before an action")))
    }

    fn next(&mut self, _situation: &Situation, _world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        self.plan.pop_front().ok_or_else(|| Failed::because("the plan is too short"))
    }

    fn end(&mut self, outcome: Outcome, why: Option<&str>) {
        let done = Done { outcome: outcome.name().to_owned(), why: why.map(str::to_owned) };
        // A planner that failed is gone already.
        drop(self.send(&ToPlanner::Done(done)));
    }
}

impl Drop for External {
    /// Closes the planner's input and lets it end; kills it if it does not.
    fn drop(&mut self) {
        self.process.take().map(Process::end);
    }
}

impl Process {
    fn start(command: &str) -> Result<Self, Failed> {
        let mut shell = Command::new("sh");
        // Replaces the shell, so that killing it kills the planner.
        shell.arg("-c").arg(format!("exec {command}"));
        let mut child = shell
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| Failed::because(format!("the planner cannot be started: {error}")))?;
        let streams = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(input), Some(output), Some(messages)) = streams else {
            return Err(Failed::because("the planner has no standard streams"));
        };
        let (to, lines) = channel();
        let (answers, from) = sync_channel(MOST_LINES);
        let said = Arc::default();
        // Each thread ends with its stream, which ends with the process.
        thread::spawn(move || feed(input, &lines));
        thread::spawn(move || listen(output, &answers));
        thread::spawn({
            let said = Arc::clone(&said);
            move || keep_last(messages, &said)
        });
        Ok(Self { child, to, from, said, has_answered: false })
    }

    /// Kills the process, and returns the last line of its standard error.
    fn end(self) -> String {
        let Self { mut child, to, from, said, .. } = self;
        drop((to, from));
        for _ in 0..20 {
            match child.try_wait() {
                Ok(None) => thread::sleep(Duration::from_millis(5)),
                _ => break,
            }
        }
        // Both fail only if it has ended already.
        drop(child.kill());
        drop(child.wait());
        let said = said.lock().unwrap_or_else(PoisonError::into_inner);
        let text = String::from_utf8_lossy(&said).into_owned();
        text.lines().rev().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default().to_owned()
    }
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

fn keep_last(mut messages: ChildStderr, said: &Mutex<Vec<u8>>) {
    let mut bytes = [0; 4096];
    while let Ok(n @ 1..) = messages.read(&mut bytes) {
        let mut said = said.lock().unwrap_or_else(PoisonError::into_inner);
        said.extend_from_slice(&bytes[..n]);
        let n_old = said.len().saturating_sub(KEPT_BYTES);
        said.drain(..n_old);
    }
}
