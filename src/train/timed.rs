//! A training that is given time instead of steps: what does it do with it?
//!
//! A few steps and an evaluation tell how long they take. Where a twenty-fifth of the time is enough to learn
//! something, scales of motion and learning rates are tried for that long each, all from the same weights; otherwise
//! the first of each are taken: before any step, other scales are worse than those of the weights even where they are
//! better in the end. What does best on held-out scenes is trained for the rest, on a schedule as
//! long as the time allows. What was chosen is written down: with the same settings given explicitly, training brings
//! the same bytes on any machine unless it had to change its plan, and a resumed training goes on with them.

use super::denoiser::TrainedFrom;
use super::fit::take_steps;
use super::pace::Pace;
use super::{DenoiserTraining, Error, FitConfig, JobTime, Scales, SceneTraining, TrainTask, Within};
use crate::files::write_atomically;
use crate::tensor::TaskWeights;
use fs_err as fs;
use serde::{Deserialize, Serialize};
use std::io::Write;

/// Name of the file with what was chosen.
pub const CHOSEN_FILE: &str = "chosen.json";

/// Steps that are timed, after a first one in which memory is allocated, and scenes that are evaluated meanwhile.
const TIMED_STEPS: u64 = 4;
const TIMED_SCENES: usize = 8;
/// The part of the time of a trial, and the least steps that it must allow.
const TRIAL: f64 = 0.04;
const TRIAL_STEPS: u64 = 25;
/// The part of the time of one evaluation, and the least and largest number of its scenes.
const EVALUATION: f64 = 0.04;
const N_EVALUATED: [f64; 2] = [8.0, 96.0];
/// The part of the time of all evaluations between steps, and the least and largest number of them.
const EVALUATIONS: f64 = 0.05;
const N_EVALUATIONS: [f64; 2] = [2.0, 20.0];
/// The least time between evaluations, relative to theirs.
const EVERY: f64 = 8.0;
/// Steps that are taken at least, so that they can be timed again.
const LEAST_STEPS: u64 = 10;

/// A trial of some settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tried {
    /// The scales of motion.
    pub scales: Scales,
    /// Learning rate after warm-up.
    pub learning_rate: f64,
    /// Steps.
    pub steps: u64,
    /// The mean error of sampled held-out scenes, meters; missing if nothing is held out or the loss was no longer a
    /// number.
    pub scene_error_m: Option<f64>,
}

/// The settings of `[train.denoiser]` that a training chose for its time, and what they were chosen by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chosen {
    /// Optimizer steps in all, unless they become slower or faster.
    pub steps: u64,
    /// Learning rate after warm-up.
    pub learning_rate: f64,
    /// The scales of motion.
    pub scales: Scales,
    /// Steps between evaluations.
    pub evaluate_every: u64,
    /// Held-out scenes of each evaluation.
    pub n_eval_scenes: usize,
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
    /// How often one of the run's own scenes is drawn relative to those of other runs.
    pub own_weight: f64,
    /// The error of scenes that the checkpoint samples as it is, meters.
    pub began_m: Option<f64>,
    /// Everything that was tried.
    pub tried: Vec<Tried>,
    /// The duration of a step, seconds.
    pub step_s: f64,
    /// The duration of an evaluation, seconds.
    pub evaluation_s: f64,
}

impl Chosen {
    /// These settings, the others as in `base`.
    pub(super) fn settings(&self, base: &DenoiserTraining) -> DenoiserTraining {
        let fit = FitConfig {
            evaluate_every: self.evaluate_every,
            save_every: (self.evaluate_every / 2).max(1),
            ..schedule(&base.common.fit, self.steps, self.learning_rate)
        };
        let common = SceneTraining { n_eval_scenes: self.n_eval_scenes, fit, ..base.common.clone() };
        DenoiserTraining { scales: self.scales, within: None, common, ..base.clone() }
    }
}

/// The schedule of so many steps.
fn schedule(base: &FitConfig, steps: u64, learning_rate: f64) -> FitConfig {
    FitConfig { steps, learning_rate, warmup_steps: base.warmup_steps.min(steps / 10), ..base.clone() }
}

pub(super) struct Choice<'a> {
    within: &'a Within,
    from: TrainedFrom<'a>,
    time: JobTime<'a>,
    n_eval_scenes: usize,
    step_s: f64,
    /// The error of the checkpoint as it is.
    began_m: Option<f64>,
    tried: Vec<Tried>,
}

impl<'a> Choice<'a> {
    /// Chooses the settings of a training, or reads those that it chose before it was interrupted.
    pub(super) fn made(within: &'a Within, from: TrainedFrom<'a>) -> Result<Chosen, Error> {
        let path = from.job.dir.join(CHOSEN_FILE);
        if path.exists() {
            return serde_json::from_str(&fs::read_to_string(&path)?).map_err(|_| Error::DamagedState { path });
        }
        let no_clock = || Error::Config("train.denoiser.for needs a clock, which only a run has".to_owned());
        let time = from.job.time.ok_or_else(no_clock)?;
        let choice = Self { within, from, time, n_eval_scenes: 0, step_s: 0.0, began_m: None, tried: Vec::new() };
        from.job.progress.start("try", 0, "settings");
        let chosen = choice.choose()?;
        from.job.progress.finish();
        fs::create_dir_all(from.job.dir)?;
        let text = serde_json::to_vec_pretty(&chosen).map_err(std::io::Error::from)?;
        write_atomically::<Error>(&path, |file| Ok(file.write_all(&text)?))?;
        Ok(chosen)
    }

    fn choose(mut self) -> Result<Chosen, Error> {
        let (within, time, TrainedFrom { training, data, start, .. }) = (self.within, self.time, self.from);
        let each_s = self.timed()?;
        let n_scenes = (EVALUATION * within.seconds / each_s).clamp(N_EVALUATED[0], N_EVALUATED[1]) as usize;
        self.n_eval_scenes = within.n_eval_scenes.unwrap_or(n_scenes);
        if start.is_some() {
            self.began_m = self.error_after(Scales::Checkpoint, training.common.fit.learning_rate, 0)?;
        }
        let fits = (TRIAL * within.seconds / self.step_s) as u64;
        let steps = if fits < TRIAL_STEPS { 0 } else { fits };
        let (scales, learning_rate) = self.best_after(steps)?;
        let evaluation_s = each_s * self.n_eval_scenes as f64;
        let left_s = time.until_s - time.elapsed_s() - evaluation_s;
        let pace = Pace::new(self.step_s, evaluation_s);
        let n = (EVALUATIONS * left_s / evaluation_s).clamp(N_EVALUATIONS[0], N_EVALUATIONS[1]).floor();
        let every = pace.steps(0, left_s - (n - 1.0) * evaluation_s, u64::MAX).div_ceil(n as u64);
        // Both may have taken longer than usual when they were timed.
        let evaluate_every = every.max((EVERY * evaluation_s / self.step_s) as u64);
        Ok(Chosen {
            steps: pace.steps(0, left_s, evaluate_every).max(LEAST_STEPS),
            learning_rate,
            scales,
            evaluate_every,
            n_eval_scenes: self.n_eval_scenes,
            tasks: training.common.tasks,
            own_weight: data.sources.first().map_or(1.0, |own| own.weight),
            began_m: self.began_m,
            tried: self.tried,
            step_s: self.step_s,
            evaluation_s,
        })
    }

    /// Times steps; returns the time that an evaluation takes for each scene, seconds.
    fn timed(&mut self) -> Result<f64, Error> {
        let (time, job, fit) = (self.time, self.from.job, &self.from.training.common.fit);
        let settings = self.settings(Scales::Checkpoint, TIMED_SCENES);
        let steps = |n: u64| schedule(fit, n, 0.0);
        let ((each_s, step_s), _) = self.from.with_task(&settings, |params, task| {
            take_steps(&steps(1), params, task, job)?;
            let from_s = time.elapsed_s();
            take_steps(&steps(TIMED_STEPS), params, task, job)?;
            let between_s = time.elapsed_s();
            task.evaluate()?;
            let n_scenes = task.draws.held_out.len().max(1) as f64;
            Ok(((time.elapsed_s() - between_s) / n_scenes, (between_s - from_s) / TIMED_STEPS as f64))
        })?;
        self.step_s = step_s;
        Ok(each_s)
    }

    /// The scales that have the least error after so many steps at the first learning rate, and of the learning rates
    /// that with these scales; the first of both without steps.
    fn best_after(&mut self, steps: u64) -> Result<(Scales, f64), Error> {
        let Within { scales, learning_rates, .. } = self.within;
        let own = [Scales::default()];
        let scales = if self.from.start.is_some() { scales } else { &own[..] };
        let mut best = (scales[0], learning_rates[0]);
        if steps == 0 || scales.len() * learning_rates.len() == 1 {
            return Ok(best);
        }
        let mut least_m = self.tried(best, steps)?;
        for i in 1..scales.len() + learning_rates.len() - 1 {
            let other = match scales.get(i) {
                Some(scales) => (*scales, best.1),
                None => (best.0, learning_rates[i + 1 - scales.len()]),
            };
            let error_m = self.tried(other, steps)?;
            if error_m < least_m {
                (best, least_m) = (other, error_m);
            }
        }
        Ok(best)
    }

    /// The error after a trial, which is written down; infinite if there is none.
    fn tried(&mut self, (scales, learning_rate): (Scales, f64), steps: u64) -> Result<f64, Error> {
        let scene_error_m = self.error_after(scales, learning_rate, steps)?;
        self.tried.push(Tried { scales, learning_rate, steps, scene_error_m });
        Ok(scene_error_m.unwrap_or(f64::INFINITY))
    }

    fn error_after(&mut self, scales: Scales, learning_rate: f64, steps: u64) -> Result<Option<f64>, Error> {
        let (time, job, fit) = (self.time, self.from.job, &self.from.training.common.fit);
        let settings = self.settings(scales, self.n_eval_scenes);
        let mut n_held_out = 0;
        let ((error_m, step_s), _) = self.from.with_task(&settings, |params, task| {
            n_held_out = task.draws.held_out.len();
            let from_s = time.elapsed_s();
            match take_steps(&schedule(fit, steps, learning_rate), params, task, job) {
                Err(Error::Diverged { .. }) => return Ok((None, None)),
                other => other?,
            }
            let step_s = (time.elapsed_s() - from_s) / steps as f64;
            Ok((task.scene_error_m()?, Some(step_s)))
        })?;
        self.step_s = step_s.filter(|_| steps > 0).unwrap_or(self.step_s);
        self.n_eval_scenes = self.n_eval_scenes.min(n_held_out.max(1));
        Ok(error_m)
    }

    fn settings(&self, scales: Scales, n_eval_scenes: usize) -> DenoiserTraining {
        let base = self.from.training;
        DenoiserTraining { scales, common: SceneTraining { n_eval_scenes, ..base.common.clone() }, ..base.clone() }
    }
}
