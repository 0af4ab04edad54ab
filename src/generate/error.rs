//! Errors that stop generation.

use crate::scene::SceneId;
use crate::settings::Issue;

/// A failure of generation.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// A setting that cannot work.
    #[error("{0}")]
    Setting(Issue),
    /// Settings, models and scenes that do not fit each other.
    #[error("{0}")]
    Config(String),
    /// A sweep is guided toward a behavior without a classifier.
    #[error("sweep {sweep}: there is no classifier for {behavior}; train one, or set strengths = [0.0]")]
    NoClassifier { sweep: String, behavior: String },
    /// No scene fits the configuration.
    #[error("{of}: none of the {n_considered} scenes in the chosen splits and places is suitable{hint}")]
    NoScenes { of: String, n_considered: usize, hint: &'static str },
    /// No pair can reach any bucket of a request.
    #[error(
        "request {request}: none of {n_pairs} pairs in {n_scenes} scenes can reach any of its buckets, given their \
         past and the limits of driving; widen buckets or where, choose other splits or places, or set \
         pairs.only_feasible = false"
    )]
    Infeasible { request: String, n_scenes: usize, n_pairs: usize },
    /// A scene could not be loaded.
    #[error("cannot load scene {scene_id}")]
    Scene { scene_id: SceneId, source: Box<dyn std::error::Error + Send + Sync> },
    /// A scene differs from the plan.
    #[error("scene {scene_id} has changed since the plan was made ({detail}); plan again")]
    Stale { scene_id: SceneId, detail: String },
    /// Generation had to stop within a shard, which starts again next time.
    #[error("stopped within a shard")]
    Stopped,
    /// A tensor operation failed.
    #[error("a tensor operation failed")]
    Tensor(#[from] candle_core::Error),
}
