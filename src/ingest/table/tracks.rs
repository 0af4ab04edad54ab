//! The tracks of a table: the states of each agent from its rows, at the frames of scenes.

use super::headings::{Chords, headings};
use super::left_out::LeftOut;
use super::mapping::{HeadingUnit, PositionOf, TableColumns, TableMapping};
use super::resample::{TimedState, resampled};
use super::rows::{Group, Rows};
use crate::geometry::{Vec2, wrap_angle};
use crate::ingest::raw::SeenTrack;
use crate::ingest::recorded_track::{DT_S, HeadingSource, Observation, RecordedTrack};
use crate::ingest::windows::Recording;
use crate::ingest::{RawUnit, Reject};
use crate::scene::{Dataset, Extent, State, TrackId, velocity_at};

/// Frames are numbered by the times of the recording unless these are further than this from 0, as times of day are,
/// seconds.
const MAX_START_S: f64 = 1e6;
/// The longest recording, seconds; see [`windows`](crate::ingest::windows).
pub(super) const MAX_RECORDING_S: f64 = 1e5;
/// The largest agent, meters.
pub(super) const MAX_SIZE_M: f64 = 1e3;
/// Rows of a track that are usually further apart than this do not show its motion, seconds.
const MAX_USUAL_S: f64 = 1.0;
/// This many rows of a track in a part show their usual distance in time.
const N_ROWS_OF_PART: usize = 20;
/// If this share of the frames of tracks has no state, there are no scenes.
const MIN_FILLED_SHARE: f64 = 0.9;
/// A recording that is not too short in which no agent moves as far as this is not in meters.
const MAX_AT_REST_M: f64 = 0.5;
const N_STATES_AT_REST: usize = 10;

/// The recordings of a file, in the order of their first rows, or why one cannot be read.
pub(super) fn recordings(mut unit: RawUnit, mapping: &TableMapping) -> Vec<Result<Recording, Reject>> {
    let rows = match Rows::read(&unit, mapping) {
        Ok(rows) => rows,
        Err(reject) => return vec![Err(reject)],
    };
    (unit.bytes, unit.lines, unit.companion) = (Vec::new(), Vec::new(), None);
    let mut of_table = rows.findings();
    let mut recordings: Vec<Result<Recording, Reject>> =
        rows.groups().into_iter().map(|group| rows.recording(&unit, &group)).collect();
    if let Some(first) = recordings.iter_mut().find_map(|recording| recording.as_mut().ok()) {
        first.findings.append(&mut of_table);
    } else if let Some(Err(reject)) = recordings.first_mut() {
        reject.explain(&of_table);
    }
    recordings
}

impl Rows<'_> {
    fn recording(&self, unit: &RawUnit, group: &Group) -> Result<Recording, Reject> {
        let mut unit = unit.clone();
        if !group.recording.is_empty() {
            unit.case_id = format!("{}:{}", unit.case_id, group.recording);
        }
        let own_name = || unit.case_id.clone();
        unit.place = group.place.clone().or_else(|| self.mapping.place.clone()).unwrap_or_else(own_name);

        let clock = self.clock(group);
        let names = self.table.text(Some(&self.mapping.columns.track));
        let mut left_out = LeftOut::default();
        let mut tracks = Vec::new();
        for (id, rows) in &group.tracks {
            let id = names.map_or("", |names| names.different[*id as usize].as_str());
            left_out.n_agents += 1;
            left_out.n_rows += rows.len();
            match self.agents(id, rows, clock, &mut left_out) {
                Ok(agents) => tracks.extend(agents),
                Err(reject) => left_out.agent(reject, self.is_own(self.time_s(rows[0]) - clock.start_s)),
            }
        }
        let away_m = tracks.iter().map(farthest_m).fold(0.0, f64::max);
        let is_long = tracks.iter().any(|track| track.states.len() > N_STATES_AT_REST);
        let is_at_rest = self.part.is_none() && is_long && away_m < MAX_AT_REST_M;
        let at_rest = format!(
            "{}: nobody is ever more than {away_m:.4} m from where it begins; are positions in meters, by \
             ingest.table.length_unit_m, and not in degrees, which need ingest.table.origin?",
            self.file
        );
        left_out.note("recordings_at_rest", usize::from(is_at_rest), &at_rest);
        // Once for a table in parts.
        if self.part.as_ref().is_none_or(|part| part.windows.start == 0) {
            self.judge_classes(&tracks, &mut left_out);
        }
        Ok(Recording { dataset: Dataset::Table, unit, tracks, findings: left_out.findings()? })
    }

    /// When the recording begins.
    fn clock(&self, group: &Group) -> Clock {
        if let Some(part) = &self.part {
            return Clock { start_s: part.start_s, first_s: part.frames.0 as f64 * DT_S };
        }
        let begun_s = group.tracks.first().map_or(0.0, |(_, rows)| self.time_s(rows[0]));
        let times = group.tracks.iter().flat_map(|(_, rows)| rows).map(|row| self.time_s(*row));
        let first_s = times.filter(|time_s| is_of_recording(*time_s, begun_s)).fold(begun_s, f64::min);
        let first_frame_s = first_frame_of(first_s) as f64 * DT_S;
        Clock { start_s: first_s - first_frame_s, first_s: first_frame_s }
    }

    pub(super) fn time_s(&self, row: u32) -> f64 {
        let TableColumns { time, frame, .. } = &self.mapping.columns;
        let times = self.table.number(time.as_deref().or(frame.as_deref()));
        times.map_or(f64::NAN, |times| self.mapping.seconds_of(times[row as usize]))
    }

    /// Whether findings at this time are counted here, and not with the previous or the next part.
    pub(super) fn is_own(&self, time_s: f64) -> bool {
        self.part.as_ref().is_none_or(|part| part.own_s.contains(&time_s))
    }

    pub(super) fn reject(&self, reason: &'static str, row: u32, detail: &str) -> Reject {
        Reject { reason, detail: format!("{}, {}: {detail}", self.file, self.table.place_of(row as usize)) }
    }

    /// The track of the rows of one agent, by ascending time; `None` if it is not at any frame.
    pub(super) fn track(
        &self,
        (id, name): (&str, String),
        rows: &[u32],
        seen: &SeenTrack,
        clock: Clock,
        left_out: &mut LeftOut,
    ) -> Result<Option<RecordedTrack>, Reject> {
        let class = self.class(id, rows, clock, left_out)?;
        let extent = self.extent(id, rows, clock, left_out)?;
        let mut states: Vec<TimedState> = rows.iter().map(|row| self.state(*row, extent, clock.start_s)).collect();
        let chords = Chords::of(class, extent, self.mapping.position);
        self.blank_headings((id, class, chords), rows, &mut states, left_out);
        let observations = self.observed(id, rows, &states, left_out)?;
        if observations.is_empty() {
            return Ok(None);
        }
        let mut found = headings(&observations, class, chords);
        let is_unknown = |(_, source): &(f64, HeadingSource)| *source == HeadingSource::Unknown;
        // A course over ground is 0 where nothing moves.
        if chords.is_wheeled && self.are_zero(self.mapping.columns.heading.as_deref(), rows) {
            let blank = |seen: &Observation| Observation { heading_rad: None, ..*seen };
            let observations: Vec<Observation> = observations.iter().map(blank).collect();
            if headings(&observations, class, chords).iter().all(is_unknown) {
                found.iter_mut().for_each(|(_, source)| *source = HeadingSource::Unknown);
                let detail =
                    format!("{}: track {id} never moves; its lane tells its heading, if it is on one", self.file);
                let n = usize::from(self.is_own(observations[0].frame as f64 * DT_S));
                left_out.note("headings_of_0_at_rest", n, &detail);
            }
        }
        if chords.is_wheeled
            && found.iter().all(is_unknown)
            && let Some(stood_rad) = self.stood_rad(rows[0], seen)
        {
            found.fill((stood_rad, HeadingSource::Held));
        }
        let half_m = extent.unwrap_or_else(|| class.nominal_extent()).length_m / 2.0;
        let ahead_m = match self.mapping.position {
            PositionOf::Center | PositionOf::Corner => 0.0,
            PositionOf::Front => -half_m,
            PositionOf::Rear => half_m,
        };
        let state = |(seen, (heading_rad, source)): (&Observation, (f64, HeadingSource))| {
            // A person whose heading is not recorded is where the position is, whatever part of it that may be.
            let is_known = source == HeadingSource::Recorded || chords.is_wheeled && source != HeadingSource::Unknown;
            let to_center = Vec2::from_angle(heading_rad) * if is_known { ahead_m } else { 0.0 };
            let position = seen.position + to_center;
            (seen.frame, State { position, heading_rad, velocity: seen.velocity }, source)
        };
        let states: Vec<_> = observations.iter().zip(found).map(state).collect();
        let never_moves = chords.is_wheeled && states.iter().all(|(.., source)| *source == HeadingSource::Unknown);
        let mut track = RecordedTrack::of_states(TrackId(name), class, extent, seen.parked_s.clone(), states);
        track.never_moves = never_moves.then_some(ahead_m);
        Ok(Some(track))
    }

    /// The states of an agent at the frames, with gaps filled as far as the mapping allows.
    fn observed(
        &self,
        id: &str,
        rows: &[u32],
        states: &[TimedState],
        left_out: &mut LeftOut,
    ) -> Result<Vec<Observation>, Reject> {
        let gaps = Gaps::of(states, self.mapping.max_gap_s, |time_s| self.is_own(time_s));
        // At the ends of a part there may be few rows, on either side of a gap.
        let is_enough = self.part.is_none() || states.len() > N_ROWS_OF_PART;
        if is_enough && gaps.usual_s > MAX_USUAL_S.max(self.mapping.max_gap_s) {
            let detail = format!(
                "the rows of track {id} are {:.3} s apart, expected {MAX_USUAL_S} s at most; are \
                 ingest.table.time_unit_s and frame_rate_hz right?",
                gaps.usual_s
            );
            return Err(self.reject("implausible_times", rows[0], &detail));
        }
        left_out.note("gaps_filled", gaps.n_filled, &format!("{}: gaps within tracks are filled in", self.file));
        let resampled = resampled(states, self.mapping.max_gap_s);
        let lasts_s = states.last().map_or(0.0, |last| last.time_s - states[0].time_s);
        let is_open = (resampled.len() as f64) < MIN_FILLED_SHARE * lasts_s / DT_S;
        if is_enough && is_open && gaps.usual_s > self.mapping.max_gap_s + 1e-4 {
            let detail = format!(
                "the rows of track {id} are {0:.3} s apart, and nothing between them is filled in: set \
                 ingest.table.max_gap_s, {1}, to more than {0:.3}",
                gaps.usual_s, self.mapping.max_gap_s
            );
            return Err(self.reject("implausible_times", rows[0], &detail));
        }
        // Radians are passed on as they are: they may be degrees.
        let heading = |heading_rad: f64| match self.mapping.heading {
            HeadingUnit::Radians => heading_rad,
            HeadingUnit::Degrees | HeadingUnit::CompassDegrees => wrap_angle(heading_rad),
        };
        let observation = |(frame, state): &(i64, TimedState)| Observation {
            frame: *frame,
            position: state.position,
            velocity: Vec2::ZERO,
            heading_rad: state.heading_rad.map(heading),
        };
        let mut observations: Vec<Observation> = resampled.iter().map(observation).collect();
        // Scenes derive velocities anew, those of the past from the past alone; these are for states without neighbors.
        let velocities: Vec<Vec2> = (0..observations.len()).map(|index| velocity(&observations, index)).collect();
        for (observation, velocity) in observations.iter_mut().zip(velocities) {
            observation.velocity = velocity;
        }
        Ok(observations)
    }

    /// Whether a column is 0 in all of these rows.
    fn are_zero(&self, column: Option<&str>, rows: &[u32]) -> bool {
        self.table.number(column).is_some_and(|numbers| rows.iter().all(|row| numbers[*row as usize] == 0.0))
    }

    /// Where an agent points that stands from this row on, if other parts of the table tell.
    fn stood_rad(&self, row: u32, seen: &SeenTrack) -> Option<f64> {
        let time_s = self.time_s(row);
        let at = seen.stood_rad.partition_point(|(until_s, _)| *until_s <= time_s);
        let (_, heading_rad) = seen.stood_rad.get(at)?;
        Some(if self.mapping.y_points_down { -heading_rad } else { *heading_rad })
    }

    /// The position in a row, as recorded, meters.
    pub(super) fn position(&self, row: u32) -> Vec2 {
        let TableColumns { x, y, .. } = &self.mapping.columns;
        let number = |name: &String| self.table.number(Some(name)).map_or(f64::NAN, |numbers| numbers[row as usize]);
        self.plane.at([x, y].map(number))
    }

    /// Center (or front or rear) and heading at a row.
    fn state(&self, row: u32, extent: Option<Extent>, start_s: f64) -> TimedState {
        let mut position = self.position(row);
        if let (PositionOf::Corner, Some(Extent { length_m, width_m })) = (self.mapping.position, extent) {
            position = position + Vec2::new(length_m, width_m) * 0.5;
        }
        let heading = self.table.number(self.mapping.columns.heading.as_deref()).map(|headings| headings[row as usize]);
        let mut heading_rad = heading.filter(|heading| heading.is_finite()).map(|heading| match self.mapping.heading {
            HeadingUnit::Radians => heading,
            HeadingUnit::Degrees => heading.to_radians(),
            HeadingUnit::CompassDegrees => self.plane.north_rad - heading.to_radians(),
        });
        if self.mapping.y_points_down {
            position.y = -position.y;
            heading_rad = heading_rad.map(|heading_rad| -heading_rad);
        }
        TimedState { time_s: self.time_s(row) - start_s, position, heading_rad }
    }
}

/// When a recording begins, seconds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    /// The time of frame 0, as in the rows: 0, unless the recording begins far from it.
    pub(super) start_s: f64,
    /// The time of its first row after that.
    pub(super) first_s: f64,
}

/// Whether a time can be of the recording that began at another.
pub(super) fn is_of_recording(time_s: f64, begun_s: f64) -> bool {
    (time_s - begun_s).abs() <= MAX_RECORDING_S
}

/// The frame at which a recording begins. Frames are counted so that rows at 10 Hz stay unchanged.
pub(super) fn first_frame_of(first_s: f64) -> i64 {
    if first_s.abs() < MAX_START_S { (first_s / DT_S).round() as i64 } else { 0 }
}

/// The velocity derived from the observations around one.
fn velocity(observations: &[Observation], index: usize) -> Vec2 {
    let position = |offset: isize| {
        let beside = observations.get(index.checked_add_signed(offset)?)?;
        (beside.frame - observations[index].frame == offset as i64).then_some(beside.position)
    };
    velocity_at(position, DT_S).unwrap_or(Vec2::ZERO)
}

/// The distances in time between the rows of a track.
struct Gaps {
    usual_s: f64,
    /// The number of longer ones that are filled in.
    n_filled: usize,
}

impl Gaps {
    fn of(states: &[TimedState], max_gap_s: f64, is_own: impl Fn(f64) -> bool) -> Self {
        let gap_s = |pair: &[TimedState]| pair[1].time_s - pair[0].time_s;
        let mut gaps_s: Vec<f64> = states.windows(2).map(gap_s).collect();
        gaps_s.sort_by(f64::total_cmp);
        let usual_s = gaps_s.get(gaps_s.len() / 2).copied().unwrap_or_default();
        let is_filled =
            |pair: &&[TimedState]| (1.5 * usual_s..=max_gap_s).contains(&gap_s(pair)) && is_own(pair[1].time_s);
        let n_filled = states.windows(2).filter(is_filled).count();
        Self { usual_s, n_filled }
    }
}

/// The largest distance of a track from its beginning, meters.
fn farthest_m(track: &RecordedTrack) -> f64 {
    let positions = || track.states.iter().map(|(_, state, _)| state.position);
    positions().next().map_or(0.0, |first| positions().map(|at| at.distance(first)).fold(0.0, f64::max))
}
