//! Which noise levels is a network trained at?

use crate::seed::SeededRng;
use serde::{Deserialize, Serialize};

/// The training distribution p_train of noise levels: ln σ is normal (EDM, table 1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NoiseDistribution {
    /// Mean of ln σ.
    pub p_mean: f64,
    /// Standard deviation (not variance) of ln σ.
    pub p_std: f64,
}

impl Default for NoiseDistribution {
    fn default() -> Self {
        Self { p_mean: -1.2, p_std: 1.2 }
    }
}

impl NoiseDistribution {
    /// Draws a noise level.
    pub fn draw(&self, rng: &mut SeededRng) -> f64 {
        (self.p_mean + self.p_std * rng.normal()).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    #[test]
    fn the_logarithm_has_the_configured_moments() {
        let mut rng = Seed(3).rng();
        let distribution = NoiseDistribution::default();
        let logs: Vec<f64> = (0..20_000).map(|_| distribution.draw(&mut rng).ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let std = (logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / logs.len() as f64).sqrt();
        assert!((mean + 1.2).abs() < 0.03 && (std - 1.2).abs() < 0.03, "mean {mean}, std {std}");
    }
}
