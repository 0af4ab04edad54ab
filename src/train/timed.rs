//! A training that is given time instead of steps: what does it do with it?
//!
//! A few steps tell how long one takes. Each learning rate is then tried for a twentieth of the time, all from the same
//! weights; the one that ends with the least scene error trains anew for the rest, on a schedule as long as the time
//! allows. What was chosen is written down: with the same settings given explicitly, training brings the same bytes on
//! any machine, and a resumed training goes on with them.

use super::fit::take_steps;
use super::{DenoiserTraining, DenoisingTask, Error, FitConfig, TrainJob, TrainTask, TrainingData};
use crate::files::write_atomically;
use crate::nn::{Params, copies};
use crate::tensor::TaskWeights;
use fs_err as fs;
use serde::{Deserialize, Serialize};
use std::io::Write;

/// Name of the file with what was chosen.
pub const CHOSEN_FILE: &str = "chosen.json";

/// Steps that are timed, after a first one in which memory is allocated.
const TIMED_STEPS: u64 = 8;
/// The part of the time in which each learning rate is tried.
const TRIAL: f64 = 0.05;
/// The part of the time that evaluations may take, and their least and largest number.
const EVALUATIONS: f64 = 0.12;
const N_EVALUATIONS: [f64; 2] = [2.0, 20.0];
/// Left for steps that take longer than the timed ones.
const SPARE: f64 = 0.05;
/// Held-out scenes of each evaluation for each minute, and the least and largest number of them.
const EVALUATED_PER_MINUTE: f64 = 8.0;
const N_EVALUATED: [f64; 2] = [16.0, 192.0];

/// What a training that is given time may choose from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Within {
    /// The time for all of it, seconds.
    pub seconds: f64,
    /// The learning rates that are tried.
    pub learning_rates: Vec<f64>,
}

impl Within {
    /// Held-out scenes of each evaluation.
    pub(super) fn n_eval_scenes(&self) -> usize {
        (self.seconds / 60.0 * EVALUATED_PER_MINUTE).clamp(N_EVALUATED[0], N_EVALUATED[1]) as usize
    }
}

/// The settings of `[train.denoiser]` that a training chose for its time, and what they were chosen by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chosen {
    /// Optimizer steps in all.
    pub steps: u64,
    /// Learning rate after warm-up.
    pub learning_rate: f64,
    /// Steps between evaluations.
    pub evaluate_every: u64,
    /// Held-out scenes of each evaluation.
    pub n_eval_scenes: usize,
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
    /// How often one of the run's own scenes is drawn relative to those of other runs.
    pub own_weight: f64,
    /// Every learning rate that was tried and the scene error that it ended with, meters; missing if nothing is held
    /// out or the loss was no longer a number.
    pub tried: Vec<(f64, Option<f64>)>,
    /// The duration of a step, seconds.
    pub step_s: f64,
    /// The duration of an evaluation, seconds.
    pub evaluation_s: f64,
}

impl Chosen {
    /// The schedule with these settings, the others as in `base`.
    pub(super) fn schedule(&self, base: &FitConfig) -> FitConfig {
        FitConfig {
            steps: self.steps,
            learning_rate: self.learning_rate,
            warmup_steps: base.warmup_steps.min(self.steps / 10),
            evaluate_every: self.evaluate_every,
            save_every: (self.evaluate_every / 2).max(1),
            ..base.clone()
        }
    }

    /// The number of steps that leaves time for evaluations, and the steps between these, if `left_s` are left.
    pub(super) fn lasting(left_s: f64, step_s: f64, evaluation_s: f64) -> [u64; 2] {
        let n = (EVALUATIONS * left_s / evaluation_s).floor().clamp(N_EVALUATIONS[0], N_EVALUATIONS[1]);
        // One before the first step, and about one after the last for the losses of changed scenes.
        let stepping_s = left_s * (1.0 - SPARE) - (n + 2.0) * evaluation_s;
        let steps = (stepping_s / step_s).floor().max(n) as u64;
        [steps, steps.div_ceil(n as u64)]
    }
}

/// Chooses the settings of a training, or reads those that it chose before it was interrupted. The weights stay as they
/// are.
///
/// # Errors
/// When a step or an evaluation fails, the process must stop, or the file cannot be written or read.
pub(super) fn choose(
    within: &Within,
    training: &DenoiserTraining,
    (task, data): (&DenoisingTask<'_>, &TrainingData<'_>),
    params: &mut Params,
    job: TrainJob<'_>,
) -> Result<Chosen, Error> {
    let path = job.dir.join(CHOSEN_FILE);
    if path.exists() {
        return serde_json::from_str(&fs::read_to_string(&path)?).map_err(|_| Error::DamagedState { path });
    }
    let Some(time) = job.time else {
        return Err(Error::Config("train.denoiser.for needs a clock, which only a run has".to_owned()));
    };
    let begun = copies(&params.tensors())?;
    let base = &training.common.fit;
    job.progress.start("try", 1 + within.learning_rates.len() as u64, "learning rates");
    let from_s = time.elapsed_s();
    task.evaluate()?;
    let evaluation_s = time.elapsed_s() - from_s;
    let of_steps = |steps: u64, learning_rate: f64| FitConfig {
        steps,
        learning_rate,
        warmup_steps: base.warmup_steps.min(steps / 10),
        ..base.clone()
    };
    let timed = |steps: u64, rate: f64, params: &mut Params| -> Result<f64, Error> {
        let from_s = time.elapsed_s();
        take_steps(&of_steps(steps, rate), params, task, job)?;
        Ok((time.elapsed_s() - from_s) / steps as f64)
    };
    timed(1, 0.0, params)?;
    let mut step_s = timed(TIMED_STEPS, 0.0, params)?;
    job.progress.advance(1);
    let trial_s = TRIAL * (time.until_s - time.elapsed_s());
    let mut tried = Vec::new();
    if let [only] = within.learning_rates[..] {
        tried.push((only, None));
    } else {
        for rate in &within.learning_rates {
            params.load(&begun)?;
            let steps = (trial_s / step_s).max(TIMED_STEPS as f64) as u64;
            let error_m = match timed(steps, *rate, params) {
                Ok(each_s) => {
                    step_s = each_s;
                    task.scene_error_m()?
                }
                Err(Error::Diverged { .. }) => None,
                Err(error) => return Err(error),
            };
            tried.push((*rate, error_m));
            job.progress.advance(1);
        }
    }
    params.load(&begun)?;
    job.progress.finish();
    let error_m = |(_, error_m): &&(f64, Option<f64>)| error_m.unwrap_or(f64::INFINITY);
    let best = tried.iter().min_by(|a, b| error_m(a).total_cmp(&error_m(b)).then(a.0.total_cmp(&b.0)));
    let learning_rate = best.map_or(base.learning_rate, |(rate, _)| *rate);
    let [steps, evaluate_every] = Chosen::lasting(time.until_s - time.elapsed_s(), step_s, evaluation_s);
    let chosen = Chosen {
        steps,
        learning_rate,
        evaluate_every,
        n_eval_scenes: training.common.n_eval_scenes,
        tasks: training.common.tasks,
        own_weight: data.sources.first().map_or(1.0, |own| own.weight),
        tried,
        step_s,
        evaluation_s,
    };
    fs::create_dir_all(job.dir)?;
    let text = serde_json::to_vec_pretty(&chosen).map_err(std::io::Error::from)?;
    write_atomically::<Error>(&path, |file| Ok(file.write_all(&text)?))?;
    Ok(chosen)
}
