//! A generated scenario: a scene whose future was sampled, and everything needed to sample it again.

use super::{GuidanceLevel, ObservationMask, Roles, Scene, SceneId};
use serde::{Deserialize, Serialize};

/// The guidance a scenario was sampled with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuidanceTag {
    /// Name of the guidance, such as `none`, `classifier:cut_in` or `classifier_free`; parts that act together are joined by `+`.
    /// Of the baseline, which cannot be guided, `scene_transformer`.
    pub kind: String,
    /// How strongly.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The tracks the guidance acted on, as (role, track): empty without guidance.
    pub roles: Roles,
}

impl GuidanceTag {
    /// The kind where nothing guides.
    pub const NONE: &str = "none";
    /// The kind of the baseline's joint futures.
    pub const BASELINE: &str = "scene_transformer";
}

/// What a generated scenario came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The recorded scene whose observed states it continues.
    pub scene_id: SceneId,
    /// Which states were observed, in a word: the name of a training task such as `predictive`, or `mask`. The states
    /// themselves are in [`Scenario::observed`].
    pub observation: String,
    /// The noise level from which an edited recording was denoised again; `None` where nothing was edited.
    pub edit_tau: Option<f64>,
    /// Fingerprint of the checkpoint of the model that made it: the denoiser, or the baseline.
    pub checkpoint: String,
    /// Fingerprint of the classifier checkpoint; `None` where no classifier was used.
    pub classifier: Option<String>,
    /// The run's seed.
    pub seed: u64,
    /// Which sample of its scene and guidance this is.
    pub sample_idx: usize,
    /// How likely the model holds it to be; `None` for plain draws, which are equally likely.
    pub probability: Option<f64>,
    /// The guidance.
    pub guidance: GuidanceTag,
    /// Name of the sampler and its number of steps, such as `heun-50`.
    pub sampler: String,
    /// Every setting it was sampled with, as JSON text, objectives with their options among them.
    pub settings: String,
}

impl Provenance {
    /// Whether it is a forecast: nothing guided it, whatever varies within its sweep, and it does not start from an edited
    /// recording. That samples are kept to the rules of traffic does not count: it is no wish for what happens. The one definition of
    /// unguided traffic, for tables, comparisons and predictions.
    pub fn is_unguided(&self) -> bool {
        matches!(self.guidance.kind.as_str(), GuidanceTag::NONE | GuidanceTag::BASELINE) && self.edit_tau.is_none()
    }
}

/// A generated scene with its provenance.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Unique within a corpus; derived from the provenance.
    pub id: String,
    /// Observed states as recorded (or as edited), and generated ones, whose velocities follow from their positions.
    pub scene: Scene,
    /// Which states of the scene were observed: one entry for each of its tracks and timesteps, false where it has no state.
    pub observed: ObservationMask,
    /// What it came from.
    pub provenance: Provenance,
}
