//! Which noise leads to the wanted sample? Gradient ascent through all steps of a short sampler.

use super::CleanPotential;
use crate::diffusion::Denoiser;
use crate::diffusion::sampler::EulerConfig;
use candle_core::{Error, Result, Tensor, Var};
use candle_nn::{AdamW, Optimizer, ParamsAdamW};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the noise that a sample starts from is optimized.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseOptimizationConfig {
    /// Number of gradient steps. Each takes as many evaluations as the sampler has steps, and their derivatives.
    #[schemars(range(min = 1, max = 1000))]
    pub iterations: usize,
    /// How far a gradient step moves each number of the noise, whose standard deviation is 1.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub learning_rate: f64,
}

impl Default for NoiseOptimizationConfig {
    fn default() -> Self {
        Self { iterations: 3, learning_rate: 0.3 }
    }
}

/// What an evaluation of the network with its derivative counts as, in evaluations without: 2.5 of them were measured.
pub const EVALUATIONS_PER_GRADIENT: usize = 3;
/// The most steps of a sampler that can be differentiated: memory grows with them.
pub const MOST_STEPS: usize = 8;

impl NoiseOptimizationConfig {
    /// Evaluations of the network for one sample, beyond those of its sampler of `n_steps` steps.
    pub const fn n_evaluations(&self, n_steps: usize) -> usize {
        self.iterations * n_steps * EVALUATIONS_PER_GRADIENT
    }

    /// Standard normal noise `z` (B, A, …), moved toward larger J(x₀(z)), where x₀(z) is where Euler's steps through `sigmas`
    /// lead from σ z: by Adam (Kingma and Ba, 2015), row by row. The noise of every entry of the second axis (an agent)
    /// moves on the sphere of its own norm: that is where standard normal noise of many dimensions lies, and where the
    /// denoiser was trained. Only the part of the gradient along the sphere counts, and each step is scaled back to it.
    ///
    /// # Errors
    /// When `denoiser` or `potential` cannot be differentiated.
    pub fn optimize(
        &self,
        sigmas: &[f64],
        denoiser: &dyn Denoiser,
        potential: &dyn CleanPotential,
        z: &Tensor,
    ) -> Result<Tensor> {
        let norms = block_norms(z)?;
        let var = Var::from_tensor(&z.detach())?;
        let params = ParamsAdamW { lr: self.learning_rate, weight_decay: 0.0, ..ParamsAdamW::default() };
        let mut adam = AdamW::new(vec![var.clone()], params)?;
        for _ in 0..self.iterations {
            let x = (var.as_tensor() * sigmas[0])?;
            let x0 = EulerConfig::integrate_differentiably(sigmas, denoiser, x)?;
            let mut gradients = potential.log_potential(&x0)?.sum_all()?.neg()?.backward()?;
            let gradient = gradients.remove(&var).ok_or_else(|| {
                Error::Msg("the sample does not depend on its noise; some operation cuts its gradient".into())
            })?;
            let unit = var.as_tensor().detach().broadcast_div(&norms)?;
            let outward = unit.broadcast_mul(&block_sums(&(&unit * &gradient)?)?)?;
            gradients.insert(&var, (gradient - outward)?);
            adam.step(&gradients)?;
            let moved = var.as_tensor().detach();
            var.set(&moved.broadcast_mul(&norms.div(&block_norms(&moved)?)?)?)?;
        }
        Ok(var.as_tensor().detach())
    }
}

/// The sum over each entry of the first two axes, (B, A, 1, …).
fn block_sums(values: &Tensor) -> Result<Tensor> {
    let mut dims = vec![1; values.rank()];
    dims[..2].copy_from_slice(&values.dims()[..2]);
    values.flatten_from(2)?.sum(2)?.reshape(dims)
}

/// The Euclidean norm of each of them; 1 instead of 0.
fn block_norms(z: &Tensor) -> Result<Tensor> {
    let norms = block_sums(&z.sqr()?)?.sqrt()?;
    norms.eq(0.0)?.to_dtype(z.dtype())? + norms
}

#[cfg(test)]
#[path = "noise_optimization_tests.rs"]
mod tests;
