//! What can stop generation.

use crate::scene::SceneId;
use crate::settings::Issue;

/// A failure of generation.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A setting that cannot work.
    #[error("{0}")]
    Setting(Issue),
    /// Settings, models and scenes that do not fit each other.
    #[error("{0}")]
    Config(String),
    /// A sweep is guided toward a behavior without a classifier.
    #[error("sweep {sweep}: there is no classifier of {behavior}; train one, or use the strength 0 alone")]
    NoClassifier {
        /// The sweep.
        sweep: String,
        /// The behavior.
        behavior: String,
    },
    /// A classifier does not belong to the denoiser.
    #[error("the classifier of {behavior} was trained with another {what} than the denoiser; train it again")]
    Mismatch {
        /// The behavior.
        behavior: String,
        /// What differs.
        what: &'static str,
    },
    /// A scene is not of the kind that the denoiser was trained on.
    #[error(
        "scene {scene_id} has {found} timesteps, the denoiser was trained on {expected}; ingest the scenes with the same lengths"
    )]
    SceneShape {
        /// The scene.
        scene_id: SceneId,
        /// Its history, whole length and step.
        found: String,
        /// Those of the denoiser's training scenes.
        expected: String,
    },
    /// No scene fits the configuration.
    #[error("sweep {sweep}: no scene fits; {n_considered} scenes are of the chosen splits and places{hint}")]
    NoScenes {
        /// The sweep.
        sweep: String,
        /// How many scenes were looked at.
        n_considered: usize,
        /// What to change.
        hint: &'static str,
    },
    /// Nothing that a request asks for can happen.
    #[error(
        "request {request}: none of {n_pairs} pairs in {n_scenes} scenes can fall into any of its buckets, told from their past and the \
         limits of driving; widen buckets or where, choose other splits or places, or set pairs.only_feasible = false"
    )]
    Infeasible {
        /// The request.
        request: String,
        /// Scenes that were looked at.
        n_scenes: usize,
        /// Pairs of them.
        n_pairs: usize,
    },
    /// A scene could not be loaded.
    #[error("scene {scene_id} could not be loaded")]
    Scene {
        /// The scene.
        scene_id: SceneId,
        /// Why.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A scene does not hold what the plan says.
    #[error("scene {scene_id} is not the one that was planned with ({detail}); plan again")]
    Stale {
        /// The scene.
        scene_id: SceneId,
        /// What differs.
        detail: String,
    },
    /// A tensor operation failed.
    #[error("a tensor operation failed")]
    Tensor(#[from] candle_core::Error),
}
