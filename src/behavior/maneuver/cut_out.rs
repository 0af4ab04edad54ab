//! Cutting out: the leader moves over to a lane beside, and the ego brakes for whom that reveals.

use super::moving_over::ways_over;
use super::{Driver, Maneuver, Pace};
use crate::behavior::cut_out::CutOut;
use crate::behavior::feasible::effort;
use crate::behavior::following::Follower;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// How the ego and the revealed vehicle go on, m/s².
const EGO_MPS2: [f64; 3] = [0.0, 1.0, -1.0];
const REVEALED_MPS2: [f64; 3] = [0.0, -1.0, -2.5];
/// So long after the leader is midway between the lanes the ego brakes, seconds, and so hard, m/s².
const REACTION_S: f64 = 0.6;
const BRAKES_MPS2: [f64; 3] = [2.0, 4.0, 6.0];

impl CutOut {
    /// How the leader could leave the lane, with an ego that brakes as gently as it can for the revealed vehicle.
    pub(in crate::behavior) fn reveals_by(&self, scene: &Scene, agents: [usize; 3]) -> Vec<Maneuver> {
        self.among(scene, agents).unwrap_or_default()
    }

    fn among(&self, scene: &Scene, [ego_idx, revealed_idx, leader_idx]: [usize; 3]) -> Option<Vec<Maneuver>> {
        let (config, lanes) = (self.config(), SceneLanes::new(&scene.lanes));
        let is_admitted = config.agents.admits(scene.tracks[ego_idx].class);
        let follower = is_admitted.then(|| Follower::as_observed(scene, &lanes, config.agents, ego_idx)).flatten()?;
        let [leader, next] = self.queue(&follower, scene.current_timestep())?;
        let are_asked = [leader.agent_idx, next.agent_idx] == [leader_idx, revealed_idx];
        let ways = if are_asked { ways_over(scene, &lanes, leader_idx) } else { Vec::new() };
        let (ego, revealed) = (Driver::new(scene, &lanes, ego_idx)?, Driver::new(scene, &lanes, revealed_idx)?);
        let mut maneuvers = Vec::new();
        for way in &ways {
            for (own_mps2, their_mps2) in EGO_MPS2.iter().flat_map(|own| REVEALED_MPS2.map(|theirs| (*own, theirs))) {
                let theirs = revealed.progress(&Pace::steady(their_mps2)).driven_m;
                // The gap along the way is what both drive of it.
                let keeps = |pace: &Pace| {
                    let own = ego.progress(pace).driven_m;
                    own.iter().zip(&theirs).all(|(own, theirs)| own - theirs < next.gap_m)
                };
                let braking = |mps2: f64| Pace::steady(own_mps2).then(way.midway_s + REACTION_S, -mps2);
                let Some(pace) = BRAKES_MPS2.into_iter().map(braking).find(keeps) else { continue };
                let own = ego.progress(&pace).driven_m;
                for (a, b) in (0..ego.rails.len()).flat_map(|a| (0..revealed.rails.len()).map(move |b| (a, b))) {
                    maneuvers.push(Maneuver {
                        kind: [usize::from(way.side > 0.0), (way.midway_s * 10.0) as usize],
                        effort: way.effort.max(effort(own_mps2)).max(effort(their_mps2)),
                        parameters: &["ttc_s", "gap_m", "relative_speed_mps", "side"],
                        in_the_way: Some(InTheWay::Everybody),
                        positions: vec![ego.positions(a, &own), revealed.positions(b, &theirs), way.positions.clone()],
                    });
                }
            }
        }
        Some(maneuvers)
    }
}
