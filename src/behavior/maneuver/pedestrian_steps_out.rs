//! Stepping out: a pedestrian walks into the lane of a vehicle, which brakes.

use super::{Driver, Maneuver, Pace};
use crate::behavior::following::Follower;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::{REACTIONS_S, effort};
use crate::behavior::pedestrian_steps_out::{MAX_PEDESTRIAN_MPS, PedestrianStepsOut};
use crate::behavior::template::InTheWay;
use crate::geometry::Vec2;
use crate::scene::Scene;

/// Walking speeds, m/s; how long it takes to reach them, and when walking begins, seconds.
const WALKS_MPS: [f64; 3] = [1.0, 1.4, 1.8];
const STARTING_S: f64 = 0.8;
const BEGINS_S: [f64; 6] = [0.0, 0.4, 0.8, 1.2, 1.6, 2.0];
/// Accelerations of the vehicle until the pedestrian turns to the lane, m/s², and how hard it brakes, m/s², after the
/// pedestrian has begun to reach into its lane and it has reacted.
const EGO_MPS2: [f64; 3] = [0.0, 0.6, -1.0];
const BRAKES_MPS2: [f64; 5] = [1.5, 2.5, 3.5, 5.0, 7.0];
/// How long before the scene ends the vehicle reacts at the latest, seconds.
const SHOWN_S: f64 = 0.6;
/// How far before the pedestrian the vehicle stops, meters.
const LEFT_M: f64 = 0.5;

impl PedestrianStepsOut {
    /// Maneuvers in which the pedestrian walks straight across the lane and the vehicle brakes as gently as it can.
    pub(in crate::behavior) fn steps_across(&self, scene: &Scene, pair: [usize; 2]) -> Vec<Maneuver> {
        self.across(scene, pair).unwrap_or_default()
    }

    fn across(&self, scene: &Scene, [ego_idx, walker_idx]: [usize; 2]) -> Option<Vec<Maneuver>> {
        let lanes = SceneLanes::new(&scene.lanes);
        let is_possible = scene.tracks[ego_idx].class.is_motorized()
            && self.is_beside_road(scene, &lanes, walker_idx, scene.n_history);
        let ego = is_possible.then(|| Follower::as_observed(scene, &lanes, ego_idx))??;
        let present = scene.current_timestep();
        let (own, theirs) = (ego.state_in_lane(ego_idx, present)?, scene.state(walker_idx, present)?);
        let (place, there) = (ego.lane.project(own.position)?, ego.lane.project(theirs.position)?);
        let side = if there.offset_m < 0.0 { -1.0 } else { 1.0 };
        let toward = Vec2::from_angle(there.heading_rad).rotated(-side * std::f64::consts::FRAC_PI_2);
        let along = Vec2::from_angle(there.heading_rad);
        let along_mps = theirs.velocity.dot(along);
        let half_width_m = scene.tracks[walker_idx].extent_or_nominal().width_m / 2.0;
        let to_lane_m = (ego.lane.beyond_m(theirs.position, side)? - half_width_m).max(0.0);
        let half_m = |idx: usize| scene.tracks[idx].extent_or_nominal().length_m / 2.0;
        let gap_m = there.station_m - place.station_m - half_m(ego_idx) - half_m(walker_idx);
        let driver = Driver::new(scene, &lanes, ego_idx)?;
        let n_steps = scene.n_timesteps - scene.n_history;
        let mut maneuvers = Vec::new();
        for (i, walks_mps) in WALKS_MPS.into_iter().enumerate() {
            for begins_s in BEGINS_S {
                // The speed toward the lane rises evenly, as that along it falls.
                let walked = |elapsed_s: f64| {
                    let since_s = (elapsed_s - begins_s).max(0.0);
                    let starting_s = since_s.min(STARTING_S);
                    let rising_s = starting_s * starting_s / (2.0 * STARTING_S);
                    let along_s = elapsed_s.min(begins_s) + starting_s - rising_s;
                    toward * (walks_mps * (rising_s + since_s - starting_s)) + along * (along_mps * along_s)
                };
                // While the speed rises from rest, half of the way of the full speed is covered.
                let rising_m = walks_mps * STARTING_S / 2.0;
                let reaches_s = match to_lane_m < rising_m {
                    true => STARTING_S * (to_lane_m / rising_m).sqrt(),
                    false => STARTING_S / 2.0 + to_lane_m / walks_mps,
                };
                let seen_s = begins_s + reaches_s;
                if seen_s + REACTIONS_S[1] + SHOWN_S > n_steps as f64 * scene.dt_s {
                    continue;
                }
                let gap_m = gap_m + along_mps * (begins_s + STARTING_S / 2.0);
                let walked: Vec<Vec2> =
                    (0..=n_steps).map(|step| theirs.position + walked(step as f64 * scene.dt_s)).collect();
                for (rail, own_mps2) in (0..driver.rails.len()).flat_map(|rail| EGO_MPS2.map(|mps2| (rail, mps2))) {
                    // As gently as suffices to stop before the pedestrian, if not before the scene ends.
                    let tried = BRAKES_MPS2.into_iter().flat_map(|mps2| REACTIONS_S.map(|reacts_s| (mps2, reacts_s)));
                    let stopping = tried.into_iter().find_map(|(mps2, reacts_s)| {
                        let pace = Pace::steady(own_mps2).then(begins_s, own_mps2.min(0.0));
                        let pace = pace.then(seen_s + reacts_s, -mps2);
                        let travel = driver.travel(rail, &pace);
                        let (driven_m, then_mps) = (*travel.driven_m.last()?, *travel.speeds_mps.last()?);
                        let stops_m = driven_m + then_mps * then_mps / (2.0 * mps2);
                        (stops_m + LEFT_M < gap_m).then_some(travel.driven_m)
                    });
                    let Some(driven_m) = stopping else { continue };
                    maneuvers.push(Maneuver {
                        kind: [i, (begins_s * 10.0) as usize],
                        effort: effort(own_mps2).max(walks_mps / MAX_PEDESTRIAN_MPS),
                        parameters: &["time_to_arrival_s", "gap_m", "ego_speed_mps", "side"],
                        in_the_way: Some(InTheWay::Ahead),
                        others: Vec::new(),
                        positions: vec![driver.positions(rail, &driven_m), walked.clone()],
                    });
                }
            }
        }
        Some(maneuvers)
    }
}
