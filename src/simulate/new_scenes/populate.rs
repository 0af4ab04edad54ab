//! Puts road users into a recorded scene: vehicles and cyclists as they were seen at the place at other times, with
//! their pasts; pedestrians also where none was ever seen, beside the road.
//!
//! What they do next, and how everybody answers to them, is decided in the closed loop that follows. Only windows in
//! which their whole past is sampled become scenes.

use crate::behavior::way_on::{SETTLES_S, way_on};
use crate::geometry::{OrientedBox, Polyline, Vec2};
use crate::metrics::Road;
use crate::scene::{AgentClass, Extent, Scene, State, Track, TrackId, TrackRole, Trajectory};
use crate::seed::SeededRng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Road users are put this close to the ego, meters.
const WITHIN_M: f64 = 80.0;
/// The free way ahead of everybody, meters and seconds of driving: as arrivals need.
const GAP_M: f64 = 2.0;
const HEADWAY_S: f64 = 1.0;
/// Places that are tried for each.
const N_TRIED: usize = 60;
/// Walking speeds, m/s: mean and standard deviation of Weidmann (1993), within two deviations.
const WALKS_MPS: f64 = 1.34;
const WALKS_SD_MPS: f64 = 0.26;
/// How far from the road pedestrians walk, meters, how far from the middle of a lane this is looked for, and in which
/// steps.
const BESIDE_ROAD_M: [f64; 2] = [0.5, 2.0];
const ASIDE_M: [f64; 2] = [1.5, 12.0];
const ASIDE_STEP_M: f64 = 0.25;
/// Pedestrians are put where a vehicle arrives this long after the present, seconds, if it goes on at its speed.
const MET_S: [f64; 2] = [3.0, 9.0];
/// Slower vehicles, m/s, come to nobody.
const LEAST_MPS: f64 = 2.0;

/// How many road users of each kind are put into a scene, as far as there is room.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AddedConfig {
    /// Vehicles.
    #[schemars(range(max = 100))]
    pub vehicles: usize,
    /// Pedestrians.
    #[schemars(range(max = 100))]
    pub pedestrians: usize,
    /// Cyclists.
    #[schemars(range(max = 100))]
    pub cyclists: usize,
}

impl Default for AddedConfig {
    fn default() -> Self {
        Self { vehicles: 1, pedestrians: 1, cyclists: 0 }
    }
}

/// Puts road users into `scene`, drawn from the presents of `seen`, scenes of the same place. Returns how many.
pub(super) fn populate(scene: &mut Scene, seen: &[Scene], added: &AddedConfig, rng: &mut SeededRng) -> usize {
    let n_before = scene.tracks.len();
    let road = Road::new(&scene.lanes);
    let classes = |wanted: &[AgentClass]| wanted.to_vec();
    for (n, name, wanted) in [
        (added.vehicles, "vehicle", classes(&[AgentClass::Vehicle, AgentClass::Bus, AgentClass::Unknown])),
        (added.cyclists, "cyclist", classes(&[AgentClass::Cyclist, AgentClass::Motorcyclist])),
        (added.pedestrians, "pedestrian", classes(&[AgentClass::Pedestrian, AgentClass::PedestrianOrCyclist])),
    ] {
        let on_foot = name == "pedestrian";
        let known: Vec<(&Scene, &Track)> = candidates(seen, &wanted);
        for number in 0..n {
            let placed = (0..N_TRIED).find_map(|tried| {
                // Half of the pedestrians come as they were seen.
                let walks = on_foot && (known.is_empty() || tried % 2 == 1);
                let track = match known.get(rng.below(known.len().max(1))) {
                    _ if walks => walker(scene, &road, class_on_foot(seen), rng),
                    Some(known) => transplanted(scene, *known),
                    None => None,
                };
                track.filter(|track| fits(scene, track))
            });
            let Some(track) = placed else { break };
            let id = TrackId(format!("added_{name}_{}", number + 1));
            scene.tracks.push(Track { id, role: TrackRole::Context, ..track });
        }
    }
    scene.tracks.len() - n_before
}

/// The tracks of these classes that were observed throughout the pasts of their scenes and move.
fn candidates<'s>(seen: &'s [Scene], classes: &[AgentClass]) -> Vec<(&'s Scene, &'s Track)> {
    let of_scene = |scene: &'s Scene| scene.tracks.iter().map(move |track| (scene, track));
    let is_whole = |(scene, track): &(&Scene, &Track)| {
        let mut past = track.trajectory.entries().iter().take(scene.n_history);
        classes.contains(&track.class) && !track.is_parked() && past.all(Option::is_some)
    };
    seen.iter().flat_map(of_scene).filter(is_whole).collect()
}

/// How pedestrians of the dataset are classed.
fn class_on_foot(seen: &[Scene]) -> AgentClass {
    let mut tracks = seen.iter().flat_map(|scene| &scene.tracks);
    let unclear = tracks.any(|track| track.class == AgentClass::PedestrianOrCyclist);
    if unclear { AgentClass::PedestrianOrCyclist } else { AgentClass::Pedestrian }
}

/// A track of another scene of the place, with its past, in the frame of `scene`.
fn transplanted(scene: &Scene, (other, track): (&Scene, &Track)) -> Option<Track> {
    if other.n_history < scene.n_history || (other.dt_s - scene.dt_s).abs() > 1e-6 {
        return None;
    }
    let first = other.n_history - scene.n_history;
    let scene_from_world = scene.world_from_scene.inverse();
    let here = |state: &Option<State>| {
        state.map(|state| state.transformed(&other.world_from_scene).transformed(&scene_from_world))
    };
    let past = track.trajectory.entries()[first..other.n_history].iter().map(here);
    Some(Track { trajectory: with_past(scene, past), ..track.clone() })
}

/// Somebody who walks beside the road where a vehicle will come by.
fn walker(scene: &Scene, road: &Road, class: AgentClass, rng: &mut SeededRng) -> Option<Track> {
    let present = scene.current_timestep();
    let drives = |idx: &usize| {
        let state = scene.state(*idx, present);
        scene.tracks[*idx].class.is_motorized() && state.is_some_and(|state| state.speed_mps() >= LEAST_MPS)
    };
    let vehicles: Vec<usize> = (0..scene.tracks.len()).filter(drives).collect();
    let vehicle = *vehicles.get(rng.below(vehicles.len().max(1)))?;
    let now = scene.state(vehicle, present)?;
    let ahead_m = now.speed_mps() * (MET_S[0] + rng.uniform() * (MET_S[1] - MET_S[0]));
    let observed = Scene { n_timesteps: scene.n_history, ..scene.clone() };
    let way = Polyline([vec![now.position], way_on(&observed, vehicle, ahead_m + 1.0, SETTLES_S)].concat());
    let middle = way.point_at(ahead_m)?;
    let along = Vec2::from_angle(way.project(middle)?.heading_rad);
    let side = if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
    let n_steps = ((ASIDE_M[1] - ASIDE_M[0]) / ASIDE_STEP_M) as usize;
    let beside = (0..n_steps)
        .map(|step| middle + along.left() * (side * (ASIDE_M[0] + step as f64 * ASIDE_STEP_M)))
        .find(|at| (BESIDE_ROAD_M[0]..=BESIDE_ROAD_M[1]).contains(&road.distance_m(*at)))?;
    let toward = along * if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
    let velocity = toward * (WALKS_MPS + WALKS_SD_MPS * rng.normal().clamp(-2.0, 2.0));
    let past = (0..scene.n_history).map(|timestep| {
        let before_s = (present - timestep) as f64 * scene.dt_s;
        Some(State { position: beside - velocity * before_s, heading_rad: velocity.angle(), velocity })
    });
    let trajectory = with_past(scene, past);
    Some(Track { id: TrackId(String::new()), class, role: TrackRole::Context, extent: None, trajectory })
}

/// A trajectory with this past, and without a future.
fn with_past(scene: &Scene, past: impl Iterator<Item = Option<State>>) -> Trajectory {
    let future = std::iter::repeat_n(None, scene.n_timesteps - scene.n_history);
    Trajectory::new(past.chain(future).collect()).with_velocities_from_positions(scene.n_history, scene.dt_s)
}

/// Whether there is room for a track near the ego: nobody at the same place before, and a way ahead for all now.
fn fits(scene: &Scene, track: &Track) -> bool {
    let present = scene.current_timestep();
    let is_near =
        |at: Vec2| scene.state(scene.ego_idx, present).is_some_and(|ego| ego.position.distance(at) < WITHIN_M);
    let Some(now) = track.trajectory.get(present).filter(|now| now.is_finite() && is_near(now.position)) else {
        return false;
    };
    let body = |track: &Track, state: &State| {
        let Extent { length_m, width_m } = track.extent_or_nominal();
        OrientedBox { center: state.position, heading_rad: state.heading_rad, length_m, width_m }
    };
    let way = |track: &Track, state: &State| {
        let (body, clear_m) = (body(track, state), GAP_M + HEADWAY_S * state.speed_mps());
        let center = body.center + Vec2::from_angle(state.heading_rad) * (clear_m / 2.0);
        OrientedBox { center, length_m: body.length_m + clear_m, ..body }
    };
    scene.tracks.iter().all(|other| {
        let is_apart = |timestep: usize| {
            let both = track.trajectory.get(timestep).zip(other.trajectory.get(timestep));
            both.is_none_or(|(own, theirs)| !body(track, own).overlaps(&body(other, theirs)))
        };
        let has_way = other.trajectory.get(present).is_none_or(|theirs| {
            !way(track, now).overlaps(&body(other, theirs)) && !body(track, now).overlaps(&way(other, theirs))
        });
        has_way && (0..present).all(is_apart)
    })
}
