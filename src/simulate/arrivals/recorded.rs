//! Who came into sight in the recording of a scenario, after its present?
//!
//! Scenes of a long recording are windows of it. A window holds the agents at its present, in all of its frames in
//! which they are tracked, and no others: agents that come into sight in its future or left before its present are
//! missing. So its future says nothing of arrivals, and its past names everybody who came and stayed until its present.
//! An agent that is there in its first frame came in that frame or earlier, but after the present of the previous
//! window if it is missing there.
//!
//! So the time between the presents of two windows is *covered* if they are so close that hardly anybody came and left
//! in between; else only the past of the later one is. The present of the scenario is the first of these presents: the
//! agents of the scenario have come already. Arrivals at covered times are the recorded ones; at others they are drawn
//! at the rate of the place.
//!
//! An agent that came between a window's present and the first frame of the next one was on its way in that frame. It
//! is put back on its lane toward where traffic is first seen, for no longer than since that present; an agent in no
//! lane that begins at the end of the map comes in that frame.
//!
//! Windows of the other split are another recording. Agents that ingest left out because a scene had too many may seem
//! to arrive once there is room.

use super::{Arrival, Ends};
use crate::scene::{Scene, State, Track, TrackId};
use std::collections::BTreeSet;

/// Hardly anybody comes and leaves between presents this far apart, seconds: crossing a place takes longer.
const KNOWN_WITHIN_S: f64 = 5.0;

/// A window of a recording.
#[derive(Debug, Clone)]
pub(in crate::simulate) struct Window {
    /// The first frame, and that of the present.
    frames: [i64; 2],
    /// Time between frames, seconds.
    dt_s: f64,
    /// The agents at its present: the first frame that has them, and their state there in the frame of the recording.
    seen: Vec<(Track, i64, State)>,
}

/// The arrivals in the recording of a scenario.
#[derive(Debug, Clone, Default)]
pub(in crate::simulate) struct Recorded {
    /// In order of time.
    pub(super) arrivals: Vec<(Arrival, Track)>,
    /// The covered times: from one timestep (exclusive) to another (inclusive).
    covered: Vec<[usize; 2]>,
}

impl Window {
    /// The window of the recording that this scene, or any scenario that continues it, is; it begins at `first_frame`.
    pub(in crate::simulate) fn of(scene: &Scene, first_frame: i64) -> Self {
        let n_history = scene.n_history;
        let seen = scene.tracks.iter().filter_map(|track| {
            let (timestep, state) = track.trajectory.valid().next().filter(|(timestep, _)| *timestep < n_history)?;
            let state = state.transformed(&scene.world_from_scene);
            Some((super::without_states(track), first_frame + timestep as i64, state))
        });
        let frames = [first_frame, first_frame + scene.current_timestep() as i64];
        Self { frames, dt_s: scene.dt_s, seen: seen.collect() }
    }
}

impl Recorded {
    /// The arrivals after the present of this scene, whose first frame is given, according to other windows of its
    /// recording in order of time.
    pub(in crate::simulate) fn of<'w>(
        (scene, first_frame): (&Scene, i64),
        windows: impl IntoIterator<Item = &'w Window>,
        ends: &Ends,
    ) -> Self {
        let mut recorded = Self::default();
        let mut known: BTreeSet<&TrackId> = scene.tracks.iter().map(|track| &track.id).collect();
        let timestep = |frame: i64| usize::try_from(frame - first_frame).unwrap_or_default();
        let n_within = (KNOWN_WITHIN_S / scene.dt_s).round() as i64;
        let mut known_at = first_frame + scene.current_timestep() as i64;
        for Window { frames: [first, present], dt_s, seen } in windows {
            if *present <= known_at || (dt_s - scene.dt_s).abs() > 1e-6 {
                continue;
            }
            // Agents that were not there in this frame have come since.
            let since = if known_at >= present - n_within { known_at } else { (*first).max(present - n_within) };
            recorded.covered.push([since, *present].map(timestep));
            for (track, frame, state) in seen {
                let is_new = known.insert(&track.id) && *frame > since && !track.is_parked();
                if !is_new {
                    continue;
                }
                // An agent in the first frame came in it, or was on its way.
                let n_most = if frame == first { timestep(first_frame + frame - since - 1) } else { 0 };
                let drives = track.class.is_motorized();
                let before = drives.then(|| ends.before(state, n_most, *dt_s)).flatten();
                let (n_back, state) = before.unwrap_or((0, *state));
                let entry_idx = drives.then(|| ends.entry_at(&state)).flatten();
                let timestep = timestep(*frame) - n_back;
                recorded.arrivals.push((Arrival { timestep, state, entry_idx, is_recorded: true }, track.clone()));
            }
            known_at = *present;
        }
        // Arrivals of one time stay in the order of their windows.
        recorded.arrivals.sort_by_key(|(arrival, _)| arrival.timestep);
        recorded
    }

    /// Whether the recording tells the arrivals of a timestep.
    pub(super) fn covers(&self, timestep: usize) -> bool {
        self.covered.iter().any(|[since, until]| (since + 1..=*until).contains(&timestep))
    }

    /// The arrivals, in order of time.
    pub(super) fn arrivals(&self) -> impl Iterator<Item = &(Arrival, Track)> {
        self.arrivals.iter()
    }
}
