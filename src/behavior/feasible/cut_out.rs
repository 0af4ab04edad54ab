//! Can the vehicle ahead still leave the lane and reveal a slow one?

use super::{ACCELERATIONS_MPS2, LATERAL_ACCELERATION_MPS2, driven, effort, horizon_s};
use crate::behavior::cut_out::CutOut;
use crate::behavior::following::{Ahead, Follower};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::outcome::Outcome;
use crate::scene::Scene;
use std::collections::BTreeMap;

/// Spacing of the accelerations and of the times that are tried, m/s² and seconds.
const SPACING: f64 = 0.5;
/// How far beyond the side of the lane the leader's center must be, meters.
const BEYOND_M: f64 = 0.5;
/// Resolution of outcomes: times to collision in seconds, speeds in m/s.
const TTC_SPACING_S: f64 = 0.25;
const SPEED_SPACING_MPS: f64 = 2.0;

impl CutOut {
    /// The outcomes of the ego behind the revealed vehicle if the leader moves over to a lane beside its own with at
    /// most 2 m/s² across, and the other two continue with -4 to 2.5 m/s² each. Empty if the leader is not between the
    /// two or is slow itself, or if there is no lane beside its own.
    pub(in crate::behavior) fn outcomes(
        &self,
        scene: &Scene,
        [ego_idx, revealed_idx, leader_idx]: [usize; 3],
    ) -> Option<Vec<Outcome>> {
        let (config, lanes) = (self.config(), SceneLanes::new(&scene.lanes));
        if !config.agents.admits(scene.tracks[ego_idx].class) {
            return None;
        }
        let ego = Follower::as_observed(scene, &lanes, config.agents, ego_idx)?;
        let [leader, next] = self.queue(&ego, scene.current_timestep())?;
        let are_asked = [leader.agent_idx, next.agent_idx] == [leader_idx, revealed_idx];
        if !are_asked || self.is_slow(leader.their_mps, leader.own_mps) {
            return None;
        }
        let position = ego.state_in_lane(leader_idx, scene.current_timestep())?.position;
        let mut sides: Vec<f64> =
            lanes.lanes_at(position).flat_map(|(own, _)| lanes.beside(own, position)).map(|(_, side)| side).collect();
        sides.sort_by(f64::total_cmp);
        sides.dedup();
        // The easiest of similar outcomes.
        let mut easiest: BTreeMap<(bool, u64, u64), Outcome> = BTreeMap::new();
        for side in sides {
            let aside_m = (BEYOND_M - ego.lane.beyond_m(position, side)?).max(0.0);
            let least_s = 2.0 * (aside_m / LATERAL_ACCELERATION_MPS2).sqrt();
            for (revealed, elapsed_s, effort) in self.reveals(next, horizon_s(scene)) {
                if least_s > elapsed_s {
                    continue;
                }
                let relative_mps = revealed.own_mps - revealed.their_mps;
                let ttc_s = revealed.gap_m / relative_mps;
                let alike = (side > 0.0, (ttc_s / TTC_SPACING_S) as u64, (relative_mps / SPEED_SPACING_MPS) as u64);
                let most = effort.max((least_s / elapsed_s).powi(2));
                if easiest.get(&alike).is_none_or(|known| most < known.effort()) {
                    let outcome = Outcome::default()
                        .with("ttc_s", ttc_s)
                        .with("gap_m", revealed.gap_m)
                        .with("relative_speed_mps", relative_mps)
                        .with("ego_speed_mps", revealed.own_mps)
                        .with("revealed_speed_mps", revealed.their_mps)
                        .with("side", side);
                    easiest.insert(alike, outcome.at_effort(most));
                }
            }
        }
        Some(easiest.into_values().collect())
    }

    /// The possible relations of the revealed vehicle to the ego with their times, each with its effort.
    fn reveals(&self, now: Ahead, horizon_s: f64) -> Vec<(Ahead, f64, f64)> {
        let n = |range: f64| (range / SPACING).floor().max(0.0) as usize;
        let tried = || {
            (0..=n(ACCELERATIONS_MPS2.end() - ACCELERATIONS_MPS2.start()))
                .map(|i| ACCELERATIONS_MPS2.start() + i as f64 * SPACING)
        };
        let mut found = Vec::new();
        for time_s in (1..=n(horizon_s)).map(|i| i as f64 * SPACING) {
            for (own_mps2, their_mps2) in tried().flat_map(|own| tried().map(move |theirs| (own, theirs))) {
                let (own_m, own_mps) = driven(now.own_mps, own_mps2, time_s);
                let (their_m, their_mps) = driven(now.their_mps, their_mps2, time_s);
                let then = Ahead { gap_m: now.gap_m + their_m - own_m, own_mps, their_mps, ..now };
                if self.is_reached(&then) {
                    found.push((then, time_s, effort(own_mps2).max(effort(their_mps2))));
                }
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::testing::LaneSpec;
    use crate::behavior::{CutOut, Outcome};
    use crate::scene::LaneGraph;
    use crate::scene::testing::Drive;

    /// Of a vehicle at 12 m/s, behind a leader as fast, behind one that stands so far ahead of it; with or without a lane to the left.
    fn found(ahead_m: f64, has_lane_beside: bool) -> Vec<Outcome> {
        let lane = |id: i64, y_m: f64| LaneSpec {
            id,
            centerline: vec![[-50.0, y_m], [300.0, y_m]],
            width_m: Some(3.5),
            successors: Vec::new(),
            predecessors: Vec::new(),
            left_neighbor: None,
            right_neighbor: None,
        };
        let lanes: Vec<LaneSpec> = if has_lane_beside { vec![lane(1, 0.0), lane(2, 3.5)] } else { vec![lane(1, 0.0)] };
        let drives = [(0.0, 12.0), (ahead_m, 0.0), (15.0, 12.0)].map(|(x, mps)| Drive::straight(x, 0.0, 0.0, mps));
        let lanes = LaneGraph::new(lanes.iter().map(LaneSpec::build).collect());
        outcomes(&CutOut::default(), &drives, lanes, &[0, 1, 2])
    }

    #[test]
    fn a_leader_with_a_lane_beside_can_reveal_who_stands_in_reach() {
        let near = found(50.0, true);
        assert!(near.iter().all(|outcome| outcome.get("side") == Some(1.0)));
        // The leader needs 2 √(2.25 / 2) = 2.1 s, so 2.5 of those tried. The ego has driven 3.6 m up to the present and drives 30 until then.
        let coasting = near.iter().filter(|o| o.get("relative_speed_mps") == Some(12.0)).filter_map(|o| o.get("ttc_s"));
        assert!(coasting.into_iter().any(|ttc_s| (ttc_s - (45.5 - 3.6 - 30.0) / 12.0).abs() < 1e-6), "{near:?}");
        assert!(near.iter().all(|outcome| outcome.get("ttc_s").is_some_and(|ttc_s| (0.0..4.0).contains(&ttc_s))));
    }

    #[test]
    fn without_a_lane_beside_or_out_of_reach_there_is_none() {
        assert!(found(50.0, false).is_empty() && found(180.0, true).is_empty());
    }
}
