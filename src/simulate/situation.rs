//! A scenario of a corpus as the start of a drive: its past, its map, its event, and the route of its ego.

use super::arrivals::{Arrivals, Ends, Recorded};
use super::bends::{BendSpeeds, rounded};
use super::event::is_decided_by_ego;
use super::world::World;
use super::{Error, Result};
use crate::behavior::driven_path::DrivenPath;
use crate::behavior::footprint::Bounds;
use crate::behavior::kept_lane::way_on;
use crate::geometry::{OrientedBox, Vec2};
use crate::metrics::Road;
use crate::scenario::ScenarioRecord;
use crate::scene::{Lane, LaneGraph, LaneId, ObservationMask, Scene, State, Track, Trajectory};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Agents farther than this from the middle of every lane, meters, have left the map.
const OFF_MAP_M: f64 = 10.0;
/// The model sees lanes this close to an agent, meters, as in scenes.
const LANES_WITHIN_M: f64 = 100.0;
/// The map is known this far around the ego at present, meters: farther than a drive leads, since maps of cities are
/// large.
const MAP_WITHIN_M: f64 = 400.0;
/// How far the route of the ego goes on after the scenario, meters.
const WAY_ON_M: f64 = 300.0;

/// A scenario as the start of a drive.
#[derive(Clone)]
pub struct Situation {
    /// The scenario.
    pub scenario_id: String,
    /// The requested behavior.
    pub behavior: Option<String>,
    /// The parameters of its event.
    pub parameters: BTreeMap<String, f64>,
    /// The scenario, with the lanes of its map around the ego.
    pub scene: Scene,
    /// The driven agent.
    pub ego_idx: usize,
    /// The agents of the event, in the order of its roles.
    pub roles: Vec<usize>,
    /// The agents of the event other than the ego.
    pub planned: Vec<usize>,
    /// The first and the last timestep of the event; the present if there is none.
    pub event: [usize; 2],
    /// Whether the event is a collision.
    pub is_collision: bool,
    /// Whether the event is kept in aim where the ego drives otherwise.
    pub(super) aims: bool,
    /// The ego's largest speed in the scenario, m/s, at which it would like to drive.
    pub target_speed_mps: f64,
    /// The route of the ego: its path in the scenario, and on along its lane.
    pub(crate) route: DrivenPath,
    /// How fast it takes the bends after the scenario.
    bend_speeds: BendSpeeds,
    /// The arrivals: the last tracks of the scene, absent at present.
    pub(super) arrivals: Arrivals,
    road: Arc<Road>,
    /// The rectangle around the middle of each lane.
    lane_bounds: Vec<Option<Bounds>>,
    /// Whether each agent is on the map at present, and whether it overlaps the ego there.
    starts_on_map: Vec<bool>,
    starts_in_ego: Vec<bool>,
    starts_on_road: bool,
}

impl Situation {
    /// The start of a scenario for its agent `ego_idx`; `map` is the whole map in the frame of the recording.
    ///
    /// # Errors
    /// [`Error::Unfit`] when the ego is absent at present, or has no route.
    pub fn new(record: &ScenarioRecord, ego_idx: usize, map: Option<&LaneGraph>) -> Result<Self> {
        let unfit = |why: &str| Error::Unfit { scenario_id: record.scenario.id.clone(), why: why.to_owned() };
        let mut scene = record.scenario.scene.clone();
        let present = scene.current_timestep();
        let now = scene.state(ego_idx, present).filter(|state| state.is_finite());
        let now = *now.ok_or_else(|| unfit("has no state of its ego at present"))?;
        if let Some(map) = map {
            let center = scene.world_from_scene.point(now.position);
            let near = map.subset(&near(map, &bounds(map), &[center], MAP_WITHIN_M));
            scene.lanes = Arc::new(near.into_frame(&scene.world_from_scene.inverse()));
        }
        let ego = &scene.tracks[ego_idx];
        let driven: Vec<&State> = (present..scene.n_timesteps).map_while(|t| scene.state(ego_idx, t)).collect();
        let target_speed_mps = driven.iter().map(|state| state.speed_mps()).fold(0.0, f64::max);
        let mut points: Vec<Vec2> = driven.iter().map(|state| state.position).collect();
        let ended = Scene { n_timesteps: present + driven.len(), ..scene.clone() };
        let (last, on) = (points[points.len() - 1], way_on(&ended, ego_idx, WAY_ON_M));
        points.extend(rounded(&[vec![last], on].concat()));
        if points.iter().all(|point| point.distance(now.position) < 1.0) {
            points = vec![now.position, now.position + Vec2::from_angle(now.heading_rad) * WAY_ON_M];
        }
        let length_m = ego.extent_or_nominal().length_m;
        let route = DrivenPath::along(&points, length_m).ok_or_else(|| unfit("has no way for its ego"))?;
        let bend_speeds = BendSpeeds::new(&route, route.driven_m(last).unwrap_or_default());
        let event = record.main_event();
        let roles: Vec<usize> = event
            .map_or_else(Vec::new, |event| event.roles.tracks().filter_map(|track| scene.track_idx(track)).collect());
        let mut situation = Self {
            scenario_id: record.scenario.id.clone(),
            behavior: record.requested_behavior.clone(),
            parameters: event.map(|event| event.parameters.clone()).unwrap_or_default(),
            ego_idx,
            planned: roles.iter().copied().filter(|idx| *idx != ego_idx).collect(),
            roles,
            event: event.map_or([present; 2], |event| [event.start_timestep, event.end_timestep]),
            is_collision: record.asks_for_collision(),
            aims: !is_decided_by_ego(record.requested_behavior.as_deref()),
            target_speed_mps,
            route,
            bend_speeds,
            arrivals: Arrivals::default(),
            road: Arc::new(Road::new(&scene.lanes)),
            lane_bounds: bounds(&scene.lanes),
            starts_on_map: Vec::new(),
            starts_in_ego: Vec::new(),
            starts_on_road: false,
            scene,
        };
        situation.look_at_present(&now);
        situation.starts_on_road = situation.off_road_m(&now).is_some_and(|off_m| off_m <= 0.0);
        Ok(situation)
    }

    /// Expects arrivals for `n_steps` timesteps, and at least as many as a world with `n_tracks` does.
    pub(super) fn expect(&mut self, ends: &Arc<Ends>, recorded: &Recorded, seed: u64, [n_steps, n_tracks]: [usize; 2]) {
        let sizes = [n_steps, n_tracks.saturating_sub(self.scene.tracks.len())];
        let (scene, scene_from_world) = (&self.scene, self.scene.world_from_scene.inverse());
        let has_map = |state: &State| self.is_on_map(&state.transformed(&scene_from_world));
        let asked = (scene, self.scenario_id.as_str(), seed);
        let (arrivals, tracks) = Arrivals::expect(ends, recorded, asked, has_map, sizes);
        self.arrivals = arrivals;
        self.starts_on_map.extend(tracks.iter().map(|_| true));
        self.starts_in_ego.extend(tracks.iter().map(|_| false));
        self.scene.tracks.extend(tracks);
    }

    /// Finds which agents are on the map at present and which overlap the ego, whose state is `ego`.
    fn look_at_present(&mut self, ego: &State) {
        let at = |idx: usize| self.scene.state(idx, self.scene.current_timestep());
        let idxs = 0..self.scene.tracks.len();
        let on_map = idxs.clone().map(|idx| at(idx).is_some_and(|state| self.is_on_map(state))).collect();
        let in_ego = idxs.map(|idx| at(idx).is_some_and(|state| self.overlap([(self.ego_idx, ego), (idx, state)])));
        (self.starts_in_ego, self.starts_on_map) = (in_ego.collect(), on_map);
    }

    /// The situation with the other agents of the event `n_steps` timesteps later in everything they do. `None` if
    /// there are none, or one of them would overlap an agent in the past that was apart from it.
    pub(crate) fn delayed(&self, n_steps: usize) -> Option<Self> {
        let mut delayed = self.clone();
        for agent_idx in &self.planned {
            delayed.scene.tracks[*agent_idx].trajectory = later(&self.scene, *agent_idx, n_steps);
        }
        delayed.event = self.event.map(|timestep| timestep + n_steps);
        // The delay is intended, so the event is not aimed for.
        delayed.aims = false;
        delayed.look_at_present(&self.scene.state(self.ego_idx, self.scene.current_timestep()).copied()?);
        let meets = |situation: &Self, one: usize, other: usize, timestep: usize| {
            let [a, b] = [one, other].map(|idx| situation.scene.state(idx, timestep).map(|state| (idx, state)));
            a.zip(b).is_some_and(|(a, b)| situation.overlap([a, b]))
        };
        let is_free = |one: usize| {
            (0..self.scene.tracks.len()).filter(|other| *other != one).all(|other| {
                let mut past = 0..self.scene.n_history;
                past.all(|timestep| !meets(&delayed, one, other, timestep) || meets(self, one, other, timestep))
            })
        };
        (!self.planned.is_empty() && self.planned.iter().all(|idx| is_free(*idx))).then_some(delayed)
    }

    /// The world at present, with this seed.
    pub fn start(&self, seed: u64) -> World {
        let tracks = self.scene.tracks.iter().map(|track| &track.trajectory.entries()[..self.scene.n_history]);
        // Many an event is complete before its maneuver is: a vehicle cutting in is not in the lane yet. See `let_go`.
        let ends = if is_decided_by_ego(self.behavior.as_deref()) { self.event[1] } else { self.scene.n_timesteps };
        World::new(&self.scenario_id, seed, ends.min(self.scene.n_timesteps - 1), tracks)
    }

    /// The speed at which the ego would like to drive at a place of its route, m/s.
    pub(super) fn wanted_speed_mps(&self, at: Vec2) -> f64 {
        let in_bend_mps = self.route.driven_m(at).map_or(f64::INFINITY, |driven_m| self.bend_speeds.at(driven_m));
        self.target_speed_mps.min(in_bend_mps)
    }

    /// The box of an agent in this state; the least of its class if its size is unknown.
    pub(super) fn body(&self, agent_idx: usize, state: &State) -> OrientedBox {
        let extent = self.scene.tracks[agent_idx].extent_or_least();
        let State { position: center, heading_rad, .. } = *state;
        OrientedBox { center, heading_rad, length_m: extent.length_m, width_m: extent.width_m }
    }

    /// Whether the boxes of two agents overlap.
    pub(super) fn overlap(&self, [(a, one), (b, other)]: [(usize, &State); 2]) -> bool {
        self.body(a, one).overlaps(&self.body(b, other))
    }

    /// Whether an overlap of an agent with the ego counts; not if there is one at present already.
    pub(super) fn can_touch(&self, agent_idx: usize) -> bool {
        agent_idx != self.ego_idx && !self.starts_in_ego[agent_idx]
    }

    /// How far off the road an ego that starts on it is, meters. `None` where the map does not show the road.
    pub(super) fn ego_off_road_m(&self, state: &State) -> Option<f64> {
        self.starts_on_road.then(|| self.off_road_m(state))?
    }

    pub(super) fn off_road_m(&self, state: &State) -> Option<f64> {
        (!self.scene.lanes.is_empty()).then(|| self.road.distance_m(state.position))
    }

    fn is_on_map(&self, state: &State) -> bool {
        let mut lanes = self.scene.lanes.lanes().iter().zip(&self.lane_bounds);
        self.scene.lanes.is_empty() || lanes.any(|(lane, bounds)| is_near(lane, *bounds, state.position, OFF_MAP_M))
    }

    /// Whether an agent was on the map at present and is off it now.
    pub(super) fn has_left_map(&self, agent_idx: usize, state: &State) -> bool {
        self.starts_on_map[agent_idx] && !self.is_on_map(state)
    }

    /// Whether an agent has gone since an earlier timestep where no traffic of the place is seen. Agents of the event
    /// may do so until it has happened, and are gone then.
    pub(super) fn goes_out_of_sight(&self, world: &World, agent_idx: usize, since: usize) -> bool {
        let is_out = |timestep: usize| {
            let state = world.state(agent_idx, timestep);
            state.is_some_and(|state| self.arrivals.is_out_of_sight(self, &state))
        };
        let now = world.now();
        let since = match self.roles.contains(&agent_idx) {
            true if now <= world.plan_ends => return false,
            true => self.scene.current_timestep(),
            false => since,
        };
        is_out(now) && !is_out(since)
    }

    /// The scene of all reached states; its past is the scenario's.
    pub fn driven(&self, world: &World) -> Scene {
        let mut scene = self.cut(world, 0, world.n_timesteps(), self.scene.n_history);
        for track in &mut scene.tracks {
            track.trajectory = track.trajectory.with_velocities_from_positions(scene.n_history, scene.dt_s);
        }
        scene
    }

    /// The lanes of a `sampled` scene with those around what was `driven` from a timestep on; `None` if there are no
    /// more.
    pub(super) fn lanes_along(&self, sampled: &Scene, driven: &Scene, from: usize) -> Option<Arc<LaneGraph>> {
        let later = driven.tracks.iter().flat_map(|track| track.trajectory.valid().filter(|(t, _)| *t >= from));
        let later: Vec<Vec2> = later.map(|(_, state)| state.position).collect();
        let mut ids: Vec<LaneId> = sampled.lanes.lanes().iter().map(|lane| lane.id).collect();
        let n_before = ids.len();
        let more = near(&self.scene.lanes, &self.lane_bounds, &later, LANES_WITHIN_M);
        ids.extend(more.into_iter().filter(|id| sampled.lanes.get(*id).is_none()));
        (ids.len() > n_before).then(|| Arc::new(self.scene.lanes.subset(&ids)))
    }

    /// The last `n_history` timesteps of the world as the past of a scene of `n_timesteps`, with the plans of the
    /// agents of the event if it `knows_plans`, and the `expected` states of the ego; and the mask that shows just
    /// these.
    pub(super) fn window(
        &self,
        world: &World,
        expected: Option<&[State]>,
        knows_plans: bool,
        [n_history, n_timesteps]: [usize; 2],
    ) -> (Scene, ObservationMask) {
        let first = world.n_timesteps() - n_history;
        let mut scene = self.cut(world, first, n_timesteps, n_history);
        self.bring_in_arrivals(world, &mut scene);
        let planned = if knows_plans { self.planned.as_slice() } else { &[] };
        for agent_idx in planned.iter().copied().filter(|idx| world.present(*idx).is_some()) {
            let trajectory = &mut scene.tracks[agent_idx].trajectory;
            let entry = |(t, state): (usize, &Option<State>)| {
                if t < n_history { *state } else { self.plan(world, agent_idx, first + t) }
            };
            *trajectory = Trajectory::new(trajectory.entries().iter().enumerate().map(entry).collect());
        }
        if let Some(expected) = expected {
            let trajectory = &mut scene.tracks[self.ego_idx].trajectory;
            let past = trajectory.entries()[..n_history].iter().copied();
            let states = past.chain(expected.iter().map(|state| Some(*state))).take(n_timesteps).collect();
            *trajectory = Trajectory::new(states);
        }
        for track in &mut scene.tracks {
            track.trajectory = track.trajectory.with_velocities_from_positions(n_history, scene.dt_s);
        }
        let present: Vec<Vec2> = (0..scene.tracks.len()).filter_map(|i| world.present(i)).map(|s| s.position).collect();
        let ids = near(&self.scene.lanes, &self.lane_bounds, &present, LANES_WITHIN_M);
        if ids.len() < self.scene.lanes.lanes().len() {
            scene.lanes = Arc::new(self.scene.lanes.subset(&ids));
        }
        let mask = ObservationMask::from_fn(scene.tracks.len(), n_timesteps, |agent_idx, timestep| {
            let is_known = scene.state(agent_idx, timestep).is_some();
            timestep < n_history || (is_known && (agent_idx == self.ego_idx || planned.contains(&agent_idx)))
        });
        (scene, mask)
    }

    /// Leaves out the last tracks that have not arrived yet, and lets the others have come along as they arrived.
    fn bring_in_arrivals(&self, world: &World, scene: &mut Scene) {
        let n_before = scene.tracks.len() - self.arrivals.n_expected();
        let is_there = |idx: &usize| world.present(*idx).is_some();
        let n_kept = (n_before..scene.tracks.len()).rev().find(is_there).map_or(n_before, |idx| idx + 1);
        scene.tracks.truncate(n_kept);
        for track in &mut scene.tracks[n_before..] {
            track.trajectory = came_along(&track.trajectory, scene.dt_s);
        }
    }

    /// The planned state of an agent of the event at a timestep, while it follows the scenario.
    pub(super) fn plan(&self, world: &World, agent_idx: usize, timestep: usize) -> Option<State> {
        let is_planned = timestep <= world.plan_ends && self.planned.contains(&agent_idx);
        is_planned.then(|| match world.is_planned_anew(agent_idx) {
            true => world.planned(agent_idx, timestep),
            false => self.scene.state(agent_idx, timestep).copied(),
        })?
    }

    /// `n_timesteps` of the world from `first` on; states not reached yet are missing.
    fn cut(&self, world: &World, first: usize, n_timesteps: usize, n_history: usize) -> Scene {
        let track = |(agent_idx, track): (usize, &Track)| {
            let states = (first..first + n_timesteps).map(|timestep| world.state(agent_idx, timestep)).collect();
            Track { trajectory: Trajectory::new(states), ..track.clone() }
        };
        let tracks = self.scene.tracks.iter().enumerate().map(track).collect();
        Scene { tracks, n_timesteps, n_history, ego_idx: self.ego_idx, ..self.scene.clone() }
    }
}

/// The trajectory, extended to before its first state at the velocity of that one.
fn came_along(trajectory: &Trajectory, dt_s: f64) -> Trajectory {
    let Some((first, state)) = trajectory.valid().next().map(|(timestep, state)| (timestep, *state)) else {
        return trajectory.clone();
    };
    let entry = |(timestep, entry): (usize, &Option<State>)| {
        let before_s = first.checked_sub(timestep).map(|n_steps| n_steps as f64 * dt_s);
        before_s.map_or(*entry, |s| Some(State { position: state.position - state.velocity * s, ..state }))
    };
    Trajectory::new(trajectory.entries().iter().enumerate().map(entry).collect())
}

/// The lanes whose middle comes this close to any of these points.
fn near(lanes: &LaneGraph, bounds: &[Option<Bounds>], points: &[Vec2], within_m: f64) -> Vec<LaneId> {
    let is_near_one =
        |(lane, bounds): &(&Lane, &Option<Bounds>)| points.iter().any(|at| is_near(lane, **bounds, *at, within_m));
    lanes.lanes().iter().zip(bounds).filter(is_near_one).map(|(lane, _)| lane.id).collect()
}

/// The rectangle around the middle of each lane, in their order.
fn bounds(lanes: &LaneGraph) -> Vec<Option<Bounds>> {
    lanes.lanes().iter().map(|lane| Bounds::around(lane.centerline.0.iter().copied())).collect()
}

fn is_near(lane: &Lane, bounds: Option<Bounds>, at: Vec2, within_m: f64) -> bool {
    bounds.is_some_and(|bounds| bounds.contains(at, within_m))
        && lane.centerline.project(at).is_some_and(|place| place.offset_m.abs() <= within_m)
}

/// The trajectory of an agent `n_steps` later; before, it comes along at its first velocity.
fn later(scene: &Scene, agent_idx: usize, n_steps: usize) -> Trajectory {
    let entries = scene.tracks[agent_idx].trajectory.entries();
    let first = entries.iter().enumerate().find_map(|(t, state)| state.map(|state| (t, state)));
    let entry = |timestep: usize| {
        let (t, state) = first?;
        match timestep.checked_sub(n_steps).filter(|before| *before >= t) {
            Some(before) => entries[before],
            None if timestep < t => None,
            None => {
                let missing_s = (t + n_steps - timestep) as f64 * scene.dt_s;
                Some(State { position: state.position - state.velocity * missing_s, ..state })
            }
        }
    };
    Trajectory::new((0..entries.len()).map(entry).collect())
}

#[cfg(test)]
mod tests {
    use super::super::testing::{record, situation};
    use super::*;

    #[test]
    fn who_leaves_the_map_is_gone_and_who_was_never_on_it_stays() {
        let mut record = record();
        let ego_idx = record.subject_idx().unwrap();
        let far = |state: State| State { position: state.position + Vec2::new(0.0, 200.0), ..state };
        let stray = (0..record.scenario.scene.tracks.len()).find(|idx| *idx != ego_idx).unwrap();
        let before = situation(&record);
        let now = |situation: &Situation, idx: usize| situation.start(1).present(idx).unwrap();
        assert!(
            !before.has_left_map(stray, &now(&before, stray)) && before.has_left_map(stray, &far(now(&before, stray)))
        );
        let track = &mut record.scenario.scene.tracks[stray];
        let moved = track.trajectory.entries().iter().map(|state| state.map(far)).collect();
        track.trajectory = Trajectory::new(moved);
        let after = situation(&record);
        assert!(!after.has_left_map(stray, &now(&after, stray)));
        assert!(after.ego_off_road_m(&far(now(&after, ego_idx))).unwrap() > 10.0);
    }

    #[test]
    fn a_window_shows_the_last_second_and_the_plan_of_the_event() {
        let situation = situation(&record());
        let mut world = situation.start(1);
        for timestep in world.n_timesteps()..world.n_timesteps() + 5 {
            world.push((0..situation.scene.tracks.len()).map(|idx| situation.scene.state(idx, timestep).copied()));
        }
        let (scene, mask) = situation.window(&world, None, true, [10, 40]);
        assert_eq!((scene.n_history, scene.n_timesteps, mask.n_timesteps()), (10, 40, 40));
        let planned = situation.planned[0];
        for (agent_idx, timestep, is_shown) in
            [(situation.ego_idx, 9, true), (situation.ego_idx, 10, false), (planned, 10, true), (planned, 39, false)]
        {
            assert_eq!(mask.is_observed(agent_idx, timestep), is_shown, "{agent_idx} at {timestep}");
            let state = scene.state(agent_idx, timestep).map(|state| state.position);
            let expected = situation.scene.state(agent_idx, timestep + 5).filter(|_| is_shown).map(|s| s.position);
            assert_eq!(state, expected);
        }
        let expected = vec![State::default(); 30];
        let (scene, mask) = situation.window(&world, Some(&expected), true, [10, 40]);
        assert!(mask.is_observed(situation.ego_idx, 39) && scene.state(situation.ego_idx, 9) != Some(&expected[0]));
        assert_eq!(scene.state(situation.ego_idx, 20).map(|state| state.position), Some(Vec2::ZERO));
    }

    #[test]
    fn the_others_of_the_event_come_later_along_the_same_path() {
        let situation = situation(&record());
        let other = situation.planned[0];
        let delayed = situation.delayed(3).unwrap();
        for t in 3..situation.scene.n_timesteps {
            assert_eq!(delayed.scene.state(other, t), situation.scene.state(other, t - 3));
        }
        let [first, second] = [0, 1].map(|t| *delayed.scene.state(other, t).unwrap());
        let missed_m = (second.position - first.position - first.velocity * situation.scene.dt_s).norm();
        assert!(missed_m < 1e-9 && delayed.event == situation.event.map(|t| t + 3));
        for idx in (0..situation.scene.tracks.len()).filter(|idx| *idx != other) {
            assert_eq!(delayed.scene.tracks[idx].trajectory, situation.scene.tracks[idx].trajectory);
        }
    }
}
