//! Decides how a long table is cut into parts, once its times are known.

use super::mapping::TableMapping;
use super::owners::Owners;
use super::timed_rows::TimedRows;
use super::tracks::{first_frame_of, is_of_recording};
use crate::ingest::IngestConfig;
use crate::ingest::raw::{Part, Reject};
use crate::ingest::recorded_track::DT_S;
use crate::ingest::source::Horizon;
use crate::ingest::windows::MAX_RECORDING_FRAMES;
use parquet::file::metadata::ParquetMetaData;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::BufRead;
use std::ops::Range;
use std::sync::Arc;

/// Seconds before the first scene of a part whose rows are read with it, if headings are not recorded.
const LEAD_S: f64 = 60.0;
/// Seconds before the first and after the last scene of a part whose rows are read with it, for motion between rows.
const NEAR_S: f64 = 1.0;
/// The most bytes of what is known of tracks.
const MAX_TRACKS_BYTES: usize = 1 << 30;

/// When and how tables are cut.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    /// Smaller tables are read as a whole.
    pub(super) whole_bytes: u64,
    /// The approximate size of a part, in the columns that are read.
    pub(super) part_bytes: u64,
    /// The least duration of a part, seconds.
    pub(super) part_s: f64,
    /// Parts of that size that are gathered at a time if rows are not by time.
    pub(super) n_at_a_time: usize,
}

pub(super) const SIZES: Sizes = Sizes { whole_bytes: 32 << 20, part_bytes: 4 << 20, part_s: 120.0, n_at_a_time: 8 };

/// The parts of a table.
pub(super) struct Plan {
    /// Whether one reading yields all parts.
    pub(super) is_sorted: bool,
    pub(super) recordings: BTreeMap<String, KeyedRows>,
    /// Each with the number of its recording, recording by recording in the order of their first rows.
    pub(super) parts: Vec<(usize, Part)>,
    /// The approximate size of each part, bytes.
    pub(super) n_bytes: Vec<u64>,
}

/// The rows of one recording, found when the times of the table are read.
pub(super) struct KeyedRows {
    pub(super) number: usize,
    /// The time of its first row in the table, and its first and last time, seconds.
    pub(super) begun_s: f64,
    pub(super) first_s: f64,
    pub(super) last_s: f64,
    pub(super) rows: Range<u64>,
    pub(super) n_bytes: u64,
    pub(super) is_sorted: bool,
    pub(super) tracks: BTreeMap<String, (usize, Owners)>,
}

/// The settings by which tables are cut.
#[derive(Clone, Copy)]
pub(super) struct Planner<'a> {
    pub(super) mapping: &'a TableMapping,
    pub(super) config: &'a IngestConfig,
    pub(super) horizon: Horizon,
    pub(super) sizes: Sizes,
}

impl Planner<'_> {
    /// Reads the times of a table.
    pub(super) fn plan(
        &self,
        file: &str,
        table: &mut dyn BufRead,
        footer: Option<&Arc<ParquetMetaData>>,
    ) -> Result<Plan, Reject> {
        let reject = |reason, detail: &dyn Display| Reject { reason, detail: format!("{file}: {detail}") };
        let mut rows =
            TimedRows::of(table, footer, self.mapping).map_err(|(reason, detail)| reject(reason, &detail))?;
        let mut recordings: BTreeMap<String, KeyedRows> = BTreeMap::new();
        let (mut key, mut n_rows, mut n_track_bytes) = (String::new(), 0, 0);
        while let Some(time_s) = rows.next().map_err(|error| reject("bad_table", &error))? {
            rows.key(&mut key);
            let n_recordings = recordings.len();
            if !recordings.contains_key(&key) {
                recordings.insert(key.clone(), KeyedRows::new(n_recordings, time_s, n_rows));
            }
            n_rows += 1;
            let Some(seen) = recordings.get_mut(&key) else { continue };
            seen.rows.end = n_rows;
            if !is_of_recording(time_s, seen.begun_s) {
                continue;
            }
            seen.is_sorted &= time_s >= seen.last_s;
            (seen.first_s, seen.last_s) = (seen.first_s.min(time_s), seen.last_s.max(time_s));
            seen.n_bytes += rows.rows.n_bytes();
            let (track, n_tracks) = (rows.track(), seen.tracks.len());
            if !seen.tracks.contains_key(&*track) {
                n_track_bytes += track.len() + size_of::<Owners>();
                if n_track_bytes > MAX_TRACKS_BYTES {
                    let detail =
                        format!("more than {n_tracks} tracks; is column {} their id?", self.mapping.columns.track);
                    return Err(reject("too_large", &detail));
                }
                seen.tracks.insert(track.clone().into_owned(), (n_tracks, Owners::default()));
            }
            let seen_now = rows.seen(time_s);
            if let Some((_, owners)) = seen.tracks.get_mut(&*track).filter(|_| seen_now.is_possible()) {
                owners.see(seen_now, self.mapping.max_gap_s);
            }
        }
        let passed = &rows.rows.passed;
        if let Some(fault) = passed.fault() {
            return Err(reject("bad_table", &fault));
        }
        if n_rows == 0 {
            return Err(reject("no_rows", &"the table has no rows with the id of a track"));
        }
        let counted = rows.rows.counted();
        let mut plan = self.cut(recordings, counted).map_err(|detail| reject("frame_out_of_range", &detail))?;
        if let Some((_, first)) = plan.parts.first_mut() {
            first.findings = passed.findings(file);
        }
        Ok(plan)
    }

    /// Cuts the recordings of a table.
    fn cut(&self, mut recordings: BTreeMap<String, KeyedRows>, counted: &'static str) -> Result<Plan, String> {
        let mut in_order: Vec<&mut KeyedRows> = recordings.values_mut().collect();
        in_order.sort_by_key(|seen| seen.number);
        let mut ends: Vec<u64> = in_order.iter().map(|seen| seen.rows.end).collect();
        ends.sort_unstable();
        let n_under_way = |seen: &&mut KeyedRows| seen.number + 1 - ends.partition_point(|end| *end <= seen.rows.start);
        let is_sorted = in_order.iter().map(n_under_way).max().unwrap_or_default() <= self.sizes.n_at_a_time
            && in_order.iter().all(|seen| seen.is_sorted);
        let (mut parts, mut n_bytes) = (Vec::new(), Vec::new());
        for seen in in_order {
            let of_recording = self.parts(seen, counted)?;
            n_bytes.extend(of_recording.iter().map(|_| seen.n_bytes / of_recording.len() as u64));
            parts.extend(of_recording.into_iter().map(|part| (seen.number, part)));
        }
        Ok(Plan { is_sorted, recordings, parts, n_bytes })
    }

    /// The parts of a recording; one that is too short for a scene is a part without any.
    fn parts(&self, seen: &mut KeyedRows, counted: &'static str) -> Result<Vec<Part>, String> {
        let KeyedRows { first_s, last_s, n_bytes, .. } = *seen;
        let first_frame = first_frame_of(first_s);
        let start_s = first_s - first_frame as f64 * DT_S;
        let n_frames = ((last_s - first_s) / DT_S + 1e-3).floor() as i64 + 1;
        if n_frames > MAX_RECORDING_FRAMES {
            return Err(format!("{n_frames} frames, expected at most {MAX_RECORDING_FRAMES}"));
        }
        let seen_track = |(id, (number, mut owners)): (String, (usize, Owners))| {
            owners.end();
            (id, owners.seen_track(number, start_s))
        };
        let tracks = std::mem::take(&mut seen.tracks).into_iter().map(seen_track);
        let tracks = Arc::new(tracks.collect::<BTreeMap<_, _>>());
        let stride = self.config.window_stride.max(1) as i64;
        let n_windows = ((n_frames - self.horizon.n_timesteps() as i64).div_euclid(stride) + 1).max(0);
        let n_parts = n_bytes.div_ceil(self.sizes.part_bytes).max(1) as i64;
        let shortest = (self.sizes.part_s / (stride as f64 * DT_S)).ceil() as i64;
        let n_each = (n_windows / n_parts).max(shortest).max(1);
        let near_s = NEAR_S + 2.0 * self.mapping.max_gap_s;
        let lead_s = if self.mapping.columns.heading.is_some() { near_s } else { near_s + LEAD_S };
        let part = |first: i64| -> Part {
            let windows = first..(first + n_each).min(n_windows);
            let seconds = |window: i64| (first_frame + window * stride) as f64 * DT_S;
            let behind_s = seconds(windows.end - 1) + self.horizon.n_timesteps() as f64 * DT_S;
            let is_last = windows.end == n_windows;
            let until = |end_s: f64| if is_last { f64::INFINITY } else { end_s };
            let from = |begin_s: f64| if first == 0 { f64::NEG_INFINITY } else { begin_s };
            Part {
                counted,
                start_s,
                frames: (first_frame, first_frame + n_frames - 1),
                tracks: Arc::clone(&tracks),
                own_s: from(seconds(first))..until(seconds(windows.end)),
                rows_s: from(seconds(first) - lead_s)..until(behind_s + near_s),
                windows,
                findings: Vec::new(),
            }
        };
        Ok((0..n_windows.max(1)).step_by(n_each as usize).map(part).collect())
    }
}

impl KeyedRows {
    const fn new(number: usize, time_s: f64, row: u64) -> Self {
        let tracks = BTreeMap::new();
        let (begun_s, first_s, last_s) = (time_s, time_s, time_s);
        Self { number, begun_s, first_s, last_s, rows: row..row, n_bytes: 0, is_sorted: true, tracks }
    }
}
