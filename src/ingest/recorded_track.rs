//! One agent of a long recording, from which scenes are cut.

use super::plausible_tracks::recorded_heading;
use super::standing::Standing;
use crate::geometry::Vec2;
use crate::scene::{AgentClass, Derivation, Extent, State, Track, TrackId, TrackRole, Trajectory, velocity_at};
use std::ops::RangeInclusive;

/// Time between frames, seconds.
pub(super) const DT_S: f64 = 0.1;

/// Below this speed the direction of a velocity is noise, so the heading is held.
const MIN_HEADING_SPEED_MPS: f64 = 0.5;

/// An agent at one frame, as recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observation {
    /// The frame, counted by the recording at 10 Hz.
    pub(super) frame: i64,
    /// Center, meters.
    pub(super) position: Vec2,
    /// m/s; used only if it does not follow from positions.
    pub(super) velocity: Vec2,
    /// Radians, counterclockwise from x, if recorded.
    pub(super) heading_rad: Option<f64>,
}

/// One agent over all frames in which it was tracked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RecordedTrack {
    pub(super) id: TrackId,
    pub(super) class: AgentClass,
    role: TrackRole,
    pub(super) extent: Option<Extent>,
    /// When it is parked, seconds after frame 0.
    pub(super) parked_s: Vec<RangeInclusive<f64>>,
    /// If its heading is unknown because it never moves: how far its center is ahead of its positions, meters.
    pub(super) never_moves: Option<f64>,
    /// By ascending frame.
    pub(super) states: Vec<(i64, State, HeadingSource)>,
}

/// The source of a heading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HeadingSource {
    Recorded,
    /// The direction of the motion.
    Motion,
    /// The last known heading, because the agent is slow.
    Held,
    /// The agent has been slow from the start, so nothing tells: the direction of the velocity, which is noise, or 0.
    Unknown,
}

/// The states by frame. A heading that is not recorded is the direction of the motion up to then, held while the agent
/// is slow.
fn states(observations: &[Observation], class: AgentClass) -> Vec<(i64, State, HeadingSource)> {
    let mut known_rad: Option<f64> = None;
    let mut states = Vec::with_capacity(observations.len());
    for (index, Observation { frame, position, velocity, heading_rad }) in observations.iter().enumerate() {
        let before = |offset: isize| {
            let observation = observations.get(index.checked_add_signed(offset)?)?;
            (offset <= 0 && observation.frame - frame == offset as i64).then_some(observation.position)
        };
        let motion = velocity_at(before, DT_S).unwrap_or(*velocity);
        let is_moving = motion.norm() >= MIN_HEADING_SPEED_MPS;
        let (heading_rad, source) = match (heading_rad, known_rad) {
            (Some(recorded_rad), _) => (recorded_heading(*recorded_rad, class), HeadingSource::Recorded),
            (None, _) if is_moving => (motion.angle(), HeadingSource::Motion),
            (None, Some(known_rad)) => (known_rad, HeadingSource::Held),
            (None, None) => (motion.angle(), HeadingSource::Unknown),
        };
        if source != HeadingSource::Unknown {
            known_rad = Some(heading_rad);
        }
        states.push((*frame, State { position: *position, heading_rad, velocity: *velocity }, source));
    }
    states
}

impl RecordedTrack {
    /// The track with these observations, by ascending frame.
    pub(super) fn new(
        id: TrackId,
        class: AgentClass,
        role: TrackRole,
        extent: Option<Extent>,
        observations: &[Observation],
    ) -> Self {
        let mut standing = Standing::default();
        observations.iter().for_each(|seen| standing.see(seen.frame as f64 * DT_S, seen.position));
        let parked_s = standing.parked_s(0.0);
        Self { id, class, role, extent, parked_s, never_moves: None, states: states(observations, class) }
    }

    /// The track of a context agent with these states, by ascending frame.
    pub(super) const fn of_states(
        id: TrackId,
        class: AgentClass,
        extent: Option<Extent>,
        parked_s: Vec<RangeInclusive<f64>>,
        states: Vec<(i64, State, HeadingSource)>,
    ) -> Self {
        Self { id, class, role: TrackRole::Context, extent, parked_s, never_moves: None, states }
    }

    /// First and last frame.
    pub(super) fn frames(&self) -> Option<(i64, i64)> {
        Some((self.states.first()?.0, self.states.last()?.0))
    }

    /// The track in the `n_timesteps` frames from `first_frame` on, the first `n_history` of which are observed; `None`
    /// if it was not tracked in any of them.
    ///
    /// An agent that is slow from its start has one heading until it moves: that of its first motion, if that is
    /// observed; otherwise the direction of its first velocity. Looking further ahead would leak the future direction
    /// of the agent into the past.
    pub(super) fn cut(&self, first_frame: i64, n_timesteps: usize, n_history: usize) -> Option<Track> {
        let end_frame = first_frame + n_timesteps as i64;
        let within = |end_frame: i64| {
            let first = self.states.partition_point(|(frame, ..)| *frame < first_frame);
            let end = self.states.partition_point(|(frame, ..)| *frame < end_frame);
            &self.states[first..end]
        };
        let states = within(end_frame);
        let observed = within(first_frame + n_history as i64);
        let told_by = if observed.is_empty() { states } else { observed };
        let known = told_by.iter().find(|(.., source)| *source != HeadingSource::Unknown);
        let moving = || told_by.iter().find(|(_, state, _)| state.velocity != Vec2::ZERO);
        let (_, first, _) = known.or_else(moving).or(told_by.first())?;

        let mut entries = vec![None; n_timesteps];
        let mut held_headings = vec![false; n_timesteps];
        for (frame, state, source) in states {
            let timestep = usize::try_from(frame - first_frame).ok()?;
            let is_unknown = *source == HeadingSource::Unknown;
            let heading_rad = if is_unknown { first.heading_rad } else { state.heading_rad };
            entries[timestep] = Some(State { heading_rad, ..*state });
            held_headings[timestep] = is_unknown || *source == HeadingSource::Held;
        }
        let trajectory = Trajectory::new(entries);
        let is_recorded = states.iter().all(|(.., source)| *source == HeadingSource::Recorded);
        let trajectory = match is_recorded {
            true => trajectory,
            false => trajectory.derived(Derivation { held_headings, recorded: Vec::new() }),
        };
        let times_s = [states.first()?.0, states.last()?.0].map(|frame| frame as f64 * DT_S);
        let stands = |parked_s: &RangeInclusive<f64>| times_s.iter().all(|time_s| parked_s.contains(time_s));
        let is_parked = self.class.is_motorized() && self.parked_s.iter().any(stands);
        let role = if self.role == TrackRole::Context && is_parked { TrackRole::Parked } else { self.role };
        Some(Track { id: self.id.clone(), class: self.class, role, extent: self.extent, trajectory })
    }
}
