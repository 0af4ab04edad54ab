//! The settings of the training loop.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The learning-rate schedule after warm-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum LearningRateDecay {
    /// Constant (the paper's).
    Constant,
    /// Half a cosine down to zero at the last step: better for short training.
    #[default]
    Cosine,
}

/// Settings of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitConfig {
    /// Optimizer steps in all.
    pub steps: u64,
    /// Learning rate after warm-up (the paper's 3e-4).
    pub learning_rate: f64,
    /// Steps over which the learning rate rises from 0.
    pub warmup_steps: u64,
    /// The schedule afterwards.
    pub decay: LearningRateDecay,
    /// Gradients are scaled down to this global norm (the paper's 5).
    pub clip_norm: f64,
    /// Decay of the moving average of the weights; 0 for none.
    pub ema_decay: f64,
    /// Steps between evaluations.
    pub evaluate_every: u64,
    /// Steps between saved states.
    pub save_every: u64,
    /// Steps between lines of the statistics with mean losses.
    pub log_every: u64,
    /// Whether training ends with the weights of its best evaluation instead of the last ones.
    pub keeps_best: bool,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self {
            steps: 8_000,
            learning_rate: 1e-3,
            warmup_steps: 200,
            decay: LearningRateDecay::Cosine,
            clip_norm: 5.0,
            ema_decay: 0.99,
            evaluate_every: 500,
            save_every: 250,
            log_every: 20,
            keeps_best: false,
        }
    }
}

impl FitConfig {
    /// The learning rate of `step`, from 0.
    pub fn learning_rate_at(&self, step: u64) -> f64 {
        let warm = ((step + 1) as f64 / self.warmup_steps.max(1) as f64).min(1.0);
        let share = match self.decay {
            LearningRateDecay::Constant => 1.0,
            LearningRateDecay::Cosine => {
                let done = step as f64 / self.steps.max(1) as f64;
                0.5 * (1.0 + (std::f64::consts::PI * done).cos())
            }
        };
        self.learning_rate * warm * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learning_rate_warms_up_and_decays() {
        let config = FitConfig { learning_rate: 0.05, warmup_steps: 4, steps: 100, ..FitConfig::default() };
        assert!((config.learning_rate_at(0) - 0.05 * 0.25).abs() < 1e-12);
        assert!(config.learning_rate_at(50) < 0.0251 && config.learning_rate_at(50) > 0.0249);
        assert!(config.learning_rate_at(99) < 1e-4);
    }
}
