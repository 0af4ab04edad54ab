//! The observation mask O: which agent states are given, and which are to be generated?

/// A × T booleans; `true` means observed (the paper's 𝒪).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ObservationMask {
    n_agents: usize,
    n_timesteps: usize,
    observed: Vec<bool>,
}

impl ObservationMask {
    /// A mask with every entry given by `observed(agent_idx, timestep)`.
    pub fn from_fn(n_agents: usize, n_timesteps: usize, mut observed: impl FnMut(usize, usize) -> bool) -> Self {
        let entries = (0..n_agents * n_timesteps).map(|i| observed(i / n_timesteps, i % n_timesteps)).collect();
        Self { n_agents, n_timesteps, observed: entries }
    }

    /// The predictive task: every agent is observed for the first `n_history` timesteps.
    pub fn predictive(n_agents: usize, n_timesteps: usize, n_history: usize) -> Self {
        Self::from_fn(n_agents, n_timesteps, |_, timestep| timestep < n_history)
    }

    /// Number of agents.
    pub const fn n_agents(&self) -> usize {
        self.n_agents
    }

    /// Number of timesteps.
    pub const fn n_timesteps(&self) -> usize {
        self.n_timesteps
    }

    /// Whether this state is observed.
    pub fn is_observed(&self, agent_idx: usize, timestep: usize) -> bool {
        self.observed[agent_idx * self.n_timesteps + timestep]
    }

    /// All entries, agent by agent.
    pub fn entries(&self) -> &[bool] {
        &self.observed
    }
}
