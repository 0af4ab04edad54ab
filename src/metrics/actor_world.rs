//! The best joint sample for the agents that Argoverse 2 scores.

use super::displacement::{displacements_m, final_displacement_m, mean};
use super::miss_rate::is_miss;
use super::sample_group::{future, present_agents};
use super::{Direction, Metric, MetricSpec, ModesOf, SampleGroup};
use crate::scene::{Benchmark, MissRule, Scene, TrackRole};

/// Agents whose centers are closer than this collide, meters (Argoverse 2).
const COLLISION_M: f64 = 1.0;

/// Figures of Argoverse 2's benchmark of worlds, its word for joint samples.
///
/// The agents are those that are marked as focal or scored and are recorded throughout the future. The best world has
/// the least mean FDE over them (the first among equals), and every figure is taken from that world. Unlike
/// minSceneADE, each agent has the same weight. Only defined for Argoverse 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActorWorld {
    /// avgMinADE: the mean over agents of their mean distance over the future.
    AvgMinAde,
    /// avgMinFDE: the mean over agents of their distance at the last timestep.
    AvgMinFde,
    /// avgBrierMinFDE: avgMinFDE plus (1 - p)² for the world's probability p.
    AvgBrierMinFde,
    /// actorMR: the share of agents that end more than 2 m from their recorded position.
    MissRate,
    /// actorCR: the share of agents whose center comes within 1 m of another scored agent's, at the same time.
    CollisionRate,
}

impl Metric for ActorWorld {
    fn spec(&self) -> MetricSpec {
        let (id, unit, description) = match self {
            Self::AvgMinAde => {
                ("avg_min_ade_m", "m", "Argoverse 2's avgMinADE: mean distance of scored agents in the best world")
            }
            Self::AvgMinFde => {
                ("avg_min_fde_m", "m", "Argoverse 2's avgMinFDE: last distance of scored agents in the best world")
            }
            Self::AvgBrierMinFde => {
                ("avg_brier_min_fde_m", "m", "Argoverse 2's avgBrierMinFDE: avg_min_fde_m plus (1 - p)² of that world")
            }
            Self::MissRate => {
                ("actor_miss_rate", "1", "Argoverse 2's actorMR: share of scored agents that miss in the best world")
            }
            Self::CollisionRate => (
                "actor_collision_rate",
                "1",
                "Argoverse 2's actorCR: share of scored agents that come within 1 m of another in the best world",
            ),
        };
        MetricSpec::new(id, unit, Direction::LowerIsBetter, description).over_modes(ModesOf::Scene)
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let recorded = group.recorded;
        if recorded.source.dataset.facts().benchmark != Some(Benchmark::ArgoverseWorlds) {
            return None;
        }
        let agents = scored_agents(recorded);
        let over_agents = |figure: &dyn Fn(usize) -> Option<f64>| -> Option<f64> {
            let figures: Option<Vec<f64>> = agents.iter().map(|agent| figure(*agent)).collect();
            mean(&figures?)
        };
        let (best, fde_m) =
            group.best_sample(|sample| over_agents(&|agent| final_displacement_m(recorded, sample, agent)))?;
        let world = &group.samples[best];
        let as_figure = |holds: bool| if holds { 1.0 } else { 0.0 };
        match self {
            Self::AvgMinAde => over_agents(&|agent| mean(&displacements_m(recorded, world, agent)?)),
            Self::AvgMinFde => Some(fde_m),
            Self::AvgBrierMinFde => Some(fde_m + (1.0 - group.probability(best)?).powi(2)),
            Self::MissRate => {
                let last = future(recorded).last()?;
                over_agents(&|agent| {
                    let (truth, sampled) = (recorded.state(agent, last)?, world.state(agent, last)?);
                    Some(as_figure(is_miss(MissRule::Radial, truth, sampled)))
                })
            }
            Self::CollisionRate => over_agents(&|agent| {
                let mut others = agents.iter().filter(|other| **other != agent);
                Some(as_figure(others.any(|other| meet(world, agent, *other))))
            }),
        }
    }
}

fn scored_agents(recorded: &Scene) -> Vec<usize> {
    let is_scored = |agent: &usize| {
        let track = &recorded.tracks[*agent];
        matches!(track.role, TrackRole::Focal | TrackRole::Scored)
            && future(recorded).all(|timestep| track.trajectory.is_valid(timestep))
    };
    present_agents(recorded).filter(is_scored).collect()
}

fn meet(world: &Scene, agent: usize, other: usize) -> bool {
    future(world).any(|timestep| {
        let states = world.state(agent, timestep).zip(world.state(other, timestep));
        states.is_some_and(|(a, b)| a.position.distance(b.position) < COLLISION_M)
    })
}
