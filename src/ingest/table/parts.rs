//! Cuts long tables into parts of some minutes, so that memory does not grow with the length of a recording.
//!
//! A table larger than [`Sizes::whole_bytes`] is read several times: first for its times (in Parquet, before that for
//! its footer), then for the rows of its parts, as many parts at a time as memory allows. If rows are by ascending
//! time, as simulators and fleets write them, one more time suffices, as long as no more than [`Sizes::n_at_a_time`]
//! recordings of a file are in progress at a time; if they are by track, each time yields a few parts. Scenes are those
//! of the table read as a whole, except for a heading that is not recorded and held for longer than [`LEAD_S`]; class
//! and size of an agent are those of its first row in the part.

use super::columns::PARQUET;
use super::mapping::TableMapping;
use super::rows::wanted;
use super::timed_rows::{Gathered, TimedRows};
use super::tracks::first_frame_of;
use crate::ingest::archive::Entry;
use crate::ingest::pairing::PairReader;
use crate::ingest::parquet_columns::read_footer;
use crate::ingest::raw::{Part, RawUnit, Reject, SeenTrack};
use crate::ingest::recorded_track::DT_S;
use crate::ingest::source::{EmitUnit, Horizon, UnitReader};
use crate::ingest::standing::Standing;
use crate::ingest::windows::MAX_RECORDING_FRAMES;
use crate::ingest::{Error, IngestConfig};
use parquet::file::metadata::ParquetMetaData;
use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, Read};
use std::ops::{ControlFlow, Range};
use std::path::PathBuf;
use std::sync::Arc;

/// Seconds before the first scene of a part whose rows are read with it, if headings are not recorded.
const LEAD_S: f64 = 60.0;
/// Seconds before the first and after the last scene of a part whose rows are read with it, for motion between rows.
const NEAR_S: f64 = 1.0;
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
    /// All of it, since it cannot be cut.
    Whole,
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
    /// Time of the first row, seconds.
    first_s: f64,
    last_s: f64,
    /// The range of its rows in the table.
    rows: Range<u64>,
    n_bytes: u64,
    is_sorted: bool,
    tracks: BTreeMap<String, (usize, Standing)>,
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

    /// Reads the times of a table.
    fn plan(&self, table: &mut dyn BufRead, footer: Option<&Arc<ParquetMetaData>>) -> Option<Plan> {
        let mut rows = TimedRows::of(table, footer, self.mapping)?;
        let mut recordings: BTreeMap<String, KeyedRows> = BTreeMap::new();
        let (mut key, mut n_rows) = (String::new(), 0);
        while let Some(time_s) = rows.next()? {
            rows.key(&mut key)?;
            if !recordings.contains_key(&key) {
                recordings.insert(key.clone(), KeyedRows::new(recordings.len(), time_s, n_rows));
            }
            n_rows += 1;
            let seen = recordings.get_mut(&key)?;
            seen.is_sorted &= time_s >= seen.last_s;
            (seen.first_s, seen.last_s) = (seen.first_s.min(time_s), seen.last_s.max(time_s));
            seen.rows.end = n_rows;
            seen.n_bytes += rows.n_bytes();
            let (track, n_tracks) = (rows.track()?, seen.tracks.len());
            if !seen.tracks.contains_key(&*track) {
                seen.tracks.insert(track.clone().into_owned(), (n_tracks, Standing::default()));
            }
            seen.tracks.get_mut(&*track)?.1.see(time_s, rows.position());
        }
        let mut in_order: Vec<&mut KeyedRows> = recordings.values_mut().collect();
        in_order.sort_by_key(|seen| seen.number);
        let mut ends: Vec<u64> = in_order.iter().map(|seen| seen.rows.end).collect();
        ends.sort_unstable();
        let n_under_way = |seen: &&mut KeyedRows| seen.number + 1 - ends.partition_point(|end| *end <= seen.rows.start);
        let is_sorted = in_order.iter().map(n_under_way).max()? <= self.sizes.n_at_a_time
            && in_order.iter().all(|seen| seen.is_sorted);
        let (mut parts, mut n_bytes) = (Vec::new(), Vec::new());
        for seen in in_order {
            let of_recording = self.parts(seen, rows.counted())?;
            n_bytes.extend(of_recording.iter().map(|_| seen.n_bytes / of_recording.len() as u64));
            parts.extend(of_recording.into_iter().map(|part| (seen.number, part)));
        }
        Some(Plan { is_sorted, recordings, parts, n_bytes })
    }

    /// The parts of a recording; one that is too short for a scene is a part without any.
    fn parts(&self, seen: &mut KeyedRows, counted: &'static str) -> Option<Vec<Part>> {
        let KeyedRows { first_s, last_s, n_bytes, .. } = *seen;
        let first_frame = first_frame_of(first_s);
        let start_s = first_s - first_frame as f64 * DT_S;
        let n_frames = ((last_s - first_s) / DT_S + 1e-3).floor() as i64 + 1;
        if n_frames > MAX_RECORDING_FRAMES {
            return None;
        }
        let tracks = std::mem::take(&mut seen.tracks)
            .into_iter()
            .map(|(id, (number, standing))| (id, SeenTrack { number, parked_s: standing.parked_s(start_s) }));
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
            }
        };
        Some((0..n_windows.max(1)).step_by(n_each as usize).map(part).collect())
    }

    /// The footer of a table in Parquet that begins with `head`, if the table is large enough to be cut.
    fn footer(&self, head: &[u8], rest: &mut dyn BufRead) -> Option<ParquetMetaData> {
        let mut last: VecDeque<u8> = head.iter().copied().collect();
        let mut n_bytes = head.len() as u64;
        loop {
            last.drain(..last.len().saturating_sub(MAX_FOOTER_BYTES));
            let read = rest.fill_buf().ok()?;
            if read.is_empty() {
                break;
            }
            last.extend(read);
            let n_read = read.len();
            n_bytes += n_read as u64;
            rest.consume(n_read);
        }
        let footer = read_footer(last.make_contiguous(), n_bytes).ok()??;
        let n_cells = footer.file_metadata().num_rows().unsigned_abs() * wanted(&self.mapping.columns).len() as u64;
        (n_cells * 8 > self.sizes.whole_bytes).then_some(footer)
    }
}

impl KeyedRows {
    const fn new(number: usize, time_s: f64, row: u64) -> Self {
        let tracks = BTreeMap::new();
        Self { number, first_s: time_s, last_s: time_s, rows: row..row, n_bytes: 0, is_sorted: true, tracks }
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
            match &self.long[index].next {
                Next::Whole => {
                    self.long.remove(index);
                    return self.pairs.read(entry, reader, emit);
                }
                Next::Times => {
                    let plan = self.plan(reader, self.long[index].footer.as_ref());
                    let next = &mut self.long[index].next;
                    *next = plan.map_or(Next::Whole, Next::Parts);
                    // Its counterpart, if it needs one, has arrived by now.
                    let is_cut = matches!(next, Next::Parts(_));
                    return if is_cut {
                        self.read_whole(entry, &mut &b""[..], emit)
                    } else {
                        Ok(ControlFlow::Continue(()))
                    };
                }
                Next::Parts(_) => {
                    let (long, sizes) = (&mut self.long[index], self.sizes);
                    return Ok(long.read(reader, self.mapping, sizes, emit));
                }
            }
        }
        let mut head = Vec::new();
        if let Err(error) = (&mut *reader).take(self.sizes.whole_bytes + 1).read_to_end(&mut head) {
            let detail = format!("{}: {error}", entry.path);
            return Ok(emit(Err(Reject { reason: "unreadable", detail })));
        }
        let (is_parquet, is_long) = (head.starts_with(PARQUET), head.len() as u64 > self.sizes.whole_bytes);
        let footer = if is_parquet { self.footer(&head, reader).map(Arc::new) } else { None };
        if !is_long && footer.is_none() {
            return self.read_whole(entry, &mut head.as_slice(), emit);
        }
        let next = match &footer {
            Some(_) => Next::Times,
            None if is_parquet => Next::Whole,
            None => self.plan(&mut head.as_slice().chain(reader), None).map_or(Next::Whole, Next::Parts),
        };
        let is_cut = matches!(next, Next::Parts(_));
        let (container, file) = (entry.container.clone(), entry.path.clone());
        self.long.push(Long { entry: number, container, file, footer, unit: None, next, n_parts_done: 0 });
        // Its counterpart, if it needs one, arrives like that of any other.
        if is_cut { self.read_whole(entry, &mut &b""[..], emit) } else { Ok(ControlFlow::Continue(())) }
    }

    fn next_pass(&mut self) -> bool {
        self.n_passes += 1;
        self.n_entries = 0;
        let is_done = |long: &Long| match &long.next {
            // A table without its counterpart is a reject at the end.
            Next::Parts(plan) => long.unit.is_none() || long.n_parts_done == plan.parts.len(),
            Next::Times | Next::Whole => false,
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
        let Some(mut rows) = TimedRows::of(table, self.footer.as_ref(), mapping) else { return emit(changed()) };
        // By recording: its parts to come and its open ones.
        let mut of_recordings: BTreeMap<usize, (VecDeque<&Part>, VecDeque<Gathered<'_>>)> = BTreeMap::new();
        for (recording, part) in parts {
            of_recordings.entry(*recording).or_default().0.push_back(part);
        }
        let (mut key, mut n_rows) = (String::new(), 0);
        loop {
            let Some(time_s) = rows.next() else { return emit(changed()) };
            let Some(time_s) = time_s else { break };
            n_rows += 1;
            let Some(seen) = rows.key(&mut key).and_then(|()| recordings.get(&key)) else { return emit(changed()) };
            let Some((to_come, open)) = of_recordings.get_mut(&seen.number) else { continue };
            let is_last = *is_sorted && n_rows == seen.rows.end;
            let begins = |part: &&Part| !is_sorted || is_last || part.rows_s.start <= time_s - part.start_s;
            while let Some(part) = to_come.front().filter(|part| begins(part)) {
                open.push_back(rows.gather(part));
                to_come.pop_front();
            }
            let is_over = |part: &Part| *is_sorted && part.rows_s.end < time_s - part.start_s;
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
