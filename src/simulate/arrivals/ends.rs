//! Where traffic enters and leaves a place: at the ends of its map, or where scenes of the corpus first and last see
//! it, since maps mostly reach farther than recordings.

use super::{LEAST_MPS, without_states};
use crate::geometry::{Path, Polyline, Vec2, angle_difference};
use crate::quantile::quantile;
use crate::scene::{Lane, LaneGraph, LaneId, Scene, State, Track};
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// The distance from the end of the map within which traffic must first or last be seen on a lane, and the length of
/// the stretch on which flow is measured, meters; stretches shorter than the last say too little.
const IN_SIGHT_M: f64 = 100.0;
const STRETCH_M: f64 = 30.0;
const LEAST_STRETCH_M: f64 = 5.0;
/// Vehicles farther than this from the middle of a lane, meters, are not in it.
const IN_LANE_M: f64 = 2.0;
/// With fewer vehicles on the last stretch, it is unknown where traffic goes out of sight.
const LEAST_SEEN: usize = 10;

/// The ends of a place, in the frame of its recordings.
#[derive(Debug, Default)]
pub(in crate::simulate) struct Ends {
    pub(super) entries: Vec<End>,
    exits: Vec<End>,
}

/// A lane at the end of the map. No lane leads to it or to its neighbors: where lanes are added or end, traffic changes
/// lanes. An exit is an entry seen against the direction of traffic.
#[derive(Debug)]
pub(super) struct End {
    /// The lane and those that follow it up to where others join, each with its distance from the beginning.
    lanes: Vec<(Path, f64)>,
    /// Where traffic is first seen.
    pub(super) starts_at_m: f64,
    /// The median speed of vehicles that come into sight, m/s.
    enters_at_mps: Option<f64>,
    /// The vehicles on the stretch behind that point.
    pub(super) seen: Vec<Seen>,
}

/// A vehicle that a scene has just behind the end, and how many vehicles like it pass per second.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub(super) track: Track,
    pub(super) speed_mps: f64,
    pub(super) offset_m: f64,
    pub(super) rate_per_s: f64,
}

impl Ends {
    /// The ends of a map, estimated from different scenes on it.
    pub(in crate::simulate) fn of(map: &LaneGraph, scenes: &[Scene]) -> Self {
        let backwards = |lane: &Lane| Lane {
            centerline: Polyline(lane.centerline.0.iter().rev().copied().collect()),
            successors: lane.predecessors.clone(),
            predecessors: lane.successors.clone(),
            ..lane.clone()
        };
        let reversed = LaneGraph::new(map.lanes().iter().map(backwards).collect());
        Self { entries: ends(map, scenes, |state| state), exits: ends(&reversed, scenes, turned) }
    }

    pub(super) fn entry(&self, entry_idx: usize) -> Option<&End> {
        self.entries.get(entry_idx)
    }

    pub(super) fn entry_at(&self, state: &State) -> Option<usize> {
        at(&self.entries, state).map(|(entry_idx, _)| entry_idx)
    }

    /// An earlier place of a vehicle in an entry, and how many timesteps ago: at most `n_most`, and not before traffic
    /// is first seen. Since many brake for the traffic ahead, it is assumed to have entered as fast as others and to
    /// have braked evenly since, or later if there was no time for that.
    pub(super) fn before(&self, state: &State, n_most: usize, dt_s: f64) -> Option<(usize, State)> {
        let (entry_idx, [station_m, offset_m]) = at(&self.entries, state)?;
        let entry = self.entries.get(entry_idx).filter(|entry| entry.is_in_use())?;
        let (now_mps, driven_m) = (state.speed_mps(), (station_m - entry.starts_at_m).max(0.0));
        let entered_mps = entry.enters_at_mps.unwrap_or_default().max(now_mps);
        let since_s = 2.0 * driven_m / (now_mps + entered_mps);
        let n_back = n_most.min((since_s / dt_s).round() as usize);
        let was_m = (station_m - n_back as f64 * dt_s * entered_mps).max(entry.starts_at_m);
        let state = entry.state(was_m, entered_mps, offset_m)?;
        (n_back > 0).then_some((n_back, state))
    }

    /// Whether a vehicle is farther out than traffic is seen.
    pub(super) fn is_out_of_sight(&self, state: &State) -> bool {
        let Some((exit_idx, [station_m, _])) = at(&self.exits, &turned(*state)) else { return false };
        self.exits.get(exit_idx).is_some_and(|exit| {
            // One more vehicle would be seen about this much farther out.
            let spacing_m = STRETCH_M / exit.seen.len() as f64;
            exit.seen.len() >= LEAST_SEEN && station_m < exit.starts_at_m - spacing_m
        })
    }
}

/// The state with the opposite heading.
fn turned(state: State) -> State {
    State { heading_rad: state.heading_rad + PI, ..state }
}

/// The end in which a vehicle is, with its place there as defined by [`End::place`].
fn at(ends: &[End], state: &State) -> Option<(usize, [f64; 2])> {
    let places = ends.iter().map(|end| end.place(state)).enumerate();
    let places = places.filter_map(|(end_idx, place)| Some((end_idx, place?)));
    places.min_by(|(_, a), (_, b)| a[1].abs().total_cmp(&b[1].abs()))
}

/// The lanes of the map without a predecessor, with the vehicles seen there after their states are `faced`.
fn ends(map: &LaneGraph, scenes: &[Scene], faced: impl Fn(State) -> State) -> Vec<End> {
    let begins = |lane: &Lane| lane.predecessors.is_empty();
    let begins_beside = |id: &LaneId| map.get(*id).is_none_or(begins);
    let beside = |lane: &Lane| [lane.left_neighbor, lane.right_neighbor].into_iter().flatten();
    let begin = map.lanes().iter().filter(|lane| begins(lane) && beside(lane).all(|id| begins_beside(&id)));
    let end = |lane: &Lane| End {
        lanes: lanes_from(map, lane.id),
        starts_at_m: f64::INFINITY,
        enters_at_mps: None,
        seen: Vec::new(),
    };
    let mut ends: Vec<End> = begin.map(end).collect();
    let mut entered: Vec<Vec<f64>> = vec![Vec::new(); ends.len()];
    let mut present = Vec::new();
    for scene in scenes {
        for track in scene.tracks.iter().filter(|track| track.class.is_motorized()) {
            for (timestep, state) in track.trajectory.valid().take_while(|(t, _)| *t < scene.n_history) {
                let state = faced(state.transformed(&scene.world_from_scene));
                let Some((end_idx, [station_m, offset_m])) = at(&ends, &state) else { continue };
                ends[end_idx].starts_at_m = ends[end_idx].starts_at_m.min(station_m);
                if timestep > 0 && !track.trajectory.is_valid(timestep - 1) {
                    entered[end_idx].push(state.speed_mps());
                }
                if timestep == scene.current_timestep() {
                    present.push((end_idx, station_m, offset_m, state.speed_mps(), track));
                }
            }
        }
    }
    for (end, mut speeds) in ends.iter_mut().zip(entered) {
        speeds.sort_by(f64::total_cmp);
        end.enters_at_mps = quantile(&speeds, 0.5);
    }
    for (end_idx, station_m, offset_m, speed_mps, track) in present {
        let end = &mut ends[end_idx];
        let behind_m = station_m - end.starts_at_m;
        let length_m = (end.length_m() - end.starts_at_m).min(STRETCH_M);
        let is_behind = end.is_in_use() && length_m >= LEAST_STRETCH_M && behind_m <= length_m;
        if is_behind && speed_mps >= LEAST_MPS {
            let rate_per_s = speed_mps / (length_m * scenes.len() as f64);
            end.seen.push(Seen { track: without_states(track), speed_mps, offset_m, rate_per_s });
        }
    }
    ends
}

impl End {
    fn length_m(&self) -> f64 {
        self.lanes.iter().map(|(lane, start_m)| start_m + lane.length_m()).fold(0.0, f64::max)
    }

    /// Whether traffic comes along the lane, rather than out of houses farther on.
    const fn is_in_use(&self) -> bool {
        self.starts_at_m <= IN_SIGHT_M
    }

    /// The distance of a vehicle from the beginning of the lane, and to the left of its middle, meters.
    pub(super) fn place(&self, state: &State) -> Option<[f64; 2]> {
        let near = self.lanes.iter().filter(|(lane, _)| lane.may_come_within(state.position, IN_LANE_M));
        let places = near.filter_map(|(lane, start_m)| {
            let place = lane.project(state.position)?;
            let is_along = angle_difference(place.heading_rad, state.heading_rad).abs() < FRAC_PI_4;
            (is_along && place.point.distance(state.position) < IN_LANE_M)
                .then_some([start_m + place.station_m, place.offset_m])
        });
        places.min_by(|a, b| a[1].abs().total_cmp(&b[1].abs()))
    }

    /// The state of a vehicle at this place that drives along the lane.
    pub(super) fn state(&self, station_m: f64, speed_mps: f64, offset_m: f64) -> Option<State> {
        let holds = |(lane, start_m): &&(Path, f64)| start_m + lane.length_m() > station_m;
        let (lane, start_m) = self.lanes.iter().find(holds)?;
        let (middle, heading_rad) = lane.pose_at(station_m - start_m)?;
        let position = middle + Vec2::from_angle(heading_rad + FRAC_PI_2) * offset_m;
        Some(State { position, heading_rad, velocity: Vec2::from_angle(heading_rad) * speed_mps })
    }
}

/// A lane and those that follow it up to where others join, each with its distance from the beginning of the first.
fn lanes_from(map: &LaneGraph, first: LaneId) -> Vec<(Path, f64)> {
    let (mut lanes, mut known, mut open) = (Vec::new(), BTreeSet::from([first]), vec![(first, 0.0)]);
    while let Some((id, start_m)) = open.pop() {
        let Some(lane) = map.get(id) else { continue };
        let path = Path::new(lane.centerline.clone());
        let end_m = start_m + path.length_m();
        lanes.push((path, start_m));
        let joins_alone = |id: &&LaneId| map.get(**id).is_some_and(|lane| lane.predecessors.len() == 1);
        for id in lane.successors.iter().filter(joins_alone).filter(|_| end_m < IN_SIGHT_M + STRETCH_M) {
            if known.insert(*id) {
                open.push((*id, end_m));
            }
        }
    }
    lanes.sort_by(|a, b| a.1.total_cmp(&b.1));
    lanes
}
