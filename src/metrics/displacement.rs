//! The distance of a sampled agent from its recorded position.

use super::sample_group::{future, present_agents};
use crate::scene::{AgentClass, Benchmark, Scene};

/// The agents that a joint metric scores, among those tracked at present. Most papers, DJINN among them, score all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScoredAgents {
    /// Every agent.
    All,
    /// Every agent but the scene's ego.
    Others,
    /// The agents to predict in INTERACTION's multi-agent benchmark: the vehicles that are recorded throughout, history
    /// and future, without the ego, which is the benchmark's `interesting_agent`. None in other datasets.
    Targets,
}

impl ScoredAgents {
    /// The indices of the agents.
    pub(super) fn of(self, recorded: &Scene) -> impl Iterator<Item = usize> + '_ {
        present_agents(recorded).filter(move |agent_idx| match self {
            Self::All => true,
            Self::Others => *agent_idx != recorded.ego_idx,
            Self::Targets => *agent_idx != recorded.ego_idx && is_target(recorded, *agent_idx),
        })
    }
}

fn is_target(recorded: &Scene, agent_idx: usize) -> bool {
    let track = &recorded.tracks[agent_idx];
    recorded.source.dataset.facts().benchmark == Some(Benchmark::InteractionJoint)
        && track.class == AgentClass::Vehicle
        && (0..recorded.n_timesteps).all(|timestep| track.trajectory.is_valid(timestep))
}

/// The distances of an agent to its recorded positions at the future timesteps at which it is recorded, meters. `None`
/// if the sample lacks one of these states.
pub(super) fn displacements_m(recorded: &Scene, sample: &Scene, agent_idx: usize) -> Option<Vec<f64>> {
    let recorded_timesteps = future(recorded).filter(|timestep| recorded.state(agent_idx, *timestep).is_some());
    recorded_timesteps.map(|timestep| displacement_m(recorded, sample, agent_idx, timestep)).collect()
}

/// The distance of an agent to its recorded position at the last timestep, meters; `None` if the recording or the
/// sample lacks it, or there is no future.
pub(super) fn final_displacement_m(recorded: &Scene, sample: &Scene, agent_idx: usize) -> Option<f64> {
    displacement_m(recorded, sample, agent_idx, future(recorded).last()?)
}

fn displacement_m(recorded: &Scene, sample: &Scene, agent_idx: usize, timestep: usize) -> Option<f64> {
    let positions = recorded.state(agent_idx, timestep).zip(sample.state(agent_idx, timestep));
    positions.map(|(truth, sampled)| truth.position.distance(sampled.position)).filter(|d| d.is_finite())
}

/// The arithmetic mean; `None` without values.
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
