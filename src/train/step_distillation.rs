//! Distills a denoiser to a few large steps, each of which ends where many small steps of the teacher end.

use super::latent_error::{pseudo_huber, squared_error};
use super::objective_loss::{objective_costs, objective_loss};
use super::{DistillTraining, DrawnBatch, Error, SceneDraws, TrainTask};
use crate::diffusion::sampler::StepGrid;
use crate::diffusion::{Denoiser, Edm, NoiseSource, SamplerConfig, Step, rows_like};
use crate::model::SceneDenoiser;
use crate::settings::{self, Issue};
use candle_core::Tensor;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The disagreement at which the loss turns from quadratic to linear: small beside that of networks, so that few
/// outliers do not decide, and yet smooth at 0.
const HUBER: f64 = 0.01;
/// Weight of the squared disagreement of the paths to which diffused motion adds up, as in the training of denoisers.
const PATH_LOSS: f64 = 0.1;

/// The steps to which a denoiser is distilled, and the teacher's steps within each.
///
/// The student predicts at the levels of Euler's sampler σ_0 > σ_1 > … > 0. From noise at σ_0 the teacher takes each
/// interval in `teacher_steps` steps of DPM-Solver++(2M), and the student learns the prediction with which a single
/// Euler step ends where the teacher does: (x_{k+1} - (σ_{k+1} / σ_k) x_k) / (1 - σ_{k+1} / σ_k) (Salimans and Ho 2022,
/// progressive distillation, in one stage). The student learns a function of the noise, not a mean over outcomes.
///
/// Objectives apply to the end of the student's own steps, with gradients through all of them (Clark et al. 2024,
/// DRaFT); the distance to the teacher keeps samples likely.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StepDistillation {
    /// Number of steps N, one evaluation each.
    #[schemars(range(min = 1, max = 1_000))]
    pub n_steps: usize,
    /// The noise levels at which the steps begin.
    pub grid: StepGrid,
    /// Steps of the teacher per step. No setting: with 5, the teacher's own error is far below the student's.
    #[serde(skip)]
    pub teacher_steps: usize,
    /// The noise level of the teacher's last step, which leads to 0.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub teacher_sigma_min: f64,
}

impl Default for StepDistillation {
    fn default() -> Self {
        let grid = StepGrid { sigma_max: Some(30.0), sigma_min: Some(2.5) };
        Self { n_steps: 2, grid, teacher_steps: 5, teacher_sigma_min: 0.08 }
    }
}

impl StepDistillation {
    /// The sampler that the student is made for.
    pub const fn sampler(&self) -> SamplerConfig {
        SamplerConfig::euler(self.n_steps).on(self.grid)
    }

    /// Rejects steps that work with no denoiser.
    pub(super) fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        self.sampler().validate()?;
        let last = if self.n_steps == 1 { self.grid.sigma_max } else { self.grid.sigma_min };
        self.check_last(last.unwrap_or(f64::INFINITY))
    }

    /// Rejects steps that do not work with a denoiser of these constants.
    pub(super) fn check_levels(&self, edm: &Edm) -> settings::Result {
        let sigmas = self.sigmas(edm);
        let (first, most) = (sigmas[0], edm.sigma_max);
        if first > most {
            let why = format_args!("begins at {first}, expected at most the denoiser's largest noise level {most}");
            return Err(Issue::new("grid", why));
        }
        self.check_last(sigmas[sigmas.len() - 2])
    }

    fn check_last(&self, last: f64) -> settings::Result {
        let found = self.teacher_sigma_min;
        match found > 0.0 && found < last {
            true => Ok(()),
            false => Err(Issue::new(
                "teacher_sigma_min",
                format_args!("is {found}, expected a positive number below the last level of the steps, {last}"),
            )),
        }
    }

    /// The noise levels at which the student predicts, and 0.
    pub fn sigmas(&self, edm: &Edm) -> Vec<f64> {
        self.sampler().schedule(edm, self.sampler().sigma_start(edm))
    }

    /// The noise levels that the teacher goes through: every `teacher_steps`-th of them is one of the student's.
    fn teacher_sigmas(&self, edm: &Edm) -> Vec<f64> {
        let schedule = |from, sigma_min, n_steps| Edm { sigma_min, ..*edm }.schedule_from(from, n_steps);
        let intervals = self.sigmas(edm);
        let intervals = intervals.windows(2).flat_map(|pair| match pair[1] {
            0.0 => schedule(pair[0], self.teacher_sigma_min, self.teacher_steps),
            to => schedule(pair[0], to, self.teacher_steps + 1).into_iter().take(self.teacher_steps).collect(),
        });
        intervals.collect()
    }

    /// The states of `teacher` at all of the student's noise levels, starting from `x` (B, …) at the first of them.
    ///
    /// The solver runs once through all levels. A multistep solver begins with a first-order step; restarted at each
    /// level, it would make samples too similar.
    fn states(&self, edm: &Edm, teacher: &dyn Denoiser, x: Tensor) -> candle_core::Result<Vec<Tensor>> {
        let solver = SamplerConfig::dpmpp_2m(self.teacher_steps);
        let mut states = vec![x.clone()];
        let mut observer = |step: &Step<'_>| {
            if (step.step_idx + 1).is_multiple_of(self.teacher_steps) {
                states.push(step.x.clone());
            }
        };
        solver.integrate(&self.teacher_sigmas(edm), teacher, x, &mut observer)?;
        Ok(states)
    }
}

/// The prediction with which one Euler step goes from `x` (B, …) at noise level `from` to `next` (B, …) at `to`:
/// (next - r x) / (1 - r) with r = to / from.
fn answer(x: &Tensor, next: &Tensor, from: f64, to: f64) -> candle_core::Result<Tensor> {
    let ratio = to / from;
    (next - (x * ratio)?)? / (1.0 - ratio)
}

/// Distillation of a `SceneDenoiser` onto a few steps, on the scenes of a dataset.
pub struct StepDistillationTask<'a> {
    /// The denoiser with trainable parameters.
    pub denoiser: &'a SceneDenoiser,
    /// The model without gradients, for evaluations.
    pub frozen: &'a SceneDenoiser,
    /// The teacher.
    pub teacher: &'a SceneDenoiser,
    /// The steps.
    pub steps: &'a StepDistillation,
    /// Other settings.
    pub training: &'a DistillTraining,
    /// Draws batches.
    pub draws: SceneDraws<'a>,
}

impl StepDistillationTask<'_> {
    /// The predictions of `denoiser` from noise by the rows' seeds; the rows are all or a part of a batch of `n_rows`.
    fn answers(&self, denoiser: &SceneDenoiser, drawn: &DrawnBatch, n_rows: usize) -> Result<Answers, Error> {
        let (batch, mut noise) = (&drawn.batch, NoiseSource::new(drawn.seeds.clone()));
        let edm = denoiser.edm();
        let sigmas = self.steps.sigmas(edm);
        let student = denoiser.bind(batch, 1)?;
        let x = (noise.draw_like(&batch.x0)?.broadcast_mul(&batch.latent.unsqueeze(3)?)? * sigmas[0])?;
        let ask = |x: &Tensor, sigma: f64| student.denoise(x, &rows_like(vec![sigma; x.dim(0)?], x)?.flatten_all()?);
        let states = self.steps.states(edm, &self.teacher.bind(batch, 1)?, x.clone())?;
        let mut distances = Vec::with_capacity(sigmas.len() - 1);
        // The state of the student's own steps, which start from the teacher's noise.
        let mut own = x;
        for (step, (states, levels)) in states.windows(2).zip(sigmas.windows(2)).enumerate() {
            let (x, from, to) = (&states[0], levels[0], levels[1]);
            let answered = ask(x, from)?;
            let target = answer(x, &states[1], from, to)?;
            let squared = squared_error(batch, &answered, &target, PATH_LOSS)?;
            distances.push((pseudo_huber(batch, &squared, HUBER)?.sum_all()? / n_rows as f64)?);
            if !self.training.objectives.is_empty() {
                let answered = if step == 0 { answered } else { ask(&own, from)? };
                own = ((own * (to / from))? + (answered * (1.0 - to / from))?)?;
            }
        }
        Ok(Answers { distances, sample: own })
    }
}

/// The predictions of a student.
struct Answers {
    /// For each of its levels, the mean distance over rows between its prediction on the teacher's path and the target
    /// prediction.
    distances: Vec<Tensor>,
    /// The end of its own steps, (B, A, T, D), with the graph through all of them; their start if there are no
    /// objectives.
    sample: Tensor,
}

impl TrainTask for StepDistillationTask<'_> {
    fn loss(&self, step: u64) -> Result<Tensor, Error> {
        let (drawn, n_rows) = (self.draws.training_batch(step)?, self.draws.batch_size);
        let Answers { distances, sample } = self.answers(self.denoiser, &drawn, n_rows)?;
        let distance = Tensor::stack(&distances, 0)?.mean_all()?;
        let everywhere = vec![1.0; drawn.seeds.len()];
        Ok(match objective_loss(&self.training.objectives, &sample, &drawn, &everywhere, n_rows as f64)? {
            Some(wished) => (distance + wished)?,
            None => distance,
        })
    }

    fn prepare(&self, step: u64) -> Result<(), Error> {
        self.draws.prepare(step)
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        let sigmas = self.steps.sigmas(self.frozen.edm());
        let objectives = &self.training.objectives;
        let levels = sigmas[..sigmas.len() - 1].iter().map(|sigma| format!("held_out_distance_at_sigma_{sigma:.3}"));
        let wishes = objectives.iter().map(|objective| format!("held_out_cost_of_{}", objective.kind()));
        let names: Vec<String> = levels.chain(wishes).collect();
        let means = self.draws.held_out_means(names.len(), |drawn| {
            let Answers { mut distances, sample } = self.answers(self.frozen, drawn, drawn.seeds.len())?;
            for cost in objective_costs(objectives, &sample, drawn)? {
                distances.push(cost.mean_all()?);
            }
            Ok(distances)
        })?;
        Ok(names.into_iter().zip(means).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::testing::values;
    use candle_core::Device;

    /// Data N(1.5, 0.4²): the probability-flow equation keeps (x - 1.5) / √(0.4² + σ²).
    struct Gaussian;

    const MEAN: f64 = 1.5;
    const STD: f64 = 0.4;

    impl Denoiser for Gaussian {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> candle_core::Result<Tensor> {
            let shrink =
                crate::diffusion::sigma_rows(sigma)?.into_iter().map(|s| (STD / s.hypot(STD)).powi(2)).collect();
            (x - MEAN)?.broadcast_mul(&rows_like(shrink, x)?)? + MEAN
        }
    }

    #[test]
    fn the_levels_are_those_of_the_sampler_and_the_teacher_goes_between_them() {
        let edm = Edm::default();
        let steps = StepDistillation {
            grid: StepGrid { sigma_max: Some(30.0), sigma_min: Some(4.0) },
            teacher_steps: 3,
            ..StepDistillation::default()
        };
        assert_eq!(steps.sigmas(&edm), [30.0, 4.0, 0.0]);
        let levels = steps.teacher_sigmas(&edm);
        assert_eq!((levels.len(), levels[0], levels[3], levels[5], levels[6]), (7, 30.0, 4.0, 0.08, 0.0));
        // Evenly spaced in σ^(1/7): the middle one of three between 4 and 0.08.
        let middle = ((4f64.powf(1.0 / 7.0) + 0.08f64.powf(1.0 / 7.0)) / 2.0).powi(7);
        assert!((levels[4] - middle).abs() < 1e-12);
        assert!(levels.windows(2).all(|pair| pair[0] > pair[1]), "{levels:?}");
        let single = StepDistillation { n_steps: 1, ..steps };
        assert_eq!((single.sigmas(&edm), single.teacher_sigmas(&edm).len()), (vec![30.0, 0.0], 4));
    }

    #[test]
    fn an_euler_step_with_the_learned_answer_lands_where_the_exact_solution_does() {
        struct Answer(Tensor);
        impl Denoiser for Answer {
            fn denoise(&self, _: &Tensor, _: &Tensor) -> candle_core::Result<Tensor> {
                Ok(self.0.clone())
            }
        }
        let edm = Edm::default();
        let x = Tensor::from_vec(vec![-40.0, -3.0, 0.0, 20.0, 60.0], (5, 1), &Device::Cpu).unwrap();
        let steps =
            StepDistillation { n_steps: 3, teacher_steps: 300, teacher_sigma_min: 1e-3, ..StepDistillation::default() };
        let states = steps.states(&edm, &Gaussian, x.clone()).unwrap();
        let sigmas = steps.sigmas(&edm);
        assert_eq!((states.len(), sigmas.len()), (4, 4));
        for (states, levels) in states.windows(2).zip(sigmas.windows(2)) {
            let learned = Answer(answer(&states[0], &states[1], levels[0], levels[1]).unwrap());
            let euler = SamplerConfig::euler(3);
            let landed = euler.integrate(levels, &learned, states[0].clone(), &mut |_| ()).unwrap();
            let gain = levels[1].hypot(STD) / sigmas[0].hypot(STD);
            let exact = ((&x - MEAN).unwrap() * gain).unwrap() + MEAN;
            for (landed, exact) in values(&landed).iter().zip(values(&exact.unwrap())) {
                // The error of a second-order method and of the last step.
                assert!((landed - exact).abs() < 2e-3 * exact.abs().max(1.0), "{levels:?}: {landed}, exactly {exact}");
            }
        }
    }

    #[test]
    fn settings_that_make_no_sense_are_named() {
        let refusal = |steps: StepDistillation| steps.validate().unwrap_err().to_string();
        let default = StepDistillation::default;
        assert!(refusal(StepDistillation { n_steps: 0, ..default() }).contains("n_steps is 0"));
        assert!(refusal(StepDistillation { teacher_sigma_min: 2.5, ..default() }).contains("of the steps, 2.5"));
        assert!(default().validate().is_ok());
        let edm = |sigma_max, sigma_min| Edm { sigma_max, sigma_min, ..Edm::default() };
        assert!(default().check_levels(&edm(80.0, 0.002)).is_ok());
        let beyond = default().check_levels(&edm(20.0, 0.002)).unwrap_err();
        assert!(beyond.to_string().contains("grid begins at 30, expected at most"));
        // The denoiser's own last level, if the grid names none.
        let open = StepDistillation { grid: StepGrid { sigma_min: None, ..default().grid }, ..default() };
        assert!(open.validate().is_ok() && open.check_levels(&edm(80.0, 0.5)).is_ok());
        assert!(open.check_levels(&edm(80.0, 0.002)).unwrap_err().to_string().contains("of the steps, 0.002"));
    }
}
