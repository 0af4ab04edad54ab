//! A denoiser whose estimates lean toward what a guidance finds likely; every sampler can use it.

use super::Guidance;
use crate::diffusion::{Denoiser, rows_like, sigma_rows};
use candle_core::{Error, Result, Tensor, Var};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// When guidance acts and how far it may go.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GuidanceConfig {
    /// The highest noise level at which guidance acts. Classifiers see little noise above 3 in training and are
    /// unreliable there: on merging cases, gradients from up there lowered the rate of cut-ins.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma_hi: f64,
    /// The largest Euclidean norm of the shift α σ² ∇ ln p of one scene's clean estimate, in diffused units (the data
    /// has standard deviation σ_data = 0.5 in each entry); longer shifts are shortened to it, which keeps trajectories
    /// smooth at large strengths. A very large number, such as 1e9, means no limit.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_shift: f64,
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        Self { sigma_hi: 3.0, max_shift: 6.0 }
    }
}

impl GuidanceConfig {
    /// Guidance as in the paper's equation 3: at every noise level, however far it shifts.
    pub const UNRESTRICTED: Self = Self { sigma_hi: f64::MAX, max_shift: f64::MAX };

    /// Whether guidance acts at a noise level. The bound belongs to it, in the single precision in which samplers pass
    /// levels.
    pub(super) fn acts_at(&self, sigma: f64) -> bool {
        sigma as f32 <= self.sigma_hi as f32
    }
}

/// D'(x; σ) = D(x; σ) + α σ² ∇ₓ ln p(y | x; σ).
///
/// By D = x + σ² ∇ ln p(x; σ) this adds α times the guidance's gradient to the score (DJINN, equation 3). Both
/// evaluations of a Heun step go through here. The gradient is taken at the noisy tensor itself, so that the denoiser
/// is not differentiated through.
pub struct GuidedDenoiser<'a> {
    /// The denoiser that is guided.
    pub inner: &'a dyn Denoiser,
    /// The guidance, whose likelihood is raised.
    pub guidance: &'a dyn Guidance,
    /// Strength α: 1 samples from the conditional distribution if `guidance` is its exact likelihood; 0 changes
    /// nothing.
    pub strength: f64,
    /// When guidance acts and how far it may go.
    pub config: GuidanceConfig,
}

impl GuidedDenoiser<'_> {
    /// The shift α σ² ∇ₓ ln p of each row, gated and limited; `None` where it is zero in every row.
    fn shift(&self, x: &Tensor, sigma: &Tensor) -> Result<Option<Tensor>> {
        let factors: Vec<f64> = sigma_rows(sigma)?.into_iter().map(|sigma| self.factor(sigma)).collect();
        if factors.iter().all(|factor| *factor == 0.0) {
            return Ok(None);
        }
        let shift = log_potential_gradient(self.guidance, x, sigma)?.broadcast_mul(&rows_like(factors, x)?)?;
        limit_norm(&shift, self.config.max_shift).map(Some)
    }

    /// α σ² where guidance acts, otherwise 0.
    fn factor(&self, sigma: f64) -> f64 {
        if self.config.acts_at(sigma) { self.strength * sigma.powi(2) } else { 0.0 }
    }
}

impl Denoiser for GuidedDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let x0_hat = self.inner.denoise(x, sigma)?;
        match self.shift(x, sigma)? {
            Some(shift) => x0_hat + shift,
            None => Ok(x0_hat),
        }
    }
}

/// ∇ₓ of each row's log potential, with the shape of `x`, detached from its graph.
pub fn log_potential_gradient(guidance: &dyn Guidance, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
    let x = Var::from_tensor(&x.detach())?;
    // Rows are independent, so the gradient of the sum holds every row's own gradient.
    let total = guidance.log_potential(x.as_tensor(), sigma)?.sum_all()?;
    let gradients = total.backward()?;
    gradients.get(x.as_tensor()).map(Tensor::detach).ok_or_else(|| {
        Error::Msg(
            "the guidance's log potential does not depend on the noisy tensor; some operation cuts its gradient".into(),
        )
    })
}

/// Shortens each row of `x` (B, …) to a Euclidean norm of at most `max_norm`.
pub(super) fn limit_norm(x: &Tensor, max_norm: f64) -> Result<Tensor> {
    let norms = x.flatten_from(1)?.sqr()?.sum(1)?.sqrt()?;
    let scales = sigma_rows(&norms)?.into_iter().map(|norm| if norm > max_norm { max_norm / norm } else { 1.0 });
    x.broadcast_mul(&rows_like(scales.collect(), x)?)
}
