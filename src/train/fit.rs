//! One training loop for every model: steps, warm-up, clipping, averages, evaluation.

use super::fit_config::CLIP_NORM;
use super::pace::Pace;
use super::run_state::{Position, Run};
use super::{Error, FitConfig, TrainJob, TrainTask};
use crate::nn::{Params, copies, in_pool, keep_freed_memory};
use crate::progress::Progress;
use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A line of the statistics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitStatistics {
    /// Steps taken.
    pub step: u64,
    /// Mean training loss since the previous line; `None` on lines of an evaluation.
    pub loss: Option<f64>,
    /// Mean norm of the gradients before clipping since the previous line.
    pub gradient_norm: Option<f64>,
    /// Held-out figures, on lines of an evaluation.
    pub evaluation: BTreeMap<String, f64>,
    /// The time by then, minutes, on lines of an evaluation of a training that is given time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// The steps that are planned in all, where a training that is given time changed its plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub planned: Option<u64>,
}

/// The result of a training run.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOutcome {
    /// Steps that were taken in all.
    pub n_steps: u64,
    /// Steps that this call took, beyond those of the state from which it resumed.
    pub steps_taken: u64,
    /// The badness of the best evaluation, if training ended with its weights or could have.
    pub best: Option<f64>,
    /// All lines of statistics, in order.
    pub statistics: Vec<FitStatistics>,
}

/// Trains `params` on `task` for `config.steps` steps, or as many instead as the time of the job allows, from the state
/// in its folder if there is one. At the end `params` are the averaged weights if `config.ema_decay` is positive,
/// otherwise the last ones; with `config.keeps_best`, those of the best evaluation, including the one before the first
/// step.
///
/// The folder holds `state.safetensors` (weights, averages, optimizer, position) and `statistics.jsonl`. A run that was
/// killed and resumed ends with the same weights as an uninterrupted one.
///
/// # Errors
/// When the loss is no longer finite, or files cannot be written or do not fit the model. [`Error::Stopped`] when the
/// process must stop between two steps; the state is saved then.
pub fn fit(
    config: &FitConfig,
    params: &mut Params,
    task: &dyn TrainTask,
    TrainJob { dir, progress, time, .. }: TrainJob<'_>,
) -> Result<FitOutcome, Error> {
    keep_freed_memory();
    let mut run = Run::open(config, params, dir)?;
    let mut config = FitConfig { steps: run.position.planned.unwrap_or(config.steps), ..config.clone() };
    let first_step = run.position.step;
    let before_s = run.position.elapsed_s;
    let elapsed_s = || time.map_or(0.0, |time| before_s + time.elapsed_s());
    let mut pace = Pace::new(0.0, run.position.evaluation_s);
    progress.start("train", config.steps, "steps");
    progress.advance(first_step);
    // The effect of training shows only beside the figures of the initial weights.
    if run.position.statistics.is_empty() && first_step == 0 && config.steps > 0 {
        run.position.elapsed_s = elapsed_s();
        run.evaluate(&config, params, task)?;
        run.position.evaluation_s = elapsed_s() - run.position.elapsed_s;
        pace.evaluation_s = run.position.evaluation_s;
    }
    while run.position.step < config.steps {
        if progress.must_stop() {
            run.save(params)?;
            return Err(Error::Stopped { step: run.position.step });
        }
        let from_s = elapsed_s();
        run.step(&config, params, task)?;
        run.position.elapsed_s = elapsed_s();
        pace.took(run.position.elapsed_s - from_s);
        let step = run.position.step;
        let left_s = time.map(|time| time.until_s - run.position.elapsed_s);
        let replanned = left_s.and_then(|left_s| pace.replanned(config.steps, step, left_s, config.evaluate_every));
        // An interruption changes nothing, unless there is no time left.
        if let Some(steps) = replanned.filter(|steps| first_step == 0 || *steps == step + 1) {
            (run.position.planned, config.steps) = (Some(steps), steps);
        }
        let is_last = step == config.steps;
        if step.is_multiple_of(config.log_every) || is_last {
            progress.note(&run.log(&config)?);
        }
        if step.is_multiple_of(config.evaluate_every) || is_last {
            run.evaluate(&config, params, task)?;
            run.position.evaluation_s = elapsed_s() - run.position.elapsed_s;
            pace.evaluation_s = run.position.evaluation_s;
        }
        if step.is_multiple_of(config.save_every) || is_last {
            run.save(params)?;
        }
        progress.advance(1);
    }
    progress.finish();
    run.choose_weights(params, progress)?;
    let Position { step: n_steps, best, statistics, .. } = run.position;
    Ok(FitOutcome { n_steps, steps_taken: n_steps - first_step, best: best.map(|(_, badness)| badness), statistics })
}

/// Takes the steps of `config` in a folder without a state, and saves nothing. At the end `params` are the averaged
/// weights, as after [`fit`].
pub(super) fn take_steps(
    config: &FitConfig,
    params: &mut Params,
    task: &dyn TrainTask,
    TrainJob { dir, progress, .. }: TrainJob<'_>,
) -> Result<(), Error> {
    keep_freed_memory();
    let mut run = Run::open(config, params, dir)?;
    while run.position.step < config.steps {
        if progress.must_stop() {
            return Err(Error::Stopped { step: 0 });
        }
        run.step(config, params, task)?;
    }
    Ok(run.ema.as_mut().map_or(Ok(()), |ema| ema.swap(params))?)
}

impl Run {
    /// Puts the averaged weights, or those of an earlier step that was better, into `params`.
    fn choose_weights(&mut self, params: &mut Params, progress: &dyn Progress) -> Result<(), Error> {
        if let Some(ema) = &mut self.ema {
            ema.swap(params)?;
        }
        if let Some((step, _)) = self.position.best.filter(|(step, _)| *step < self.position.step) {
            progress.note(&format!("the weights of step {step} are kept: later ones are worse on held-out scenes"));
            params.load(&self.best)?;
        }
        Ok(())
    }

    fn step(&mut self, config: &FitConfig, params: &Params, task: &dyn TrainTask) -> Result<(), Error> {
        let step = self.position.step;
        in_pool(params.device(), || {
            let loss = task.loss(step)?;
            let prepare = || if step + 1 < config.steps { task.prepare(step + 1) } else { Ok(()) };
            if params.device().is_cpu() {
                let descend = || self.descend(config, params, &loss, &loss.backward()?);
                let (descended, prepared) = rayon::join(descend, prepare);
                return descended.and(prepared);
            }
            // A GPU has only queued this work. The host prepares the next scenes before it waits for a result.
            let gradients = loss.backward()?;
            prepare()?;
            self.descend(config, params, &loss, &gradients)
        })
    }

    /// Updates the parameters by the gradient.
    fn descend(
        &mut self,
        config: &FitConfig,
        params: &Params,
        loss: &Tensor,
        gradients: &GradStore,
    ) -> Result<(), Error> {
        let step = self.position.step;
        let value = f64::from(loss.to_dtype(DType::F32)?.to_scalar::<f32>()?);
        if !value.is_finite() {
            return Err(Error::Diverged { step, loss: value });
        }
        let norm = self.adam.step(params, gradients, config.learning_rate_at(step), Some(CLIP_NORM))?;
        if let Some(ema) = &mut self.ema {
            ema.update(params)?;
            self.position.ema_updates = ema.n_updates();
        }
        self.position.step += 1;
        self.position.loss_sum += value;
        self.position.norm_sum += norm;
        Ok(())
    }

    fn log(&mut self, config: &FitConfig) -> Result<String, Error> {
        let n_steps = match self.position.step % config.log_every {
            0 => config.log_every,
            rest => rest,
        } as f64;
        let (loss, norm) = (self.position.loss_sum / n_steps, self.position.norm_sum / n_steps);
        self.position.loss_sum = 0.0;
        self.position.norm_sum = 0.0;
        self.position.statistics.push(FitStatistics {
            step: self.position.step,
            loss: Some(loss),
            gradient_norm: Some(norm),
            evaluation: BTreeMap::new(),
            minutes: None,
            planned: self.position.planned,
        });
        self.write_statistics()?;
        Ok(format!("loss {loss:.4}"))
    }

    fn evaluate(&mut self, config: &FitConfig, params: &mut Params, task: &dyn TrainTask) -> Result<(), Error> {
        if let Some(ema) = &mut self.ema {
            ema.swap(params)?;
        }
        let evaluation = task.evaluate();
        let badness = evaluation.as_ref().ok().and_then(|figures| task.badness(figures)).filter(|_| config.keeps_best);
        if let Some(badness) = badness.filter(|badness| self.position.best.is_none_or(|(_, best)| *badness < best)) {
            self.position.best = Some((self.position.step, badness));
            self.best = copies(&params.tensors())?;
        }
        if let Some(ema) = &mut self.ema {
            ema.swap(params)?;
        }
        self.position.statistics.push(FitStatistics {
            step: self.position.step,
            loss: None,
            gradient_norm: None,
            evaluation: evaluation?,
            minutes: Some(self.position.elapsed_s / 60.0).filter(|minutes| *minutes > 0.0),
            planned: self.position.planned,
        });
        self.write_statistics()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Compute, Init, read_checkpoint};
    use crate::progress::Silent;
    use crate::seed::Seed;
    use crate::train::LearningRateDecay;
    use candle_core::Device;
    use fs_err as fs;
    use std::path::Path;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Least squares toward a target that depends on the step; fails at one step, as a killed process would.
    struct Chase {
        x: Tensor,
        fails_at: Option<u64>,
    }

    impl TrainTask for Chase {
        fn loss(&self, step: u64) -> Result<Tensor, Error> {
            if self.fails_at == Some(step) {
                return Err(Error::Config("killed".to_owned()));
            }
            Ok((&self.x - (step % 7) as f64)?.sqr()?.mean_all()?)
        }

        fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
            let mean = self.x.detach().mean_all()?.to_scalar::<f32>()?;
            Ok(BTreeMap::from([("mean".to_owned(), f64::from(mean))]))
        }
    }

    fn job<'a>(dir: &'a Path, progress: &'a dyn Progress) -> TrainJob<'a> {
        static CPU: Compute = Compute::cpu();
        TrainJob { seed: Seed(1), dir, compute: &CPU, progress, time: None }
    }

    fn config() -> FitConfig {
        FitConfig {
            steps: 23,
            learning_rate: 0.05,
            warmup_steps: 4,
            decay: LearningRateDecay::Constant,
            ema_decay: 0.9,
            evaluate_every: 6,
            save_every: 5,
            log_every: 4,
            keeps_best: false,
        }
    }

    /// Interrupts after this many steps.
    struct StopAfter(AtomicU64);

    impl Progress for StopAfter {
        fn must_stop(&self) -> bool {
            self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err()
        }
    }

    fn train(dir: &Path, fails_at: Option<u64>) -> (Vec<f32>, Result<FitOutcome, Error>) {
        let mut params = Params::new(&Compute::cpu());
        let x = params.get_or_init("x", &[3], Init::KaimingUniform { fan_in: 1 }, Seed(1)).unwrap();
        let outcome = fit(&config(), &mut params, &Chase { x: x.clone(), fails_at }, job(dir, &Silent));
        (x.to_vec1().unwrap(), outcome)
    }

    #[test]
    fn a_run_that_is_asked_to_stop_loses_no_step() {
        let (whole, stopped) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        train(whole.path(), None).1.unwrap();
        let config = FitConfig { save_every: 1_000, ..config() };
        for (n_steps, reached) in [(0, 0), (2, 2), (5, 7), (9, 16), (1, 17)] {
            let mut params = Params::new(&Compute::cpu());
            let x = params.get_or_init("x", &[3], Init::KaimingUniform { fan_in: 1 }, Seed(1)).unwrap();
            let progress = StopAfter(AtomicU64::new(n_steps));
            let outcome = fit(&config, &mut params, &Chase { x, fails_at: None }, job(stopped.path(), &progress));
            assert!(matches!(outcome, Err(Error::Stopped { step }) if step == reached), "{outcome:?}");
        }
        train(stopped.path(), None).1.unwrap();
        for name in ["state.safetensors", "statistics.jsonl"] {
            let read = |dir: &Path| fs::read(dir.join(name)).unwrap();
            assert_eq!(read(whole.path()), read(stopped.path()), "{name}");
        }
    }

    #[test]
    fn a_resumed_run_ends_where_an_undisturbed_one_does() {
        let (whole, stopped) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (expected, undisturbed) = train(whole.path(), None);
        for fails_at in [3, 13, 14, 21] {
            assert!(train(stopped.path(), Some(fails_at)).1.is_err());
            // The state holds the statistics; the file is for people.
            fs::write(stopped.path().join("statistics.jsonl"), "damaged").unwrap();
        }
        let (found, resumed) = train(stopped.path(), None);
        assert_eq!(found, expected);
        assert_eq!(resumed.unwrap().statistics, undisturbed.unwrap().statistics);
        for name in ["state.safetensors", "statistics.jsonl"] {
            let read = |dir: &Path| fs::read(dir.join(name)).unwrap();
            assert_eq!(read(whole.path()), read(stopped.path()), "{name}");
        }
        let whole_statistics = fs::read(whole.path().join("statistics.jsonl")).unwrap();
        fs::remove_file(whole.path().join("statistics.jsonl")).unwrap();
        let (again, outcome) = train(whole.path(), None);
        assert_eq!((again, outcome.unwrap().steps_taken), (expected, 0));
        assert_eq!(fs::read(whole.path().join("statistics.jsonl")).unwrap(), whole_statistics);
    }

    /// A gradient of 1 everywhere, so that each of Adam's steps is the learning rate.
    struct Slope(Tensor);

    impl TrainTask for Slope {
        fn loss(&self, _step: u64) -> Result<Tensor, Error> {
            Ok(self.0.sum_all()?)
        }

        fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
            Ok(BTreeMap::from([("x".to_owned(), f64::from(self.0.detach().sum_all()?.to_scalar::<f32>()?))]))
        }

        fn badness(&self, figures: &BTreeMap<String, f64>) -> Option<f64> {
            Some((figures["x"] + 0.11).abs())
        }
    }

    #[test]
    fn steps_follow_the_schedule_and_the_averages_are_evaluated_and_kept() {
        let config = FitConfig {
            steps: 4,
            learning_rate: 0.1,
            warmup_steps: 2,
            decay: LearningRateDecay::Cosine,
            evaluate_every: 1,
            ..config()
        };
        let dir = tempfile::tempdir().unwrap();
        let mut params = Params::new(&Compute::cpu());
        let x = params.get_or_init("x", &[1], Init::Zeros, Seed(1)).unwrap();
        let outcome = fit(&config, &mut params, &Slope(x.clone()), job(dir.path(), &Silent)).unwrap();
        // Worked out by hand: rates 0.05, 0.1 (1 + cos π/4) / 2, 0.05 and 0.1 (1 + cos 3π/4) / 2, and averages whose
        // decay is 2/11, 3/12, 4/13 and 5/14; before them, the initial weights.
        let evaluated: Vec<f64> =
            outcome.statistics.iter().filter_map(|line| line.evaluation.get("x").copied()).collect();
        let expected = [0.0, -0.040_909, -0.111_744, -0.162_706, -0.186_681];
        assert!(evaluated.len() == 5, "{evaluated:?}");
        assert!(evaluated.iter().zip(expected).all(|(x, expected)| (x - expected).abs() < 2e-6), "{evaluated:?}");
        let last = read_checkpoint::<Position>(&Run::state_path(dir.path()), &Device::Cpu).unwrap();
        let last = last.tensors["params.x"].to_vec1::<f32>().unwrap()[0];
        assert!((last + 0.2).abs() < 2e-6, "{last}");
        let kept = x.to_vec1::<f32>().unwrap()[0];
        assert!((kept + 0.186_681).abs() < 2e-6, "{kept}");
        // Its second evaluation is the best one, also after an interruption.
        let dir = tempfile::tempdir().unwrap();
        for (steps, expected) in [(2, -0.111_744), (4, -0.111_744)] {
            let mut params = Params::new(&Compute::cpu());
            let x = params.get_or_init("x", &[1], Init::Zeros, Seed(1)).unwrap();
            let config = FitConfig { keeps_best: true, save_every: 1, ..config.clone() };
            let progress = StopAfter(AtomicU64::new(steps));
            let outcome = fit(&config, &mut params, &Slope(x.clone()), job(dir.path(), &progress));
            assert_eq!(outcome.is_ok(), steps == 4, "{outcome:?}");
            let kept = x.to_vec1::<f32>().unwrap()[0];
            assert!(outcome.is_err() || (kept - expected).abs() < 2e-6, "{kept}");
        }
    }
}
