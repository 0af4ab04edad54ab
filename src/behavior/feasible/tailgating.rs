//! Can a vehicle still come too close behind another, and stay there?

use super::{ACCELERATIONS_MPS2, effort};
use crate::behavior::following::{Ahead, Follower};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::outcome::Outcome;
use crate::behavior::tailgating::{FollowingMoment, Tailgating, means};
use crate::scene::Scene;
use std::collections::BTreeMap;

/// Spacing of the accelerations that are tried, m/s².
const SPACING_MPS2: f64 = 0.5;
/// Resolution of outcomes: headways in seconds.
const HEADWAY_SPACING_S: f64 = 0.1;
/// The smallest gap, meters.
const LEAST_GAP_M: f64 = 1.0;
/// The largest gap that a vehicle could close within a scene, meters.
const REACH_M: f64 = 60.0;

impl Tailgating {
    /// Mean headways at which the follower could drive behind the leader for long enough, if the leader keeps its speed
    /// and the follower uses one acceleration of -4 to 2.5 m/s² over the first half of the remaining time and another
    /// over the second. Empty if the leader is not the nearest vehicle ahead in the follower's lane at present.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, [follower_idx, leader_idx]: [usize; 2]) -> Vec<Outcome> {
        let config = self.config();
        let lanes = SceneLanes::new(&scene.lanes);
        let is_admitted = config.agents.admits(scene.tracks[follower_idx].class);
        let follower = is_admitted.then(|| Follower::as_observed(scene, &lanes, config.agents, follower_idx)).flatten();
        let Some(follower) = follower else { return Vec::new() };
        let nearest = follower.ahead(scene.current_timestep(), REACH_M).first().copied();
        let Some(now) = nearest.filter(|nearest| nearest.agent_idx == leader_idx) else { return Vec::new() };
        let past = self.moments(&follower, 0..scene.n_history).remove(&leader_idx).unwrap_or_default();
        let n = ((ACCELERATIONS_MPS2.end() - ACCELERATIONS_MPS2.start()) / SPACING_MPS2).floor() as usize;
        let tried = || (0..=n).map(|i| ACCELERATIONS_MPS2.start() + i as f64 * SPACING_MPS2);
        // The easiest of similar outcomes.
        let mut easiest: BTreeMap<u64, Outcome> = BTreeMap::new();
        for accelerations_mps2 in tried().flat_map(|first| tried().map(move |second| [first, second])) {
            let future = self.driven(scene, now, accelerations_mps2);
            let moments: Vec<FollowingMoment> = past.iter().copied().chain(future).collect();
            let Some(run) = self.longest(&moments, config.max_headway_s, scene.dt_s) else { continue };
            let ((headway_s, speed_mps), most) =
                (means(&run), accelerations_mps2.map(effort).into_iter().fold(0.0, f64::max));
            let alike = (headway_s / HEADWAY_SPACING_S) as u64;
            if easiest.get(&alike).is_none_or(|known| most < known.effort()) {
                let outcome = Outcome::default().with("time_headway_s", headway_s).with("mean_speed_mps", speed_mps);
                easiest.insert(alike, outcome.at_effort(most));
            }
        }
        easiest.into_values().collect()
    }

    /// The future moments if the follower drives like this, as long as both are fast enough and there is a gap.
    fn driven(&self, scene: &Scene, now: Ahead, accelerations_mps2: [f64; 2]) -> Vec<FollowingMoment> {
        let halfway = usize::midpoint(scene.n_history, scene.n_timesteps);
        let (mut gap_m, mut own_mps) = (now.gap_m, now.own_mps);
        let mut moments = Vec::new();
        for timestep in scene.n_history..scene.n_timesteps {
            let before_mps = own_mps;
            own_mps = (own_mps + accelerations_mps2[usize::from(timestep >= halfway)] * scene.dt_s).max(0.0);
            gap_m += (now.their_mps - f64::midpoint(before_mps, own_mps)) * scene.dt_s;
            if gap_m < LEAST_GAP_M {
                return Vec::new();
            }
            if own_mps.min(now.their_mps) >= self.config().min_speed_mps {
                moments.push(FollowingMoment { timestep, gap_m, own_mps });
            }
        }
        moments
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::{Outcome, Tailgating};
    use crate::scene::testing::{Drive, scene};

    /// Of a vehicle at 10 m/s in the lane along x, behind one that starts so far ahead with this speed.
    fn found(ahead_m: f64, speed_mps: f64, pair: &[usize]) -> Vec<Outcome> {
        let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(ahead_m, 0.0, 0.0, speed_mps)];
        let lanes = (*scene(&drives).lanes).clone();
        outcomes(&Tailgating::default(), &drives, lanes, pair)
    }

    #[test]
    fn who_is_near_behind_stays_there_at_no_effort_and_who_is_far_cannot_come_near() {
        // 10.5 m from center to center less 4.5 m at equal speeds: 0.6 s.
        let near = found(10.5, 10.0, &[0, 1]);
        let staying = near.iter().find(|outcome| outcome.effort() == 0.0).and_then(|o| o.get("time_headway_s"));
        assert!(staying.is_some_and(|headway_s| (headway_s - 0.6).abs() < 1e-6), "{near:?}");
        assert!(near.iter().all(|outcome| outcome.get("time_headway_s").is_some_and(|s| s < 0.9)));
        // 15.5 m of gap are to become less than 0.9 s within 2 of 4 s: (15.5 - 2 a) / (10 + 2 a) < 0.9 from 1.7 m/s² on.
        let behind = found(20.0, 10.0, &[0, 1]);
        assert!(!behind.is_empty() && behind.iter().all(|outcome| outcome.effort() > 0.5), "{behind:?}");
        assert!(found(45.0, 10.0, &[0, 1]).is_empty() && found(45.0, 16.0, &[0, 1]).is_empty());
    }

    #[test]
    fn nobody_tailgates_who_is_slow_or_behind() {
        assert!(found(10.0, 3.0, &[0, 1]).is_empty() && found(10.5, 10.0, &[1, 0]).is_empty());
    }
}
