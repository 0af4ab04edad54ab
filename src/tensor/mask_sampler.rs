//! The training distribution over observation masks p(𝒪): the seven tasks of the paper's Appendix B.

use crate::scene::{ObservationMask, Scene};
use crate::seed::SeededRng;
use crate::settings::named;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A way of choosing which states are observed. Timesteps count from 0; t_obs is the length of the history.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MaskTask {
    /// The history of all agents: `[0, t_obs)`.
    Predictive,
    /// The history, and the final state of up to three random agents that are tracked then.
    GoalConditioned,
    /// The history, and the entire trajectory of up to three random fully tracked agents.
    AgentConditioned,
    /// The history, and the entire trajectory of the ego agent.
    EgoConditioned,
    /// All but a window of t_obs steps that starts at t_start ~ U{0, …, t_obs}.
    Windowed,
    /// Every (T / t_obs)-th state, from a random start.
    Upsampling,
    /// Each state with probability t_obs / T.
    Imputation,
}

/// How often each task is drawn in training. Only the ratios matter: the paper's own add up to 110 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TaskWeights {
    /// Weight of observing the history of all agents.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub predictive: f64,
    /// Weight of observing the goals of three agents, too.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub goal_conditioned: f64,
    /// Weight of observing three agents entirely, too.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub agent_conditioned: f64,
    /// Weight of observing the ego agent entirely, too.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub ego_conditioned: f64,
    /// Weight of hiding one window.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub windowed: f64,
    /// Weight of observing states at regular intervals.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub upsampling: f64,
    /// Weight of observing states at random.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub imputation: f64,
}

impl Default for TaskWeights {
    fn default() -> Self {
        Self {
            predictive: 50.0,
            goal_conditioned: 25.0,
            agent_conditioned: 10.0,
            ego_conditioned: 10.0,
            windowed: 5.0,
            upsampling: 5.0,
            imputation: 5.0,
        }
    }
}

impl TaskWeights {
    /// Each task with its probability; `None` unless the weights are finite, not negative and not all zero.
    pub fn probabilities(&self) -> Option<[(MaskTask, f64); 7]> {
        let weights = [
            (MaskTask::Predictive, self.predictive),
            (MaskTask::GoalConditioned, self.goal_conditioned),
            (MaskTask::AgentConditioned, self.agent_conditioned),
            (MaskTask::EgoConditioned, self.ego_conditioned),
            (MaskTask::Windowed, self.windowed),
            (MaskTask::Upsampling, self.upsampling),
            (MaskTask::Imputation, self.imputation),
        ];
        let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
        let usable = weights.iter().all(|(_, weight)| *weight >= 0.0) && total.is_finite() && total > 0.0;
        usable.then(|| weights.map(|(task, weight)| (task, weight / total)))
    }
}

/// Draws masks from p(𝒪).
#[derive(Debug, Clone)]
pub struct MaskSampler {
    probabilities: [(MaskTask, f64); 7],
}

/// How many agents the goal- and agent-conditioned tasks observe beyond the history.
const N_CONDITIONED_AGENTS: usize = 3;

impl MaskSampler {
    /// A sampler with these weights; `None` if they are not valid.
    pub fn new(weights: &TaskWeights) -> Option<Self> {
        weights.probabilities().map(|probabilities| Self { probabilities })
    }

    /// Draws a task, then a mask of that task for `scene` with ego agent `ego_idx`.
    pub fn sample(&self, scene: &Scene, ego_idx: usize, rng: &mut SeededRng) -> ObservationMask {
        let mut left = rng.uniform();
        let task = self
            .probabilities
            .iter()
            .find(|(_, probability)| {
                left -= probability;
                left < 0.0
            })
            .map_or(MaskTask::Predictive, |(task, _)| *task);
        task.sample(scene, ego_idx, rng)
    }
}

named! { MaskTask {
    Predictive = "predictive", GoalConditioned = "goal_conditioned", AgentConditioned = "agent_conditioned",
    EgoConditioned = "ego_conditioned", Windowed = "windowed", Upsampling = "upsampling", Imputation = "imputation",
} }

impl MaskTask {
    /// Draws a mask of this task for `scene` with ego agent `ego_idx`.
    pub fn sample(self, scene: &Scene, ego_idx: usize, rng: &mut SeededRng) -> ObservationMask {
        let (n_agents, n_timesteps, n_history) = (scene.tracks.len(), scene.n_timesteps, scene.n_history);
        let mask = |observed: &dyn Fn(usize, usize) -> bool| ObservationMask::from_fn(n_agents, n_timesteps, observed);
        let agents_where =
            |eligible: &dyn Fn(usize) -> bool| (0..n_agents).filter(|a| eligible(*a)).collect::<Vec<_>>();
        match self {
            Self::Predictive => ObservationMask::predictive(n_agents, n_timesteps, n_history),
            Self::GoalConditioned => {
                let eligible = agents_where(&|a| scene.state(a, n_timesteps - 1).is_some());
                let chosen = rng.choose(&eligible, N_CONDITIONED_AGENTS);
                mask(&|a, t| t < n_history || (t == n_timesteps - 1 && chosen.contains(&a)))
            }
            Self::AgentConditioned => {
                let eligible = agents_where(&|a| scene.tracks[a].trajectory.n_valid() == n_timesteps);
                let chosen = rng.choose(&eligible, N_CONDITIONED_AGENTS);
                mask(&|a, t| t < n_history || chosen.contains(&a))
            }
            Self::EgoConditioned => mask(&|a, t| t < n_history || a == ego_idx),
            Self::Windowed => {
                let start = rng.below(n_history + 1);
                mask(&|_, t| t < start || t >= start + n_history)
            }
            Self::Upsampling => {
                let stride = n_timesteps as f64 / n_history.max(1) as f64;
                let start = rng.below(stride.ceil() as usize) as f64;
                let observed: Vec<usize> = (0..n_history).map(|i| stride.mul_add(i as f64, start) as usize).collect();
                mask(&|_, t| observed.contains(&t))
            }
            Self::Imputation => {
                let probability = n_history as f64 / n_timesteps.max(1) as f64;
                ObservationMask::from_fn(n_agents, n_timesteps, |_, _| rng.uniform() < probability)
            }
        }
    }
}
