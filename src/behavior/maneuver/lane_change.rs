//! Changing lanes: moving over to the lane beside.

use super::Maneuver;
use super::moving_over::{MovingOver, going_on, ways_over};
use crate::behavior::lane_change::LaneChange;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

impl LaneChange {
    /// Maneuvers of an agent that moves over.
    pub(in crate::behavior) fn changes(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        if !scene.tracks[agent_idx].class.is_motorized() {
            return Vec::new();
        }
        let lanes = SceneLanes::new(&scene.lanes);
        let (ways, all) = (ways_over(scene, &lanes, agent_idx, self.hurry), going_on(scene, &lanes));
        let ways: Vec<MovingOver> = ways.into_iter().filter(|way| way.has_room(scene, agent_idx, &all, &[])).collect();
        // Nobody slows down for a gap that is there anyway.
        let free_sides: Vec<f64> = ways.iter().filter(|way| !way.slows).map(|way| way.side).collect();
        let ways = ways.into_iter().filter(|way| !(way.slows && free_sides.contains(&way.side)));
        let maneuver = |way: MovingOver| Maneuver {
            kind: [usize::from(way.side > 0.0), (way.midway_s * 2.0) as usize],
            effort: way.effort,
            parameters: &["side"],
            in_the_way: Some(InTheWay::Everybody),
            others: Vec::new(),
            positions: vec![way.positions],
        };
        ways.map(maneuver).collect()
    }
}
