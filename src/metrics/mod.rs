//! Figures of merit of sampled futures, in plain `f64`: how close to the recording, how diverse, how plausible?
//!
//! One metric a file. A new one needs its file and an entry in [`ALL`].
//!
//! Common to all: the future is every timestep from `n_history` on. Agents that count are those tracked at present,
//! t_obs - 1; nothing is generated for others. Where the recording is the yardstick, only timesteps at which it holds
//! the agent count. Observed states of the future (goals, other agents' plans, all but a window) are part of it as they were
//! recorded: their distances are 0, so distances of sweeps with different masks do not compare. A group for which a metric is not defined has no value and does not enter the mean.

mod aggregate;
mod collision_rate;
mod constant_velocity;
mod displacement;
mod kinematics;
mod mfd;
mod min_ade;
mod min_fde;
mod min_scene_ade;
mod min_scene_fde;
mod miss_rate;
mod offroad_rate;
mod road;
mod sample_group;
mod spec;

pub use aggregate::Aggregate;
pub use collision_rate::{AgentCollisionRate, CollisionRate};
pub use constant_velocity::constant_velocity;
pub use displacement::ScoredAgents;
pub use kinematics::{AccelerationViolationRate, JerkViolationRate};
pub use mfd::Mfd;
pub use min_ade::{MinAde, MinAdeOfMinFde};
pub use min_fde::MinFde;
pub use min_scene_ade::MinSceneAde;
pub use min_scene_fde::MinSceneFde;
pub use miss_rate::MissRate;
pub use offroad_rate::OffroadRate;
pub use sample_group::SampleGroup;
pub use spec::{Direction, MetricSpec};

/// A figure of merit of the samples of one scene.
pub trait Metric: Send + Sync {
    /// What the figure is.
    fn spec(&self) -> MetricSpec;
    /// The figure. `None` where it is not defined, such as a distance to a recording without a future.
    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64>;
}

/// Every metric, in the order of tables.
pub static ALL: &[&dyn Metric] = &[
    &MinAde,
    &MinFde,
    &MinAdeOfMinFde,
    &MissRate,
    &MinSceneAde(ScoredAgents::All),
    &MinSceneFde(ScoredAgents::All),
    &MinSceneAde(ScoredAgents::Others),
    &MinSceneFde(ScoredAgents::Others),
    &Mfd,
    &CollisionRate,
    &AgentCollisionRate,
    &OffroadRate,
    &AccelerationViolationRate,
    &JerkViolationRate,
];

/// The metric of this name. `None` when there is no such metric.
pub fn by_id(id: &str) -> Option<&'static dyn Metric> {
    ALL.iter().copied().find(|metric| metric.spec().id == id)
}

#[cfg(test)]
mod tests;
