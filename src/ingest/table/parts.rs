//! Cuts long tables into parts of some minutes, so that memory does not grow with the length of a recording.
//!
//! A table larger than [`Sizes::whole_bytes`] is read several times: first for its times (in Parquet, before that for
//! its footer), then for the rows of its parts, as many parts at a time as memory allows. If rows are by ascending
//! time, as simulators and fleets write them, one more time suffices, as long as no more than [`Sizes::n_at_a_time`]
//! recordings of a file are in progress at a time; if they are by track, each time yields a few parts. Scenes are those
//! of the table read as a whole, except for a heading that is not recorded, or cannot be, for longer than [`LEAD_S`];
//! class and size of an agent are those of most of its rows in the part.

use super::columns::PARQUET;
use super::mapping::TableMapping;
use super::owners::Owners;
use super::rows::wanted;
use super::table_rows::alternatives;
use super::timed_rows::{Gathered, TimedRows};
use super::tracks::{first_frame_of, is_of_recording};
use crate::containment::contained;
use crate::ingest::archive::Entry;
use crate::ingest::error::Malformed;
use crate::ingest::pairing::{PairPart, PairReader};
use crate::ingest::parquet_columns::{columns_of, n_bytes_of, read_footer};
use crate::ingest::raw::{Part, RawUnit, Reject};
use crate::ingest::recorded_track::DT_S;
use crate::ingest::source::{EmitUnit, Horizon, UnitReader};
use crate::ingest::windows::MAX_RECORDING_FRAMES;
use crate::ingest::{Error, IngestConfig};
use parquet::file::metadata::ParquetMetaData;
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Display;
use std::io::{BufRead, Read};
use std::ops::{ControlFlow, Range};
use std::path::PathBuf;
use std::sync::Arc;

/// Seconds before the first scene of a part whose rows are read with it, if headings are not recorded.
const LEAD_S: f64 = 60.0;
/// Seconds before the first and after the last scene of a part whose rows are read with it, for motion between rows.
const NEAR_S: f64 = 1.0;
/// The most bytes of what is known of tracks.
const MAX_TRACKS_BYTES: usize = 1 << 30;
/// The most bytes of a footer, more than in the largest tables.
const MAX_FOOTER_BYTES: usize = 16 << 20;

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

/// Reads pairs unchanged, and long tables in parts.
pub(super) struct PartReader<'a> {
    pairs: PairReader<'a>,
    mapping: &'a TableMapping,
    config: &'a IngestConfig,
    horizon: Horizon,
    sizes: Sizes,
    n_passes: usize,
    /// Entries that arrived in this pass.
    n_entries: usize,
    long: Vec<Long>,
}

/// A table that is read once more.
struct Long {
    entry: usize,
    container: PathBuf,
    file: String,
    /// The footer of a table in Parquet.
    footer: Option<Arc<ParquetMetaData>>,
    /// Everything except its rows, as soon as its counterpart has arrived.
    unit: Option<RawUnit>,
    next: Next,
    n_parts_done: usize,
}

/// The purpose of the next reading of a table.
enum Next {
    Times,
    Parts(Plan),
}

/// The parts of a table.
struct Plan {
    /// Whether one reading yields all parts.
    is_sorted: bool,
    recordings: BTreeMap<String, KeyedRows>,
    /// Each with the number of its recording, recording by recording in the order of their first rows.
    parts: Vec<(usize, Part)>,
    /// The approximate size of each part, bytes.
    n_bytes: Vec<u64>,
}

/// The rows of one recording, found when the times of the table are read.
struct KeyedRows {
    number: usize,
    /// The time of its first row in the table, and its first and last time, seconds.
    begun_s: f64,
    first_s: f64,
    last_s: f64,
    /// The range of its rows in the table.
    rows: Range<u64>,
    n_bytes: u64,
    is_sorted: bool,
    tracks: BTreeMap<String, (usize, Owners)>,
}

impl<'a> PartReader<'a> {
    pub(super) fn new(
        pairs: PairReader<'a>,
        mapping: &'a TableMapping,
        config: &'a IngestConfig,
        horizon: Horizon,
        sizes: Sizes,
    ) -> Self {
        Self { pairs, mapping, config, horizon, sizes, n_passes: 0, n_entries: 0, long: Vec::new() }
    }

    /// Reads an entry as a whole; an entry that is to be cut is kept.
    fn read_whole(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let (pairs, long) = (&mut self.pairs, &mut self.long);
        let mut keep = |unit: Result<RawUnit, Reject>| {
            let is_its = |long: &&mut Long, unit: &RawUnit| {
                matches!(long.next, Next::Parts(_)) && long.file == unit.file && long.container == unit.container
            };
            match unit {
                Ok(unit) => match long.iter_mut().find(|long| is_its(long, &unit)) {
                    Some(long) => {
                        long.unit = Some(unit);
                        ControlFlow::Continue(())
                    }
                    None => emit(Ok(unit)),
                },
                Err(reject) => emit(Err(reject)),
            }
        };
        pairs.read(entry, reader, &mut keep)
    }

    /// Takes up the plan of a table; its counterpart, if it needs one, arrives like that of any other.
    fn keep(
        &mut self,
        index: usize,
        entry: &Entry,
        plan: Result<Plan, Reject>,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        match plan {
            Ok(plan) => {
                self.long[index].next = Next::Parts(plan);
                self.read_whole(entry, &mut &b""[..], emit)
            }
            Err(reject) => {
                self.long.remove(index);
                Ok(emit(Err(reject)))
            }
        }
    }

    /// Reads the times of a table.
    fn plan(&self, file: &str, table: &mut dyn BufRead, footer: Option<&Arc<ParquetMetaData>>) -> Result<Plan, Reject> {
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
        let mut in_order: Vec<&mut KeyedRows> = recordings.values_mut().collect();
        in_order.sort_by_key(|seen| seen.number);
        let mut ends: Vec<u64> = in_order.iter().map(|seen| seen.rows.end).collect();
        ends.sort_unstable();
        let n_under_way = |seen: &&mut KeyedRows| seen.number + 1 - ends.partition_point(|end| *end <= seen.rows.start);
        let is_sorted = in_order.iter().map(n_under_way).max().unwrap_or_default() <= self.sizes.n_at_a_time
            && in_order.iter().all(|seen| seen.is_sorted);
        let (mut parts, mut n_bytes) = (Vec::new(), Vec::new());
        for seen in in_order {
            let of_recording =
                self.parts(seen, rows.rows.counted()).map_err(|detail| reject("frame_out_of_range", &detail))?;
            n_bytes.extend(of_recording.iter().map(|_| seen.n_bytes / of_recording.len() as u64));
            parts.extend(of_recording.into_iter().map(|part| (seen.number, part)));
        }
        if let Some((_, first)) = parts.first_mut() {
            first.findings = passed.findings(file);
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

    /// The footer of a table in Parquet that begins with `head`; `None` if the table is small enough to be read whole.
    fn footer(&self, head: &[u8], rest: &mut dyn BufRead) -> Result<Option<ParquetMetaData>, Malformed> {
        let mut last: VecDeque<u8> = head.iter().copied().collect();
        let mut n_bytes = head.len() as u64;
        loop {
            last.drain(..last.len().saturating_sub(MAX_FOOTER_BYTES));
            let read = rest.fill_buf().map_err(|error| error.to_string())?;
            if read.is_empty() {
                break;
            }
            last.extend(read);
            let n_read = read.len();
            n_bytes += n_read as u64;
            rest.consume(n_read);
        }
        let is_long = n_bytes > self.sizes.whole_bytes;
        let footer = match contained(|| read_footer(last.make_contiguous(), n_bytes)) {
            Some(Ok(Some(footer))) => footer,
            // What is wrong with a small table is said when it is read.
            _ if !is_long => return Ok(None),
            Some(Err(error)) => return Err(error),
            _ => return Err("the file is cut short".into()),
        };
        let found = columns_of(&footer)?;
        let names: Vec<&str> =
            wanted(&self.mapping.columns).into_iter().flat_map(|(name, _)| alternatives(name, &found)).collect();
        let n_cells = footer.file_metadata().num_rows().unsigned_abs().saturating_mul(names.len() as u64);
        let n_bytes = n_bytes_of(&footer, &names).max(n_cells.saturating_mul(8));
        Ok((is_long || n_bytes > self.sizes.whole_bytes).then_some(footer))
    }
}

impl KeyedRows {
    const fn new(number: usize, time_s: f64, row: u64) -> Self {
        let tracks = BTreeMap::new();
        let (begun_s, first_s, last_s) = (time_s, time_s, time_s);
        Self { number, begun_s, first_s, last_s, rows: row..row, n_bytes: 0, is_sorted: true, tracks }
    }
}

impl UnitReader for PartReader<'_> {
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let number = self.n_entries;
        self.n_entries += 1;
        if self.n_passes > 0 {
            let Some(index) = self.long.iter().position(|long| long.entry == number) else {
                return Ok(ControlFlow::Continue(()));
            };
            if let Next::Parts(_) = self.long[index].next {
                let (long, sizes) = (&mut self.long[index], self.sizes);
                return Ok(long.read(reader, self.mapping, sizes, emit));
            }
            let plan = self.plan(&entry.path, reader, self.long[index].footer.as_ref());
            return self.keep(index, entry, plan, emit);
        }
        let mut head = Vec::new();
        if let Err(error) = (&mut *reader).take(self.sizes.whole_bytes + 1).read_to_end(&mut head) {
            let detail = format!("{}: {error}", entry.path);
            return Ok(emit(Err(Reject { reason: "unreadable", detail })));
        }
        let is_long = head.len() as u64 > self.sizes.whole_bytes;
        if self.pairs.names.part_of(&entry.path).is_some_and(|(_, part)| part == PairPart::Companion) {
            return self.read_whole(entry, &mut head.as_slice().chain(reader), emit);
        }
        let footer = match head.starts_with(PARQUET) {
            true => self.footer(&head, reader).map(|footer| footer.map(Arc::new)),
            false => Ok(None),
        };
        let footer = match footer {
            Ok(footer) => footer,
            Err(error) => {
                let detail = format!("{}: {error}", entry.path);
                return Ok(emit(Err(Reject { reason: "bad_table", detail })));
            }
        };
        if !is_long && footer.is_none() {
            return self.read_whole(entry, &mut head.as_slice(), emit);
        }
        let is_parquet = footer.is_some();
        let (container, file) = (entry.container.clone(), entry.path.clone());
        self.long.push(Long { entry: number, container, file, footer, unit: None, next: Next::Times, n_parts_done: 0 });
        if is_parquet {
            // Its columns are read when its footer is known.
            return Ok(ControlFlow::Continue(()));
        }
        let plan = self.plan(&entry.path, &mut head.as_slice().chain(reader), None);
        self.keep(self.long.len() - 1, entry, plan, emit)
    }

    fn next_pass(&mut self) -> bool {
        self.n_passes += 1;
        self.n_entries = 0;
        let is_done = |long: &Long| match &long.next {
            // A table without its counterpart is a reject at the end.
            Next::Parts(plan) => long.unit.is_none() || long.n_parts_done == plan.parts.len(),
            Next::Times => false,
        };
        self.long.retain(|long| !is_done(long));
        !self.long.is_empty()
    }

    fn finish(&mut self, emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        self.pairs.finish(emit)
    }
}

impl Long {
    /// Reads the table once more, and emits the next parts.
    fn read(
        &mut self,
        table: &mut dyn BufRead,
        mapping: &TableMapping,
        sizes: Sizes,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        let (Next::Parts(Plan { is_sorted, recordings, parts, n_bytes }), Some(unit)) = (&self.next, &self.unit) else {
            return ControlFlow::Continue(());
        };
        let first = self.n_parts_done;
        let mut n_waiting_bytes = 0;
        let is_room = |n_bytes: &&u64| {
            n_waiting_bytes += *n_bytes;
            n_waiting_bytes <= sizes.n_at_a_time as u64 * sizes.part_bytes
        };
        let n_parts = if *is_sorted { parts.len() } else { n_bytes[first..].iter().take_while(is_room).count().max(1) };
        let parts = &parts[first..first + n_parts];
        self.n_parts_done += n_parts;
        let changed = || Err(unit.reject("unreadable", "the table changed while it was read"));
        let Ok(mut rows) = TimedRows::of(table, self.footer.as_ref(), mapping) else { return emit(changed()) };
        // By recording: its parts to come and its open ones.
        let mut of_recordings: BTreeMap<usize, (VecDeque<&Part>, VecDeque<Gathered<'_>>)> = BTreeMap::new();
        for (recording, part) in parts {
            of_recordings.entry(*recording).or_default().0.push_back(part);
        }
        let (mut key, mut n_rows) = (String::new(), 0);
        loop {
            let Ok(time_s) = rows.next() else { return emit(changed()) };
            let Some(time_s) = time_s else { break };
            n_rows += 1;
            rows.key(&mut key);
            let Some(seen) = recordings.get(&key) else { return emit(changed()) };
            let Some((to_come, open)) = of_recordings.get_mut(&seen.number) else { continue };
            let is_last = *is_sorted && n_rows == seen.rows.end;
            let is_of_it = is_of_recording(time_s, seen.begun_s);
            let begins =
                |part: &&Part| !is_sorted || is_last || (is_of_it && part.rows_s.start <= time_s - part.start_s);
            while let Some(part) = to_come.front().filter(|part| begins(part)) {
                open.push_back(rows.gather(part));
                to_come.pop_front();
            }
            let is_over = |part: &Part| *is_sorted && is_of_it && part.rows_s.end < time_s - part.start_s;
            while open.front().is_some_and(|gathered| is_over(gathered.part)) {
                open.pop_front().map_or(ControlFlow::Continue(()), |over| emit(over.unit(unit)))?;
            }
            let is_of = |part: &Part| part.rows_s.contains(&(time_s - part.start_s));
            open.iter_mut().filter(|gathered| is_of(gathered.part)).for_each(|to| rows.put(to));
            if is_last {
                open.drain(..).try_for_each(|over| emit(over.unit(unit)))?;
            }
        }
        of_recordings.into_values().flat_map(|(_, open)| open).try_for_each(|over| emit(over.unit(unit)))
    }
}
