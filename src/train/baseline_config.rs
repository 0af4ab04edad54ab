//! The `[train.baseline]` section: training of Scene Transformer, with which the denoiser is compared.

use super::section::{SceneTraining, check_tasks};
use super::{Error, OwnScenes, Preset, SceneChoice};
use crate::model::SceneTransformerConfig;
use crate::settings;
use crate::tensor::{StateParametrization, TaskWeights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How to train Scene Transformer, the paper's baseline. All else is the preset's: except for the network, the
/// denoiser's.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BaselineTrainingConfig {
    /// Size of the network: `tiny`, `small` or `paper`.
    pub preset: Preset,
    /// How often each observation task is drawn.
    pub tasks: TaskWeights,
    /// Optimizer steps in all.
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub steps: Option<u64>,
    /// Scenes per step.
    #[schemars(range(min = 1, max = 16_384))]
    pub batch_size: Option<usize>,
    /// A trained checkpoint to use instead of training.
    pub checkpoint: Option<std::path::PathBuf>,
}

/// The resolved section, with every value decided.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BaselineTraining {
    /// The network.
    pub network: SceneTransformerConfig,
    /// The output of the network.
    pub parametrization: StateParametrization,
    /// Maximum number of agents per scene.
    pub max_agents: usize,
    /// Maximum number of lane polylines per scene.
    pub max_lanes: usize,
    /// Tasks, batches, evaluations and the schedule.
    #[serde(flatten)]
    pub common: SceneTraining,
}

impl BaselineTrainingConfig {
    /// Its place in a pipeline file.
    pub const SECTION: &'static str = "train.baseline";

    /// The scenes it trains on.
    pub const fn scene_choice(own: OwnScenes<'_>) -> SceneChoice<'_> {
        SceneChoice { section: Self::SECTION, own, own_weight: 1.0, data: &[] }
    }

    /// The preset with the section's settings over it.
    pub fn resolve(&self) -> Result<BaselineTraining, Error> {
        settings::check_ranges(self).map_err(|issue| Error::Config(issue.within(Self::SECTION).to_string()))?;
        check_tasks(Self::SECTION, &self.tasks)?;
        let base = self.preset.settings();
        let mut common = base.common;
        common.tasks = self.tasks;
        common.batch_size = self.batch_size.unwrap_or(common.batch_size);
        common.fit.steps = self.steps.unwrap_or(common.fit.steps);
        Ok(BaselineTraining {
            network: network(self.preset),
            parametrization: base.parametrization,
            max_agents: base.max_agents,
            max_lanes: base.max_lanes,
            common,
        })
    }
}

/// The network of a preset: about as large as the preset's denoiser.
fn network(preset: Preset) -> SceneTransformerConfig {
    let smaller = |encoder: &str, decoder: &str, width, n_heads, encoding| SceneTransformerConfig {
        encoder: encoder.to_owned(),
        decoder: decoder.to_owned(),
        width,
        n_heads,
        feed_forward: 4 * width,
        encoding,
        ..SceneTransformerConfig::default()
    };
    match preset {
        Preset::Tiny => smaller("TAM", "TA", 32, 2, 16),
        Preset::Small | Preset::PaperSmall => smaller("TATM TA", "TA", 96, 4, 32),
        Preset::Large | Preset::Paper => SceneTransformerConfig::default(),
    }
}
