//! Sampling of consistency models: jump to the end, add noise again, jump again.

use super::{Observer, Step, denoise_at, steps};
use crate::diffusion::{Denoiser, NoiseSource};
use crate::settings::{self, Issue};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of multistep consistency sampling (Song et al. 2023, algorithm 1).
///
/// A consistency model says of a noisy state where the probability-flow equation leads to at σ = 0, in one evaluation. Further
/// evaluations start again from that answer with fresh noise of a lower level, and repair what the first one got wrong. Of an
/// ordinary denoiser, whose answer is the mean of all endings, it makes blurred samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistencyConfig {
    /// The noise level of the first evaluation. Left out: the denoiser's σ_max. Far above the data's scale hardly
    /// anything is decided, so a lower start is as good.
    pub sigma_max: Option<f64>,
    /// Noise levels of the evaluations after the first one, decreasing; none: a single evaluation.
    pub levels: Vec<f64>,
}

impl Default for ConsistencyConfig {
    fn default() -> Self {
        Self { sigma_max: None, levels: vec![0.8] }
    }
}

impl ConsistencyConfig {
    /// The noise levels from `sigma_start`, ending with 0; levels that are not below the start are left out.
    pub(super) fn schedule(&self, sigma_start: f64) -> Vec<f64> {
        let below = self.levels.iter().copied().filter(|level| *level < sigma_start);
        [sigma_start].into_iter().chain(below).chain([0.0]).collect()
    }

    /// Refuses levels that do not go down.
    pub(super) fn validate(&self) -> settings::Result {
        let all: Vec<f64> = self.sigma_max.iter().chain(&self.levels).copied().collect();
        let is_decreasing = all.windows(2).all(|pair| pair[0] > pair[1]);
        match is_decreasing && all.iter().all(|level| level.is_finite() && *level > 0.0) {
            true => Ok(()),
            false => Err(Issue::new(
                "levels",
                format_args!("and sigma_max are {all:?}, expected decreasing positive noise levels"),
            )),
        }
    }
}

/// See [`super::SamplerConfig::integrate`]. One evaluation a step; each step but the last one adds noise.
pub(super) fn integrate(
    sigmas: &[f64],
    denoiser: &dyn Denoiser,
    mut x: Tensor,
    noise: &mut NoiseSource,
    observer: &mut Observer<'_>,
) -> Result<Tensor> {
    let n_steps = sigmas.len().saturating_sub(1);
    for (step_idx, sigma, sigma_next) in steps(sigmas) {
        let x0_hat = denoise_at(denoiser, &x, sigma)?;
        x = match sigma_next {
            0.0 => x0_hat.clone(),
            _ => (&x0_hat + (noise.draw_like(&x)? * sigma_next)?)?,
        };
        observer(&Step { step_idx, n_steps, sigma, x: &x, x0_hat: &x0_hat });
    }
    Ok(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffusion::{Edm, rows_like};
    use crate::diffusion::{SamplerConfig, sigma_rows};
    use crate::seed::Seed;
    use candle_core::{DType, Device};

    /// Data N(mean, std²): the probability-flow equation keeps (x - mean) / √(std² + σ²), so this is its exact solution.
    struct GaussianEnding {
        mean: f64,
        std: f64,
    }

    impl Denoiser for GaussianEnding {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            let shrink = sigma_rows(sigma)?.into_iter().map(|s| self.std / s.hypot(self.std)).collect();
            (x - self.mean)?.broadcast_mul(&rows_like(shrink, x)?)? + self.mean
        }
    }

    #[test]
    fn an_exact_consistency_model_is_sampled_exactly_by_any_number_of_evaluations() {
        let (ending, edm) = (GaussianEnding { mean: 1.5, std: 0.4 }, Edm::default());
        for levels in [vec![], vec![0.8], vec![5.0, 0.8, 0.1]] {
            let n_evaluations = levels.len() + 1;
            let sampler = SamplerConfig::Consistency(ConsistencyConfig { levels, ..ConsistencyConfig::default() });
            assert_eq!((sampler.n_steps(), sampler.n_evaluations()), (n_evaluations, n_evaluations));
            let mut noise = NoiseSource::new((0..20_000).map(Seed).collect());
            let like = Tensor::zeros(1, DType::F32, &Device::Cpu).unwrap();
            let samples = sampler.sample(&edm, &ending, &[1], &like, &mut noise, &mut |_| ()).unwrap();
            let values: Vec<f64> =
                samples.flatten_all().unwrap().to_vec1::<f32>().unwrap().into_iter().map(f64::from).collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let std = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt();
            // Standard errors are 0.4 / √20000 = 0.003 and 0.002.
            assert!((mean - 1.5).abs() < 0.012 && (std - 0.4).abs() < 0.008, "{n_evaluations}: {mean} {std}");
        }
    }

    #[test]
    fn schedules_begin_where_editing_begins() {
        let config = ConsistencyConfig { levels: vec![3.0, 0.8], ..ConsistencyConfig::default() };
        assert_eq!(config.schedule(80.0), [80.0, 3.0, 0.8, 0.0]);
        assert_eq!(config.schedule(1.6), [1.6, 0.8, 0.0]);
        assert!(config.validate().is_ok());
        for levels in [vec![0.8, 3.0], vec![1.0, 1.0], vec![0.0], vec![f64::NAN]] {
            assert!(ConsistencyConfig { levels, ..ConsistencyConfig::default() }.validate().is_err());
        }
        // From a level of its own.
        let lower = ConsistencyConfig { sigma_max: Some(24.0), levels: vec![0.8] };
        assert!(lower.validate().is_ok());
        assert!(ConsistencyConfig { sigma_max: Some(0.5), ..lower.clone() }.validate().is_err());
        let (sampler, edm) = (SamplerConfig::Consistency(lower), Edm::default());
        assert_eq!(sampler.schedule(&edm, sampler.sigma_start(&edm)), [24.0, 0.8, 0.0]);
        assert_eq!((sampler.name().as_str(), sampler.n_evaluations()), ("consistency-0.8-from-24", 2));
    }
}
