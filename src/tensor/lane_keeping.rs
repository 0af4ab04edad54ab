//! Makes samples of agents that keep their lanes to the millimeter, as drivers of simulations do, do so, too.
//!
//! A network leaves centimeters of drift where a recording has none at all. If the observed second of an agent shows
//! that its offset from its lane and its heading along it do not change, up to rounding, small drift of a sample is an
//! error, and is removed; so are small changes of progress if its observed speed is constant. Human drivers never keep
//! a lane like that, and agents that are generated to leave their offset or their speed, or are led into a bend, are
//! left alone.

use crate::geometry::{Polyline, Projection, Vec2, angle_difference, wrap_angle};
use crate::scene::{Lane, LaneGraph, Scene, State};
use std::f64::consts::FRAC_PI_2;

/// The number of consecutive states that decide.
const MIN_STATES: usize = 6;
/// An agent that moved by less than this in them is standing, meters.
const MOVED_M: f64 = 0.3;
/// Places and headings that differ by less are equal up to rounding, meters and radians.
const SAME_M: f64 = 2e-3;
const SAME_HEADING_RAD: f64 = 2.5e-3;
/// An agent that is generated to leave its offset by more than this does so on purpose, meters.
const KEPT_M: f64 = 0.25;
/// An agent that is generated to move farther, or less far, than at its speed by more than this does so on purpose,
/// meters.
const CRUISE_M: f64 = 0.3;
/// Lanes that turn by more are bends, in which the middle of a vehicle does not keep its offset, radians.
const STRAIGHT_RAD: f64 = 0.1;
/// Within this distance of a corner of its line, meters, a vehicle rounds it off; after the present, it begins to
/// within this many timesteps.
const ROUNDED_M: f64 = 3.0;
const N_ROUNDED: usize = 5;
/// A lane is an agent's if it is at most this far away, meters, and turned by this much, radians.
const MAX_OFFSET_M: f64 = 2.5;
const MAX_TURN_RAD: f64 = 0.5;
/// A lane turned by one radian counts as this many meters farther.
const TURN_M: f64 = 4.0;
/// How far ways lead ahead, meters; straight on where the map ends.
const AHEAD_M: f64 = 150.0;

/// An agent that keeps its lane.
#[derive(Debug, Clone)]
pub(super) struct LaneKeeper {
    /// The middle of its lane and of those that follow.
    line: Polyline,
    /// Its last observed pose: meters to the left of the line, heading, and direction of the line, radians.
    offset_m: f64,
    heading_rad: f64,
    direction_rad: f64,
    /// Its progress along the line at that time, meters, and its progress per timestep if that was steady.
    station_m: f64,
    steady_step_m: Option<f64>,
    /// Whether it was seen to move.
    has_moved: bool,
}

/// The agents of a scene that keep their lanes, by track, given their `observed` states by timestep. A standing agent
/// counts as one if at least half of the moving ones do.
pub(super) fn lane_keepers(scene: &Scene, observed: &[Vec<Option<State>>]) -> Vec<Option<LaneKeeper>> {
    let mut n_moving = 0;
    let mut keeper = |(track, states): (usize, &Vec<Option<State>>)| {
        let last = states.iter().rposition(Option::is_some)?;
        let run: Vec<State> = states[..=last].iter().rev().map_while(|state| *state).collect();
        let is_told = scene.tracks[track].class.is_motorized() && run.len() >= MIN_STATES;
        let has_moved = is_told && run[0].position.distance(run[run.len() - 1].position) >= MOVED_M;
        n_moving += usize::from(has_moved);
        is_told.then(|| LaneKeeper::new(&scene.lanes, &run, has_moved)).flatten()
    };
    let mut keepers: Vec<Option<LaneKeeper>> = observed.iter().enumerate().map(&mut keeper).collect();
    let n_kept = keepers.iter().flatten().filter(|keeper| keeper.has_moved).count();
    if n_kept == 0 || 2 * n_kept < n_moving {
        keepers.iter_mut().for_each(|keeper| *keeper = keeper.take().filter(|keeper| keeper.has_moved));
    }
    keepers
}

impl LaneKeeper {
    /// An agent of the observed states `run`, the last one first, if they keep a lane.
    fn new(lanes: &LaneGraph, run: &[State], has_moved: bool) -> Option<Self> {
        let range = |values: &mut dyn Iterator<Item = f64>| {
            let ends = values.fold((0.0f64, 0.0f64), |(low, high), value| (low.min(value), high.max(value)));
            ends.1 - ends.0
        };
        let now = run.first()?;
        // A turning agent has left every straight lane, so no lane needs to be searched for it.
        let turns = &mut run.iter().map(|state| angle_difference(state.heading_rad, now.heading_rad));
        if range(turns) > SAME_HEADING_RAD + STRAIGHT_RAD {
            return None;
        }
        let line = way(lanes, own_lane(lanes, now)?);
        let at = run.iter().map(|state| line.project(state.position)).collect::<Option<Vec<_>>>()?;
        let (offset_m, direction_rad) = (at[0].offset_m, at[0].heading_rad);
        let offsets = &mut at.iter().map(|at| at.offset_m - offset_m);
        let turns = &mut run.iter().zip(&at).map(|(state, at)| {
            let since = angle_difference(state.heading_rad, now.heading_rad);
            angle_difference(since, angle_difference(at.heading_rad, direction_rad))
        });
        let keeps = range(offsets) <= SAME_M && range(turns) <= SAME_HEADING_RAD;
        let station_m = at[0].station_m;
        let step_m = (station_m - at[at.len() - 1].station_m) / (at.len() - 1) as f64;
        let is_steady = |(i, at): (usize, &Projection)| (station_m - i as f64 * step_m - at.station_m).abs() <= SAME_M;
        let steady_step_m = Some(step_m).filter(|_| has_moved && at.iter().enumerate().all(is_steady));
        let heading_rad = now.heading_rad;
        keeps.then_some(Self { line, offset_m, heading_rad, direction_rad, station_m, steady_step_m, has_moved })
    }

    /// Removes the drift from states that were generated after all observed ones.
    pub(super) fn keep(&self, entries: &mut [Option<State>], latent: &[u8]) {
        let is_observed = |t: &usize| latent[*t] == 0 && entries[*t].is_some();
        let Some(first) = (0..entries.len()).rfind(is_observed).map(|last| last + 1) else { return };
        // Beside the inner side of a corner, the nearest place on the line jumps; the agent is moved over to it first.
        let on_line = |(i, state): (usize, &Option<State>)| {
            let state = state.as_ref()?;
            let along_rad = self.direction_rad + angle_difference(state.heading_rad, self.heading_rad);
            let beside = Vec2::from_angle(along_rad + FRAC_PI_2) * self.offset_m;
            Some((first + i, self.line.project(state.position - beside)))
        };
        let found: Vec<(usize, Option<Projection>)> = entries[first..].iter().enumerate().filter_map(on_line).collect();
        let turn = |at: &Projection| angle_difference(at.heading_rad, self.direction_rad);
        let is_kept = |at: &Projection| at.offset_m.abs() <= KEPT_M && turn(at).abs() <= STRAIGHT_RAD;
        if !found.iter().all(|(_, at)| at.as_ref().is_some_and(is_kept)) {
            return;
        }
        let steady_m = |t: usize| self.steady_step_m.map(|step_m| self.station_m + (t + 1 - first) as f64 * step_m);
        let is_steady = |(t, at): &(usize, Option<Projection>)| {
            at.zip(steady_m(*t)).is_some_and(|(at, steady_m)| (at.station_m - steady_m).abs() <= CRUISE_M)
        };
        let cruises = found.iter().all(is_steady);
        for (t, at) in &found {
            let at = match steady_m(*t).filter(|_| cruises) {
                Some(station_m) => self.line.point_at(station_m).and_then(|point| self.line.project(point)),
                None => *at,
            };
            let (Some(at), Some(state)) = (at, &mut entries[*t]) else { continue };
            let at = self.rounded(at, ((t + 1 - first) as f64 / N_ROUNDED as f64).min(1.0));
            state.position = at.point + Vec2::from_angle(at.heading_rad + FRAC_PI_2) * self.offset_m;
            state.heading_rad = wrap_angle(self.heading_rad + turn(&at));
        }
    }

    /// A place on the line, moved by this part toward a way on which corners are rounded off.
    fn rounded(&self, at: Projection, part: f64) -> Projection {
        let [before, after] = [-ROUNDED_M, ROUNDED_M].map(|by_m| self.line.point_at(at.station_m + by_m));
        let Some((before, after)) = before.zip(after) else { return at };
        let turn_rad = angle_difference((after - before).angle(), at.heading_rad);
        let middle = (before + after) * 0.25 + at.point * 0.5;
        Projection { point: at.point.lerp(middle, part), heading_rad: at.heading_rad + turn_rad * part, ..at }
    }
}

/// The lane that an agent at `state` is in.
fn own_lane<'a>(lanes: &'a LaneGraph, state: &State) -> Option<&'a Lane> {
    let cost = |lane: &'a Lane| {
        let at = lane.centerline.project(state.position)?;
        let turn = angle_difference(at.heading_rad, state.heading_rad).abs();
        let is_own = at.offset_m.abs() <= MAX_OFFSET_M && turn <= MAX_TURN_RAD;
        is_own.then_some((at.offset_m.abs() + TURN_M * turn, lane))
    };
    lanes.lanes().iter().filter_map(cost).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, lane)| lane)
}

/// The middle of `lane` and of the lanes before and after it that turn least, straight on beyond the map.
fn way(lanes: &LaneGraph, lane: &Lane) -> Polyline {
    let turn = |lane: &&Lane| match lane.centerline.0.as_slice() {
        [first, second, .., before, last] => {
            angle_difference((*last - *before).angle(), (*second - *first).angle()).abs()
        }
        _ => 0.0,
    };
    let straightest = |ids: &[crate::scene::LaneId]| {
        ids.iter().filter_map(|id| lanes.get(*id)).min_by(|a, b| turn(a).total_cmp(&turn(b)))
    };
    let mut points = straightest(&lane.predecessors).map_or_else(Vec::new, |before| before.centerline.0.clone());
    points.pop();
    points.extend(&lane.centerline.0);
    let (mut last, mut ahead_m) = (lane, 0.0);
    while let Some(next) = straightest(&last.successors).filter(|next| ahead_m < AHEAD_M && next.id != lane.id) {
        points.extend(next.centerline.0.iter().skip(1));
        ahead_m += next.centerline.length_m().max(1.0);
        last = next;
    }
    if let [.., before, end] = points[..] {
        let step = end - before;
        points.push(end + step * (AHEAD_M / step.norm().max(1e-3)));
    }
    Polyline(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{LaneId, Trajectory};
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, StateParametrization};
    use std::sync::Arc;

    const N_OBSERVED: usize = 11;

    fn lane(id: i64, line: &[[f64; 2]], successors: &[i64]) -> Lane {
        let line = line.iter().map(|[x, y]| Vec2::new(*x, *y)).collect();
        let mut lane = Lane::unconnected(id, Polyline(line), Default::default());
        lane.successors = successors.iter().map(|id| LaneId(*id)).collect();
        lane
    }

    /// Agents along a lane that turns by 10 mrad at x = 20.5, at the offsets of `offset_m` by agent and timestep.
    fn traffic(speeds_mps: &[f64], offset_m: impl Fn(usize, usize) -> f64) -> Scene {
        let drives: Vec<Drive> = speeds_mps.iter().map(|speed| Drive::straight(0.0, 0.0, 0.0, *speed)).collect();
        let mut made = scene(&drives);
        (made.n_history, made.n_timesteps) = (N_OBSERVED, 41);
        for (agent, speed_mps) in speeds_mps.iter().enumerate() {
            let state = |t: usize| {
                let station_m = 0.1 * speed_mps * t as f64;
                let (on_lane, direction_rad) = on_lane(station_m);
                let left = Vec2::from_angle(direction_rad + FRAC_PI_2) * offset_m(agent, t);
                Some(State { position: on_lane + left, heading_rad: direction_rad, velocity: Vec2::ZERO })
            };
            made.tracks[agent].trajectory = Trajectory::new((0..41).map(state).collect());
        }
        let end = on_lane(80.0).0;
        let lanes = vec![lane(1, &[[-20.0, 0.0], [20.5, 0.0]], &[2]), lane(2, &[[20.5, 0.0], [end.x, end.y]], &[])];
        Scene { lanes: Arc::new(LaneGraph::new(lanes)), ..made }
    }

    fn on_lane(station_m: f64) -> (Vec2, f64) {
        match station_m {
            s if s < 20.5 => (Vec2::new(s, 0.0), 0.0),
            s => (Vec2::new(20.5, 0.0) + Vec2::from_angle(0.01) * (s - 20.5), 0.01),
        }
    }

    fn keepers(scene: &Scene) -> Vec<Option<LaneKeeper>> {
        let given = |track: &crate::scene::Track| -> Vec<Option<State>> {
            (0..41).map(|t| track.trajectory.get(t).filter(|_| t < N_OBSERVED).copied()).collect()
        };
        lane_keepers(scene, &scene.tracks.iter().map(given).collect::<Vec<_>>())
    }

    #[test]
    fn drift_is_taken_from_who_keeps_its_lane_and_progress_stays() {
        let rounded = |t: usize| 0.4 + 0.0004 * (t % 3) as f64;
        let drifting = |_: usize, t: usize| rounded(t) + 0.005 * t.saturating_sub(N_OBSERVED) as f64;
        let scene = traffic(&[10.0], drifting);
        let keeper = keepers(&scene)[0].clone().unwrap();
        let mut entries = scene.tracks[0].trajectory.entries().to_vec();
        let latent: Vec<u8> = (0..41).map(|t| u8::from(t >= N_OBSERVED)).collect();
        keeper.keep(&mut entries, &latent);
        for (t, entry) in entries.iter().enumerate() {
            let (found, sampled) = (entry.unwrap(), scene.state(0, t).unwrap());
            let (on_lane, direction_rad) = on_lane(t as f64);
            let expected = on_lane + Vec2::from_angle(direction_rad + FRAC_PI_2) * rounded(N_OBSERVED - 1);
            match t < N_OBSERVED {
                true => assert_eq!(found, *sampled),
                // Where the lane turns, the corner is rounded off, and the offset along it accurate to millimeters.
                false => assert!(found.position.distance(expected) < 0.014, "{t}: {found:?}"),
            }
            let near_corner_m = (t as f64 - 20.5).abs();
            let turned = (t as f64 - 20.5 + ROUNDED_M).clamp(0.0, 2.0 * ROUNDED_M) / (2.0 * ROUNDED_M);
            match near_corner_m < ROUNDED_M {
                true => assert!((found.heading_rad - 0.01 * turned).abs() < 1e-4, "{t}: {}", found.heading_rad),
                false => assert!((found.heading_rad - direction_rad).abs() < 1e-12, "{t}"),
            }
        }
    }

    #[test]
    fn who_drives_beside_a_corner_of_the_line_moves_on_steadily() {
        for offset_m in [1.7, -1.7] {
            let mut scene = traffic(&[9.0], |_, _| offset_m);
            let keeper = keepers(&scene)[0].clone().unwrap();
            // A sample that rounds the corner off over 6 m by itself, and becomes faster with 0.1 m/s².
            let smooth = |t: usize| {
                let station_m = 0.9 * t as f64 + 5e-4 * (t.saturating_sub(N_OBSERVED) as f64).powi(2);
                let all: Vec<(Vec2, f64)> = (-30..=30).map(|i| on_lane(station_m + 0.1 * f64::from(i))).collect();
                let sum = all.iter().fold((Vec2::ZERO, 0.0), |sum, (at, rad)| (sum.0 + *at, sum.1 + *rad));
                let (at, heading_rad) = (sum.0 * (1.0 / 61.0), sum.1 / 61.0);
                let position = at + Vec2::from_angle(heading_rad + FRAC_PI_2) * offset_m;
                Some(State { position, heading_rad, velocity: Vec2::ZERO })
            };
            scene.tracks[0].trajectory = Trajectory::new((0..41).map(smooth).collect());
            let mut entries = scene.tracks[0].trajectory.entries().to_vec();
            keeper.keep(&mut entries, &(0..41).map(|t| u8::from(t >= N_OBSERVED)).collect::<Vec<_>>());
            let steps_m = entries.windows(2).map(|pair| pair[1].unwrap().position.distance(pair[0].unwrap().position));
            let steps_m: Vec<f64> = steps_m.collect();
            let most_m = steps_m.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
            assert!(most_m < 4e-3, "{most_m}");
        }
    }

    #[test]
    fn samples_keep_lanes() {
        let scene = traffic(&[10.0], |_, _| 0.4);
        let batch = collator([&scene], StateParametrization::Motion).predictive(&[&scene], FutureValidity::Everything);
        let latent = batch.latent.unsqueeze(3).unwrap();
        let drifting = (&batch.x0 + 0.05).unwrap().broadcast_mul(&latent).unwrap();
        let sample = &batch.decode_scenes(&drifting, &[&scene]).unwrap()[0];
        // As far as the corner of the lane is rounded off.
        assert!((N_OBSERVED..15).all(|t| (sample.state(0, t).unwrap().position.y - 0.4).abs() < 1e-9));
        let elsewhere = Scene { lanes: Arc::default(), ..scene };
        let sample = &batch.decode_scenes(&drifting, &[&elsewhere]).unwrap()[0];
        assert!((sample.state(0, 19).unwrap().position.y - 0.4).abs() > 1e-3);
    }

    #[test]
    fn a_steady_speed_is_kept_and_braking_stays() {
        let latent: Vec<u8> = (0..41).map(|t| u8::from(t >= N_OBSERVED)).collect();
        let behind_m = |deceleration_mps2: f64| {
            let mut scene = traffic(&[10.0], |_, _| 0.4);
            let keeper = keepers(&scene)[0].clone().unwrap();
            let later = |(t, state): (usize, &Option<State>)| {
                let since_s = 0.1 * t.saturating_sub(N_OBSERVED - 1) as f64;
                let back = Vec2::new(-0.5 * deceleration_mps2 * since_s * since_s, 0.0);
                state.map(|state| State { position: state.position + back, ..state })
            };
            let track = &mut scene.tracks[0].trajectory;
            let mut entries: Vec<Option<State>> = track.entries().iter().enumerate().map(later).collect();
            keeper.keep(&mut entries, &latent);
            40.0 - entries[40].unwrap().position.x
        };
        // The second half of the way is turned by 10 mrad.
        assert!(behind_m(0.05).abs() < 2e-3 + 0.4 * 0.01 + 20.0 * 0.5e-4);
        assert!((behind_m(0.2) - 0.9).abs() < 0.01);
    }

    #[test]
    fn who_leaves_its_offset_and_who_never_kept_it_is_left_alone() {
        // Leaves by 45 cm.
        let leaving = traffic(&[10.0], |_, t| 0.015 * t.saturating_sub(N_OBSERVED) as f64);
        let mut entries = leaving.tracks[0].trajectory.entries().to_vec();
        let latent: Vec<u8> = (0..41).map(|t| u8::from(t >= N_OBSERVED)).collect();
        keepers(&leaving)[0].clone().unwrap().keep(&mut entries, &latent);
        assert_eq!(entries, leaving.tracks[0].trajectory.entries());
        // Observed at five millimeters about its middle; observed again later.
        assert!(keepers(&traffic(&[10.0], |_, t| 0.005 * (t % 2) as f64))[0].is_none());
        let small = traffic(&[10.0], |_, t| 0.002 * t.saturating_sub(N_OBSERVED) as f64);
        let mut entries = small.tracks[0].trajectory.entries().to_vec();
        let until_goal: Vec<u8> = (0..41).map(|t| u8::from((N_OBSERVED..40).contains(&t))).collect();
        keepers(&small)[0].clone().unwrap().keep(&mut entries, &until_goal);
        assert_eq!(entries, small.tracks[0].trajectory.entries());
    }

    #[test]
    fn who_stands_keeps_its_lane_where_those_who_move_do() {
        let jitters = |agent: usize, t: usize| if agent == 1 { 0.01 * (t % 2) as f64 } else { 0.3 };
        let kept = |speeds: &[f64]| keepers(&traffic(speeds, jitters)).iter().map(Option::is_some).collect::<Vec<_>>();
        assert_eq!(kept(&[0.0, 10.0, 10.0]), [true, false, true]);
        assert_eq!(kept(&[0.0, 10.0]), [false, false]);
        assert_eq!(kept(&[0.0]), [false], "nobody shows it");
    }
}
