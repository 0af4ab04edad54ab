//! A scenario of a corpus as the start of a drive: its past, its map, its event, and the route of its ego.

mod delay;
mod whereabouts;
mod window;

use self::whereabouts::{bounds, near};
use crate::behavior::footprint::Bounds;
use crate::geometry::OrientedBox;
use crate::metrics::{Road, Way, body};
use crate::scenario::ScenarioRecord;
use crate::scene::{LaneGraph, Roles, Scene, State};
use crate::simulate::arrivals::{Arrivals, Ends, Recorded};
use crate::simulate::event::is_decided_by_ego;
use crate::simulate::{Error, Result, World};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The map is known this far around the ego at present, meters: farther than a drive leads, since maps of cities are
/// large.
const MAP_WITHIN_M: f64 = 400.0;

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
    /// The roles of the event, and their agents, in the same order.
    pub event_roles: Roles,
    /// See `event_roles`.
    pub roles: Vec<usize>,
    /// The agents of the event other than the ego.
    pub planned: Vec<usize>,
    /// The first and the last timestep of the event; the present if there is none.
    pub event: [usize; 2],
    /// Whether the event is a collision.
    pub is_collision: bool,
    /// Whether the event is kept in aim where the ego drives otherwise.
    pub(in crate::simulate) aims: bool,
    /// Whether vehicles hold their place in the lane, rather than drift with each plan. In situations alone: elsewhere
    /// it neither helps nor harms for sure. Where places were held in bends, too, 88 of 120 ordinary closed loops of
    /// 30 s at the archive's places were valid rather than 85, trees told their tracks with an AUC of .886 rather than
    /// .888 (smoothed, .844 and .832), and `idm` and `model` survived the quickstart's 110 drives either way.
    pub(in crate::simulate) holds_places: bool,
    /// The way of the ego.
    pub way: Way,
    /// The arrivals: the last tracks of the scene, absent at present.
    pub(in crate::simulate) arrivals: Arrivals,
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
        let scene = record.scenario.scene.clone();
        let mut situation = Self::without_event(&record.scenario.id, scene, ego_idx, map)?;
        situation.behavior.clone_from(&record.requested_behavior);
        situation.is_collision = record.asks_for_collision();
        situation.aims = !is_decided_by_ego(record.requested_behavior.as_deref());
        let Some(event) = record.main_event() else { return Ok(situation) };
        situation.roles = event.roles.tracks().filter_map(|track| situation.scene.track_idx(track)).collect();
        situation.planned = situation.roles.iter().copied().filter(|idx| *idx != ego_idx).collect();
        situation.event_roles.clone_from(&event.roles);
        situation.parameters.clone_from(&event.parameters);
        situation.event = [event.start_timestep, event.end_timestep];
        Ok(situation)
    }

    /// The start of a scene without an event for its agent `ego_idx`, by the name of its noise.
    ///
    /// # Errors
    /// See [`Situation::new`].
    pub(in crate::simulate) fn without_event(
        name: &str,
        mut scene: Scene,
        ego_idx: usize,
        map: Option<&LaneGraph>,
    ) -> Result<Self> {
        let unfit = |why: &str| Error::Unfit { scenario_id: name.to_owned(), why: why.to_owned() };
        let present = scene.current_timestep();
        let now = scene.state(ego_idx, present).filter(|state| state.is_finite());
        let now = *now.ok_or_else(|| unfit("has no state of its ego at present"))?;
        if let Some(map) = map {
            let center = scene.world_from_scene.point(now.position);
            let near = map.subset(&near(map, &bounds(map), &[center], MAP_WITHIN_M));
            scene.lanes = Arc::new(near.into_frame(&scene.world_from_scene.inverse()));
        }
        let way = Way::of(&scene, ego_idx).ok_or_else(|| unfit("has no way for its ego"))?;
        let mut situation = Self {
            scenario_id: name.to_owned(),
            behavior: None,
            parameters: BTreeMap::new(),
            ego_idx,
            event_roles: Roles::default(),
            roles: Vec::new(),
            planned: Vec::new(),
            event: [present; 2],
            is_collision: false,
            aims: true,
            holds_places: false,
            way,
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
    pub(in crate::simulate) fn expect(
        &mut self,
        ends: &Arc<Ends>,
        recorded: &Recorded,
        seed: u64,
        [n_steps, n_tracks]: [usize; 2],
    ) {
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

    /// The world at present, with this seed.
    pub fn start(&self, seed: u64) -> World {
        let tracks = self.scene.tracks.iter().map(|track| &track.trajectory.entries()[..self.scene.n_history]);
        // Many an event is complete before its maneuver is: a vehicle cutting in is not in the lane yet. See `let_go`.
        let ends = if is_decided_by_ego(self.behavior.as_deref()) { self.event[1] } else { self.scene.n_timesteps };
        World::new(&self.scenario_id, seed, ends.min(self.scene.n_timesteps - 1), tracks)
    }

    /// The box of an agent in this state; the least of its class if its size is unknown.
    pub(in crate::simulate) fn body(&self, agent_idx: usize, state: &State) -> OrientedBox {
        body(&self.scene.tracks[agent_idx], state)
    }

    /// Whether the boxes of two agents overlap.
    pub(in crate::simulate) fn overlap(&self, [(a, one), (b, other)]: [(usize, &State); 2]) -> bool {
        self.body(a, one).overlaps(&self.body(b, other))
    }

    /// Whether an overlap of an agent with the ego counts; not if there is one at present already.
    pub(in crate::simulate) fn can_touch(&self, agent_idx: usize) -> bool {
        agent_idx != self.ego_idx && !self.starts_in_ego[agent_idx]
    }
}
