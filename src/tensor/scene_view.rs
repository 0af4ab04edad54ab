//! What of a scene becomes a row of a batch?

use crate::scene::{ObservationMask, Scene};

/// Which unobserved states are generated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FutureValidity {
    /// The recorded ones: for training and for losses.
    Recorded,
    /// Every stretch of hidden states that follows or precedes an observed state of the agent, recorded or not: for
    /// sampling. Where the mask shows that the agent was not tracked, it stays absent.
    Everything,
    /// The stretches of [`Self::Everything`], in which recorded states are scored: for training a network on the inputs
    /// that it gets in sampling. States that were not recorded continue the last recorded motion.
    Continued,
}

/// A scene as one row of a batch: the agent at its origin, and its mask.
#[derive(Debug, Clone, Copy)]
pub struct SceneView<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The agent at the origin. If it is not tracked at the last timestep of the history, the scene frame is used.
    pub ego_idx: usize,
    /// Which states are observed; one entry for each track and timestep of the scene.
    pub mask: &'a ObservationMask,
}
