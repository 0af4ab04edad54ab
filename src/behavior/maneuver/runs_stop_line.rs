//! Running a stop line: going on along one's ways, no slower than ordinary driving makes necessary.

use super::{Driver, Maneuver, ORDINARY_MPS2, Pace};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::runs_stop_line::RunsStopLine;
use crate::behavior::template::InTheWay;
use crate::scene::{Lane, LaneDuty, Scene};

impl RunsStopLine {
    /// Drives along all ways ahead of an agent. The miner decides which of them lead over a stop line.
    pub(in crate::behavior) fn drives_through(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        let stops = |lane: &Lane| lane.attributes.duties().any(|(_, duty)| duty == LaneDuty::Stops);
        let is_admitted = scene.tracks[agent_idx].class.is_motorized();
        if !is_admitted || !scene.lanes.lanes().iter().any(stops) {
            return Vec::new();
        }
        let lanes = SceneLanes::new(&scene.lanes);
        let Some(driver) = Driver::new(scene, &lanes, agent_idx) else { return Vec::new() };
        let tried = (0..driver.rails.len()).flat_map(|rail| ORDINARY_MPS2.map(|mps2| (rail, Pace::steady(mps2))));
        let maneuver = |(rail, pace): (usize, Pace)| Maneuver {
            kind: [rail, 0],
            effort: pace.effort(),
            parameters: &["speed_mps", "min_speed_mps"],
            in_the_way: Some(InTheWay::Ahead),
            others: Vec::new(),
            positions: vec![driver.positions(rail, &driver.travel(rail, &pace).driven_m)],
        };
        tried.map(maneuver).collect()
    }
}
