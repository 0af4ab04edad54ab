//! Do agents drive into each other?

use super::sample_group::{future, present_agents};
use super::{Direction, Metric, MetricSpec, SampleGroup};
use crate::behavior::sweep::Sweep;
use crate::scene::{AgentClass, Scene};

/// An agent that stays within this distance of its place at present stands, metres.
const MIN_MOTION_M: f64 = 1.0;

/// Collision rate: the share of samples in which any two agents collide.
///
/// Two agents collide if their boxes overlap at the same future timestep at which both have a state. Pairs that
/// overlap at present already, and pairs that both stand, do not count: recordings hold such pairs, and nothing
/// can be learned of the sample from them.
#[derive(Debug, Clone, Copy)]
pub struct CollisionRate;

/// Agent collision rate: the share of agents, over all samples, that collide with any other.
#[derive(Debug, Clone, Copy)]
pub struct AgentCollisionRate;

impl Metric for CollisionRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec {
            id: "collision_rate",
            unit: "1",
            direction: Direction::LowerIsBetter,
            description: "share of samples in which any two agents collide",
        }
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let is_hit = |sample: &Scene| vec![sample.has_future() && collides(sample).contains(&true)];
        group.share_over_samples(is_hit).filter(|_| group.recorded.has_future())
    }
}

impl Metric for AgentCollisionRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec {
            id: "agent_collision_rate",
            unit: "1",
            direction: Direction::LowerIsBetter,
            description: "share of agents, over all samples, that collide with another",
        }
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        group.share_over_samples(collides).filter(|_| group.recorded.has_future())
    }
}

/// For every agent tracked at present whether it collides.
fn collides(scene: &Scene) -> Vec<bool> {
    let agents: Vec<(Option<Sweep>, bool)> =
        present_agents(scene).map(|i| (Sweep::new(&scene.tracks[i]), is_moving(scene, i))).collect();
    let mut collides = vec![false; agents.len()];
    for (i, (first, first_moves)) in agents.iter().enumerate() {
        for (j, (second, second_moves)) in agents.iter().enumerate().skip(i + 1) {
            let Some((first, second)) = first.as_ref().zip(second.as_ref()) else { continue };
            if (*first_moves || *second_moves) && collide(scene, first, second) {
                collides[i] = true;
                collides[j] = true;
            }
        }
    }
    collides
}

fn collide(scene: &Scene, first: &Sweep, second: &Sweep) -> bool {
    let present = scene.current_timestep();
    let overlap =
        |timesteps: std::ops::Range<usize>| first.both_at(second, timesteps).any(|(_, one, other)| one.overlaps(other));
    first.may_come_within(second, 0.0) && overlap(future(scene)) && !overlap(present..present + 1)
}

fn is_moving(scene: &Scene, agent_idx: usize) -> bool {
    let Some(start) = scene.state(agent_idx, scene.current_timestep()) else { return false };
    scene.tracks[agent_idx].class != AgentClass::Static
        && future(scene)
            .filter_map(|timestep| scene.state(agent_idx, timestep))
            .any(|state| state.position.distance(start.position) >= MIN_MOTION_M)
}
