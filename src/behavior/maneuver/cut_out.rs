//! Cutting out: the leader moves over to the lane beside, and the ego brakes for the vehicle that this reveals.

use super::driver::Travel;
use super::moving_over::{going_on, is_clear_of, ways_over};
use super::{Driver, Maneuver, Pace};
use crate::behavior::cut_out::CutOut;
use crate::behavior::following::{Ahead, Follower};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::{REACTIONS_S, effort};
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// Accelerations of the ego and of the revealed vehicle, m/s²; neither brakes hard for no reason.
const EGO_MPS2: [f64; 2] = [0.0, -1.0];
const REVEALED_MPS2: [f64; 3] = [0.0, -1.0, -2.0];
/// How long after it is midway the leader may be out of the lane, seconds.
const REVEALED_AT_S: [f64; 3] = [0.0, 0.3, 0.6];
/// The ego brakes after the leader is midway, once it has reacted, this long before the scene ends at the latest,
/// seconds, and how hard, m/s².
const SHOWN_S: f64 = 0.4;
const BRAKES_MPS2: [f64; 4] = [2.0, 3.5, 5.0, 7.0];

impl CutOut {
    /// Maneuvers in which the leader leaves the lane and the ego brakes as gently as it can for the revealed vehicle.
    pub(in crate::behavior) fn reveals_by(&self, scene: &Scene, agents: [usize; 3]) -> Vec<Maneuver> {
        self.among(scene, agents).unwrap_or_default()
    }

    fn among(&self, scene: &Scene, [ego_idx, revealed_idx, leader_idx]: [usize; 3]) -> Option<Vec<Maneuver>> {
        let lanes = SceneLanes::new(&scene.lanes);
        let is_admitted = scene.tracks[ego_idx].class.is_motorized();
        let follower = is_admitted.then(|| Follower::as_observed(scene, &lanes, ego_idx)).flatten()?;
        let [leader, next] = self.queue(&follower, scene.current_timestep())?;
        let are_asked = [leader.agent_idx, next.agent_idx] == [leader_idx, revealed_idx];
        let mut ways = if are_asked { ways_over(scene, &lanes, leader_idx, 1.0) } else { Vec::new() };
        let all = going_on(scene, &lanes);
        let horizon_s = (scene.n_timesteps - scene.n_history) as f64 * scene.dt_s;
        ways.retain(|way| {
            way.midway_s + REACTIONS_S[1] + SHOWN_S < horizon_s
                && way.has_room(scene, leader_idx, &all, &[ego_idx, revealed_idx])
        });
        let (ego, revealed) = (Driver::new(scene, &lanes, ego_idx)?, Driver::new(scene, &lanes, revealed_idx)?);
        let rails = (0..ego.rails.len()).flat_map(|own| (0..revealed.rails.len()).map(move |theirs| (own, theirs)));
        let paces = EGO_MPS2.iter().flat_map(|own| REVEALED_MPS2.map(|theirs| (*own, theirs)));
        let tried: Vec<_> = rails.flat_map(|rails| paces.clone().map(move |paces| (rails, paces))).collect();
        let mut maneuvers = Vec::new();
        for way in &ways {
            for ((own_rail, their_rail), (own_mps2, their_mps2)) in &tried {
                let theirs = revealed.travel(*their_rail, &Pace::steady(*their_mps2));
                let coasting = ego.travel(*own_rail, &Pace::steady(*own_mps2));
                let is_reached = REVEALED_AT_S.iter().any(|after_s| {
                    let step = (((way.midway_s + after_s) / scene.dt_s) as usize).min(theirs.driven_m.len() - 1);
                    self.is_reached(&Ahead {
                        gap_m: next.gap_m + theirs.driven_m[step] - coasting.driven_m[step],
                        own_mps: coasting.speeds_mps[step],
                        their_mps: theirs.speeds_mps[step],
                        ..next
                    })
                });
                let keeps = |(pace, mps2): &(Pace, f64)| {
                    keeps_distance(&ego.travel(*own_rail, pace), &theirs, next.gap_m, *mps2)
                };
                let braking = |mps2: f64| {
                    let pace = |reacts_s: f64| Pace::steady(*own_mps2).then(way.midway_s + reacts_s, -mps2);
                    REACTIONS_S.map(|reacts_s| (pace(reacts_s), mps2))
                };
                let braking = if is_reached { BRAKES_MPS2.into_iter().flat_map(braking).find(keeps) } else { None };
                let pace = braking.map(|(pace, _)| pace);
                let Some(pace) = pace else { continue };
                let revealed_at = revealed.positions(*their_rail, &theirs.driven_m);
                if !is_clear_of(scene, [leader_idx, revealed_idx], [&way.positions, &revealed_at]) {
                    continue;
                }
                maneuvers.push(Maneuver {
                    kind: [usize::from(way.side > 0.0), (way.midway_s * 10.0) as usize],
                    effort: way.effort.max(effort(*own_mps2)).max(effort(*their_mps2)),
                    parameters: &["ttc_s", "gap_m", "relative_speed_mps", "side"],
                    in_the_way: Some(InTheWay::Everybody),
                    others: Vec::new(),
                    positions: vec![
                        ego.positions(*own_rail, &ego.travel(*own_rail, &pace).driven_m),
                        revealed_at,
                        way.positions.clone(),
                    ],
                });
            }
        }
        Some(maneuvers)
    }
}

/// Whether the ego slows down to the other's speed before the gap is gone, braking on at this rate after the scene.
/// Both drive along the same way, so the difference of their distances closes the gap.
fn keeps_distance(own: &Travel, theirs: &Travel, gap_m: f64, mps2: f64) -> bool {
    let closed_m = |step: usize| own.driven_m[step] - theirs.driven_m[step];
    let last = own.driven_m.len() - 1;
    let closing_mps = (own.speeds_mps[last] - theirs.speeds_mps[last]).max(0.0);
    let after_m = closing_mps * closing_mps / (2.0 * mps2);
    (0..=last).all(|step| closed_m(step) < gap_m) && closed_m(last) + after_m < gap_m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_still_closes_in_at_the_end_needs_room_to_brake_on() {
        let travel = |speeds_mps: [f64; 2]| Travel {
            driven_m: speeds_mps.iter().scan(0.0, |sum, speed| Some(std::mem::replace(sum, *sum + speed))).collect(),
            speeds_mps: speeds_mps.to_vec(),
        };
        let (own, slow) = (travel([10.0, 8.0]), travel([2.0, 2.0]));
        // It has closed 8 m, and closes 6² / (2 · 3) more.
        for (gap_m, mps2, expected) in [(14.1, 3.0, true), (13.9, 3.0, false), (13.9, 4.0, true), (7.9, 100.0, false)] {
            assert_eq!(keeps_distance(&own, &slow, gap_m, mps2), expected, "{gap_m} m, {mps2} m/s²");
        }
        assert!(keeps_distance(&slow, &own, 0.1, 1.0), "nobody closes in");
    }
}
