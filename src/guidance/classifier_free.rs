//! Classifier-free guidance: lean toward target states that are not known exactly (paper, section 5.1).

use crate::diffusion::Denoiser;
use candle_core::{Result, Tensor};

/// The relation of the states of the two branches: both describe the same noisy scene, each in its own coordinates.
pub trait BranchChange {
    /// The state of the conditional branch for the state `x` (B, …) of the unconditional one. Entries that only the
    /// latter has are left out (zero).
    fn to_conditional(&self, x: &Tensor) -> Result<Tensor>;
    /// The clean estimate of the unconditional branch for that of the conditional one, `x0_hat` (B, …): entries that
    /// are observed in the conditional branch have their clean values.
    fn to_unconditional(&self, x0_hat: &Tensor) -> Result<Tensor>;
}

/// D(x; σ) = D(x; σ | `x_obs`) + λ (D(x; σ | `x_obs`, `x_cond`) - D(x; σ | `x_obs`)).
///
/// By D = x + σ² ∇ ln p this is the paper's mixture of scores. The two branches observe different states: `x_cond` is
/// latent in the first and observed in the second, where its score is not defined. So estimates are mixed rather than
/// scores: in the conditional branch the estimate of `x_cond` is its clean value, while `x_cond` keeps diffusing in the
/// state. At λ = 1 this samples exactly from the conditional distribution, as if `x_cond` had been observed; at λ = 0
/// from the unconditional one.
pub struct ClassifierFreeDenoiser<'a> {
    /// The denoiser that sees only the precise observations.
    pub unconditional: &'a dyn Denoiser,
    /// The denoiser that also sees the target states.
    pub conditional: &'a dyn Denoiser,
    /// Maps the state of one branch to that of the other.
    pub change: &'a dyn BranchChange,
    /// The weight λ.
    pub weight: f64,
}

impl Denoiser for ClassifierFreeDenoiser<'_> {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        if self.weight == 0.0 {
            return self.unconditional.denoise(x, sigma);
        }
        let x0_hat = self.conditional.denoise(&self.change.to_conditional(x)?, sigma)?;
        let conditional = self.change.to_unconditional(&x0_hat)?;
        if self.weight == 1.0 {
            return Ok(conditional);
        }
        let unconditional = self.unconditional.denoise(x, sigma)?;
        &unconditional + ((conditional - &unconditional)? * self.weight)?
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffusion::{Edm, NoiseSource, SamplerConfig, sigma_rows};
    use crate::seed::Seed;
    use candle_core::{DType, Device};

    // (a, b) is normal with this mean and covariance; in the conditional branch b is known to be B0.
    const MEAN: [f64; 2] = [0.2, -0.1];
    const COVARIANCE: [[f64; 2]; 2] = [[0.25, 0.15], [0.15, 0.2]];
    const B0: f64 = 0.5;
    /// The origin of the conditional branch: a reference that moved because b is known.
    const ORIGIN: f64 = 0.7;

    fn rows(x: &Tensor, sigma: &Tensor, row: impl Fn(&[f64], f64) -> [f64; 2]) -> Result<Tensor> {
        let values = x.to_vec2::<f64>()?;
        let rows: Vec<Vec<f64>> = values.iter().zip(sigma_rows(sigma)?).map(|(x, s)| row(x, s).to_vec()).collect();
        Tensor::new(rows, &Device::Cpu)
    }

    /// E[x₀ | x] = μ + Σ (Σ + σ²)⁻¹ (x - μ).
    struct Joint;
    impl Denoiser for Joint {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            rows(x, sigma, |x, s| {
                let [[aa, ab], [_, bb]] = COVARIANCE;
                let (p, q) = (aa + s * s, bb + s * s);
                let determinant = p * q - ab * ab;
                let (u, v) = (x[0] - MEAN[0], x[1] - MEAN[1]);
                let (u, v) = ((q * u - ab * v) / determinant, (p * v - ab * u) / determinant);
                [MEAN[0] + aa * u + ab * v, MEAN[1] + ab * u + bb * v]
            })
        }
    }

    /// a given b = B0: mean 0.2 + 0.75 · 0.6, variance 0.25 - 0.15² / 0.2; in coordinates from `ORIGIN`.
    struct GivenB;
    const GIVEN_MEAN: f64 = 0.65;
    const GIVEN_VARIANCE: f64 = 0.1375;
    impl Denoiser for GivenB {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            rows(x, sigma, |x, s| {
                assert_eq!(x[1], 0.0, "what is observed is no part of the state");
                let mean = GIVEN_MEAN - ORIGIN;
                [mean + GIVEN_VARIANCE / (GIVEN_VARIANCE + s * s) * (x[0] - mean), 0.0]
            })
        }
    }

    struct Moved;
    impl BranchChange for Moved {
        fn to_conditional(&self, x: &Tensor) -> Result<Tensor> {
            rows(x, &x.get_on_dim(1, 0)?, |x, _| [x[0] - ORIGIN, 0.0])
        }
        fn to_unconditional(&self, x0_hat: &Tensor) -> Result<Tensor> {
            rows(x0_hat, &x0_hat.get_on_dim(1, 0)?, |x, _| [x[0] + ORIGIN, B0])
        }
    }

    /// Mean of a and of b, variance of a and of b.
    fn moments(weight: f64) -> [f64; 4] {
        let n_rows = 4000;
        let mut noise = NoiseSource::new((0..n_rows).map(|row| Seed(23).derive("row", &[row])).collect());
        let like = Tensor::zeros(1, DType::F64, &Device::Cpu).unwrap();
        let sampler = SamplerConfig::heun(30);
        let denoiser = ClassifierFreeDenoiser { unconditional: &Joint, conditional: &GivenB, change: &Moved, weight };
        let x = sampler.sample(&Edm::default(), &denoiser, &[2], &like, &mut noise, &mut |_| {}).unwrap();
        let x = x.to_vec2::<f64>().unwrap();
        let mean = |of: &dyn Fn(&[f64]) -> f64| x.iter().map(|row| of(row)).sum::<f64>() / n_rows as f64;
        let [a, b] = [0, 1].map(|i| mean(&|row| row[i]));
        [a, b, mean(&|row| (row[0] - a).powi(2)), mean(&|row| (row[1] - b).powi(2))]
    }

    #[test]
    fn weight_zero_is_unconditional_and_weight_one_conditional() {
        let expect = |found: [f64; 4], expected: [f64; 4]| {
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 0.025, "{found:?}, expected {expected:?}");
            }
        };
        expect(moments(0.0), [0.2, -0.1, 0.25, 0.2]);
        expect(moments(1.0), [GIVEN_MEAN, B0, GIVEN_VARIANCE, 0.0]);
    }

    #[test]
    fn more_weight_draws_nearer_to_what_is_wanted() {
        let distance = |weight: f64| (moments(weight)[1] - B0).abs() + moments(weight)[3].sqrt();
        assert!(distance(0.0) > 1.5 * distance(0.4) && distance(0.4) > 1.5 * distance(0.8));
    }

    #[test]
    fn estimates_are_mixed_linearly() {
        let x = Tensor::new(&[[0.3f64, -0.4]], &Device::Cpu).unwrap();
        let sigma = Tensor::new(&[0.6f64], &Device::Cpu).unwrap();
        let at = |weight: f64| {
            let denoiser =
                ClassifierFreeDenoiser { unconditional: &Joint, conditional: &GivenB, change: &Moved, weight };
            denoiser.denoise(&x, &sigma).unwrap().to_vec2::<f64>().unwrap().remove(0)
        };
        let (none, one, more) = (at(0.0), at(1.0), at(2.5));
        for i in 0..2 {
            assert!((more[i] - (none[i] + 2.5 * (one[i] - none[i]))).abs() < 1e-12);
        }
        assert_eq!(one[1], B0);
    }
}
