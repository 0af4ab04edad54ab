//! The way on: where an agent drives after its track.

use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{Scene, State};

/// Points of a way are this far apart, meters.
const SPACING_M: f64 = 1.0;
/// Each point of the middle of a lane is the mean of itself and of so many before and after it, twice over.
const ROUNDED_OVER: usize = 3;
/// An agent comes over to the middle as a spring does that is at rest after some six times as much, meters.
const COMES_OVER_M: f64 = 4.5;
/// Likewise, seconds at its speed: as drivers settle in a lane, and for who must not get any farther from it.
pub(crate) const SETTLES_S: f64 = 0.8;
pub(crate) const CAUGHT_S: f64 = 0.45;
/// Before its lane ends beside another, an agent moves over to that one within so much, meters, but not within less
/// than vehicles can.
const MOVES_OVER_M: f64 = 50.0;
const LEAST_OVER_M: f64 = 12.0;
/// Within which time the heading comes to be that of the motion, seconds.
const ALIGNS_S: f64 = 1.0;
/// The largest angle to the lane, radians, and the largest curvature, 1/m, with which it begins.
const MOST_ACROSS_RAD: f64 = 1.4;
const MOST_1PM: f64 = 0.1;
/// The last moment, timesteps, and the speed below which an agent has no direction but its heading, m/s.
const N_STEPS: usize = 3;
const STANDING_MPS: f64 = 1.0;

/// The points at which an agent continues after the last timestep of its track, which lasts to the end of the scene:
/// along the lane that it is in there, the straightest at forks, and along the one beside it after its end, for
/// `length_m` or to the end of the map. From its own direction and bend it comes over to the middle of the lane, within
/// a time of `SETTLES_S` or `CAUGHT_S`. Corners of center lines become bends that vehicles can drive. Empty if it is in
/// no lane.
pub(crate) fn way_on(scene: &Scene, agent_idx: usize, length_m: f64, within_s: f64) -> Vec<Vec2> {
    let ended = Scene { n_history: scene.n_timesteps, ..scene.clone() };
    let lanes = SceneLanes::new(&scene.lanes);
    let lane = KeptLane::as_observed(&ended, &lanes, agent_idx);
    let Some((lane, state)) = lane.as_ref().zip(scene.state(agent_idx, ended.current_timestep())) else {
        return Vec::new();
    };
    let Some(place) = lane.project(state.position) else { return Vec::new() };
    let (middles, now) = rounded(lane, lane.ends_beside(&lanes).as_ref(), place.station_m, length_m);
    let Some(last) = middles.len().checked_sub(2).filter(|last| now < *last) else { return Vec::new() };
    let along = |i: usize| (middles[i + 1] - middles[i - 1]).unit();
    let (offset_m, lane_1pm) =
        (along(now).cross(state.position - middles[now]), along(now - 1).angle_to(along(now + 1)) / (2.0 * SPACING_M));
    let (course_rad, own_1pm) = course(&ended, agent_idx, state);
    let across_rad = angle_difference(course_rad, along(now).angle());
    let slope = across_rad.clamp(-MOST_ACROSS_RAD, MOST_ACROSS_RAD).tan();
    let bend_1pm = own_1pm.map_or(0.0, |own_1pm| own_1pm - lane_1pm);
    // A spring with a triple pole, which goes on with the same offset, slope and bend.
    let over_m = COMES_OVER_M.max(within_s * state.speed_mps());
    let linear = slope + offset_m / over_m;
    let square = (bend_1pm + (2.0 * linear - offset_m / over_m) / over_m) / 2.0;
    let on = (now + 1..=last).map(|i| {
        let ahead_m = (i - now) as f64 * SPACING_M;
        let beside_m = (offset_m + (linear + square * ahead_m) * ahead_m) * (-ahead_m / over_m).exp();
        middles[i] + along(i).left() * beside_m
    });
    on.take((length_m / SPACING_M).ceil() as usize).collect()
}

/// The heading of an agent that moves in this direction, this long after it differed by `slip_rad` from the motion, as
/// recorded and sampled headings do.
pub(crate) fn aligned_rad(course_rad: f64, slip_rad: f64, elapsed_s: f64) -> f64 {
    wrap_angle(course_rad + slip_rad * (-elapsed_s / ALIGNS_S).exp())
}

/// Points of the middle of a lane from before this station to `length_m` after it or its end, and the index of the one
/// there. Each is the mean of those around it, twice over: a corner of 50 degrees becomes a bend with a radius of 7 m.
/// Where the lane `ends` beside another, they move over to the middle of that one.
fn rounded(lane: &KeptLane, ends: Option<&(f64, KeptLane)>, station_m: f64, length_m: f64) -> (Vec<Vec2>, usize) {
    let now = 2 * ROUNDED_OVER + 2;
    let at = |i: usize| {
        let at_m = (station_m + (i as f64 - now as f64) * SPACING_M).max(0.0);
        let own = lane.point_at(at_m)?;
        let Some((end_m, next)) = ends else { return Some(own) };
        let from_m = station_m.max(end_m - MOVES_OVER_M);
        let share = ((at_m - from_m) / (end_m - from_m).max(LEAST_OVER_M)).clamp(0.0, 1.0);
        let beside = next.project(lane.point_at(at_m.min(*end_m))?)?.station_m + (at_m - end_m).max(0.0);
        Some(own.lerp(next.point_at(beside)?, share * share * (3.0 - 2.0 * share)))
    };
    let n = 2 * now + (length_m / SPACING_M).ceil() as usize;
    let mut points: Vec<Vec2> = (0..n).map_while(at).collect();
    for _ in 0..2 {
        let mean = |i: usize| {
            let n = ROUNDED_OVER.min(i).min(points.len() - 1 - i);
            points[i - n..=i + n].iter().fold(Vec2::ZERO, |sum, point| sum + *point) * (1.0 / (2 * n + 1) as f64)
        };
        points = (0..points.len()).map(mean).collect();
    }
    (points, now)
}

/// The direction in which an agent moves at present, radians, and its curvature in the last moment, 1/m; `None` if it
/// hardly moved.
fn course(scene: &Scene, agent_idx: usize, state: &State) -> (f64, Option<f64>) {
    let moves = |state: &&State| state.is_finite() && state.speed_mps() > STANDING_MPS;
    if !moves(&state) {
        return (state.heading_rad, None);
    }
    let before = scene.current_timestep().checked_sub(N_STEPS).and_then(|timestep| scene.state(agent_idx, timestep));
    let own_1pm = before.filter(moves).map(|before| {
        let turned_rad = angle_difference(state.velocity.angle(), before.velocity.angle());
        (turned_rad / before.position.distance(state.position)).clamp(-MOST_1PM, MOST_1PM)
    });
    (state.velocity.angle(), own_1pm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::lane_graph;
    use crate::scene::Trajectory;
    use crate::scene::testing::{self, Drive};
    use std::sync::Arc;

    #[test]
    fn corners_of_lanes_become_bends_that_vehicles_can_drive() {
        // 50 degrees, 20 m ahead.
        let turn_rad = 50.0_f64.to_radians();
        let end = Vec2::new(20.0, 0.0) + Vec2::from_angle(turn_rad) * 100.0;
        let lanes =
            lane_graph(&format!("lanes = [{{ id = 1, centerline = [[-50, 0], [20, 0], [{}, {}]] }}]", end.x, end.y));
        let mut scene = Scene { lanes: Arc::new(lanes), ..testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 1.5)]) };
        scene.n_timesteps = scene.n_history;
        let from = scene.state(0, scene.n_timesteps - 1).unwrap().position;
        let way: Vec<Vec2> = [from].into_iter().chain(way_on(&scene, 0, 60.0, SETTLES_S)).collect();
        let headings: Vec<f64> = way.windows(2).map(|pair| (pair[1] - pair[0]).angle()).collect();
        let turns: Vec<f64> = headings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(headings[0].abs() < 1e-9 && (headings[59] - turn_rad).abs() < 1e-6, "{headings:?}");
        // The means of means turn at most by one part in seven of the corner at each of their points.
        assert!(turns.iter().all(|turn| (-1e-9..turn_rad / 6.5).contains(turn)), "{turns:?}");
    }

    #[test]
    fn an_agent_goes_on_in_its_own_direction_and_comes_over_to_the_middle() {
        let lanes = lane_graph("lanes = [{ id = 1, centerline = [[-50, 0], [150, 0]] }]");
        let scene = Scene { lanes: Arc::new(lanes), ..testing::scene(&[Drive::straight(0.0, 0.3, 0.1, 5.0)]) };
        let last = scene.state(0, scene.n_timesteps - 1).unwrap();
        let way = way_on(&scene, 0, 60.0, SETTLES_S);
        let first_rad = (way[0] - last.position).angle();
        assert!(way.len() == 60 && (first_rad - 0.1).abs() < 0.03, "{first_rad}");
        let bends = way.windows(3).map(|w| ((w[2] - w[1]).angle() - (w[1] - w[0]).angle()).abs());
        assert!(bends.fold(0.0, f64::max) < 0.06);
        assert!(way[40].y.abs() < 0.1 && way[59].y.abs() < 0.01, "{:?}", way[40]);
        // A fast one goes on straight, and takes longer: an offset of 0.4 m is (1 + s + s²/2) e^-s times as much after
        // s times 9 m.
        let fast = testing::scene(&[Drive::straight(0.0, 0.4, 0.0, 20.0)]);
        let fast = Scene { lanes: Arc::clone(&scene.lanes), ..fast };
        let way = way_on(&fast, 0, 60.0, CAUGHT_S);
        for (i, share) in [(8, 2.5 / std::f64::consts::E), (17, 5.0 * (-2.0_f64).exp())] {
            assert!((way[i].y - 0.4 * share).abs() < 1e-9, "{:?}", way[i]);
        }
    }

    #[test]
    fn an_agent_in_the_bend_of_its_lane_keeps_to_the_middle() {
        // A circle of 100 m to the left.
        let at = |rad: f64| Vec2::new(100.0 * rad.sin(), 100.0 * (1.0 - rad.cos()));
        let line: Vec<String> =
            (-25..75).map(|i| at(f64::from(i) * 0.02)).map(|Vec2 { x, y }| format!("[{x}, {y}]")).collect();
        let lanes = lane_graph(&format!("lanes = [{{ id = 1, centerline = [{}] }}]", line.join(", ")));
        let drive = Drive { curvature_1pm: 0.01, ..Drive::straight(0.0, 0.0, 0.0, 10.0) };
        let scene = Scene { lanes: Arc::new(lanes), ..testing::scene(&[drive]) };
        let way = way_on(&scene, 0, 60.0, SETTLES_S);
        let off_m = way.iter().map(|point| (point.distance(Vec2::new(0.0, 100.0)) - 100.0).abs());
        let most_m = off_m.fold(0.0, f64::max);
        assert!(way.len() == 60 && most_m < 0.1, "{most_m}");
    }

    #[test]
    fn an_agent_whose_lane_ends_moves_over_to_the_one_beside_it() {
        // A ramp that ends after 70 m beside a lane that goes on, which bends later.
        let lanes = lane_graph(
            "lanes = [{ id = 1, centerline = [[-50, 0], [70, 0]], left_neighbor = 2 },
                { id = 2, centerline = [[-50, 3.6], [70, 3.6]], right_neighbor = 1, successors = [3] },
                { id = 3, centerline = [[70, 3.6], [90, 3.6], [190, 23.6]], predecessors = [2] }]",
        );
        let scene = Scene { lanes: Arc::new(lanes), ..testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]) };
        let last = scene.state(0, scene.n_timesteps - 1).unwrap().position;
        let way = way_on(&scene, 0, 120.0, SETTLES_S);
        let beside_m = |x: f64| way.iter().min_by(|a, b| (a.x - x).abs().total_cmp(&(b.x - x).abs())).unwrap().y;
        // Half over in the middle between the later of its own place and 50 m before the end, and the end.
        let half_m = f64::midpoint(last.x.max(20.0), 70.0);
        assert!((beside_m(half_m) - 1.8).abs() < 0.1 && beside_m(21.0) < 0.2, "{} {}", last.x, beside_m(half_m));
        assert!((beside_m(72.0) - 3.6).abs() < 0.02 && (beside_m(120.0) - 9.6).abs() < 0.15, "{}", beside_m(120.0));
        let turns = way.windows(3).map(|w| (w[2] - w[1]).angle() - (w[1] - w[0]).angle());
        assert!(turns.fold(0.0, |most: f64, turn| most.max(turn.abs())) < 0.05);
    }

    #[test]
    fn an_agent_in_a_bend_of_its_own_lets_go_of_it_slowly() {
        let lanes = lane_graph("lanes = [{ id = 1, centerline = [[-50, 0], [150, 0]] }]");
        let mut scene = Scene { lanes: Arc::new(lanes), ..testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]) };
        // A circle of 100 m, at whose end it has turned by 0.05.
        let last = scene.n_timesteps - 1;
        let states = (0..=last).map(|t| {
            let rad = 0.05 - (last - t) as f64 * scene.dt_s * 10.0 / 100.0;
            let position = Vec2::new(100.0 * rad.sin(), 100.0 * (1.0 - rad.cos()));
            Some(State { position, heading_rad: rad, velocity: Vec2::from_angle(rad) * 10.0 })
        });
        scene.tracks[0].trajectory = Trajectory::new(states.collect());
        let from = scene.state(0, last).unwrap().position;
        let way: Vec<Vec2> = [from].into_iter().chain(way_on(&scene, 0, 40.0, CAUGHT_S)).collect();
        let headings: Vec<f64> = way.windows(2).map(|pair| (pair[1] - pair[0]).angle()).collect();
        // In half a meter it lets go of little of 1/100 per meter.
        assert!((headings[0] - 0.0527).abs() < 0.001, "{}", headings[0]);
        let turns: Vec<f64> = headings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let most = turns.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(most < 0.016, "{most}");
        assert!(way[40].y.abs() < 0.2, "{:?}", way[40]);
    }
}
