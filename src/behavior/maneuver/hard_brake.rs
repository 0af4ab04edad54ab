//! Braking hard along the lane for a reason: behind somebody ahead, who may brake first, or before a line at which to
//! stop.

use super::reason::{Leader, in_sight};
use super::{Driver, Maneuver};
use crate::behavior::hard_brake::HardBrake;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// Decelerations that are tried, above the least one of an event, because the measured one is smoothed; by how much
/// harder the firmest driver brakes; and the hardest, m/s².
const MORE_MPS2: [f64; 4] = [0.4, 1.1, 1.9, 2.8];
const HARDER_MPS2: f64 = 0.7;
const HARDEST_MPS2: f64 = 7.75;
/// When braking begins, earlier by up to this, as drivers differ, seconds.
const BEGINS_S: [f64; 6] = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0];
const EARLIER_S: f64 = 0.3;

impl HardBrake {
    /// Maneuvers of an agent that keeps its speed, or brakes on, and then brakes hard for a reason that is seen.
    pub(in crate::behavior) fn brakings(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        let is_admitted = scene.tracks[agent_idx].class.is_motorized();
        let driver = is_admitted.then(|| Driver::new(scene, &lanes, agent_idx)).flatten();
        let Some(driver) = driver.filter(|driver| driver.state.speed_mps() >= self.min_speed_mps) else {
            return Vec::new();
        };
        let led = Leader::of(scene, &lanes, agent_idx).map(|leader| leader.brakes()).unwrap_or_default();
        let reasons = in_sight(scene, &lanes, agent_idx, None).into_iter().chain(led);
        let begins = BEGINS_S.map(|from_s| from_s - EARLIER_S * driver.style);
        let tried = MORE_MPS2.map(|more_mps2| self.min_deceleration_mps2 + more_mps2 + HARDER_MPS2 * driver.style);
        let mut maneuvers = Vec::new();
        for reason in reasons {
            for (rail, from_s) in
                (0..driver.rails.len()).flat_map(|rail| reason.begins(&begins).into_iter().map(move |s| (rail, s)))
            {
                for (i, mps2) in tried.iter().copied().enumerate().filter(|(_, mps2)| *mps2 <= HARDEST_MPS2) {
                    let Some(braking) = reason.braking(&driver, rail, (from_s, mps2), scene.dt_s) else { continue };
                    maneuvers.push(Maneuver {
                        kind: [i, (from_s * 2.0) as usize],
                        effort: mps2 / HARDEST_MPS2,
                        parameters: &["max_deceleration_mps2"],
                        in_the_way: Some(InTheWay::Ahead),
                        positions: vec![driver.positions(rail, &braking.travel.driven_m)],
                        others: reason.others.clone(),
                    });
                }
            }
        }
        maneuvers
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::Behavior;
    use crate::behavior::testing::{going_on, two_lanes};
    use crate::scene::testing::Drive;
    use std::collections::BTreeMap;

    #[test]
    fn a_driver_brakes_hard_for_somebody_slow_who_comes_over_close_ahead() {
        let hard = HardBrake::default();
        let n_with = |their_mps: f64, y: f64| {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 15.0), Drive::straight(32.0, y, 0.0, their_mps)];
            let scene = going_on(&drives, two_lanes());
            let maneuvers = hard.brakings(&scene, 0);
            let comes_over = |maneuver: &&Maneuver| {
                let (agent_idx, positions) = &maneuver.others[0];
                // From the lane beside into that of the ego.
                *agent_idx == 1 && positions[0].y.abs() > 3.0 && positions.last().is_some_and(|at| at.y.abs() < 1.0)
            };
            let n_over = maneuvers.iter().filter(comes_over).count();
            assert_eq!(n_over, maneuvers.len(), "nobody else is there");
            (n_over, hard.template(&scene, &[0], &BTreeMap::new(), 0).is_some())
        };
        let (n_slow, has_template) = n_with(7.0, 3.5);
        assert!(n_slow > 0 && has_template, "{n_slow}");
        // Hardly slower, and two lanes away.
        assert_eq!([n_with(14.0, 3.5), n_with(7.0, 7.0)], [(0, false); 2]);
    }

    #[test]
    fn who_is_ahead_brakes_for_somebody_who_comes_over_and_so_does_the_one_behind() {
        // At the distance of the slow one, the driver behind has no reason of its own.
        let drives = |y: f64| {
            [(0.0, 0.0, 15.0), (14.0, 0.0, 15.0), (36.0, y, 10.0)].map(|(x, y, mps)| Drive::straight(x, y, 0.0, mps))
        };
        let scene = |y: f64| going_on(&drives(y), two_lanes()).lasting(60);
        let hard = HardBrake::default();
        let others = |y: f64| -> Vec<Vec<usize>> {
            let maneuvers = hard.brakings(&scene(y), 0);
            maneuvers.iter().map(|maneuver| maneuver.others.iter().map(|(idx, _)| *idx).collect()).collect()
        };
        let chains = others(3.5);
        assert!(chains.contains(&vec![1, 2]), "{chains:?}");
        assert_eq!(others(7.0), Vec::<Vec<usize>>::new());
        assert!(hard.template(&scene(3.5), &[0], &BTreeMap::new(), 0).is_some());
    }
}
