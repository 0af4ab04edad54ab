//! minSceneADE: the mean distance of all agents from the recording, in the best joint sample.

use super::displacement::{ScoredAgents, displacements_m, mean};
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};

/// minSceneADE: the least of all samples of the mean displacement over all pairs (agent, timestep) at which the agent
/// is recorded. Agents that are recorded for longer weigh more (as in FJMP). For [`ScoredAgents::Targets`] this is the
/// minJointADE of INTERACTION's multi-agent benchmark.
#[derive(Debug, Clone, Copy)]
pub struct MinSceneAde(
    /// The agents that count.
    pub ScoredAgents,
);

impl Metric for MinSceneAde {
    fn spec(&self) -> MetricSpec {
        let (id, description) = match self.0 {
            ScoredAgents::All => {
                ("min_scene_ade_m", "mean distance to the recording over agents and future, in the best joint sample")
            }
            ScoredAgents::Others => ("min_scene_ade_without_ego_m", "the same without the ego"),
            ScoredAgents::Targets => (
                "min_joint_ade_m",
                "INTERACTION's minJointADE: the same over vehicles other than the ego that are recorded throughout",
            ),
        };
        MetricSpec::new(id, "m", Direction::LowerIsBetter, description).over_modes(ModesOf::Scene)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.min_over_samples(|sample| {
            let agents = self.0.of(group.recorded);
            let distances: Option<Vec<Vec<f64>>> =
                agents.map(|agent_idx| displacements_m(group.recorded, sample, agent_idx)).collect();
            mean(&distances?.concat())
        })
    }
}
