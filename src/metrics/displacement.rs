//! How far is a sampled agent from where it was recorded?

use super::sample_group::{future, present_agents};
use crate::scene::Scene;

/// Which agents a joint metric scores: of those tracked at present, all or all but the ego.
///
/// The multi-agent INTERACTION benchmark leaves the ego out; most papers, DJINN among them, count it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScoredAgents {
    /// Every agent.
    All,
    /// Every agent but the scene's ego.
    Others,
}

impl ScoredAgents {
    /// The indices of the agents.
    pub(super) fn of(self, recorded: &Scene) -> impl Iterator<Item = usize> + '_ {
        present_agents(recorded).filter(move |agent_idx| self == Self::All || *agent_idx != recorded.ego_idx)
    }
}

/// The distances of an agent to its recorded positions at the future timesteps at which it is recorded, metres.
/// `None` where the sample lacks one of these states.
pub(super) fn displacements_m(recorded: &Scene, sample: &Scene, agent_idx: usize) -> Option<Vec<f64>> {
    let recorded_timesteps = future(recorded).filter(|timestep| recorded.state(agent_idx, *timestep).is_some());
    recorded_timesteps.map(|timestep| displacement_m(recorded, sample, agent_idx, timestep)).collect()
}

/// The distance of an agent to its recorded position at the last timestep, metres. `None` where it is not recorded
/// then, where the sample lacks it, or where there is no future.
pub(super) fn final_displacement_m(recorded: &Scene, sample: &Scene, agent_idx: usize) -> Option<f64> {
    displacement_m(recorded, sample, agent_idx, future(recorded).last()?)
}

fn displacement_m(recorded: &Scene, sample: &Scene, agent_idx: usize, timestep: usize) -> Option<f64> {
    let positions = recorded.state(agent_idx, timestep).zip(sample.state(agent_idx, timestep));
    positions.map(|(truth, sampled)| truth.position.distance(sampled.position)).filter(|d| d.is_finite())
}

/// The arithmetic mean. `None` of nothing.
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
