//! Entering ahead of a vehicle with the right of way: one passes the place where the ways meet shortly before the
//! other.

use super::Maneuver;
use super::passing_ahead::passing_ahead;
use crate::behavior::failure_to_yield::FailureToYield;
use crate::geometry::Vec2;
use crate::scene::{LaneDuty, Scene};

/// Vehicles farther than this from the end of every lane at which the rule applies do not get there, meters.
const NEAR_M: f64 = 60.0;

impl FailureToYield {
    /// Maneuvers in which one vehicle passes ahead of the other along any of its ways. The miner decides which of them
    /// take the right of way.
    pub(in crate::behavior) fn enters_ahead(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Maneuver> {
        let are_admitted = agents.iter().all(|idx| scene.tracks[*idx].class.is_motorized());
        let [entering, priority] = agents;
        let comes_along = |agent_idx: usize, duty: LaneDuty| {
            let present = scene.state(agent_idx, scene.current_timestep());
            present.is_some_and(|state| is_near(scene, state.position, duty))
        };
        let are_ruled = comes_along(entering, LaneDuty::Yields) && comes_along(priority, LaneDuty::HasRightOfWay);
        if !are_admitted || !are_ruled {
            return Vec::new();
        }
        passing_ahead(scene, agents, &["pet_s", "priority_speed_mps"])
    }
}

/// Whether a lane with this duty ends near `place`.
fn is_near(scene: &Scene, place: Vec2, wanted: LaneDuty) -> bool {
    scene.lanes.lanes().iter().any(|lane| {
        let has_duty = lane.attributes.duties().any(|(_, duty)| duty == wanted);
        has_duty && lane.centerline.0.last().is_some_and(|end| end.distance(place) < NEAR_M)
    })
}
