//! minSceneFDE: the mean distance of all agents from the recording at the end, in the best joint sample.

use super::displacement::{ScoredAgents, final_displacement_m, mean};
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};

/// minSceneFDE: the least of all samples of the mean displacement at the last timestep, over the agents recorded then.
#[derive(Debug, Clone, Copy)]
pub struct MinSceneFde(
    /// The agents that count.
    pub ScoredAgents,
);

impl Metric for MinSceneFde {
    fn spec(&self) -> MetricSpec {
        let (id, description) = match self.0 {
            ScoredAgents::All => (
                "min_scene_fde_m",
                "mean distance to the recording at the last timestep over agents, in the best joint sample",
            ),
            ScoredAgents::Others => ("min_scene_fde_without_ego_m", "the same without the ego"),
            ScoredAgents::Targets => (
                "min_joint_fde_m",
                "INTERACTION's minJointFDE: the same over vehicles other than the ego that are recorded throughout",
            ),
        };
        MetricSpec::new(id, "m", Direction::LowerIsBetter, description).over_modes(ModesOf::Scene)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.min_over_samples(|sample| {
            let last = group.recorded.n_timesteps.checked_sub(1)?;
            let agents = self.0.of(group.recorded).filter(|agent_idx| group.recorded.state(*agent_idx, last).is_some());
            let distances: Option<Vec<f64>> =
                agents.map(|agent_idx| final_displacement_m(group.recorded, sample, agent_idx)).collect();
            mean(&distances?)
        })
    }
}
