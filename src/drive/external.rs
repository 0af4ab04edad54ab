//! A planner as a child process: it may be slow, die, flood or answer nonsense, which costs one scenario at most. One
//! that never runs, whatever it is asked, is refused.

use super::process::{Process, Silence};
use super::protocol::{Done, FromPlanner, Hello, Observation, Peek, Peeked, ToPlanner};
use super::{action, answer};
use crate::generate::NamedDriver;
use crate::scene::State;
use crate::simulate::{
    Driver, Error, Failed, MOST_FUTURES, MOST_PEEKS, Outcome, Peeker, Result, RolloutConfig, Situation, World,
};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Additional time for the first answer of a process, which has to start, seconds.
const START_S: f64 = 30.0;
/// Why a planner failed whose process ended by itself.
const OUTPUT_ENDED: &str = "its output has ended";
/// What programs say that the machine does not let start.
const SHORT_OF: [&str; 3] = ["annot fork", "Resource temporarily unavailable", "Cannot allocate memory"];

/// The driver that queries a planner. Its process is started for the first scenario, serves many, and is restarted
/// after a failure.
pub(super) struct External {
    command: String,
    rollout: RolloutConfig,
    limit_s: f64,
    /// Whether the command is known to run: some process of it has answered, or waited for a question.
    runs: Arc<AtomicBool>,
    process: Option<Process>,
    /// What processes have said that are gone.
    said: String,
    /// The first timestep that the planner has not seen.
    unseen: usize,
    plan: VecDeque<State>,
}

impl External {
    /// A planner that a shell starts and that has `limit_s` seconds for an answer. All of one command share `runs`.
    pub(super) fn new(command: &str, rollout: RolloutConfig, limit_s: f64, runs: &Arc<AtomicBool>) -> Self {
        let (command, runs) = (command.to_owned(), Arc::clone(runs));
        let (process, said, unseen, plan) = (None, String::new(), 0, VecDeque::new());
        Self { command, rollout, limit_s, runs, process, said, unseen, plan }
    }

    fn send(&self, message: &ToPlanner) -> Result<(), Failed> {
        let line = serde_json::to_string(message).map_err(|error| Failed::because(error.to_string()))?;
        self.process.as_ref().map(|process| process.send(line)).ok_or_else(|| Failed::because("the planner is gone"))
    }

    /// The answer of the planner, which must not have sent any line before.
    fn answer(&mut self, message: &ToPlanner) -> Result<String, Failed> {
        match self.process.as_ref().and_then(Process::waiting) {
            Some(Ok(_)) => return Err(self.give_up("it sends more lines than it is asked for")),
            Some(Err(why)) => return Err(self.give_up(&why)),
            None => self.send(message)?,
        }
        let Some(process) = &mut self.process else { return Err(Failed::because("the planner is gone")) };
        let (is_first, limit_s) = (!process.has_answered(), self.limit_s);
        let start_s = if is_first { START_S } else { 0.0 };
        match process.line(Duration::from_secs_f64(limit_s + start_s)) {
            Ok(line) => {
                self.runs.store(true, Ordering::Relaxed);
                Ok(line)
            }
            Err(Silence::Nonsense(why)) => Err(self.give_up(&why)),
            Err(Silence::Ended) => {
                let age = process.age();
                if is_first && !self.runs.load(Ordering::Relaxed) {
                    self.check_that_it_runs(age)?;
                }
                Err(self.give_up(OUTPUT_ENDED))
            }
            Err(Silence::TimedOut) => {
                let why = match is_first {
                    true => format!(
                        "it did not answer within {limit_s} s and the {START_S} s that it has to start; does it flush \
                         its output after each line?"
                    ),
                    false => format!("it did not answer within {limit_s} s"),
                };
                Err(Failed::TimedOut(self.stop(&why)))
            }
        }
    }

    /// The failure of the planner, whose process is ended.
    fn give_up(&mut self, why: &str) -> Failed {
        Failed::because(self.stop(why))
    }

    /// Ends the process, and adds to the reason how it ended and the last of what it said.
    fn stop(&mut self, why: &str) -> String {
        let Some(process) = self.process.take() else { return why.to_owned() };
        let (ended, said) = process.end();
        self.said += &said;
        // Otherwise it ends because its input does.
        told(why, ended.as_deref().filter(|_| why == OUTPUT_ENDED), &self.said)
    }

    /// Starts the command anew and asks nothing: a planner waits then, at least as long as the first process lived.
    ///
    /// # Errors
    /// [`Error::Planner`] when it ends by itself, [`Error::Machine`] when that is for lack of processes or memory.
    fn check_that_it_runs(&self, lived: Duration) -> Result<()> {
        let mut process = Process::start(&self.command)?;
        let silence = process.line(lived * 2 + Duration::from_secs(1));
        if !matches!(silence, Err(Silence::Ended)) || self.runs.load(Ordering::Relaxed) {
            self.runs.store(true, Ordering::Relaxed);
            return Ok(());
        }
        let (ended, said) = process.end();
        let why = told("its output ends before it is asked anything", ended.as_deref(), &said);
        match SHORT_OF.iter().any(|text| said.contains(text)) {
            true => Err(Error::Machine(format!("the planner cannot be started: {why}"))),
            false => Err(Error::Planner { command: self.command.clone(), why: why + &near_name(&self.command) }),
        }
    }
}

/// A reason, with how the process ended by itself and the last line of what it said.
fn told(why: &str, ended: Option<&str>, said: &str) -> String {
    let why = ended.map_or_else(|| why.to_owned(), |ended| format!("{why}: it ended {ended}"));
    match said.lines().rev().map(str::trim).find(|line| !line.is_empty()) {
        Some(last) => format!("{why}; its last words: {last}"),
        None => why,
    }
}

/// A question for the driver whose name is nearly that of the command.
fn near_name(command: &str) -> String {
    let name = |driver: &NamedDriver| driver.name();
    let near = NamedDriver::ALL
        .iter()
        .map(name)
        .find(|name| strsim::damerau_levenshtein(name, &command.trim().to_lowercase()) <= 2);
    near.map_or_else(String::new, |name| format!("; did you mean {name}?"))
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
            let answer = answer::read(&line).map_err(|why| {
                let begins: String = line.trim_end().chars().take(80).collect();
                self.give_up(&format!("expected an action, found {begins}: {why}"))
            })?;
            match answer {
                FromPlanner::Peek(Peek { n }) if (1..=MOST_FUTURES).contains(&n) => {
                    let futures = peek(n).inspect_err(|_| {
                        // It waits for futures that never come.
                        self.stop("");
                    })?;
                    message = ToPlanner::Futures(Peeked::of(situation, world, &futures));
                }
                FromPlanner::Peek(Peek { n }) => {
                    return Err(self.give_up(&format!("it peeks into {n} futures, expected 1 to {MOST_FUTURES}")));
                }
                FromPlanner::Action(action) => {
                    let scene = &situation.scene;
                    let now = world.present(situation.ego_idx).unwrap_or_default();
                    let sizes = (scene.tracks[situation.ego_idx].extent_or_nominal().length_m, scene.dt_s);
                    let states = action::states(&action, &now, &scene.world_from_scene, sizes, n_steps);
                    self.plan = states.map_err(|why| self.give_up(&why))?.into();
                    return Ok(());
                }
            }
        }
        Err(self.give_up(&format!("it peeks more than {MOST_PEEKS} times before an action")))
    }

    fn next(&mut self, _situation: &Situation, _world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        self.plan.pop_front().ok_or_else(|| Failed::because("the plan is too short"))
    }

    fn end(&mut self, outcome: Outcome, why: Option<&str>) -> String {
        let done = Done { outcome: outcome.name().to_owned(), why: why.map(str::to_owned) };
        // A planner that failed is gone already.
        drop(self.send(&ToPlanner::Done(done)));
        let said = self.process.as_ref().map(Process::said).unwrap_or_default();
        std::mem::take(&mut self.said) + &said
    }
}

impl Drop for External {
    /// Closes the planner's input and lets it end.
    fn drop(&mut self) {
        self.process.take().map(Process::end);
    }
}
