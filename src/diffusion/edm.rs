//! Wraps a network into a denoiser, and weights each noise level in its loss (EDM, table 1).

use super::karras_schedule;
use serde::{Deserialize, Serialize};

/// σ_data: standard deviation of the diffused data; the normalizer scales every diffused feature to it.
pub const SIGMA_DATA: f64 = 0.5;

/// EDM's constants and the functions of the noise level that follow from them (DJINN, appendix A, table "Scaling
/// functions"): D(x; σ) = c_skip(σ) x + c_out(σ) F(c_in(σ) x, c_noise(σ)).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Edm {
    /// The smallest positive noise level of a sampling schedule.
    pub sigma_min: f64,
    /// The noise level at which sampling begins.
    pub sigma_max: f64,
    /// Curvature of the schedule: larger values spend more steps at low noise.
    pub rho: f64,
}

impl Default for Edm {
    fn default() -> Self {
        Self { sigma_min: 0.002, sigma_max: 80.0, rho: 7.0 }
    }
}

impl Edm {
    /// Weight of the noisy input in the clean estimate: σ_data² / (σ² + σ_data²).
    pub fn c_skip(&self, sigma: f64) -> f64 {
        SIGMA_DATA.powi(2) / total_variance(sigma)
    }

    /// Scale of the network's output: σ σ_data / √(σ² + σ_data²).
    pub fn c_out(&self, sigma: f64) -> f64 {
        sigma * SIGMA_DATA / total_variance(sigma).sqrt()
    }

    /// Scale of the network's input, which brings noisy data to unit variance: 1 / √(σ² + σ_data²).
    pub fn c_in(&self, sigma: f64) -> f64 {
        total_variance(sigma).sqrt().recip()
    }

    /// The noise level as the network sees it: ln(σ) / 4.
    pub fn c_noise(&self, sigma: f64) -> f64 {
        sigma.ln() / 4.0
    }

    /// Weight λ(σ) of the squared error at this noise level: (σ² + σ_data²) / (σ σ_data)², which gives every noise
    /// level equal weight at initialization. The DJINN paper prints its loss without a weight.
    pub fn loss_weight(&self, sigma: f64) -> f64 {
        total_variance(sigma) / (sigma * SIGMA_DATA).powi(2)
    }

    /// The noise levels of `n_steps` sampling steps from `sigma_max`: `n_steps + 1` values, the last of them 0.
    pub fn schedule(&self, n_steps: usize) -> Vec<f64> {
        self.schedule_from(self.sigma_max, n_steps)
    }

    /// The noise levels of `n_steps` sampling steps from `sigma_start`, on a grid of its own. Editing starts below
    /// `sigma_max`: truncating the full grid there would waste most of its steps.
    pub fn schedule_from(&self, sigma_start: f64, n_steps: usize) -> Vec<f64> {
        karras_schedule(self.sigma_min, sigma_start, self.rho, n_steps)
    }
}

fn total_variance(sigma: f64) -> f64 {
    sigma.powi(2) + SIGMA_DATA.powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_at_sigma_data_are_the_hand_computed_ones() {
        // At σ = σ_data = 0.5 the total variance is 1/2.
        let edm = Edm::default();
        assert!((edm.c_skip(0.5) - 0.5).abs() < 1e-15);
        assert!((edm.c_out(0.5) - 0.25 * 2f64.sqrt()).abs() < 1e-15);
        assert!((edm.c_in(0.5) - 2f64.sqrt()).abs() < 1e-15);
        assert!((edm.c_noise(0.5) + 2f64.ln() / 4.0).abs() < 1e-15);
        assert!((edm.loss_weight(0.5) - 8.0).abs() < 1e-12);
    }

    #[test]
    fn the_loss_weight_undoes_the_output_scale() {
        // EDM chooses λ = 1 / c_out² (its equation 144), so that the network's own error counts equally everywhere.
        let edm = Edm::default();
        for sigma in [0.002, 0.1, 1.0, 80.0] {
            let product = edm.loss_weight(sigma) * edm.c_out(sigma).powi(2);
            assert!((product - 1.0).abs() < 1e-12, "at σ = {sigma}: {product}");
        }
    }

    #[test]
    fn c_noise_spans_the_range_the_paper_encodes() {
        let edm = Edm::default();
        assert!((edm.c_noise(edm.sigma_min) + 1.5537).abs() < 1e-4);
        assert!((edm.c_noise(edm.sigma_max) - 1.0955).abs() < 1e-4);
    }
}
