//! Argoverse 1 recordings: from the rows of a CSV file to the tracks of a scene.

use super::even_times::{TimedRow, smoothed_states};
use super::kinematics::{DerivedStates, derive_states};
use super::{DT_S, RECORDED};
use crate::geometry::Vec2;
use crate::ingest::csv_rows::{lines_of, split_cells};
use crate::ingest::decimal;
use crate::ingest::ids;
use crate::ingest::quotes::{printable, without_quotes};
use crate::ingest::raw::{HeadingGap, RawScene, RawUnit, Reject, map_id};
use crate::ingest::source::Horizon;
use crate::scene::{AgentClass, Dataset, Derivation, SceneId, Split, Track, TrackId, TrackRole, Trajectory};
use std::collections::HashMap;

const COLUMNS: [&str; 6] = ["TIMESTAMP", "TRACK_ID", "OBJECT_TYPE", "X", "Y", "CITY_NAME"];

/// Maximum number of tracks of a file; real files have hundreds, and each track takes memory for all timesteps.
const MAX_TRACKS: usize = 10_000;

/// The scene of a file, cut to `horizon` around the present of the dataset, its tracks smoothed or as recorded.
/// Unsmoothed tracks have one row a timestep, whatever its time.
pub(super) fn parse(unit: &RawUnit, horizon: Horizon, smooths: bool) -> Result<RawScene, Reject> {
    let table = TrackTable::read(unit)?;
    let split = unit.split.of_scene();
    let timestamps_s = timestamps(unit, &table.rows, split)?;
    let first = RECORDED.n_history - horizon.n_history;
    let last = timestamps_s.len().min(RECORDED.n_history + horizon.n_future);
    let mut tracks = Vec::with_capacity(table.tracks.len());
    let mut heading_gaps = Vec::new();
    for (track, positions) in table.tracks.iter().zip(positions(unit, &table, &timestamps_s)?) {
        let derived = match smooths {
            true => smoothed(&positions, &timestamps_s),
            false => derive_states(&positions, &timestamps_s, RECORDED.n_history),
        };
        let DerivedStates { states, held_headings, headings_from, recorded } = derived;
        if headings_from > first {
            heading_gaps.push(HeadingGap {
                track_idx: tracks.len(),
                until_timestep: headings_from - first,
                never_moves: None,
            });
        }
        let derivation = Derivation { held_headings: held_headings[first..last].to_vec(), recorded };
        tracks.push(Track {
            id: TrackId(track.id.clone()),
            class: AgentClass::Unknown,
            role: track.role,
            extent: None,
            trajectory: Trajectory::new(states[first..last].to_vec()).derived(derivation),
        });
    }
    let place = table.city;
    Ok(RawScene {
        id: SceneId(format!("{}/{}/{place}/{}", Dataset::Argoverse1.name(), split.name(), unit.case_id)),
        map_id: map_id(Dataset::Argoverse1, &place),
        source: unit.source(Dataset::Argoverse1, split, place, unit.case_id.clone(), timestamps_s[first].to_string()),
        dt_s: DT_S,
        n_timesteps: last - first,
        n_history: horizon.n_history,
        tracks,
        heading_gaps,
        own_map: None,
        findings: Vec::new(),
    })
}

/// The states of a track, smoothed and resampled to even times around the present.
fn smoothed(positions: &[Option<Vec2>], timestamps_s: &[f64]) -> DerivedStates {
    let present_s = timestamps_s[RECORDED.n_history - 1];
    let row = |(time_idx, position): (usize, &Option<Vec2>)| {
        Some(TimedRow { time_idx, time_s: timestamps_s[time_idx] - present_s, position: (*position)? })
    };
    let rows: Vec<TimedRow> = positions.iter().enumerate().filter_map(row).collect();
    smoothed_states(&rows, timestamps_s.len(), timestamps_s.len())
}

struct TrackTable {
    rows: Vec<TableRow>,
    tracks: Vec<TrackHead>,
    city: String,
}

struct TableRow {
    line: u64,
    timestamp_s: f64,
    track_idx: usize,
    position: Vec2,
}

struct TrackHead {
    id: String,
    role: TrackRole,
}

impl TrackTable {
    fn read(unit: &RawUnit) -> Result<Self, Reject> {
        let bytes = unit.bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&unit.bytes);
        let bytes = &without_quotes(bytes);
        let mut lines = lines_of(bytes).zip(1..).filter(|(line, _)| !line.is_empty());
        let mut cells = Vec::new();
        let (header, header_line) = lines.next().unwrap_or((b"", 1));
        split_cells(header, &mut cells);
        let (columns, n_columns) = (find_columns(unit, header_line, &cells)?, cells.len());
        let mut table = Self { rows: Vec::with_capacity(bytes.len() / 96), tracks: Vec::new(), city: String::new() };
        let mut known: HashMap<&[u8], usize> = HashMap::new();
        for (line, number) in lines {
            split_cells(line, &mut cells);
            if cells.len() != n_columns {
                let detail = format!("{} fields, expected {n_columns}", cells.len());
                return Err(unit.reject_at("malformed_row", number, detail));
            }
            table.push(unit, number, columns.map(|column| cells[column].trim_ascii()), &mut known)?;
        }
        if let Some(pair) = ids::ambiguous(table.tracks.iter().map(|track| track.id.as_bytes())).next() {
            return Err(unit.reject(ids::AMBIGUOUS, ids::in_words("track", pair)));
        }
        let n_focal = table.tracks.iter().filter(|track| track.role == TrackRole::Focal).count();
        match n_focal {
            0 => Err(unit.reject("no_agent_track", "no track has OBJECT_TYPE AGENT, expected exactly one")),
            1 => Ok(table),
            n => Err(unit.reject("several_agent_tracks", format!("{n} tracks have OBJECT_TYPE AGENT, expected 1"))),
        }
    }

    fn push<'a>(
        &mut self,
        unit: &RawUnit,
        line: u64,
        fields: [&'a [u8]; COLUMNS.len()],
        known: &mut HashMap<&'a [u8], usize>,
    ) -> Result<(), Reject> {
        let [timestamp, track_id, object_type, x, y, city] = fields;
        let number = |name: &str, text: &[u8]| {
            let value = decimal::number(text).ok_or_else(|| {
                unit.reject_at("malformed_row", line, format!("{name} is `{}`, expected a number", printable(text)))
            })?;
            if value.is_finite() {
                Ok(value)
            } else {
                Err(unit.reject_at("non_finite", line, format!("{name} is {value}")))
            }
        };
        let timestamp_s = number("TIMESTAMP", timestamp)?;
        let position = Vec2::new(number("X", x)?, number("Y", y)?);
        for (name, text) in [("TRACK_ID", track_id), ("CITY_NAME", city)] {
            if text.is_empty() {
                return Err(unit.reject_at("malformed_row", line, format!("{name} is empty")));
            }
            if text.iter().any(u8::is_ascii_control) {
                let detail = format!("{name} is `{}`, expected a name without commas", printable(text));
                return Err(unit.reject_at("malformed_row", line, detail));
            }
        }
        if self.city.is_empty() {
            self.city = String::from_utf8_lossy(city).into_owned();
        } else if self.city.as_bytes() != city {
            let detail = format!("CITY_NAME is `{}` after `{}`", printable(city), self.city);
            return Err(unit.reject_at("malformed_row", line, detail));
        }
        let track_idx = match known.get(track_id) {
            Some(track_idx) => *track_idx,
            None if self.tracks.len() == MAX_TRACKS => {
                return Err(unit.reject_at("too_many_tracks", line, format!("more than {MAX_TRACKS} tracks")));
            }
            None => {
                let id = String::from_utf8_lossy(track_id).into_owned();
                self.tracks.push(TrackHead { id, role: role_of(object_type) });
                known.insert(track_id, self.tracks.len() - 1);
                self.tracks.len() - 1
            }
        };
        self.rows.push(TableRow { line, timestamp_s, track_idx, position });
        Ok(())
    }
}

fn role_of(object_type: &[u8]) -> TrackRole {
    match object_type {
        b"AGENT" => TrackRole::Focal,
        b"AV" => TrackRole::Recorder,
        _ => TrackRole::Context,
    }
}

/// The positions of the format's columns in this file.
fn find_columns(unit: &RawUnit, line: u64, header: &[&[u8]]) -> Result<[usize; COLUMNS.len()], Reject> {
    let find = |name: &str| header.iter().position(|field| field.trim_ascii() == name.as_bytes());
    let missing: Vec<&str> = COLUMNS.into_iter().filter(|name| find(name).is_none()).collect();
    if !missing.is_empty() {
        let found: Vec<_> = header.iter().take(12).map(|field| String::from_utf8_lossy(field)).collect();
        let detail = format!(
            "no column {} in the header `{}`; expected comma-separated {}",
            missing.join(", "),
            shorten(&found.join(",")),
            COLUMNS.join(",")
        );
        return Err(unit.reject_at("bad_header", line, detail));
    }
    Ok(COLUMNS.map(|name| find(name).unwrap_or_default()))
}

/// The distinct times of the file, ascending: the timesteps. Only test files may end at the present.
fn timestamps(unit: &RawUnit, rows: &[TableRow], split: Split) -> Result<Vec<f64>, Reject> {
    let mut timestamps_s: Vec<f64> = rows.iter().map(|row| row.timestamp_s).collect();
    timestamps_s.sort_by(f64::total_cmp);
    timestamps_s.dedup();
    let may_end_at_present = matches!(split, Split::Test | Split::Unsplit);
    let n = timestamps_s.len();
    if n == RECORDED.n_timesteps() || (may_end_at_present && n == RECORDED.n_history) {
        return Ok(timestamps_s);
    }
    let or_test = if may_end_at_present { format!(" or {}", RECORDED.n_history) } else { String::new() };
    let detail = format!("{n} distinct timestamps, expected {}{or_test}", RECORDED.n_timesteps());
    Err(unit.reject("wrong_timestamp_count", detail))
}

/// The positions of each track, one entry a timestep.
fn positions(unit: &RawUnit, table: &TrackTable, timestamps_s: &[f64]) -> Result<Vec<Vec<Option<Vec2>>>, Reject> {
    let mut positions = vec![vec![None; timestamps_s.len()]; table.tracks.len()];
    for row in &table.rows {
        let timestep = timestamps_s.partition_point(|timestamp_s| *timestamp_s < row.timestamp_s);
        let entry: &mut Option<Vec2> = &mut positions[row.track_idx][timestep];
        if entry.replace(row.position).is_some() {
            let detail = format!("track {} has a second row at {}", table.tracks[row.track_idx].id, row.timestamp_s);
            return Err(unit.reject_at("duplicate_frame", row.line, detail));
        }
    }
    Ok(positions)
}

fn shorten(text: &str) -> String {
    const MAX_CHARS: usize = 120;
    if text.chars().count() <= MAX_CHARS {
        return text.to_owned();
    }
    text.chars().take(MAX_CHARS).chain("…".chars()).collect()
}

#[cfg(test)]
pub(super) mod tests;
