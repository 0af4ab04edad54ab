//! The tracks of a table: the states of each agent from its rows, at the frames of scenes.

use super::columns::Table;
use super::mapping::{HeadingUnit, PositionOf, TableColumns, TableMapping};
use super::resample::{TimedState, resampled};
use super::rows::{Group, Rows};
use crate::geometry::Vec2;
use crate::ingest::assemble::MAX_COORDINATE_M;
use crate::ingest::recorded_track::{DT_S, Observation, RecordedTrack};
use crate::ingest::standing::Standing;
use crate::ingest::windows::Recording;
use crate::ingest::{Finding, RawUnit, Reject};
use crate::scene::{AgentClass, Dataset, Extent, TrackId, TrackRole, velocity_at};
use std::f64::consts::FRAC_PI_2;

/// Frames are numbered by the times of the recording unless these are further than this from 0, as times of day are,
/// seconds.
const MAX_START_S: f64 = 1e6;
/// The longest recording, seconds; see [`windows`](crate::ingest::windows).
const MAX_RECORDING_S: f64 = 1e5;
/// The largest agent, meters.
const MAX_SIZE_M: f64 = 1e3;
/// Rows of a track that are usually further apart than this do not show its motion, seconds.
const MAX_USUAL_S: f64 = 1.0;
/// This many rows of a track in a part show their usual distance in time.
const N_ROWS_OF_PART: usize = 20;
/// A recording in which no agent moves as far as this is not in meters.
const MAX_AT_REST_M: f64 = 0.5;
/// Two rows of a track at one time are the same if their positions are this close, meters.
const SAME_M: f64 = 1e-6;

/// The recordings of a file, in the order of their first rows, or why one cannot be read.
pub(super) fn recordings(mut unit: RawUnit, mapping: &TableMapping) -> Vec<Result<Recording, Reject>> {
    let rows = match Rows::read(&unit, mapping) {
        Ok(rows) => rows,
        Err(reject) => return vec![Err(reject)],
    };
    (unit.bytes, unit.lines, unit.companion) = (Vec::new(), Vec::new(), None);
    rows.groups().into_iter().map(|group| rows.recording(&unit, &group)).collect()
}

impl Rows<'_> {
    fn recording(&self, unit: &RawUnit, group: &Group) -> Result<Recording, Reject> {
        let mut unit = unit.clone();
        if !group.recording.is_empty() {
            unit.case_id = format!("{}:{}", unit.case_id, group.recording);
        }
        let own_name = || unit.case_id.clone();
        unit.place = group.place.clone().or_else(|| self.mapping.place.clone()).unwrap_or_else(own_name);

        let key = self.mapping.columns.track.as_str();
        if self.part.is_none() && group.tracks.iter().all(|(id, _)| self.table.is_blank(key, *id)) {
            return Err(
                unit.reject("no_rows", format!("column {key} is blank in all rows, expected the id of a track"))
            );
        }
        let start_s = self.start_s(group)?;
        let names = self.table.text(Some(&self.mapping.columns.track));
        let mut counts = Counts::default();
        let mut tracks = Vec::new();
        for (id, rows) in &group.tracks {
            let id = names.map_or("", |names| names.different[*id as usize].as_str());
            if id.is_empty() {
                for row in rows {
                    counts.n_without_track += usize::from(self.is_own(self.time_s(*row as usize)? - start_s));
                }
                continue;
            }
            tracks.extend(self.track(id, rows, start_s, &mut counts)?);
        }
        let away_m = tracks.iter().map(farthest_m).fold(0.0, f64::max);
        counts.at_rest_m = (self.part.is_none() && !tracks.is_empty() && away_m < MAX_AT_REST_M).then_some(away_m);
        let is_first = self.part.as_ref().is_none_or(|part| part.windows.start == 0);
        let findings =
            self.unmapped_types().filter(|_| is_first).into_iter().chain(counts.findings(&self.file)).collect();
        Ok(Recording { dataset: Dataset::Table, unit, tracks, findings })
    }

    /// The time of frame 0, seconds in the unit of rows: 0, unless the recording begins far from it.
    fn start_s(&self, group: &Group) -> Result<f64, Reject> {
        if let Some(part) = &self.part {
            return Ok(part.start_s);
        }
        let rows = group.tracks.iter().flat_map(|(_, rows)| rows);
        let mut first_s = f64::INFINITY;
        for row in rows {
            first_s = first_s.min(self.time_s(*row as usize)?);
        }
        Ok(first_s - first_frame_of(first_s) as f64 * DT_S)
    }

    fn time_s(&self, row: usize) -> Result<f64, Reject> {
        let TableColumns { time, frame, .. } = &self.mapping.columns;
        let name = time.as_ref().or(frame.as_ref()).map_or("", String::as_str);
        self.finite(name, row).map(|value| self.mapping.seconds_of(value))
    }

    /// Whether findings at this time are counted here, and not with the previous or the next part.
    fn is_own(&self, time_s: f64) -> bool {
        self.part.as_ref().is_none_or(|part| part.own_s.contains(&time_s))
    }

    /// A number that every row must have.
    fn finite(&self, name: &str, row: usize) -> Result<f64, Reject> {
        match self.table.number(Some(name)).map(|numbers| numbers[row]) {
            Some(number) if number.is_finite() => Ok(number),
            found => {
                let found = match found {
                    Some(number) if !number.is_nan() => number.to_string(),
                    _ => "blank or NaN".to_owned(),
                };
                Err(self.reject("non_finite", row, &format!("column {name} is {found}, expected a number")))
            }
        }
    }

    fn reject(&self, reason: &'static str, row: usize, detail: &str) -> Reject {
        Reject { reason, detail: format!("{}, {}: {detail}", self.file, self.table.place_of(row)) }
    }

    /// The track of these rows; `None` if it is not at any frame.
    fn track(
        &self,
        id: &str,
        rows: &[u32],
        start_s: f64,
        counts: &mut Counts,
    ) -> Result<Option<RecordedTrack>, Reject> {
        let class = self.class(id, rows[0] as usize)?;
        let extent = self.extent(id, rows)?;
        let mut states = Vec::with_capacity(rows.len());
        for row in rows {
            states.push((self.state(*row as usize, extent, start_s)?, *row));
        }
        let own_rows: Vec<u32> =
            states.iter().filter(|(state, _)| self.is_own(state.time_s)).map(|(_, row)| *row).collect();
        self.count_other_classes(id, rows[0], &own_rows, counts);
        states.sort_by(|(a, _), (b, _)| a.time_s.total_cmp(&b.time_s));
        for pair in states.windows(2) {
            let ([(first, _), (again, row)], same_s) = ([pair[0], pair[1]], 1e-9);
            if again.time_s - first.time_s < same_s && first.position.distance(again.position) > SAME_M {
                let detail = format!(
                    "track {id} is at two positions at one time; if the table has several recordings, name the column \
                     that distinguishes them in ingest.table.columns.recording"
                );
                return Err(self.reject("duplicate_time", row as usize, &detail));
            }
        }
        states.dedup_by(|(again, _), (first, _)| {
            let is_repeated = again.time_s - first.time_s < 1e-9;
            counts.n_repeated += usize::from(is_repeated && self.is_own(again.time_s));
            is_repeated
        });
        let states: Vec<TimedState> = states.into_iter().map(|(state, _)| state).collect();
        let gaps = Gaps::of(&states, self.mapping.max_gap_s, |time_s| self.is_own(time_s));
        // At the ends of a part there may be few rows, on either side of a gap.
        let is_enough = self.part.is_none() || states.len() > N_ROWS_OF_PART;
        if is_enough && gaps.usual_s > MAX_USUAL_S.max(self.mapping.max_gap_s) {
            let detail = format!(
                "the rows of track {id} are {:.3} s apart, expected {MAX_USUAL_S} s at most; are \
                 ingest.table.time_unit_s and frame_rate_hz right?",
                gaps.usual_s
            );
            return Err(self.reject("implausible_times", rows[0] as usize, &detail));
        }
        counts.n_gaps += gaps.n_filled;
        let resampled = resampled(&states, self.mapping.max_gap_s);
        let observation = |(frame, state): &(i64, TimedState)| Observation {
            frame: *frame,
            position: state.position,
            velocity: Vec2::ZERO,
            heading_rad: state.heading_rad,
        };
        let mut observations: Vec<Observation> = resampled.iter().map(observation).collect();
        // Scenes derive velocities anew, those of the past from the past alone; these are for states without neighbors.
        let velocities: Vec<Vec2> = (0..observations.len()).map(|index| velocity(&observations, index)).collect();
        for (observation, velocity) in observations.iter_mut().zip(velocities) {
            observation.velocity = velocity;
        }
        if observations.is_empty() {
            return Ok(None);
        }
        let mut track = RecordedTrack::new(TrackId(id.to_owned()), class, TrackRole::Context, extent, &observations);
        track.parked_s = match &self.part {
            Some(part) => part.tracks.get(id).map(|seen| seen.parked_s.clone()).unwrap_or_default(),
            None => {
                let mut standing = Standing::default();
                states.iter().for_each(|state| standing.see(state.time_s, state.position));
                standing.parked_s(0.0)
            }
        };
        if self.mapping.position == PositionOf::Front {
            let back_m = extent.unwrap_or_else(|| class.nominal_extent()).length_m / 2.0;
            for (_, state, _) in &mut track.states {
                state.position = state.position - Vec2::from_angle(state.heading_rad) * back_m;
            }
        }
        Ok(Some(track))
    }

    /// Center (or front) and heading at a row.
    fn state(&self, row: usize, extent: Option<Extent>, start_s: f64) -> Result<TimedState, Reject> {
        let TableColumns { x, y, heading, .. } = &self.mapping.columns;
        let time_s = self.time_s(row)? - start_s;
        if time_s > MAX_RECORDING_S {
            let detail = format!(
                "is {time_s:.0} s after the first row, expected at most {MAX_RECORDING_S}; is the time right, and \
                 ingest.table.time_unit_s or frame_rate_hz?"
            );
            return Err(self.reject("implausible_times", row, &detail));
        }
        let mut position = Vec2::new(self.finite(x, row)?, self.finite(y, row)?) * self.mapping.length_unit_m;
        for (name, at_m) in [(x, position.x), (y, position.y)] {
            if at_m.abs() > MAX_COORDINATE_M {
                let detail = format!(
                    "column {name} is {at_m:e} m, expected at most {MAX_COORDINATE_M}; is ingest.table.length_unit_m \
                     right?"
                );
                return Err(self.reject("out_of_range", row, &detail));
            }
        }
        if let (PositionOf::Corner, Some(Extent { length_m, width_m })) = (self.mapping.position, extent) {
            position = position + Vec2::new(length_m, width_m) * 0.5;
        }
        let heading = self.table.number(heading.as_deref()).map(|headings| headings[row]);
        let mut heading_rad = heading.filter(|heading| heading.is_finite()).map(|heading| match self.mapping.heading {
            HeadingUnit::Radians => heading,
            HeadingUnit::Degrees => heading.to_radians(),
            HeadingUnit::CompassDegrees => FRAC_PI_2 - heading.to_radians(),
        });
        if self.mapping.y_points_down {
            position.y = -position.y;
            heading_rad = heading_rad.map(|heading_rad| -heading_rad);
        }
        Ok(TimedState { time_s, position, heading_rad })
    }

    /// The class of a track, by one of its rows or the table of tracks.
    fn class(&self, id: &str, row: usize) -> Result<AgentClass, Reject> {
        let name = self.mapping.columns.class.as_deref();
        let Some(name) = name else { return Ok(self.mapping.class) };
        let of_row = |table: &Table, row: usize| {
            table.text(Some(name)).map(|texts| texts.different[texts.of_row[row] as usize].clone())
        };
        let (found, file, place) = match (of_row(&self.table, row), &self.of_tracks) {
            (Some(found), _) => (found, self.file.clone(), self.table.place_of(row)),
            (None, Some(of_tracks)) => {
                let row = of_tracks.row_of(id)?;
                let found = of_row(&of_tracks.table, row).unwrap_or_default();
                (found, of_tracks.file.clone(), of_tracks.table.place_of(row))
            }
            (None, None) => (String::new(), self.file.clone(), self.table.place_of(row)),
        };
        self.mapping.classes.get(&found).copied().ok_or_else(|| Reject {
            reason: "unknown_class",
            detail: format!(
                "{file}, {place}: column {name} is \"{found}\", which ingest.table.classes does not list; add it, as \
                 one of {}",
                AgentClass::ALL.map(AgentClass::name).join(", ")
            ),
        })
    }

    /// Counts the rows whose class is not that of the first row of their track.
    fn count_other_classes(&self, id: &str, first: u32, rows: &[u32], counts: &mut Counts) {
        let Some(classes) = self.table.text(self.mapping.columns.class.as_deref()) else { return };
        let class_of = |row: u32| classes.of_row[row as usize];
        for row in rows.iter().filter(|row| class_of(**row) != class_of(first)) {
            counts.n_other_classes += 1;
            counts.first_other_class.get_or_insert_with(|| {
                let [found, taken] = [*row, first].map(|row| &classes.different[class_of(row) as usize]);
                let place = self.table.place_of(*row as usize);
                format!("{place}: track {id} is \"{found}\", having been \"{taken}\", which is taken")
            });
        }
    }

    /// The size of a track: of its first row with one, or of the table of tracks.
    fn extent(&self, id: &str, rows: &[u32]) -> Result<Option<Extent>, Reject> {
        let TableColumns { length, width, .. } = &self.mapping.columns;
        let Some((length, width)) = length.as_deref().zip(width.as_deref()) else { return Ok(None) };
        let size = |table: &Table, name: &str, row: usize| {
            let size_m = table.number(Some(name))?[row] * self.mapping.length_unit_m;
            (size_m != 0.0 && size_m.is_finite()).then_some(size_m)
        };
        let of = |table: &Table, row: usize| size(table, length, row).zip(size(table, width, row));
        let of_rows = rows.iter().find_map(|row| of(&self.table, *row as usize));
        let found = match (of_rows, &self.of_tracks) {
            (None, Some(of_tracks)) if self.table.number(Some(length)).is_none() => {
                of(&of_tracks.table, of_tracks.row_of(id)?)
            }
            (found, _) => found,
        };
        match found {
            Some((length_m, width_m)) if length_m.max(width_m) > MAX_SIZE_M || length_m.min(width_m) < 0.0 => {
                let detail = format!(
                    "track {id} is {length_m} by {width_m} m in length and width, expected 0 to {MAX_SIZE_M}; is \
                     ingest.table.length_unit_m right?"
                );
                Err(self.reject("out_of_range", rows[0] as usize, &detail))
            }
            found => Ok(found.map(|(length_m, width_m)| Extent { length_m, width_m })),
        }
    }
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

/// Remarkable facts about a recording.
#[derive(Debug, Default)]
struct Counts {
    n_without_track: usize,
    n_repeated: usize,
    n_gaps: usize,
    n_other_classes: usize,
    first_other_class: Option<String>,
    /// The largest distance that any agent moves, meters, if all are at rest.
    at_rest_m: Option<f64>,
}

impl Counts {
    fn findings(&self, file: &str) -> Vec<Finding> {
        let finding = |what: &'static str, n: usize, detail: &str| {
            (n > 0).then(|| Finding { what, n: n as u64, detail: format!("{file}: {detail}") })
        };
        let at_rest = self.at_rest_m.map(|away_m| {
            format!(
                "nobody is ever more than {away_m:.4} m from where it begins; are positions in meters, by \
                 ingest.table.length_unit_m, and not in degrees?"
            )
        });
        let all = [
            finding("recordings_at_rest", usize::from(at_rest.is_some()), at_rest.as_deref().unwrap_or_default()),
            finding("rows_without_track", self.n_without_track, "rows without an id are left out"),
            finding("rows_repeated", self.n_repeated, "rows that repeat the one before are left out"),
            finding("gaps_filled", self.n_gaps, "gaps within tracks are filled in"),
            finding(
                "rows_of_another_class",
                self.n_other_classes,
                self.first_other_class.as_deref().unwrap_or_default(),
            ),
        ];
        all.into_iter().flatten().collect()
    }
}
