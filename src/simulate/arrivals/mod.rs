//! Who enters, and who leaves? Arrivals are those of the recording at times that the corpus covers, and random at
//! others, at the rate of the place; vehicles leave where scenes of the place see no traffic any more.
//!
//! An arrival is expected at a time, in a place and with a speed. It comes at the first replanning from then on at
//! which there is a gap for it, and not at all if there is none for some seconds.

mod drawn;
mod ends;
mod recorded;
#[cfg(test)]
mod tests;

use super::situation::Situation;
use super::world::World;
use crate::geometry::{OrientedBox, Vec2};
use crate::scene::{Scene, State, Track, TrackRole, Trajectory};
pub(super) use ends::Ends;
pub(super) use recorded::{Recorded, Window};
use std::sync::Arc;

/// Slower agents, m/s, are waiting already: none is drawn as an arrival, and no arrival slows down further for a gap.
const LEAST_MPS: f64 = 1.0;
/// The gap, meters, the headway, seconds, and the hardest braking, m/s², of an arrival.
const GAP_M: f64 = 2.0;
const HEADWAY_S: f64 = 1.0;
const BRAKES_MPS2: f64 = 3.0;
/// An arrival that finds no gap within this time, seconds, does not come.
pub(super) const WAITS_S: f64 = 5.0;
/// The most arrivals of a drive, including those outside the part of the map that is driven.
const MOST_ARRIVALS: usize = 1000;

/// When, where and how somebody arrives.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    /// Counted from the beginning of the past of the scenario.
    timestep: usize,
    /// In the frame of the recording.
    state: State,
    /// The entry through which it comes, if any.
    entry_idx: Option<usize>,
    is_recorded: bool,
}

/// The arrivals of a drive: the last tracks of its scene, in order of time.
#[derive(Debug, Clone, Default)]
pub(super) struct Arrivals {
    ends: Arc<Ends>,
    expected: Vec<Arrival>,
}

/// The track without its states, which are yet to come.
fn without_states(track: &Track) -> Track {
    Track {
        id: track.id.clone(),
        class: track.class,
        role: if track.is_parked() { TrackRole::Parked } else { TrackRole::Context },
        extent: track.extent,
        trajectory: Trajectory::new(Vec::new()),
    }
}

impl Arrivals {
    /// The arrivals within `n_steps` after the present of this scenario where it `has_map`, with their tracks: at least
    /// `n_least`.
    pub(super) fn expect(
        ends: &Arc<Ends>,
        recorded: &Recorded,
        (scene, name, seed): (&Scene, &str, u64),
        has_map: impl Fn(&State) -> bool,
        [n_steps, n_least]: [usize; 2],
    ) -> (Self, Vec<Track>) {
        let (mut arrivals, mut tracks) = (Self { ends: Arc::clone(ends), expected: Vec::new() }, Vec::new());
        let last = scene.current_timestep() + n_steps;
        let is_open = |(arrival, _): &(Arrival, Track)| !recorded.covers(arrival.timestep);
        let mut drawn =
            ends.drawn(scene, recorded.arrivals().map(|(_, track)| track), (name, seed)).filter(is_open).peekable();
        let mut known = recorded.arrivals().peekable();
        for _ in 0..MOST_ARRIVALS {
            let is_known_first = match (known.peek(), drawn.peek()) {
                (Some((known, _)), Some((drawn, _))) => known.timestep <= drawn.timestep,
                (known, _) => known.is_some(),
            };
            let next = if is_known_first { known.next().cloned() } else { drawn.next() };
            let Some((arrival, track)) = next else { break };
            if arrival.timestep > last && tracks.len() >= n_least {
                break;
            }
            if has_map(&arrival.state) {
                arrivals.expected.push(arrival);
                tracks.push(Track { trajectory: Trajectory::new(vec![None; scene.n_timesteps]), ..track });
            }
        }
        (arrivals, tracks)
    }

    pub(super) fn n_expected(&self) -> usize {
        self.expected.len()
    }

    /// The number of arrivals that are expected before a timestep.
    pub(super) fn n_until(&self, timestep: usize) -> usize {
        self.expected.iter().take_while(|arrival| arrival.timestep < timestep).count()
    }

    /// Whether the arrival with this number, in order of time, comes from the recording.
    pub(super) fn is_recorded(&self, number: usize) -> bool {
        self.expected.get(number).is_some_and(|arrival| arrival.is_recorded)
    }

    /// Whether a vehicle is farther out than traffic of the place is seen.
    pub(super) fn is_out_of_sight(&self, situation: &Situation, state: &State) -> bool {
        self.ends.is_out_of_sight(&state.transformed(&situation.scene.world_from_scene))
    }

    /// Lets in the arrivals that are due and find a gap: at their own speed, or else at that of the vehicle ahead.
    pub(super) fn enter(&self, situation: &Situation, world: &mut World) {
        let (now, dt_s) = (world.now(), situation.scene.dt_s);
        let first_idx = world.n_tracks() - self.expected.len();
        let first_due = now.saturating_sub((WAITS_S / dt_s).round() as usize);
        for (i, arrival) in self.expected.iter().enumerate().take_while(|(_, arrival)| arrival.timestep <= now) {
            let agent_idx = first_idx + i;
            let has_come = (arrival.timestep..=now).any(|timestep| world.state(agent_idx, timestep).is_some());
            if arrival.timestep < first_due || has_come {
                continue;
            }
            if let Some(state) = self.entering(situation, world, agent_idx, arrival) {
                world.place(agent_idx, state);
            }
        }
    }

    fn entering(&self, situation: &Situation, world: &World, agent_idx: usize, arrival: &Arrival) -> Option<State> {
        let world_from_scene = &situation.scene.world_from_scene;
        let scene_from_world = world_from_scene.inverse();
        let own_mps = arrival.state.speed_mps();
        let state = |speed_mps: f64| {
            let along = if speed_mps < own_mps { speed_mps / own_mps } else { 1.0 };
            State { velocity: arrival.state.velocity * along, ..arrival.state }.transformed(&scene_from_world)
        };
        let others: Vec<(usize, State)> =
            (0..world.n_tracks()).filter_map(|idx| Some((idx, world.present(idx)?))).collect();
        let length_m = |idx: usize| situation.scene.tracks[idx].extent_or_nominal().length_m;
        // The vehicle ahead in the lane: its gap and speed.
        let entry = arrival.entry_idx.and_then(|idx| self.ends.entry(idx));
        let lane = entry.and_then(|entry| Some((entry, entry.place(&arrival.state)?[0])));
        let ahead = lane.and_then(|(entry, own_m)| {
            let ahead = others.iter().filter_map(|(idx, other)| {
                let [station_m, _] = entry.place(&other.transformed(world_from_scene))?;
                let between_m = (length_m(*idx) + length_m(agent_idx)) / 2.0;
                (station_m + between_m > own_m).then(|| (station_m - own_m - between_m, other.speed_mps()))
            });
            ahead.min_by(|a, b| a.0.total_cmp(&b.0))
        });
        // The space an arrival needs for itself: its place, and a way ahead.
        let needed = |idx: usize, state: &State| {
            let (body, clear_m) = (situation.body(idx, state), GAP_M + HEADWAY_S * state.speed_mps());
            let center = body.center + Vec2::from_angle(state.heading_rad) * (clear_m / 2.0);
            OrientedBox { center, length_m: body.length_m + clear_m, ..body }
        };
        let is_free = |speed_mps: &f64| {
            let keeps_gap = ahead.is_none_or(|(gap_m, ahead_mps)| {
                let braking_m = (speed_mps.powi(2) - ahead_mps.powi(2)).max(0.0) / (2.0 * BRAKES_MPS2);
                gap_m >= GAP_M + HEADWAY_S * speed_mps + braking_m
            });
            let own = state(*speed_mps);
            let (body, way) = (situation.body(agent_idx, &own), needed(agent_idx, &own));
            let is_apart = |(idx, other): &(usize, State)| {
                !way.overlaps(&situation.body(*idx, other)) && !body.overlaps(&needed(*idx, other))
            };
            keeps_gap && others.iter().all(is_apart)
        };
        let slower = ahead.map(|(_, ahead_mps)| ahead_mps.min(own_mps)).filter(|mps| *mps >= LEAST_MPS);
        [Some(own_mps), slower].into_iter().flatten().find(is_free).map(state)
    }
}
