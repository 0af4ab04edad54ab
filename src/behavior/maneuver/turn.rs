//! Turning along a lane that turns, as fast as the bend allows.

use super::{Driver, Maneuver, Pace};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::effort;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// Accelerations until the agent brakes for the bend, m/s².
const ACCELERATIONS_MPS2: [f64; 5] = [-1.0, -0.5, 0.0, 0.8, 1.6];

/// Speeds in the bend, as multiples of the ordinary one.
const BRISKNESS: [f64; 2] = [1.0, 1.15];

/// Drives along all ways ahead of an agent. The miner decides which of them turn.
pub(in crate::behavior) fn maneuvers(scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
    let lanes = scene.tracks[agent_idx].class.is_motorized().then(|| SceneLanes::new(&scene.lanes));
    let Some(driver) = lanes.and_then(|lanes| Driver::new(scene, &lanes, agent_idx)) else { return Vec::new() };
    let tried = (0..driver.rails.len()).flat_map(|rail| ACCELERATIONS_MPS2.map(|mps2| (rail, mps2)));
    let tried = tried.flat_map(|(rail, mps2)| BRISKNESS.map(|briskness| (rail, mps2, briskness)));
    let maneuver = |(rail, mps2, briskness): (usize, f64, f64)| Maneuver {
        kind: [rail, (10.0 * briskness) as usize],
        effort: effort(mps2).max(briskness - 1.0),
        parameters: &["mean_speed_mps"],
        in_the_way: Some(InTheWay::Ahead),
        others: Vec::new(),
        positions: vec![driver.positions(rail, &driver.travel(rail, &Pace::steady(mps2).brisk(briskness)).driven_m)],
    };
    tried.map(maneuver).collect()
}
