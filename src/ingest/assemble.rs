//! Turns a recorded scene into a `Scene`: chooses the ego, the other agents and the lanes.

use super::config::IngestConfig;
use super::interruptions::mend;
use super::lane_index::{Circle, LaneIndex};
use super::plausible_tracks::{judge, judge_place};
use super::raw::{Finding, HeadingGap, RawScene, Reject};
use super::report::IngestReport;
use super::vicinity::Vicinity;
use crate::geometry::{Transform2, Vec2};
use crate::scene::{AgentClass, LaneGraph, Scene, State, Track, TrackRole};
use crate::seed::Seed;
use std::fmt::Display;
use std::sync::Arc;

/// A standing vehicle takes the direction of a lane within this distance of its center, meters.
const MAX_LANE_DISTANCE_M: f64 = 5.0;
/// One that never moves stands on the lanes within this distance, meters.
const ON_LANE_M: f64 = 2.0;

/// Largest acceleration of an agent, m/s²: the limit for generated traffic.
const MAX_ACCELERATION_MPS2: f64 = 5.0;
/// Recorded velocities disagree with the positions if they differ by more than this in the mean of a track, m/s.
/// Positions rounded to millimeters explain some 0.01 m/s.
const MAX_VELOCITY_ERROR_MPS: f64 = 0.1;
/// Lanes belong to a scene if they are within this distance of a place that an agent can reach, meters.
const SURROUNDINGS_M: f64 = 10.0;

/// States beyond these limits are errors of the recording: UTM counts meters from the equator, and Web Mercator goes
/// around the earth. In double precision that is exact to nanometers, and scenes, which are stored in single precision,
/// have their own frame.
pub(super) const MAX_COORDINATE_M: f64 = 2.1e7;
const MAX_SPEED_MPS: f64 = 1e6;

/// Transforms a recorded scene to the frame of its ego and keeps the agents and lanes of the configuration.
///
/// The ego is the focal track, or otherwise the vehicle that recorded; if neither is there at present, a seeded draw
/// among the motorized tracks that are tracked throughout, or otherwise among those tracked at present; parked ones
/// come last. `map` is `None` if scenes need no lanes.
///
/// # Errors
/// Rejects states that are `non_finite` or `out_of_range`, scenes with `no_ego` or with `no_lanes_in_radius` of the
/// map, and scenes in which most tracks are implausible.
pub(super) fn assemble(
    mut raw: RawScene,
    map: Option<&LaneIndex>,
    config: &IngestConfig,
) -> Result<(Scene, IngestReport), Reject> {
    check_states(&raw)?;
    let present = raw.n_history.saturating_sub(1);
    let mut counts = IngestReport::default();
    if raw.source.dataset.facts().has_classes {
        let n_tracks = raw.tracks.len();
        raw.tracks.retain(|track| track.class != AgentClass::Unknown);
        counts.count_dropped("agents_of_unknown_type", (n_tracks - raw.tracks.len()) as u64);
    }
    mend(&mut raw, &mut counts);
    judge(&mut raw)?;
    if let Some(map) = map {
        judge_place(&mut raw, present, map);
    }
    std::mem::take(&mut raw.findings).into_iter().for_each(|finding| counts.count_warning(finding));
    if raw.source.dataset.facts().has_velocities {
        derive_velocities(&mut raw, &mut counts);
        // Positions may jump faster than any agent moves.
        check_states(&raw)?;
    }
    let Some((ego_idx, ego_state)) = choose_ego(&raw, present, Seed(config.seed)) else {
        return Err(reject(&raw, "no_ego", format!("no motorized track is present at timestep {present}")));
    };
    let around_ego = Circle { center: ego_state.position, radius_m: config.map_radius_m };
    if map.is_some_and(|map| !map.has_any_within(around_ego)) {
        let Vec2 { x, y } = ego_state.position;
        let lanes = map.and_then(LaneIndex::bounds).map_or_else(String::new, |(least, greatest)| {
            let Vec2 { x, y } = least;
            format!("; its lanes lie from ({x:.1}, {y:.1}) to ({:.1}, {:.1})", greatest.x, greatest.y)
        });
        let (map, within_m) = (&raw.map_id, config.map_radius_m);
        let detail = format!("no lane of {map} within {within_m} m of ({x:.1}, {y:.1}){lanes}");
        return Err(reject(&raw, "no_lanes_in_radius", detail));
    }
    let kept = choose_agents(&raw.tracks, ego_idx, present, config, &mut counts);
    for gap in std::mem::take(&mut raw.heading_gaps) {
        if kept.binary_search(&gap.track_idx).is_ok() {
            let is_filled = fill_headings(&mut raw.tracks[gap.track_idx], gap, present, map);
            count_headings(&raw, gap, is_filled, &mut counts);
        }
    }

    // Its heading may have been filled in.
    let ego_state = raw.tracks[ego_idx].trajectory.get(present).copied().unwrap_or(ego_state);
    let world_from_scene = Transform2::from_pose(ego_state.position, ego_state.heading_rad);
    let scene_from_world = world_from_scene.inverse();
    let lanes = map.map_or_else(LaneGraph::default, |map| {
        let future_s = raw.n_timesteps.saturating_sub(raw.n_history) as f64 * raw.dt_s;
        let reached = kept.iter().filter_map(|idx| reach(&raw.tracks[*idx], present, future_s));
        let circles: Vec<Circle> = reached.chain([around_ego]).collect();
        map.graph().subset(&map.within_any(&circles)).into_frame(&scene_from_world)
    });
    let is_kept = |(idx, track)| kept.binary_search(&idx).is_ok().then_some(track);
    let into_frame = |track: Track| Track { trajectory: track.trajectory.into_frame(&scene_from_world), ..track };
    let tracks: Vec<Track> = raw.tracks.into_iter().enumerate().filter_map(is_kept).map(into_frame).collect();
    counts.count_scene(&raw.source, tracks.len());
    let scene = Scene {
        ego_idx: kept.binary_search(&ego_idx).unwrap_or_default(),
        map_id: map.is_some().then_some(raw.map_id),
        lanes: Arc::new(lanes),
        id: raw.id,
        source: raw.source,
        dt_s: raw.dt_s,
        n_timesteps: raw.n_timesteps,
        n_history: raw.n_history,
        world_from_scene,
        tracks,
    };
    Ok((scene, counts))
}

/// A scene from tracks that were not read from a recording, chosen and framed as recorded ones are; `map` is the whole
/// map.
///
/// # Errors
/// Rejects what is rejected in recordings.
pub fn assemble_window(raw: RawScene, map: Option<Arc<LaneGraph>>, config: &IngestConfig) -> Result<Scene, Reject> {
    let map = map.map(LaneIndex::new);
    assemble(raw, map.as_ref(), config).map(|(scene, _)| scene)
}

/// Replaces recorded velocities by those derived from the positions, and counts the tracks whose recorded ones
/// disagree.
fn derive_velocities(raw: &mut RawScene, counts: &mut IngestReport) {
    for track in &mut raw.tracks {
        let derived = track.trajectory.with_velocities_from_positions(raw.n_history, raw.dt_s);
        let errors = (track.trajectory.valid().zip(derived.valid()))
            .map(|((_, recorded), (_, derived))| (recorded.velocity - derived.velocity).norm());
        let disagrees = errors.sum::<f64>() > MAX_VELOCITY_ERROR_MPS * derived.n_valid() as f64;
        counts.count_assumed("tracks_whose_recorded_velocities_disagree_with_positions", u64::from(disagrees));
        track.trajectory = derived;
    }
    counts.count_assumed("tracks_with_velocities_from_positions", raw.tracks.len() as u64);
}

fn reject(raw: &RawScene, reason: &'static str, detail: impl Display) -> Reject {
    Reject { reason, detail: format!("{}: scene {}: {detail}", raw.source.file, raw.id) }
}

/// Rejects states that are not finite, or beyond the limits of recordings.
fn check_states(raw: &RawScene) -> Result<(), Reject> {
    if let Some((track, _)) = states(raw).find(|(_, state)| !state.is_finite()) {
        return Err(reject(raw, "non_finite", format!("track {} has a state that is not finite", track.id)));
    }
    let vicinity = Vicinity::of(|| states(raw).map(|(_, state)| state.position));
    let is_possible = |state: &State| {
        vicinity.holds(state.position) && state.velocity.dot(state.velocity) <= MAX_SPEED_MPS * MAX_SPEED_MPS
    };
    match states(raw).find(|(_, state)| !is_possible(state)) {
        Some((track, state)) => {
            let (Vec2 { x, y }, speed) = (state.position, state.velocity.norm());
            let detail = format!("track {} is at ({x}, {y}) m with {speed} m/s", track.id);
            Err(reject(raw, "out_of_range", detail))
        }
        None => Ok(()),
    }
}

/// The circle that an agent can reach in `future_s` seconds, with a margin. It depends on observed states alone, so
/// that the lanes of a scene reveal nothing of its future.
fn reach(track: &Track, present: usize, future_s: f64) -> Option<Circle> {
    let (_, state) = track.trajectory.valid().rev().find(|(timestep, _)| *timestep <= present)?;
    let gained_m = MAX_ACCELERATION_MPS2 / 2.0 * future_s * future_s;
    let radius_m = SURROUNDINGS_M + state.velocity.norm() * future_s + gained_m;
    Some(Circle { center: state.position, radius_m })
}

fn states(raw: &RawScene) -> impl Iterator<Item = (&Track, &State)> {
    raw.tracks.iter().flat_map(|track| track.trajectory.valid().map(move |(_, state)| (track, state)))
}

fn choose_ego(raw: &RawScene, present: usize, seed: Seed) -> Option<(usize, State)> {
    let is_present = |track: &Track| track.trajectory.is_valid(present);
    let is_whole = |track: &Track| track.trajectory.n_valid() == raw.n_timesteps;
    let draw = |is_eligible: &dyn Fn(&Track) -> bool| {
        let mut eligible: Vec<usize> = (0..raw.tracks.len())
            .filter(|idx| raw.tracks[*idx].class.is_motorized() && is_eligible(&raw.tracks[*idx]))
            .collect();
        // By number, whatever the order of rows in the recording.
        eligible.sort_by_key(|idx| (raw.tracks[*idx].id.0.len(), &raw.tracks[*idx].id.0));
        let drawn = seed.derive_named("ego", &raw.id.0).rng().below(eligible.len());
        eligible.get(drawn).copied()
    };
    let drives = |track: &Track| !track.is_parked();
    let of_role = |role| raw.tracks.iter().position(|track| track.role == role && is_present(track));
    let ego_idx = of_role(TrackRole::Focal)
        .or_else(|| of_role(TrackRole::Recorder))
        .or_else(|| draw(&|track| drives(track) && is_whole(track)))
        .or_else(|| draw(&|track| drives(track) && is_present(track)))
        .or_else(|| draw(&is_present))?;
    raw.tracks[ego_idx].trajectory.get(present).map(|state| (ego_idx, *state))
}

/// The tracks of the scene, by ascending index: the ego, and the nearest of those present up to the cap, with parked
/// vehicles last.
fn choose_agents(
    tracks: &[Track],
    ego_idx: usize,
    present: usize,
    config: &IngestConfig,
    counts: &mut IngestReport,
) -> Vec<usize> {
    let at_present = |idx: usize| tracks[idx].trajectory.get(present);
    let ego_position = at_present(ego_idx).map_or(Vec2::ZERO, |state| state.position);
    let mut by_distance: Vec<(f64, usize)> = Vec::with_capacity(tracks.len());
    for (idx, track) in tracks.iter().enumerate() {
        let is_ego = idx == ego_idx;
        let Some(state) = at_present(idx) else {
            counts.count_dropped("agents_absent", 1);
            continue;
        };
        if track.class == AgentClass::Static && !is_ego {
            counts.count_dropped("agents_static", 1);
        } else {
            // The ego comes first even if another agent is recorded at the same place.
            by_distance.push((if is_ego { -1.0 } else { state.position.distance(ego_position) }, idx));
        }
    }
    by_distance.sort_by(|(a, i), (b, j)| {
        let is_behind = |idx: usize| tracks[idx].is_parked() && idx != ego_idx;
        is_behind(*i).cmp(&is_behind(*j)).then(a.total_cmp(b)).then_with(|| tracks[*i].id.cmp(&tracks[*j].id))
    });
    counts.count_dropped("agents_over_cap", by_distance.len().saturating_sub(config.max_agents) as u64);
    by_distance.truncate(config.max_agents);
    let n_parked = by_distance.iter().filter(|(_, idx)| tracks[*idx].is_parked()).count();
    counts.count_assumed("vehicles_parked", n_parked as u64);
    let mut kept: Vec<usize> = by_distance.into_iter().map(|(_, idx)| idx).collect();
    kept.sort_unstable();
    kept
}

/// Gives a standing track the direction of its lane; without a lane its headings stay, 0 in the recording's frame
/// unless recorded so, and it is false.
fn fill_headings(track: &mut Track, gap: HeadingGap, present: usize, map: Option<&LaneIndex>) -> bool {
    let observed = track.trajectory.valid().rev().find(|(timestep, _)| *timestep <= present);
    let Some((_, state)) = observed else { return false };
    let heading_rad = map.and_then(|map| match gap.never_moves {
        None => map.heading_at(state.position, MAX_LANE_DISTANCE_M),
        Some(_) => map.sole_heading_at(state.position, ON_LANE_M),
    });
    let Some(heading_rad) = heading_rad else { return false };
    let to_center = Vec2::from_angle(heading_rad) * gap.never_moves.unwrap_or_default();
    let filled = |state: State| State { heading_rad, position: state.position + to_center, ..state };
    let entries = track.trajectory.entries().iter().enumerate();
    let entries =
        entries.map(|(timestep, state)| state.map(|at| if timestep < gap.until_timestep { filled(at) } else { at }));
    track.trajectory = track.trajectory.with_states(entries.collect());
    true
}

fn count_headings(raw: &RawScene, gap: HeadingGap, is_filled: bool, counts: &mut IngestReport) {
    match gap.never_moves {
        _ if is_filled => counts.count_assumed("headings_from_lanes", 1),
        None => counts.count_assumed("headings_unknown", 1),
        Some(_) => {
            let (file, Track { id, trajectory, .. }) = (&raw.source.file, &raw.tracks[gap.track_idx]);
            let assumed_rad = trajectory.valid().next().map_or(0.0, |(_, state)| state.heading_rad);
            let detail = format!(
                "{file}: scene {}: track {id} never moves, and no lane tells its heading; {assumed_rad:.2} rad is \
                 assumed",
                raw.id
            );
            counts.count_warning(Finding { what: "headings_unknown", n: 1, detail });
        }
    }
}

#[cfg(test)]
mod tests;
