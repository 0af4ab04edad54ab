//! INTERACTION's joint miss rates and collision rates.

use super::circles::collide;
use super::displacement::ScoredAgents;
use super::miss_rate::is_miss;
use super::sample_group::future;
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};
use crate::scene::Scene;

/// Figures of INTERACTION's multi-agent benchmark beside minJointADE and minJointFDE.
///
/// They are over the agents to predict, [`ScoredAgents::Targets`]. In the datasets' train and val splits no agent is
/// marked as the ego, so the scene's ego takes its place. Agents miss by the rule of [`MissRate`](super::MissRate),
/// each at its own speed; they collide as rows of circles, as the benchmark computes it. Only defined for INTERACTION,
/// and if there are agents to predict.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointConsistency {
    /// minJointMR: the least share of missed agents of any sample.
    MinMissRate,
    /// Consistent-minJointMR, by which the benchmark ranks: the minimum over samples without a collision among the
    /// agents; 1 if there is none.
    ConsistentMinMissRate,
    /// CrossCollisionRate: the share of samples in which any two of the agents collide at any time.
    CrossCollisionRate,
    /// EgoCollisionRate: 1 if an agent collides with the recorded ego in every sample, else 0.
    EgoCollisionRate,
}

impl Metric for JointConsistency {
    fn spec(&self) -> MetricSpec {
        let (id, description) = match self {
            Self::MinMissRate => {
                ("min_joint_miss_rate", "INTERACTION's minJointMR: share of agents that miss, in the best joint sample")
            }
            Self::ConsistentMinMissRate => (
                "consistent_min_joint_miss_rate",
                "INTERACTION's Consistent-minJointMR: the same over samples without collision; 1 without any",
            ),
            Self::CrossCollisionRate => (
                "cross_collision_rate",
                "INTERACTION's CrossCollisionRate: share of samples in which vehicles other than the ego collide",
            ),
            Self::EgoCollisionRate => (
                "ego_collision_rate",
                "INTERACTION's EgoCollisionRate: share of scenes in which every sample collides with the recorded ego",
            ),
        };
        MetricSpec::new(id, "1", Direction::LowerIsBetter, description).over_modes(ModesOf::Scene)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let recorded = group.recorded;
        let targets: Vec<usize> = ScoredAgents::Targets.of(recorded).collect();
        let is_complete = |sample: &Scene| {
            targets.iter().all(|agent| future(recorded).all(|timestep| sample.state(*agent, timestep).is_some()))
        };
        if targets.is_empty() || !recorded.has_future() || !group.samples.iter().all(is_complete) {
            return None;
        }
        match self {
            Self::MinMissRate => group.min_over_samples(|sample| miss_share(recorded, sample, &targets)),
            Self::ConsistentMinMissRate => group.min_over_samples(|sample| {
                if agents_collide(sample, &targets) { Some(1.0) } else { miss_share(recorded, sample, &targets) }
            }),
            Self::CrossCollisionRate => group.share_over_samples(|sample| vec![agents_collide(sample, &targets)]),
            Self::EgoCollisionRate => group.min_over_samples(|sample| {
                let hits_ego = targets.iter().any(|agent| meet(sample, *agent, recorded, recorded.ego_idx));
                Some(f64::from(u8::from(hits_ego)))
            }),
        }
    }
}

fn miss_share(recorded: &Scene, sample: &Scene, targets: &[usize]) -> Option<f64> {
    let last = future(recorded).last()?;
    let misses: Option<Vec<bool>> = targets
        .iter()
        .map(|agent| {
            Some(is_miss(
                recorded.source.dataset.facts().miss_rule,
                recorded.state(*agent, last)?,
                sample.state(*agent, last)?,
            ))
        })
        .collect();
    Some(misses?.into_iter().filter(|is_miss| *is_miss).count() as f64 / targets.len() as f64)
}

fn agents_collide(sample: &Scene, targets: &[usize]) -> bool {
    let mut pairs = targets.iter().enumerate().flat_map(|(i, a)| targets[i + 1..].iter().map(move |b| (*a, *b)));
    pairs.any(|(a, b)| meet(sample, a, sample, b))
}

/// Whether an agent of one scene collides with an agent of another at the same future timestep.
fn meet(scene: &Scene, agent: usize, other_scene: &Scene, other: usize) -> bool {
    future(scene).any(|timestep| {
        let states = scene.state(agent, timestep).zip(other_scene.state(other, timestep));
        states.is_some_and(|(own, theirs)| collide((&scene.tracks[agent], own), (&other_scene.tracks[other], theirs)))
    })
}
