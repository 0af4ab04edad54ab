//! Driving the wrong way: moving over to the oncoming lane beside one's own, and staying there.

use super::Maneuver;
use super::moving_over::{MovingOver, ways_over_to_oncoming};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::behavior::wrong_way::WrongWay;
use crate::scene::Scene;

impl WrongWay {
    /// Maneuvers in which an agent moves over to an oncoming lane.
    pub(in crate::behavior) fn drives_against(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        if !scene.tracks[agent_idx].class.is_motorized() {
            return Vec::new();
        }
        let lanes = SceneLanes::new(&scene.lanes);
        let ways = ways_over_to_oncoming(scene, &lanes, agent_idx).into_iter();
        let maneuver = |way: MovingOver| Maneuver {
            kind: [usize::from(way.side > 0.0), (way.midway_s * 10.0) as usize],
            effort: way.effort,
            parameters: &["mean_speed_mps", "duration_s"],
            in_the_way: Some(InTheWay::Everybody),
            others: Vec::new(),
            positions: vec![way.positions],
        };
        ways.map(maneuver).collect()
    }
}
