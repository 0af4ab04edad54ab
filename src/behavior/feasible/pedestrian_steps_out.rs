//! Can a pedestrian still step out ahead of a vehicle?

use super::{ACCELERATIONS_MPS2, driven, effort, horizon_s};
use crate::behavior::AgentFilter;
use crate::behavior::following::Follower;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::outcome::Outcome;
use crate::behavior::pedestrian_steps_out::PedestrianStepsOut;
use crate::geometry::Vec2;
use crate::scene::Scene;
use std::collections::BTreeMap;

/// Spacing of the accelerations and of the times that are tried, m/s² and seconds.
const SPACING: f64 = 0.5;
/// The highest speed of pedestrians that step onto a road, m/s.
const MOST_MPS: f64 = 2.5;
/// How far inside the lane the pedestrian must be, meters.
const INSIDE_M: f64 = 0.2;
/// Resolution of outcomes, seconds.
const TIME_SPACING_S: f64 = 0.2;

impl PedestrianStepsOut {
    /// Times to arrival of the vehicle when the pedestrian steps into its lane, if it walks across to it with up to 2.5
    /// m/s, keeps its speed along it, and the vehicle continues with -4 to 2.5 m/s². Empty if the pedestrian is on the
    /// road already, or too fast to be a pedestrian.
    pub(in crate::behavior) fn outcomes(
        &self,
        scene: &Scene,
        [ego_idx, pedestrian_idx]: [usize; 2],
    ) -> Option<Vec<Outcome>> {
        let (config, lanes) = (self.config(), SceneLanes::new(&scene.lanes));
        let is_possible = scene.tracks[ego_idx].class.is_motorized()
            && self.is_beside_road(scene, &lanes, pedestrian_idx, scene.n_history);
        let ego =
            is_possible.then(|| Follower::as_observed(scene, &lanes, AgentFilter::Motorized, ego_idx)).flatten()?;
        let present = scene.current_timestep();
        let (own, theirs) = (ego.state_in_lane(ego_idx, present)?, scene.state(pedestrian_idx, present)?);
        let (place, there) = (ego.lane.project(own.position)?, ego.lane.project(theirs.position)?);
        let side = if there.offset_m < 0.0 { -1.0 } else { 1.0 };
        let across_m = ego.lane.beyond_m(theirs.position, side)? + INSIDE_M;
        let half_m = |idx: usize| scene.tracks[idx].extent_or_nominal().length_m / 2.0;
        let now_m = there.station_m - place.station_m - half_m(ego_idx) - half_m(pedestrian_idx);
        let along_mps = theirs.velocity.dot(Vec2::from_angle(there.heading_rad));
        let n = |range: f64| (range / SPACING).floor().max(0.0) as usize;
        // The easiest of similar outcomes.
        let mut easiest: BTreeMap<u64, Outcome> = BTreeMap::new();
        for time_s in (1..=n(horizon_s(scene))).map(|i| i as f64 * SPACING) {
            let across_mps = across_m / time_s;
            for i in 0..=n(ACCELERATIONS_MPS2.end() - ACCELERATIONS_MPS2.start()) {
                let acceleration_mps2 = ACCELERATIONS_MPS2.start() + i as f64 * SPACING;
                let (own_m, own_mps) = driven(own.speed_mps(), acceleration_mps2, time_s);
                let gap_m = now_m + along_mps * time_s - own_m;
                let arrival_s = gap_m / own_mps;
                let is_met = own_mps >= config.min_speed_mps
                    && gap_m > 0.0
                    && arrival_s < config.max_time_to_arrival_s
                    && across_mps <= MOST_MPS;
                let most = effort(acceleration_mps2).max(across_mps / MOST_MPS);
                let alike = (arrival_s / TIME_SPACING_S) as u64;
                if is_met && easiest.get(&alike).is_none_or(|known| most < known.effort()) {
                    let outcome = Outcome::default()
                        .with("time_to_arrival_s", arrival_s)
                        .with("gap_m", gap_m)
                        .with("ego_speed_mps", own_mps)
                        .with("side", side);
                    easiest.insert(alike, outcome.at_effort(most));
                }
            }
        }
        Some(easiest.into_values().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcomes_of;
    use crate::behavior::{Outcome, PedestrianStepsOut};
    use crate::scene::AgentClass;
    use crate::scene::testing::{Drive, scene};

    /// Of a vehicle at 10 m/s along x, and somebody who stands so far ahead and beside the middle of its lane.
    fn found(ahead_m: f64, beside_m: f64, class: AgentClass) -> Vec<Outcome> {
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(ahead_m, beside_m, 0.0, 0.0)]);
        scene.tracks[1].class = class;
        scene.tracks[1].extent = None;
        scene.dt_s = 0.5;
        outcomes_of(&PedestrianStepsOut::default(), &scene, &[0, 1])
    }

    #[test]
    fn who_stands_beside_the_lane_can_step_out_while_the_vehicle_is_near() {
        let near = found(40.0, -2.75, AgentClass::Pedestrian);
        assert!(!near.is_empty() && near.iter().all(|outcome| outcome.get("side") == Some(-1.0)));
        // 1 m beside the lane and 0.2 m into it, after 2 s at 0.6 m/s: a coasting vehicle is 40 - 3 - 2.55 - 20 m away by then, 1.45 s.
        let coasting =
            near.iter().any(|outcome| outcome.get("time_to_arrival_s").is_some_and(|s| (s - 1.445).abs() < 0.1));
        assert!(coasting, "{near:?}");
        assert!(near.iter().all(|outcome| (0.0..=1.0).contains(&outcome.effort())));
    }

    #[test]
    fn who_is_on_the_road_too_far_or_no_pedestrian_cannot() {
        assert!(found(40.0, -1.0, AgentClass::Pedestrian).is_empty());
        assert!(found(40.0, -13.0, AgentClass::Pedestrian).is_empty());
        assert!(found(200.0, -2.75, AgentClass::Pedestrian).is_empty());
        assert!(found(40.0, -2.75, AgentClass::Vehicle).is_empty());
    }
}
