//! To which side can a vehicle still change lanes?

use super::{LATERAL_ACCELERATION_MPS2, horizon_s};
use crate::behavior::lane_change::LaneChange;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::outcome::Outcome;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;
use std::f64::consts::FRAC_PI_4;

/// The lowest speed at which a vehicle can change lanes, m/s.
const LEAST_SPEED_MPS: f64 = 2.0;
/// The largest angle between a vehicle and its lane, radians.
const ALONG_RAD: f64 = FRAC_PI_4;

impl LaneChange {
    /// The sides with a lane that the agent can reach, and stay in for long enough, with at most 2 m/s² across.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, agent_idx: usize) -> Vec<Outcome> {
        let config = self.config();
        let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite());
        let Some(state) = state.filter(|state| state.speed_mps() >= LEAST_SPEED_MPS) else { return Vec::new() };
        if !config.agents.admits(scene.tracks[agent_idx].class) {
            return Vec::new();
        }
        let lanes = SceneLanes::new(&scene.lanes);
        let mut outcomes: Vec<Outcome> = Vec::new();
        let is_along = |heading_rad: f64| angle_difference(heading_rad, state.heading_rad).abs() < ALONG_RAD;
        for (own, place) in lanes.lanes_at(state.position).filter(|(_, place)| is_along(place.heading_rad)) {
            for (lane, side) in lanes.beside(own, state.position) {
                let Some(there) = lane.lane.centerline.project(state.position) else { continue };
                // From its present position and lateral speed to beyond the line between the two lanes.
                let between_centers_m = there.offset_m.abs() + side * place.offset_m;
                let to_line_m = (between_centers_m / 2.0 - side * place.offset_m + config.hysteresis_m).max(0.0);
                let across = Vec2::from_angle(there.heading_rad);
                let drift_mps = side * across.cross(state.velocity);
                let crossing_s = crossing_s(to_line_m, drift_mps);
                let outcome = Outcome::default().with("side", side);
                let effort = (crossing_s / (horizon_s(scene) - config.min_stay_s)).powi(2);
                let is_new = outcomes.iter().all(|known| known.get("side") != Some(side));
                if is_new && crossing_s + config.min_stay_s < horizon_s(scene) {
                    outcomes.push(outcome.at_effort(effort));
                }
            }
        }
        outcomes
    }
}

/// The time to move this far sideways, given the initial lateral speed.
fn crossing_s(way_m: f64, speed_mps: f64) -> f64 {
    let a = LATERAL_ACCELERATION_MPS2;
    ((speed_mps * speed_mps + 2.0 * a * way_m).sqrt() - speed_mps) / a
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use super::crossing_s;
    use crate::behavior::testing::lane_graph;
    use crate::behavior::{LaneChange, LaneChangeConfig};
    use crate::scene::testing::Drive;

    fn sides(y: f64, speed_mps: f64) -> Vec<f64> {
        let lanes = lane_graph(
            "lanes = [
                { id = 1, centerline = [[-50, 0], [100, 0]], width_m = 3.5 },
                { id = 2, centerline = [[-50, 3.5], [100, 3.5]], width_m = 3.5 },
                { id = 3, centerline = [[100, -3.5], [-50, -3.5]], width_m = 3.5 },
            ]",
        );
        let found = outcomes(
            &LaneChange::new(LaneChangeConfig::default()),
            &[Drive::straight(0.0, y, 0.0, speed_mps)],
            lanes,
            &[0],
        );
        assert!(found.iter().all(|outcome| (0.0..=1.0).contains(&outcome.effort())));
        found.iter().filter_map(|outcome| outcome.get("side")).collect()
    }

    #[test]
    fn only_to_lanes_that_lead_the_same_way_and_only_in_motion() {
        // Oncoming traffic is to the right.
        assert_eq!(sides(0.0, 8.0), [1.0]);
        assert_eq!(sides(3.5, 8.0), [-1.0]);
        assert!(sides(0.0, 1.0).is_empty());
        assert!(sides(30.0, 8.0).is_empty());
    }

    #[test]
    fn crossing_takes_the_time_of_uniform_acceleration() {
        // 4 m at 2 m/s² from rest: 2 s. At 1 m/s: 1 t + t² = 4.
        assert!((crossing_s(4.0, 0.0) - 2.0).abs() < 1e-12);
        assert!((crossing_s(4.0, 1.0) - (17f64.sqrt() - 1.0) / 2.0).abs() < 1e-12);
    }
}
