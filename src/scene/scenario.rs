//! A generated scenario: a scene whose future was sampled, and everything needed to sample it again.

use super::{GuidanceLevel, ObservationMask, Roles, Scene, SceneId};
use serde::{Deserialize, Serialize};

/// The guidance a scenario was sampled with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuidanceTag {
    /// Name of the guidance, such as `none`, `classifier:cut_in` or `classifier_free`; combined guidance is joined by
    /// `+`. For the baseline, which cannot be guided, `scene_transformer`.
    pub kind: String,
    /// The level of the guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The tracks the guidance acted on, as (role, track): empty without guidance.
    pub roles: Roles,
}

impl GuidanceTag {
    /// The kind without guidance.
    pub const NONE: &str = "none";
    /// The kind of the baseline's joint futures.
    pub const BASELINE: &str = "scene_transformer";
    /// The part of the kind of samples whose agents follow a template.
    pub const TEMPLATE: &str = "template";

    /// Whether agents with a role follow a template.
    pub fn has_template(&self) -> bool {
        self.kind.split('+').any(|part| part == Self::TEMPLATE)
    }
}

/// The provenance of a generated scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The recorded scene whose observed states it continues.
    pub scene_id: SceneId,
    /// The name of the mask: a training task such as `predictive`, or `mask`. The mask itself is
    /// [`Scenario::observed`].
    pub observation: String,
    /// The noise level from which an edited recording was denoised; `None` if nothing was edited.
    pub edit_tau: Option<f64>,
    /// Fingerprint of the checkpoint of the model that made it: the denoiser, or the baseline.
    pub checkpoint: String,
    /// Fingerprint of the classifier checkpoint; `None` if no classifier was used.
    pub classifier: Option<String>,
    /// The run's seed.
    pub seed: u64,
    /// Index among the samples of its scene and guidance.
    pub sample_idx: usize,
    /// Its probability by the model; `None` for plain draws, which are equally likely.
    pub probability: Option<f64>,
    /// The guidance.
    pub guidance: GuidanceTag,
    /// Name of the sampler and its number of steps, such as `heun-50`.
    pub sampler: String,
    /// The driver of the ego in the closed loop in which it went on; `None` if it ends with its sample.
    pub ego_driver: Option<String>,
    /// Every setting that it was sampled with, such as objectives with their options, as JSON text.
    pub settings: String,
}

impl Provenance {
    /// Whether it is a forecast: nothing guided it, and it does not start from an edited recording. Validity strength
    /// does not count as guidance, because it requests no event. This defines unguided traffic for all tables,
    /// comparisons and predictions.
    pub fn is_unguided(&self) -> bool {
        matches!(self.guidance.kind.as_str(), GuidanceTag::NONE | GuidanceTag::BASELINE) && self.edit_tau.is_none()
    }
}

/// A generated scene with its provenance.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Unique within a corpus; derived from the provenance.
    pub id: String,
    /// Observed states as recorded or edited, and generated ones, whose velocities follow from their positions.
    pub scene: Scene,
    /// The observed states of the scene: one entry for each of its tracks and timesteps, false if it has no state.
    pub observed: ObservationMask,
    /// Its provenance.
    pub provenance: Provenance,
}
