//! Could a vehicle still turn?

use super::ways::{Way, ways};
use super::{ACCELERATIONS_MPS2, effort, horizon_s};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::outcome::Outcome;
use crate::behavior::turn::{TurnConfig, TurnSide, is_at_roundabout};
use crate::geometry::angle_difference;
use crate::scene::Scene;

/// The largest lateral acceleration in a turn, m/s².
const TURNING_MPS2: f64 = 4.0;
/// More than the least change of heading of a turn, radians.
const MARGIN_RAD: f64 = 0.05;

/// Where a way turns.
struct Bend {
    /// Distance from the agent to the beginning of the turn, and to the place where it has turned far enough, meters.
    begins_m: f64,
    ends_m: f64,
    radius_m: f64,
}

/// One outcome, without parameters, if a way from the agent's lanes turns to `side`, and the agent can complete the
/// turn within the limits of driving before the scene ends.
pub(in crate::behavior) fn outcomes(
    side: TurnSide,
    config: &TurnConfig,
    scene: &Scene,
    agent_idx: usize,
) -> Vec<Outcome> {
    let track = &scene.tracks[agent_idx];
    let observed = track.trajectory.valid().filter(|(t, state)| *t < scene.n_history && state.is_finite());
    let mut observed = observed.map(|(_, state)| state);
    let Some(first) = observed.next() else { return Vec::new() };
    let now = observed.next_back().unwrap_or(first);
    if !config.agents.admits(track.class) {
        return Vec::new();
    }
    let lanes = SceneLanes::new(&scene.lanes);
    let found = ways(&lanes, now).into_iter().filter_map(|way| {
        let bend = bend(&way, side, config, (first.heading_rad, now.heading_rad))?;
        let halfway_m = f64::midpoint(bend.begins_m, bend.ends_m);
        let halfway = way.line.point_at(way.station_m + halfway_m)?;
        let heading_rad = way.line.project(halfway)?.heading_rad;
        let is_possible =
            bend.radius_m <= config.max_radius_m && !is_at_roundabout(&lanes, config, halfway, heading_rad);
        is_possible.then(|| needed_effort(&bend, now.speed_mps(), horizon_s(scene)))?
    });
    found.reduce(f64::min).map(|effort| Outcome::default().at_effort(effort)).into_iter().collect()
}

/// The first place where `way` has turned far enough from the heading at which the agent was first seen.
fn bend(way: &Way, side: TurnSide, config: &TurnConfig, (first_rad, now_rad): (f64, f64)) -> Option<Bend> {
    let wanted_rad = config.min_heading_change_rad + MARGIN_RAD;
    let mut turned_rad = side.sign() * angle_difference(now_rad, first_rad);
    let (mut station_m, mut before_rad, mut begins_m) = (0.0, now_rad, None);
    for pair in way.line.0.windows(2) {
        let length_m = pair[0].distance(pair[1]);
        station_m += length_m;
        if station_m < way.station_m {
            continue;
        }
        let along_rad = (pair[1] - pair[0]).angle();
        turned_rad += side.sign() * angle_difference(along_rad, before_rad);
        before_rad = along_rad;
        let driven_m = (station_m - length_m - way.station_m).max(0.0);
        if turned_rad > 0.1 * wanted_rad && begins_m.is_none() {
            begins_m = Some(driven_m);
        }
        if let (true, Some(begins_m)) = (turned_rad >= wanted_rad, begins_m) {
            return Some(Bend { begins_m, ends_m: driven_m, radius_m: (driven_m - begins_m) / (0.9 * wanted_rad) });
        }
    }
    None
}

/// The effort of the turn: braking before the bend, or accelerating to reach its end in time. `None` if it exceeds the
/// limits.
fn needed_effort(bend: &Bend, speed_mps: f64, horizon_s: f64) -> Option<f64> {
    let most_mps = (TURNING_MPS2 * bend.radius_m.max(1.0)).sqrt();
    let too_fast = (speed_mps.powi(2) - most_mps.powi(2)).max(0.0);
    let braking_mps2 = if too_fast > 0.0 { -too_fast / (2.0 * bend.begins_m.max(0.1)) } else { 0.0 };
    let in_time_mps2 = (2.0 * (bend.ends_m - speed_mps * horizon_s) / horizon_s.powi(2)).max(0.0);
    // An agent that must brake for the bend drives through it at the speed that the bend allows.
    let slowed_s =
        (bend.ends_m - bend.begins_m) / most_mps.min(speed_mps.max(1.0)) + bend.begins_m / speed_mps.max(1.0);
    let is_possible = ACCELERATIONS_MPS2.contains(&braking_mps2)
        && ACCELERATIONS_MPS2.contains(&in_time_mps2)
        && (braking_mps2 == 0.0 || slowed_s <= horizon_s);
    is_possible.then(|| effort(braking_mps2).max(effort(in_time_mps2)))
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::testing::lane_graph;
    use crate::behavior::{LeftTurn, RightTurn, TurnConfig};
    use crate::scene::LaneGraph;
    use crate::scene::testing::Drive;

    /// A lane along x that forks at x = 20 m: straight on, and to the left on a quarter of a circle of 10 m.
    fn fork() -> LaneGraph {
        let bend: Vec<String> = (0..=9)
            .map(|i| (f64::from(i) * 10.0).to_radians())
            .map(|angle| format!("[{}, {}]", 20.0 + 10.0 * angle.sin(), 10.0 - 10.0 * angle.cos()))
            .collect();
        let text = format!(
            "lanes = [
                {{ id = 1, centerline = [[-50.0, 0.0], [20.0, 0.0]], successors = [2, 3] }},
                {{ id = 2, centerline = [[20.0, 0.0], [100.0, 0.0]] }},
                {{ id = 3, centerline = [{}] }},
            ]",
            bend.join(", ")
        );
        lane_graph(&text)
    }

    #[test]
    fn only_where_a_way_turns_and_neither_too_fast_nor_too_far() {
        let left = |x: f64, speed_mps: f64| {
            let behavior = LeftTurn::new(TurnConfig::default());
            !outcomes(&behavior, &[Drive::straight(x, 0.0, 0.0, speed_mps)], fork(), &[0]).is_empty()
        };
        assert!(left(8.0, 7.0));
        assert!(!left(10.0, 25.0), "too fast");
        assert!(!left(-45.0, 5.0), "too far");
        let right = RightTurn::new(TurnConfig::default());
        assert!(outcomes(&right, &[Drive::straight(0.0, 0.0, 0.0, 7.0)], fork(), &[0]).is_empty());
    }
}
