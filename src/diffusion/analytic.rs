//! Perfect denoisers: Gaussian mixtures, whose denoiser and score are known in closed form.
//!
//! Samplers and guidance are checked against it: a wrong sign or a wrong order shows within milliseconds.

use super::{Denoiser, rows_like, sigma_rows};
use candle_core::{DType, Device, Result, Tensor};

/// A mixture of Gaussians with diagonal covariances: the data distribution of [`MixtureDenoiser`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GaussianMixture {
    /// The components; weights need not be normalized.
    pub(crate) components: Vec<Component>,
}

/// One component of a mixture.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Component {
    /// Relative weight, positive.
    pub(crate) weight: f64,
    /// Mean, one entry a dimension.
    pub(crate) mean: Vec<f64>,
    /// Variance, one entry a dimension.
    pub(crate) variance: Vec<f64>,
}

impl GaussianMixture {
    pub(crate) fn n_dims(&self) -> usize {
        self.components.first().map_or(0, |component| component.mean.len())
    }

    pub(crate) fn mean(&self) -> Vec<f64> {
        (0..self.n_dims()).map(|i| self.expect(|component| component.mean[i])).collect()
    }

    /// Covariance of the distribution, row by row.
    pub(crate) fn covariance(&self) -> Vec<Vec<f64>> {
        let mean = self.mean();
        let entry = |i: usize, j: usize| {
            self.expect(|component| {
                let within = if i == j { component.variance[i] } else { 0.0 };
                within + (component.mean[i] - mean[i]) * (component.mean[j] - mean[j])
            })
        };
        (0..self.n_dims()).map(|i| (0..self.n_dims()).map(|j| entry(i, j)).collect()).collect()
    }

    fn expect(&self, value: impl Fn(&Component) -> f64) -> f64 {
        let total: f64 = self.components.iter().map(|component| component.weight).sum();
        self.components.iter().map(|component| component.weight / total * value(component)).sum()
    }
}

/// The ideal denoiser of a mixture: D(x; σ) = E[x₀ | x₀ + σ n = x]. Differentiable in `x`.
#[derive(Debug, Clone)]
pub(crate) struct MixtureDenoiser {
    /// ln of the weights, (1, K).
    log_weight: Tensor,
    /// (1, K, N).
    mean: Tensor,
    /// (1, K, N).
    variance: Tensor,
}

/// The posterior of a mixture given a noisy point: again a mixture, one for each batch row.
#[derive(Debug, Clone)]
pub(crate) struct Posterior {
    /// ln of the probability that the point is from each component, (B, K).
    pub(crate) log_responsibility: Tensor,
    /// Posterior mean within each component, (B, K, N).
    pub(crate) mean: Tensor,
    /// Posterior variance within each component, (B, K, N).
    pub(crate) variance: Tensor,
}

impl MixtureDenoiser {
    /// The denoiser of `mixture`, for tensors of this dtype.
    pub(crate) fn new(mixture: &GaussianMixture, dtype: DType) -> Result<Self> {
        let (n_components, n_dims) = (mixture.components.len(), mixture.n_dims());
        let collect = |values: Vec<f64>, dims: &[usize]| Tensor::from_vec(values, dims, &Device::Cpu)?.to_dtype(dtype);
        let components = &mixture.components;
        Ok(Self {
            log_weight: collect(components.iter().map(|c| c.weight.ln()).collect(), &[1, n_components])?,
            mean: collect(components.iter().flat_map(|c| c.mean.clone()).collect(), &[1, n_components, n_dims])?,
            variance: collect(
                components.iter().flat_map(|c| c.variance.clone()).collect(),
                &[1, n_components, n_dims],
            )?,
        })
    }

    /// The posterior of the clean point given `x` (B, N) at noise `sigma` (B).
    pub(crate) fn posterior(&self, x: &Tensor, sigma: &Tensor) -> Result<Posterior> {
        let x = x.unsqueeze(1)?;
        let noise = rows_like(sigma_rows(sigma)?.into_iter().map(|s| s * s).collect(), &x)?;
        let total = self.variance.broadcast_add(&noise)?;
        let mahalanobis = x.broadcast_sub(&self.mean)?.sqr()?.div(&total)?;
        let log_density = ((mahalanobis + total.log()?)?.sum(2)? * -0.5)?;
        let log_joint = log_density.broadcast_add(&self.log_weight)?;
        let log_evidence = log_joint.log_sum_exp(1)?.unsqueeze(1)?;
        // Precision-weighted mean of the component's mean and the point, written without a division by σ².
        let mean = (x.broadcast_mul(&self.variance)? + self.mean.broadcast_mul(&noise)?)?.div(&total)?;
        let variance = self.variance.broadcast_mul(&noise)?.div(&total)?;
        Ok(Posterior { log_responsibility: log_joint.broadcast_sub(&log_evidence)?, mean, variance })
    }

    /// The score ∇ₓ log p(x; σ) = (D(x; σ) - x) / σ² (EDM, equation 3).
    pub(crate) fn score(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let precision = rows_like(sigma_rows(sigma)?.into_iter().map(|s| s.powi(-2)).collect(), x)?;
        (self.denoise(x, sigma)? - x)?.broadcast_mul(&precision)
    }
}

impl Denoiser for MixtureDenoiser {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let posterior = self.posterior(&x.flatten_from(1)?, sigma)?;
        let responsibility = posterior.log_responsibility.exp()?.unsqueeze(2)?;
        posterior.mean.broadcast_mul(&responsibility)?.sum(1)?.reshape(x.shape())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_bumps() -> GaussianMixture {
        GaussianMixture {
            components: vec![
                Component { weight: 1.0, mean: vec![-1.0, 0.5], variance: vec![0.04, 0.09] },
                Component { weight: 3.0, mean: vec![1.0, 0.0], variance: vec![0.25, 0.01] },
            ],
        }
    }

    #[test]
    fn moments_follow_the_law_of_total_covariance() {
        let mixture = two_bumps();
        // Weights 1/4 and 3/4: mean = (0.5, 0.125).
        assert!((mixture.mean()[0] - 0.5).abs() < 1e-12 && (mixture.mean()[1] - 0.125).abs() < 1e-12);
        let covariance = mixture.covariance();
        // Between the means: (2, -0.5) and w(1 - w) = 3/16.
        assert!((covariance[0][0] - (0.25 * 0.04 + 0.75 * 0.25 + 3.0 / 16.0 * 4.0)).abs() < 1e-12);
        assert!((covariance[0][1] - -(3.0 / 16.0)).abs() < 1e-12);
    }

    #[test]
    fn a_single_gaussian_is_denoised_by_shrinkage() {
        // D = (v x + σ² μ) / (v + σ²) = (1 · 3 + 4 · 1) / 5.
        let mixture =
            GaussianMixture { components: vec![Component { weight: 2.0, mean: vec![1.0], variance: vec![1.0] }] };
        let denoiser = MixtureDenoiser::new(&mixture, DType::F64).unwrap();
        let x = Tensor::new(&[[3.0f64]], &Device::Cpu).unwrap();
        let sigma = Tensor::new(&[2.0f64], &Device::Cpu).unwrap();
        let x0_hat = denoiser.denoise(&x, &sigma).unwrap().to_vec2::<f64>().unwrap()[0][0];
        assert!((x0_hat - 1.4).abs() < 1e-12);
    }

    #[test]
    fn the_score_is_the_gradient_of_the_log_density() {
        let mixture = two_bumps();
        let sigma = 0.6;
        let log_density = |x: [f64; 2]| {
            let terms = mixture.components.iter().map(|c| {
                let exponent: f64 = (0..2).map(|i| (x[i] - c.mean[i]).powi(2) / (c.variance[i] + sigma * sigma)).sum();
                let volume: f64 = (0..2).map(|i| (c.variance[i] + sigma * sigma).sqrt()).product();
                c.weight / volume * (-0.5 * exponent).exp()
            });
            terms.sum::<f64>().ln()
        };
        let denoiser = MixtureDenoiser::new(&mixture, DType::F64).unwrap();
        let at = [0.2, 0.3];
        let score = denoiser
            .score(&Tensor::new(&[at], &Device::Cpu).unwrap(), &Tensor::new(&[sigma], &Device::Cpu).unwrap())
            .unwrap()
            .to_vec2::<f64>()
            .unwrap();
        let h = 1e-5;
        for i in 0..2 {
            let (mut up, mut down) = (at, at);
            up[i] += h;
            down[i] -= h;
            let difference = (log_density(up) - log_density(down)) / (2.0 * h);
            assert!((score[0][i] - difference).abs() < 1e-7, "{} against {difference}", score[0][i]);
        }
    }
}
