//! A vehicle crosses into the lane of another: when, how far does each move over, and would the ego still be cut off if
//! it drove straight?

use super::CutIn;
use crate::behavior::footprint::Footprint;
use crate::behavior::intrusion::Intrusion;
use crate::behavior::kept_lane::KeptLane;
use crate::geometry::{Projection, Vec2, angle_difference};
use crate::scene::{Scene, State, Track};

/// How long the other must stay in the lane, and how long after its arrival in the lane both may still move over,
/// seconds.
const SETTLING_S: f64 = 1.0;
/// Both must move at least this fast, m/s: a standing agent is not cut off, and its heading may be noise.
const MIN_SPEED_MPS: f64 = 1.0;

/// Lanes merge if their center lines are closer than the second this far ahead, meters.
const MERGES_M: f64 = 50.0;
const MERGED_M: f64 = 1.0;

/// A pair (ego, other), relative to the lane that the ego keeps.
pub(super) struct LaneCrossing<'a> {
    pub(super) scene: &'a Scene,
    pub(super) pair: [usize; 2],
    pub(super) lane: &'a KeptLane,
    pub(super) behavior: &'a CutIn,
}

/// The other comes into the lane ahead of the ego.
pub(super) struct Crossing {
    /// When its box first is in the strip that the ego sweeps; t_other.
    pub(super) intrusion: usize,
    /// When the ego is there; t_ego.
    pub(super) reached: usize,
    /// When its center crosses the side of the lane.
    pub(super) crossing: usize,
    /// How far the ego moves toward the other, meters.
    pub(super) ego_shift_m: f64,
    /// Their relation at the intrusion.
    pub(super) moment: Intrusion,
}

/// The place of an agent relative to the lane.
#[derive(Clone, Copy)]
struct LanePlace {
    station_m: f64,
    /// Positive to the left of the center line.
    offset_m: f64,
    /// Direction of the lane.
    heading_rad: f64,
    /// Half the extent of its box along and across the lane.
    half_along_m: f64,
    half_across_m: f64,
}

impl LaneCrossing<'_> {
    /// The cut-in, if there is one. `others_lane` returns the lane that the other keeps.
    pub(super) fn find<'l>(&self, others_lane: impl Fn() -> Option<&'l KeptLane>) -> Option<Crossing> {
        let scene = self.scene;
        let [ego, other] = self.pair.map(|agent_idx| &scene.tracks[agent_idx]);
        let (present, end) = (scene.current_timestep(), scene.n_timesteps);
        let side = if self.place(other, present)?.offset_m < 0.0 { -1.0 } else { 1.0 };
        let crossing = self.crossed(other, side)?;
        let places: Vec<[Option<LanePlace>; 2]> = (0..end)
            .map(|t| if t < present { [None, None] } else { [self.place(ego, t), self.place(other, t)] })
            .collect();
        let (intrusion, reached) = self.replayed(&places)?;
        if !self.is_ahead(&places, crossing, intrusion)
            || self.is_behind_a_third(&places[crossing.max(intrusion)], crossing.max(intrusion))
            || !self.is_met(&places)
        {
            return None;
        }
        let last = (crossing.max(intrusion) + self.n_settling()).min(end - 1);
        let moved_m = |who: usize, toward: f64| {
            let start = places[present][who]?;
            let offsets = places[present..=last].iter().filter_map(|places| places[who]);
            offsets.map(|place| toward * (place.offset_m - start.offset_m)).reduce(f64::max)
        };
        let (shift_m, ego_shift_m) = (moved_m(1, -side)?, moved_m(0, side)?);
        if shift_m < self.behavior.min_shift_m || shift_m <= ego_shift_m {
            return None;
        }
        let keeps = |others: &KeptLane, end: usize| {
            (present..=end).all(|t| state(other, t).is_none_or(|state| others.holds(state.position)))
        };
        let others = others_lane();
        // Where the two lanes merge ahead, the offsets of both vehicles are the same.
        let merging = others.filter(|others| self.merges_ahead(others, state(other, crossing)));
        let is_mutual = merging.is_some_and(|others| keeps(others, crossing));
        if !is_mutual && others.is_some_and(|others| keeps(others, last)) {
            return None;
        }
        let across_m = |track: &Track| across_headings_m(track, present, last);
        if is_mutual && side * across_m(ego)? >= -side * across_m(other)? {
            return None;
        }
        let moment = self.moment(intrusion, &places[intrusion], side, shift_m)?;
        Some(Crossing { intrusion, reached, crossing, ego_shift_m, moment })
    }

    /// Whether the lane of the other leads into that of the ego within [`MERGES_M`] ahead of the other.
    fn merges_ahead(&self, others: &KeptLane, other: Option<&State>) -> bool {
        let apart_m = other.and_then(|state| {
            let station_m = others.project(state.position)?.station_m + MERGES_M;
            Some(self.lane.project(others.point_at(station_m)?)?.offset_m.abs())
        });
        self.lane.joins(others) && apart_m.is_some_and(|apart_m| apart_m < MERGED_M)
    }

    /// The timestep from which the other, which comes from `side`, has its center in the lane, having headed along it
    /// until then. `None` also if it soon goes back.
    fn crossed(&self, other: &Track, side: f64) -> Option<usize> {
        let (present, end) = (self.scene.current_timestep(), self.scene.n_timesteps);
        let beyond_m = |t: usize, side: f64| self.lane.beyond_m(state(other, t)?.position, side);
        let is_outside = |t: usize| beyond_m(t, side).is_some_and(|beyond_m| beyond_m > 0.0);
        let is_in =
            |t: usize| [side, -side].into_iter().all(|side| beyond_m(t, side).is_some_and(|beyond_m| beyond_m <= 0.0));
        let is_along = |t: usize| {
            let found = state(other, t).and_then(|state| Some((state, self.lane.project(state.position)?)));
            found.is_none_or(|(state, place)| {
                angle_difference(state.heading_rad, place.heading_rad).abs() < super::ALONG_RAD
            })
        };
        let crossing = (self.scene.n_history..end).find(|timestep| is_in(*timestep))?;
        let goes_back = (crossing..end.min(crossing + self.n_settling())).any(is_outside);
        (is_outside(present) && !goes_back && (present..=crossing).all(is_along)).then_some(crossing)
    }

    /// Whether the other is ahead of the ego when it crosses and when it intrudes, clear of it when both have happened,
    /// and the ego in its lane until then.
    fn is_ahead(&self, places: &[[Option<LanePlace>; 2]], crossing: usize, intrusion: usize) -> bool {
        let both = |t: usize| places[t][0].zip(places[t][1]);
        let is_ahead = |t: usize| both(t).is_some_and(|(own, theirs)| theirs.station_m > own.station_m);
        let come_in = crossing.max(intrusion);
        let ego = &self.scene.tracks[self.pair[0]];
        let keeps = |t: usize| state(ego, t).is_none_or(|state| self.lane.holds(state.position));
        is_ahead(crossing)
            && is_ahead(intrusion)
            && both(come_in).is_some_and(|(own, theirs)| self.gap_m(&own, &theirs) >= 0.0)
            && (self.scene.current_timestep()..=come_in).all(keeps)
    }

    /// Whether somebody else is in the lane between the two when the other has come in.
    fn is_behind_a_third(&self, places: &[Option<LanePlace>; 2], come_in: usize) -> bool {
        let Some((own, theirs)) = places[0].zip(places[1]) else { return false };
        let is_between = |track: &Track| {
            let Some(at) = state(track, come_in).map(|state| state.position) else { return false };
            let is_inside = || [1.0, -1.0].iter().all(|side| self.lane.beyond_m(at, *side).is_some_and(|m| m <= 0.0));
            let station_m = self.lane.project(at).map(|place| place.station_m);
            station_m.is_some_and(|m| own.station_m < m && m < theirs.station_m) && is_inside()
        };
        let mut thirds = (0..self.scene.tracks.len()).filter(|agent_idx| !self.pair.contains(agent_idx));
        thirds.any(|agent_idx| is_between(&self.scene.tracks[agent_idx]))
    }

    /// Whether the other comes into the way of the driving ego: ahead of it, and beside the place at which the ego
    /// passes it, or the ego's last place, by at most half of both widths.
    fn is_met(&self, places: &[[Option<LanePlace>; 2]]) -> bool {
        let [own_m, their_m] = self.pair.map(|agent_idx| self.scene.tracks[agent_idx].extent_or_nominal().width_m);
        let is_in_way = |timestep: usize| {
            let Some((own, theirs)) = places[timestep][0].zip(places[timestep][1]) else { return false };
            let driven = places[timestep..].iter().filter_map(|places| places[0]);
            let passing =
                driven.clone().find(|place| place.station_m >= theirs.station_m).or_else(|| driven.clone().next_back());
            let beside_m = passing.map_or(f64::INFINITY, |place| (theirs.offset_m - place.offset_m).abs());
            theirs.station_m > own.station_m && beside_m <= (own_m + their_m) / 2.0
        };
        !is_in_way(self.scene.current_timestep()) && (self.scene.n_history..self.scene.n_timesteps).any(is_in_way)
    }

    /// The relation of the two at a timestep. `None` if one of them stands still.
    fn moment(&self, timestep: usize, places: &[Option<LanePlace>; 2], side: f64, shift_m: f64) -> Option<Intrusion> {
        let [ego, other] = self.pair.map(|agent_idx| &self.scene.tracks[agent_idx]);
        let (own, theirs) = (places[0]?, places[1]?);
        let (ego_state, other_state) = (state(ego, timestep)?, state(other, timestep)?);
        if ego_state.speed_mps().min(other_state.speed_mps()) < MIN_SPEED_MPS {
            return None;
        }
        Some(Intrusion {
            ego_speed_mps: ego_state.speed_mps(),
            other_speed_mps: other_state.speed_mps(),
            relative_speed_mps: ego_state.velocity.dot(Vec2::from_angle(own.heading_rad))
                - other_state.velocity.dot(Vec2::from_angle(theirs.heading_rad)),
            gap_m: self.gap_m(&own, &theirs),
            lateral_speed_mps: -side * Vec2::from_angle(theirs.heading_rad).cross(other_state.velocity),
            side,
            ego_length_m: ego.extent_or_nominal().length_m,
            other_length_m: other.extent_or_nominal().length_m,
            shift_m: Some(shift_m),
        })
    }

    /// The distance from the front of the ego to the rear of the other, along the lane.
    fn gap_m(&self, own: &LanePlace, theirs: &LanePlace) -> f64 {
        let half_length_m = self.scene.tracks[self.pair[0]].extent_or_nominal().length_m / 2.0;
        theirs.station_m - theirs.half_along_m - own.station_m - half_length_m
    }

    fn n_settling(&self) -> usize {
        (SETTLING_S / self.scene.dt_s).round() as usize
    }

    fn place(&self, track: &Track, timestep: usize) -> Option<LanePlace> {
        let state = state(track, timestep)?;
        let Projection { station_m, offset_m, heading_rad, .. } = self.lane.project(state.position)?;
        let body = Footprint::new(&track.footprint(state));
        let along = Vec2::from_angle(heading_rad);
        let (half_along_m, half_across_m) = (body.half_extent_m(along), body.half_extent_m(along.left()));
        Some(LanePlace { station_m, offset_m, heading_rad, half_along_m, half_across_m })
    }

    /// (t_other, t_ego) with the ego replayed straight along its lane. `None` also if the other is in its strip already
    /// at present.
    fn replayed(&self, places: &[[Option<LanePlace>; 2]]) -> Option<(usize, usize)> {
        let (scene, extent) = (self.scene, self.scene.tracks[self.pair[0]].extent_or_nominal());
        let kept_offset_m = places[scene.current_timestep()][0]?.offset_m;
        let is_in_strip =
            |place: &LanePlace| (place.offset_m - kept_offset_m).abs() <= extent.width_m / 2.0 + place.half_across_m;
        if is_in_strip(&places[scene.current_timestep()][1]?) {
            return None;
        }
        // Delays that are a whole number of timesteps up to rounding, such as 30 of 0.1 s, are excluded.
        let max_delay = (self.behavior.max_delay_s / scene.dt_s - 1e-6).floor().max(0.0) as usize;
        (scene.n_history..scene.n_timesteps).find_map(|timestep| {
            let theirs = places[timestep][1].filter(is_in_strip)?;
            let is_there = |own: &LanePlace| {
                (own.station_m - theirs.station_m).abs() <= extent.length_m / 2.0 + theirs.half_along_m
            };
            let later = timestep + 1..scene.n_timesteps.min(timestep + max_delay + 1);
            let reached = later.into_iter().find(|t| places[*t][0].as_ref().is_some_and(is_there))?;
            Some((timestep, reached))
        })
    }
}

fn state(track: &Track, timestep: usize) -> Option<&State> {
    track.trajectory.get(timestep).filter(|state| state.is_finite())
}

/// How far an agent moves to the left between two timesteps (or the first and last between them at which it is
/// tracked), across the mean of its headings at both, meters: 0 on an even bend.
fn across_headings_m(track: &Track, from: usize, to: usize) -> Option<f64> {
    let mut states = (from..=to).filter_map(|timestep| state(track, timestep));
    let first = states.next()?;
    let last = states.next_back().unwrap_or(first);
    let heading_rad = first.heading_rad + angle_difference(last.heading_rad, first.heading_rad) / 2.0;
    Some(Vec2::from_angle(heading_rad).cross(last.position - first.position))
}
