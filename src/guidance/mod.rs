//! Pushes samples in a direction: log potentials over noisy tensors, and the denoiser that follows their gradient.
//!
//! One objective a file. All share one sign convention: potentials are maximized.
//!
//! `GuidedDenoiser` follows log potentials over noisy tensors (the classifier of a pair), `CleanGuidedDenoiser` those
//! over decoded clean estimates (the objectives), and `ClassifierFreeDenoiser` mixes two denoisers that are conditioned
//! on more and on less. `RememberingDenoiser` saves what several strengths have in common. Each wraps a denoiser and is
//! one, so they nest. Objectives see meters and radians, never diffused states.

mod agent_selector;
mod classifier;
mod classifier_free;
mod clean_guided_denoiser;
mod forward_denoiser;
mod guided_denoiser;
mod lane_ways;
mod mask_change;
mod objectives;
mod remembering_denoiser;
mod road_corridors;
mod scene_context;
#[cfg(test)]
mod scene_tests;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;

pub use agent_selector::AgentSelector;
pub use classifier::{ClassifierGuidance, ClassifierPotential};
pub use classifier_free::{BranchChange, ClassifierFreeDenoiser};
pub use clean_guided_denoiser::{CleanGuidedDenoiser, CleanPotential, ObjectiveSum};
pub use forward_denoiser::ForwardDenoiser;
pub use guided_denoiser::{GuidanceConfig, GuidedDenoiser, log_potential_gradient};
pub use mask_change::MaskChange;
pub use objectives::{
    AccelerationLimit, Collision, CutIn, HardBrake, LaneChange, NoCollision, ObjectiveConfig, ObjectiveKind,
    SceneObjective, Side, SlipLimit, StayOnRoad,
};
pub use remembering_denoiser::RememberingDenoiser;
pub use scene_context::{ContextRow, SceneContext, Target};

use candle_core::{Result, Tensor};

/// Something to be made likely, such as "this pair of agents performs a cut-in".
pub trait Guidance {
    /// The log potential of each batch row, (B), higher is better: ln p(y | x; σ) if there is a probability, otherwise
    /// any score whose exponential tilts the distribution. `x` is (B, …) at the noise levels `sigma` (B). It must be
    /// differentiable in `x`, and row by row: a row depends on its own row of `x` and `sigma` only.
    fn log_potential(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor>;
}
