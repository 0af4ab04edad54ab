//! The `[train.baseline]` section: training of Scene Transformer, with which the denoiser is compared.

use super::section::{SceneTraining, scene_training_section};
use super::{Error, FitConfig, Preset};
use crate::model::SceneTransformerConfig;
use crate::tensor::{StateParametrization, TaskWeights};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

scene_training_section! {
    /// How to train Scene Transformer, the paper's baseline. Settings left out are the preset's; except for the
    /// network, the denoiser's.
    #[derive(Default)]
    pub struct BaselineTrainingConfig in "train.baseline", each Option {
        /// Size of the network: `tiny`, `small` or `paper`.
        pub preset: Preset,
        /// The network, to override the preset's.
        pub network: Option<SceneTransformerConfig>,
        /// The output of the network: `scene` or `motion`.
        pub state_parametrization: Option<StateParametrization>,
        /// Maximum number of agents per scene, nearest to the ego agent.
        #[schemars(range(min = 1, max = 10_000))]
        pub max_agents: Option<usize>,
        /// Maximum number of lane polylines per scene, nearest to the ego agent.
        #[schemars(range(max = 100_000))]
        pub max_lanes: Option<usize>,
        /// Dimensions of a predicted state: 3 (x, y, heading) or 2 (x, y). Left out: 2 for Argoverse 1, else 3.
        #[schemars(range(min = 2, max = 3))]
        pub state_dim: Option<usize>,
    }
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
    /// The preset with the section's settings over it.
    ///
    /// # Errors
    /// When a value cannot work, naming it.
    pub fn resolve(&self) -> Result<BaselineTraining, Error> {
        let base = self.preset.settings();
        self.check_ranges()?;
        let network = self.network.clone().unwrap_or_else(|| network(self.preset));
        network.validate().map_err(|issue| Self::refusal(issue.within("network")))?;
        Ok(BaselineTraining {
            network,
            parametrization: self.state_parametrization.unwrap_or(base.parametrization),
            max_agents: self.max_agents.unwrap_or(base.max_agents),
            max_lanes: self.max_lanes.unwrap_or(base.max_lanes),
            common: self.scene_training(&base.common)?,
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
