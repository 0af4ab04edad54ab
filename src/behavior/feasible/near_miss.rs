//! Could two road users still come close to each other?

use super::ways::ways;
use super::{ACCELERATIONS_MPS2, LATERAL_ACCELERATION_MPS2, effort, horizon_s};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::near_miss::NearMiss;
use crate::behavior::outcome::Outcome;
use crate::geometry::Vec2;
use crate::scene::{Extent, Scene};

/// The accelerations that are tried, m/s²: the limits, coasting, and braking gently.
const TRIED_MPS2: [f64; 4] = [*ACCELERATIONS_MPS2.start(), -2.0, 0.0, *ACCELERATIONS_MPS2.end()];
/// Spacing of the times that are tried, seconds.
const SPACING_S: f64 = 0.25;
/// Nobody evades farther than this, meters.
const MOST_ASIDE_M: f64 = 1.75;
/// The times to collision that pairs can come to, from the least on, and their spacing, seconds.
const LEAST_TTC_S: f64 = 0.3;
const TTC_SPACING_S: f64 = 0.2;

/// Where an agent could be if it went on along one of its ways with one acceleration.
struct Course {
    effort: f64,
    /// Positions and directions at the times that are tried.
    places: Vec<(Vec2, Vec2)>,
}

impl NearMiss {
    /// Times to collision for two who could meet: their boxes come within the wanted distance if each goes on along a lane with -4 to 2.5 m/s²
    /// along and at most 2 m/s² across. Empty for the others.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, [first, second]: [usize; 2]) -> Vec<Outcome> {
        let config = self.config();
        let lanes = SceneLanes::new(&scene.lanes);
        let n_times = (horizon_s(scene) / SPACING_S).floor() as usize;
        let courses = |agent_idx: usize| courses(scene, &lanes, agent_idx, n_times);
        let (Some(own), Some(others)) = (courses(first), courses(second)) else { return Vec::new() };
        let extents = [first, second].map(|agent_idx| scene.tracks[agent_idx].extent_or_nominal());
        let admits = |agent_idx: usize| {
            let track = &scene.tracks[agent_idx];
            config.agents.admits(track.class) && (track.extent.is_some() || !config.recorded_sizes)
        };
        if !admits(first) || !admits(second) {
            return Vec::new();
        }
        let mut least: Option<f64> = None;
        for (one, other) in own.iter().flat_map(|one| others.iter().map(move |other| (one, other))) {
            for (i, (a, b)) in one.places.iter().zip(&other.places).enumerate() {
                let evaded = evasion_effort([*a, *b], extents, config.max_distance_m, (i + 1) as f64 * SPACING_S);
                let effort = evaded.map(|evaded| evaded.max(one.effort).max(other.effort));
                least = least.into_iter().chain(effort).reduce(f64::min);
            }
        }
        let Some(effort) = least else { return Vec::new() };
        let n = ((config.max_ttc_s - LEAST_TTC_S) / TTC_SPACING_S).floor().max(0.0) as usize;
        let ttc_s = (0..=n).map(|i| LEAST_TTC_S + i as f64 * TTC_SPACING_S);
        ttc_s.map(|ttc_s| Outcome::default().with("min_ttc_s", ttc_s).at_effort(effort)).collect()
    }
}

/// What it takes two agents to touch at these places, `elapsed_s` from now, if one of them moves across to the other: the share of the way that it
/// can move across. `None` where they cannot.
fn evasion_effort(
    [(one, along), (other, other_along)]: [(Vec2, Vec2); 2],
    [extent, other_extent]: [Extent; 2],
    near_m: f64,
    elapsed_s: f64,
) -> Option<f64> {
    // The other's box as seen from the one: half of what it takes up along and across.
    let (cos, sin) = (along.dot(other_along).abs(), along.cross(other_along).abs());
    let (length_m, width_m) = (other_extent.length_m / 2.0, other_extent.width_m / 2.0);
    let ahead_m = along.dot(other - one).abs() - extent.length_m / 2.0 - (length_m * cos + width_m * sin) - near_m;
    let aside_m = along.cross(other - one).abs() - extent.width_m / 2.0 - (length_m * sin + width_m * cos) - near_m;
    let most_m = (LATERAL_ACCELERATION_MPS2 * elapsed_s.powi(2) / 4.0).min(MOST_ASIDE_M);
    (ahead_m <= 0.0 && aside_m <= most_m).then(|| aside_m.max(0.0) / most_m)
}

/// The courses of an agent; `None` where it is not tracked at present.
fn courses(scene: &Scene, lanes: &SceneLanes<'_>, agent_idx: usize, n_times: usize) -> Option<Vec<Course>> {
    let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
    let speed_mps = state.speed_mps();
    let ways = ways(lanes, state);
    let tried = ways.iter().flat_map(|way| TRIED_MPS2.map(|acceleration_mps2| (way, acceleration_mps2)));
    let courses = tried.map(|(way, acceleration_mps2)| {
        let driven_m = |elapsed_s: f64| {
            // Who brakes to a halt stands.
            let moving_s =
                if acceleration_mps2 < 0.0 { elapsed_s.min(-speed_mps / acceleration_mps2) } else { elapsed_s };
            speed_mps * moving_s + acceleration_mps2 * moving_s.powi(2) / 2.0
        };
        let places = (1..=n_times).map_while(|i| way.place(driven_m(i as f64 * SPACING_S))).collect();
        Course { effort: effort(acceleration_mps2), places }
    });
    Some(courses.collect())
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::{NearMiss, NearMissConfig};
    use crate::scene::LaneGraph;
    use crate::scene::testing::Drive;

    #[test]
    fn who_can_meet_can_come_close_and_who_cannot_cannot() {
        let effort = |other: Drive| {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), other];
            let found = outcomes(&NearMiss::new(NearMissConfig::default()), &drives, LaneGraph::default(), &[0, 1]);
            assert!(found.iter().all(|outcome| outcome.get("min_ttc_s").is_some_and(|ttc_s| ttc_s < 1.5)));
            found.iter().map(super::super::super::Outcome::effort).reduce(f64::min)
        };
        // Beside each other, with 1.7 m between them less what is near enough, of the 1.75 m that they can move across.
        let beside = effort(Drive::straight(0.0, 3.5, 0.0, 10.0)).expect("near enough");
        assert!((beside - 1.5 / 1.75).abs() < 1e-9, "{beside}");
        // On a course to collide already; when the one ahead brakes; never.
        assert_eq!(effort(Drive::straight(20.0, 0.0, 0.0, 2.0)), Some(0.0));
        assert_eq!(effort(Drive::straight(26.0, 0.0, 0.0, 10.0)), Some(1.0));
        assert_eq!(effort(Drive::straight(20.0, -20.0, std::f64::consts::FRAC_PI_2, 10.0)), Some(0.0));
        assert_eq!(effort(Drive::straight(60.0, 0.0, 0.0, 20.0)), None);
        assert_eq!(effort(Drive::straight(0.0, 30.0, 0.0, 10.0)), None);
    }
}
