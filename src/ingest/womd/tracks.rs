//! The tracks of a scenario.

use super::messages::{ObjectState, Scenario};
use crate::geometry::{Vec2, wrap_angle};
use crate::ingest::raw::Finding;
use crate::scene::{AgentClass, Extent, State, Track, TrackId, TrackRole, Trajectory};
use std::collections::BTreeSet;
use std::ops::Range;

/// Sizes beyond these limits are errors of the recording, meters.
const MIN_SIZE_M: f64 = 1e-3;
const MAX_SIZE_M: f64 = 1e3;

/// The tracks in some timesteps of the scenario, `n_history` of which are observed, and doubts about them.
pub(super) fn read(scenario: &Scenario, steps: &Range<usize>, n_history: usize) -> (Vec<Track>, Vec<Finding>) {
    let scored: BTreeSet<i32> = scenario.tracks_to_predict.iter().map(|of| of.track_index).collect();
    let (mut ids, mut broken, mut sizeless, mut repeated) = (BTreeSet::new(), Vec::new(), Vec::new(), Vec::new());
    let mut tracks = Vec::with_capacity(scenario.tracks.len());
    for (idx, track) in (0_i32..).zip(&scenario.tracks) {
        if !ids.insert(track.id) {
            repeated.push(format!("track {}: the first of this id is kept", track.id));
            continue;
        }
        let class = class_of(track.object_type);
        let mut states = vec![None; steps.len()];
        let mut extent: Option<Extent> = None;
        for (timestep, recorded) in track.states.iter().take(steps.end).skip(steps.start).enumerate() {
            if !recorded.valid {
                continue;
            }
            states[timestep] = state(recorded);
            if states[timestep].is_none() {
                broken.push(format!("track {} at timestep {timestep} has numbers that are not finite", track.id));
            }
            let size = size(recorded);
            if size.is_none() {
                let ObjectState { length, width, .. } = recorded;
                let range = format!("expected {MIN_SIZE_M} to {MAX_SIZE_M} m");
                sizeless.push(format!("track {} at timestep {timestep} is {length} by {width} m, {range}", track.id));
            }
            // Of sizes that vary, the last observed one.
            if timestep < n_history || extent.is_none() {
                extent = size.or(extent);
            }
        }
        let role = if scenario.sdc_track_index == Some(idx) {
            TrackRole::Recorder
        } else if scored.contains(&idx) || scenario.objects_of_interest.contains(&track.id) {
            TrackRole::Scored
        } else {
            TrackRole::Context
        };
        let (id, trajectory) = (TrackId(track.id.to_string()), Trajectory::new(states));
        if trajectory.n_valid() > 0 {
            tracks.push(Track { id, class, role, extent, trajectory });
        }
    }
    let finding = |what, found: Vec<String>| {
        let n = found.len() as u64;
        found.into_iter().next().map(|detail| Finding { what, n, detail })
    };
    let findings = [
        finding("states_left_out", broken),
        finding("sizes_left_out", sizeless),
        finding("tracks_of_repeated_ids", repeated),
    ];
    (tracks, findings.into_iter().flatten().collect())
}

/// `None` if it has numbers that are not finite.
fn state(recorded: &ObjectState) -> Option<State> {
    let state = State {
        position: Vec2::new(recorded.center_x, recorded.center_y),
        // Radians for certain, although some are beyond a turn.
        heading_rad: wrap_angle(recorded.heading.into()),
        velocity: Vec2::new(recorded.velocity_x.into(), recorded.velocity_y.into()),
    };
    state.is_finite().then_some(state)
}

fn size(recorded: &ObjectState) -> Option<Extent> {
    let (length_m, width_m) = (f64::from(recorded.length), f64::from(recorded.width));
    let is_size = |m: f64| (MIN_SIZE_M..=MAX_SIZE_M).contains(&m);
    (is_size(length_m) && is_size(width_m)).then_some(Extent { length_m, width_m })
}

/// `Track.ObjectType`; buses and motorcycles are vehicles like others.
const fn class_of(object_type: i32) -> AgentClass {
    match object_type {
        1 => AgentClass::Vehicle,
        2 => AgentClass::Pedestrian,
        3 => AgentClass::Cyclist,
        _ => AgentClass::Unknown,
    }
}
