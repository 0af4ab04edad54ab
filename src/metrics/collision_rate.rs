//! Do agents drive into each other?

use super::sample_group::{future, present_agents};
use super::{Direction, Metric, MetricSpec, SampleGroup};
use crate::behavior::swept_boxes::SweptBoxes;
use crate::scene::{AgentClass, Scene, State};

/// An agent that stays within this distance of its present position stands, meters.
const MIN_MOTION_M: f64 = 1.0;

/// Collision rate: the share of samples in which any two agents collide.
///
/// Two agents collide if their boxes overlap at the same future timestep at which both have a state. Pairs that already
/// overlap at present, and pairs that both stand, do not count: recordings contain such pairs, which tell nothing about
/// the sample.
#[derive(Debug, Clone, Copy)]
pub struct CollisionRate;

/// Agent collision rate: the share of agents, over all samples, that collide with any other.
#[derive(Debug, Clone, Copy)]
pub struct AgentCollisionRate;

impl Metric for CollisionRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "collision_rate",
            "1",
            Direction::LowerIsBetter,
            "share of samples in which any two agents collide",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let is_hit = |sample: &Scene| vec![sample.has_future() && !collisions(sample).is_empty()];
        group.share_over_samples(is_hit).filter(|_| group.recorded.has_future())
    }
}

impl Metric for AgentCollisionRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "agent_collision_rate",
            "1",
            Direction::LowerIsBetter,
            "share of agents, over all samples, that collide with another",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.share_over_samples(collides).filter(|_| group.recorded.has_future())
    }
}

/// Two agents that collide.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Collision {
    /// The indices of the agents, in order.
    pub(crate) pair: [usize; 2],
    /// The first timestep at which their boxes overlap.
    pub(crate) timestep: usize,
}

/// The collisions among the agents tracked at present or later, pair by pair.
pub(crate) fn collisions(scene: &Scene) -> Vec<Collision> {
    let comes = |agent_idx: &usize| first_from_present(scene, *agent_idx).is_some();
    let agents: Vec<(usize, SweptBoxes, bool)> = (0..scene.tracks.len())
        .filter(comes)
        .filter_map(|i| Some((i, SweptBoxes::new(&scene.tracks[i])?, is_moving(scene, i))))
        .collect();
    let mut found = Vec::new();
    for (at, (i, first, first_moves)) in agents.iter().enumerate() {
        for (j, second, second_moves) in &agents[at + 1..] {
            if (*first_moves || *second_moves)
                && let Some(timestep) = first_contact(scene, first, second)
            {
                found.push(Collision { pair: [*i, *j], timestep });
            }
        }
    }
    found
}

/// Whether each agent tracked at present collides.
fn collides(scene: &Scene) -> Vec<bool> {
    let found = collisions(scene);
    present_agents(scene).map(|i| found.iter().any(|collision| collision.pair.contains(&i))).collect()
}

fn first_contact(scene: &Scene, first: &SweptBoxes, second: &SweptBoxes) -> Option<usize> {
    let present = scene.current_timestep();
    let overlap = |timesteps: std::ops::Range<usize>| {
        first.both_at(second, timesteps).find(|(_, one, other)| one.overlaps(other)).map(|(timestep, _, _)| timestep)
    };
    let timestep = first.may_come_within(second, 0.0).then(|| overlap(future(scene))).flatten()?;
    overlap(present..present + 1).is_none().then_some(timestep)
}

fn first_from_present(scene: &Scene, agent_idx: usize) -> Option<&State> {
    (scene.current_timestep()..scene.n_timesteps).find_map(|timestep| scene.state(agent_idx, timestep))
}

/// Whether an agent moves, and can move.
pub(super) fn is_moving(scene: &Scene, agent_idx: usize) -> bool {
    let Some(start) = first_from_present(scene, agent_idx) else { return false };
    scene.tracks[agent_idx].class != AgentClass::Static
        && future(scene)
            .filter_map(|timestep| scene.state(agent_idx, timestep))
            .any(|state| state.position.distance(start.position) >= MIN_MOTION_M)
}
