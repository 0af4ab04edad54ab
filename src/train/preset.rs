//! The presets of `[train.denoiser]`: from a test's network to the paper's.

use super::section::SceneTraining;
use super::{Balance, DenoiserTraining, FitConfig, LearningRateDecay, Scales};
use crate::diffusion::{Edm, NoiseDistribution};
use crate::model::{GeometryConfig, NetworkConfig};
use crate::tensor::StateParametrization;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A size of network with settings that suit it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The geometric network with 4 layers, 32 wide: trains in a minute, for tests and first trials.
    Tiny,
    /// The geometric network with 7 layers, 96 wide: for a laptop.
    #[default]
    Small,
    /// The geometric network with 13 layers, 256 wide: for a GPU.
    Large,
    /// The paper's network with 7 layers, 96 wide, motion parametrization: the reference for `small`.
    PaperSmall,
    /// The paper's 15 layers, 256 wide, with its parametrization, batch size and learning rate.
    Paper,
}

/// A row of the table of sizes: the network's, and the limits on scenes.
struct Size {
    layers: &'static str,
    width: usize,
    n_heads: usize,
    max_agents: usize,
    max_lanes: usize,
}

/// A row of the table of schedules: scenes a step, learning rate and its warm-up, decay of the moving average, steps
/// between evaluations and the held-out scenes of each.
struct Schedule {
    steps: u64,
    batch: usize,
    rate: f64,
    warmup: u64,
    ema: f64,
    every: u64,
    n_eval: usize,
}

impl Preset {
    #[rustfmt::skip]
    const fn size(self) -> Size {
        match self {
            Self::Tiny =>
                Size { layers: "TMAT",               width:  32, n_heads: 2, max_agents: 12, max_lanes:  32 },
            Self::Small =>
                Size { layers: "TMATMAT",            width:  96, n_heads: 4, max_agents: 20, max_lanes:  48 },
            Self::Large =>
                Size { layers: "TMATMATMATMAT",      width: 256, n_heads: 8, max_agents: 64, max_lanes: 256 },
            Self::PaperSmall =>
                Size { layers: "TATM TAT",           width:  96, n_heads: 4, max_agents: 16, max_lanes:  48 },
            Self::Paper =>
                Size { layers: "TATM TATM TATM TAT", width: 256, n_heads: 4, max_agents: 64, max_lanes: 256 },
        }
    }

    #[rustfmt::skip]
    const fn schedule(self) -> Schedule {
        type S = Schedule;
        match self {
            Self::Tiny =>
                S { steps:     400, batch:  8, rate: 2e-3,   warmup:    20, ema: 0.99,  every:   200, n_eval:  16 },
            Self::Small =>
                S { steps:   8_000, batch: 16, rate: 1.5e-3, warmup:   200, ema: 0.995, every:   500, n_eval:  48 },
            Self::Large =>
                S { steps: 200_000, batch: 64, rate: 5e-4,   warmup: 1_000, ema: 0.999, every: 5_000, n_eval: 200 },
            Self::PaperSmall =>
                S { steps:   8_000, batch:  8, rate: 1e-3,   warmup:   200, ema: 0.99,  every:   500, n_eval:  48 },
            Self::Paper =>
                S { steps: 200_000, batch: 32, rate: 3e-4,   warmup:   133, ema: 0.0,   every: 5_000, n_eval: 200 },
        }
    }

    fn common(self) -> SceneTraining {
        let Schedule { steps, batch, rate, warmup, ema, every, n_eval } = self.schedule();
        let fit = FitConfig {
            steps,
            learning_rate: rate,
            warmup_steps: warmup,
            ema_decay: ema,
            evaluate_every: every,
            ..FitConfig::default()
        };
        SceneTraining { batch_size: batch, n_eval_scenes: n_eval, fit, ..SceneTraining::default() }
    }

    /// Everything that it decides for the denoiser.
    pub(super) fn settings(self) -> DenoiserTraining {
        let Size { layers, width, n_heads, max_agents, max_lanes } = self.size();
        let common = self.common();
        let layers = layers.to_owned();
        let network = NetworkConfig { layers, width, n_heads, feed_forward: 4 * width, ..NetworkConfig::default() };
        let geometry = GeometryConfig { relation_width: width / 2, ..GeometryConfig::default() };
        let geometric = DenoiserTraining {
            network: NetworkConfig { geometry: Some(geometry), ..network.clone() },
            parametrization: StateParametrization::Motion,
            edm: Edm::default(),
            // Whole paths are decided at higher noise levels than their details.
            noise: NoiseDistribution { p_mean: -0.3, p_std: 1.5 },
            path_loss: 0.1,
            objectives: Vec::new(),
            objectives_below_sigma: 0.3,
            balance: Balance::Places,
            scales: Scales::default(),
            max_agents,
            max_lanes,
            within: None,
            common,
        };
        match self {
            Self::Tiny | Self::Small | Self::Large => geometric,
            // Diffused motion is of unit size: encodings with periods below 1 would show the network noise and little
            // else.
            Self::PaperSmall => DenoiserTraining {
                network: NetworkConfig { encoding: 32, latent_periods: [1.0, 100.0], path_input: true, ..network },
                noise: NoiseDistribution { p_mean: -0.5, p_std: 1.4 },
                balance: Balance::Scenes,
                ..geometric
            },
            Self::Paper => {
                let mut paper = DenoiserTraining {
                    network,
                    parametrization: StateParametrization::Scene,
                    noise: NoiseDistribution::default(),
                    path_loss: 0.0,
                    balance: Balance::Scenes,
                    ..geometric
                };
                paper.common.fit.decay = LearningRateDecay::Constant;
                paper
            }
        }
    }
}
