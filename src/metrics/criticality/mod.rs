//! How close does a scene come to a collision? Surrogate measures of safety, for one pair of road users and for the
//! worst pair.
//!
//! All measures are taken over the future, the timesteps from `n_history` on, and from positions and headings alone, so
//! that recorded and generated scenes are measured alike. A measure that is not defined, such as a time to collision
//! without a collision course, is absent.
//!
//! - time to collision (TTC): time until the boxes touch if both keep velocity and heading: exact, by the
//!   separating-axis theorem; 0 while they overlap, absent beyond 10 s (Hayward 1972, with boxes in the plane for
//!   points on a line);
//! - time exposed (TET): time during which TTC is below 1.5 s (Minderhoud and Bovy 2001);
//! - time integrated (TIT): integral of 1.5 s - TTC over that time (the same);
//! - deceleration rate to avoid a crash (DRAC): |v_rel| / (2 TTC): what brings the relative velocity to zero just
//!   before the boxes touch; Δv² / (2 d) for one behind the other; at most 20 m/s², which also stands for boxes that
//!   overlap (Cooper and Ferguson 1976, with the relative velocity for the difference of speeds);
//! - time headway: gap / speed of the follower, along the path that it goes on to drive, while the other is on that
//!   path ahead and heads the same way (within 45 degrees) (follow-distance literature);
//! - post-encroachment time (PET): time between one leaving the conflict area and the other entering it, whoever comes
//!   first; the conflict area is where the areas that their boxes sweep overlap (Allen, Shin and Cooper 1978);
//! - smallest distance: between the boxes at the same timestep, 0 where they overlap.
//!
//! Velocities are central differences of positions. PET is about paths that cross: an agent that follows another, or
//! merges and stays, never leaves the conflict area within the scene, so it has none. (The parameter `pet_s` of a near
//! miss is the least time between two agents being in the same place, which following has, too.)

mod agent;
mod closing;
mod encroachment;
mod headway;
mod pair_metrics;
mod scene_metrics;
#[cfg(test)]
mod tests;

pub use pair_metrics::PairMetric;
pub use scene_metrics::SceneMetric;

use super::sample_group::future;
use crate::scene::{AgentClass, Scene};
use agent::MovingAgent;
use closing::Closing;
use serde::{Deserialize, Serialize};

/// The criticality of an encounter of two road users. The module has the definitions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PairCriticality {
    /// Least time to collision, seconds; `None` if they are never on course to collide within 10 s.
    pub min_ttc_s: Option<f64>,
    /// Time exposed to a time to collision below 1.5 s, seconds.
    pub tet_s: f64,
    /// That time, weighted by how far below it is, s².
    pub tit_s2: f64,
    /// Largest deceleration rate to avoid a crash, m/s²; 0 if none is needed.
    pub max_drac_mps2: f64,
    /// Least time headway of either behind the other, seconds; `None` if neither follows the other.
    pub min_headway_s: Option<f64>,
    /// Post-encroachment time, seconds; `None` if paths do not cross, or one stays on the other's.
    pub pet_s: Option<f64>,
    /// Smallest distance between the boxes, meters.
    pub min_distance_m: f64,
}

/// The criticality of a scene: the worst of all pairs, measure by measure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SceneCriticality {
    /// Least time to collision, seconds; `None` if no pair is on a course to collide within 10 s.
    pub min_ttc_s: Option<f64>,
    /// Largest deceleration rate to avoid a crash, m/s².
    pub max_drac_mps2: f64,
    /// Smallest distance between two boxes, meters.
    pub min_distance_m: f64,
}

impl PairCriticality {
    /// The criticality of two agents of a scene, by their indices; `None` if they are never tracked together in the
    /// future.
    pub fn of(scene: &Scene, pair: [usize; 2]) -> Option<Self> {
        let [first, second] = [MovingAgent::of(scene, pair[0])?, MovingAgent::of(scene, pair[1])?];
        let (min_distance_m, _) = first.sweep.min_distance_m(&second.sweep, future(scene))?;
        let closing = Closing::over(&first, &second, future(scene), scene.dt_s);
        Some(Self {
            min_ttc_s: closing.min_ttc_s,
            tet_s: closing.tet_s,
            tit_s2: closing.tit_s2,
            max_drac_mps2: closing.max_drac_mps2,
            min_headway_s: headway::min_headway_s(scene, [&first, &second]),
            pet_s: encroachment::post_encroachment_s(scene, [&first, &second]),
            min_distance_m,
        })
    }
}

/// Time to collision (seconds) and distance between the boxes (meters) of two agents of a scene at each timestep of the
/// future, each if it is defined. `None` if one of them is never tracked.
pub fn closeness_over_time(scene: &Scene, pair: [usize; 2]) -> Option<Vec<[Option<f64>; 2]>> {
    let [first, second] = [MovingAgent::of(scene, pair[0])?, MovingAgent::of(scene, pair[1])?];
    let at = |timestep: usize| {
        let closing = Closing::over(&first, &second, timestep..timestep + 1, scene.dt_s);
        let distance = first.sweep.min_distance_m(&second.sweep, timestep..timestep + 1);
        [closing.min_ttc_s, distance.map(|(distance_m, _)| distance_m)]
    };
    Some(future(scene).map(at).collect())
}

impl SceneCriticality {
    /// The criticality of all pairs of road users that are tracked at present. Pairs that already overlap at present,
    /// and pairs that both stand, do not count, as in the collision rate. `None` without such a pair.
    pub fn of(scene: &Scene) -> Option<Self> {
        let present = scene.current_timestep();
        let agents: Vec<(MovingAgent, bool)> = super::sample_group::present_agents(scene)
            .filter(|agent_idx| scene.tracks[*agent_idx].class != AgentClass::Static)
            .filter_map(|agent_idx| {
                Some((MovingAgent::of(scene, agent_idx)?, super::collision_rate::is_moving(scene, agent_idx)))
            })
            .collect();
        let mut worst: Option<Self> = None;
        for (i, (first, first_moves)) in agents.iter().enumerate() {
            for (second, second_moves) in &agents[i + 1..] {
                let overlaps_now =
                    first.sweep.at(present).zip(second.sweep.at(present)).is_some_and(|(a, b)| a.overlaps(b));
                if overlaps_now || !(*first_moves || *second_moves) {
                    continue;
                }
                worst = Self::with_pair(worst, scene, first, second);
            }
        }
        worst
    }

    /// The worst of `worst` and a pair; measures of the pair that cannot be worse are not computed.
    fn with_pair(worst: Option<Self>, scene: &Scene, first: &MovingAgent, second: &MovingAgent) -> Option<Self> {
        let known = worst.unwrap_or(Self { min_ttc_s: None, max_drac_mps2: 0.0, min_distance_m: f64::INFINITY });
        let closing = Closing { min_ttc_s: known.min_ttc_s, max_drac_mps2: known.max_drac_mps2, ..Closing::default() };
        let closing = closing.worst_with(first, second, future(scene));
        let is_closer = first.sweep.may_come_within(&second.sweep, known.min_distance_m);
        let distance = is_closer.then(|| first.sweep.min_distance_m(&second.sweep, future(scene))).flatten();
        if worst.is_none() && distance.is_none() {
            return None;
        }
        Some(Self {
            min_ttc_s: closing.min_ttc_s,
            max_drac_mps2: closing.max_drac_mps2,
            min_distance_m: distance
                .map_or(known.min_distance_m, |(distance_m, _)| distance_m.min(known.min_distance_m)),
        })
    }
}
