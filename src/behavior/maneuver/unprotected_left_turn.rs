//! Turning left ahead of an oncoming vehicle: one passes the place where the ways cross shortly before the other.

use super::Maneuver;
use super::passing_ahead::passing_ahead;
use crate::behavior::unprotected_left_turn::UnprotectedLeftTurn;
use crate::geometry::angle_difference;
use crate::scene::Scene;
use std::f64::consts::FRAC_PI_3;

/// The heading of oncoming agents differs from that of a vehicle, even if that has begun to turn, by more than this,
/// radians.
const ONCOMING_RAD: f64 = FRAC_PI_3;

impl UnprotectedLeftTurn {
    /// Maneuvers in which the turner passes ahead of the oncoming vehicle along any of its ways. The miner decides
    /// which of them are left turns.
    pub(in crate::behavior) fn turns_ahead(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Maneuver> {
        let heading_rad = |agent_idx| scene.state(agent_idx, scene.current_timestep()).map(|state| state.heading_rad);
        let [Some(own_rad), Some(their_rad)] = agents.map(heading_rad) else { return Vec::new() };
        let are_admitted = agents.iter().all(|idx| scene.tracks[*idx].class.is_motorized());
        if !are_admitted || scene.lanes.is_empty() || angle_difference(own_rad, their_rad).abs() < ONCOMING_RAD {
            return Vec::new();
        }
        passing_ahead(scene, agents, &["pet_s", "oncoming_speed_mps"])
    }
}
