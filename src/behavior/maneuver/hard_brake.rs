//! Braking hard along the lane, with different decelerations, times and durations.

use super::{Driver, Maneuver, Pace};
use crate::behavior::hard_brake::HardBrake;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// Decelerations that are tried, above the least one of an event, because the measured one is smoothed; and the
/// hardest, m/s².
const MORE_MPS2: [f64; 4] = [0.5, 1.25, 2.25, 3.25];
const HARDEST_MPS2: f64 = 7.75;
/// When braking begins and how long it lasts, seconds.
const BEGINS_S: [f64; 4] = [0.4, 0.9, 1.4, 1.9];
const LASTS_S: [f64; 3] = [0.9, 1.5, 2.5];

impl HardBrake {
    /// Maneuvers of an agent that keeps its speed, or brakes on, and then brakes hard.
    pub(in crate::behavior) fn brakings(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        let driver = scene.tracks[agent_idx].class.is_motorized().then(|| SceneLanes::new(&scene.lanes));
        let driver = driver.and_then(|lanes| Driver::new(scene, &lanes, agent_idx));
        let Some(driver) = driver.filter(|driver| driver.state.speed_mps() >= self.min_speed_mps) else {
            return Vec::new();
        };
        let mut maneuvers = Vec::new();
        for (i, more_mps2) in MORE_MPS2.into_iter().enumerate() {
            let deceleration_mps2 = self.min_deceleration_mps2 + more_mps2;
            if deceleration_mps2 > HARDEST_MPS2 {
                continue;
            }
            for (rail, from_s) in (0..driver.rails.len()).flat_map(|rail| BEGINS_S.map(|from_s| (rail, from_s))) {
                for lasts_s in LASTS_S {
                    let pace = Pace::steady(driver.braking_mps2().min(0.0));
                    let pace = pace.then(from_s, -deceleration_mps2).then(from_s + lasts_s, 0.0);
                    let positions = vec![driver.positions(rail, &driver.travel(rail, &pace).driven_m)];
                    maneuvers.push(Maneuver {
                        kind: [i, (from_s * 10.0) as usize],
                        effort: deceleration_mps2 / HARDEST_MPS2,
                        parameters: &["max_deceleration_mps2"],
                        in_the_way: Some(InTheWay::Ahead),
                        positions,
                    });
                }
            }
        }
        maneuvers
    }
}
