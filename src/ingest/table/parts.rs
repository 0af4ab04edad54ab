//! Cuts long tables into parts of some minutes, so that memory does not grow with the length of a recording.
//!
//! A table in CSV of one recording that is larger than [`Sizes::whole_bytes`] is read several times: first for its
//! times, then for the rows of its parts, as many parts at a time as memory allows. Where rows are by ascending time,
//! as simulators and fleets write them, one more time suffices; where they are by track, each time gives a few parts.
//! Scenes are those of the table read as a whole, but for a heading that is not recorded and held for longer than
//! [`LEAD_S`]; class and size of an agent are those of its first row in the part.

use super::mapping::TableMapping;
use super::timed_rows::{Gathered, TimedRows};
use super::tracks::first_frame_of;
use crate::ingest::archive::Entry;
use crate::ingest::pairing::PairReader;
use crate::ingest::raw::{Part, RawUnit, Reject};
use crate::ingest::recorded_track::DT_S;
use crate::ingest::source::{EmitUnit, Horizon, UnitReader};
use crate::ingest::windows::MAX_RECORDING_FRAMES;
use crate::ingest::{Error, IngestConfig};
use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, Read};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

/// Seconds before the first scene of a part whose rows are read with it, if headings are not recorded.
const LEAD_S: f64 = 60.0;
/// Seconds before its first and behind its last scene, for motion between rows.
const NEAR_S: f64 = 1.0;

/// When and how tables are cut.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    /// Smaller tables are read as a whole.
    pub(super) whole_bytes: u64,
    /// About how much a part has, of the columns that are read.
    pub(super) part_bytes: u64,
    /// But no less time, seconds.
    pub(super) part_s: f64,
    /// Parts that are gathered at a time where rows are not by time.
    pub(super) n_at_a_time: usize,
}

pub(super) const SIZES: Sizes = Sizes { whole_bytes: 32 << 20, part_bytes: 4 << 20, part_s: 120.0, n_at_a_time: 8 };

/// Reads pairs as they are, and long tables in parts.
pub(super) struct PartReader<'a> {
    pairs: PairReader<'a>,
    mapping: &'a TableMapping,
    config: &'a IngestConfig,
    horizon: Horizon,
    sizes: Sizes,
    n_passes: usize,
    /// Entries that came in this pass.
    n_entries: usize,
    long: Vec<Long>,
}

/// A table that is read once more.
struct Long {
    entry: usize,
    container: PathBuf,
    file: String,
    /// Everything but its rows, as soon as its counterpart has come.
    unit: Option<RawUnit>,
    /// `None` if it must be read as a whole.
    plan: Option<Plan>,
    n_parts_done: usize,
}

/// The parts of a table.
struct Plan {
    is_sorted: bool,
    parts: Vec<Part>,
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

    /// Whether a table of these first bytes may be cut: it is text, and one recording.
    fn may_be_cut(&self, head: &[u8]) -> bool {
        let columns = &self.mapping.columns;
        !head.starts_with(b"PAR1") && columns.recording.is_none() && columns.place.is_none()
    }

    /// Reads an entry as it is; what becomes of one that is cut is kept.
    fn read_whole(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let (pairs, long) = (&mut self.pairs, &mut self.long);
        let mut keep = |unit: Result<RawUnit, Reject>| {
            let is_its = |long: &&mut Long, unit: &RawUnit| {
                long.plan.is_some() && long.file == unit.file && long.container == unit.container
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
    fn plan(&self, table: &mut dyn BufRead) -> Option<Plan> {
        let (mut first, mut last, mut n_bytes, mut is_sorted) = (f64::INFINITY, f64::NEG_INFINITY, 0, true);
        let mut rows = TimedRows::of(table, self.mapping)?;
        let mut tracks = BTreeMap::new();
        while let Some(time_s) = rows.next()? {
            is_sorted &= time_s >= last;
            (first, last) = (first.min(time_s), last.max(time_s));
            n_bytes += rows.n_bytes();
            let n_tracks = tracks.len();
            if !tracks.contains_key(rows.track()?) {
                tracks.insert(rows.track()?.to_owned(), n_tracks);
            }
        }
        let tracks = Arc::new(tracks);
        let first_frame = first_frame_of(first);
        let start_s = first - first_frame as f64 * DT_S;
        let n_frames = ((last - first) / DT_S + 1e-3).floor() as i64 + 1;
        let stride = self.config.window_stride.max(1) as i64;
        let n_windows = (n_frames - self.horizon.n_timesteps() as i64).div_euclid(stride) + 1;
        if n_windows <= 0 || n_frames > MAX_RECORDING_FRAMES {
            return None;
        }
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
            Part {
                start_s,
                frames: (first_frame, first_frame + n_frames - 1),
                tracks: Arc::clone(&tracks),
                own_s: if first == 0 { f64::NEG_INFINITY } else { seconds(first) }..until(seconds(windows.end)),
                rows_s: seconds(first) - lead_s..until(behind_s + near_s),
                windows,
            }
        };
        Some(Plan { is_sorted, parts: (0..n_windows).step_by(n_each as usize).map(part).collect() })
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
            if self.long[index].plan.is_none() {
                self.long.remove(index);
                return self.pairs.read(entry, reader, emit);
            }
            let (long, sizes) = (&mut self.long[index], self.sizes);
            return Ok(long.read(reader, self.mapping, sizes, emit));
        }
        let mut head = Vec::new();
        if let Err(error) = (&mut *reader).take(self.sizes.whole_bytes + 1).read_to_end(&mut head) {
            let detail = format!("{}: {error}", entry.path);
            return Ok(emit(Err(Reject { reason: "unreadable", detail })));
        }
        if head.len() as u64 <= self.sizes.whole_bytes {
            return self.read_whole(entry, &mut head.as_slice(), emit);
        }
        if !self.may_be_cut(&head) {
            return self.read_whole(entry, &mut head.as_slice().chain(reader), emit);
        }
        let plan = self.plan(&mut head.as_slice().chain(reader));
        let is_cut = plan.is_some();
        let (container, file) = (entry.container.clone(), entry.path.clone());
        self.long.push(Long { entry: number, container, file, unit: None, plan, n_parts_done: 0 });
        // Its counterpart, if it needs one, comes as that of any other.
        if is_cut { self.read_whole(entry, &mut &b""[..], emit) } else { Ok(ControlFlow::Continue(())) }
    }

    fn next_pass(&mut self) -> bool {
        self.n_passes += 1;
        self.n_entries = 0;
        self.long.retain(|long| long.plan.as_ref().is_none_or(|plan| long.n_parts_done < plan.parts.len()));
        // One without its counterpart is a reject at the end.
        self.long.iter().any(|long| long.plan.is_none() || long.unit.is_some())
    }

    fn finish(&mut self, emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        self.pairs.finish(emit)
    }
}

impl Long {
    /// Reads the table once more, and emits the parts that are next.
    fn read(
        &mut self,
        table: &mut dyn BufRead,
        mapping: &TableMapping,
        sizes: Sizes,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        let Some((Plan { is_sorted, parts }, unit)) = self.plan.as_ref().zip(self.unit.as_ref()) else {
            return ControlFlow::Continue(());
        };
        let start_s = parts[0].start_s;
        let n_parts = if *is_sorted { parts.len() } else { parts.len().min(self.n_parts_done + sizes.n_at_a_time) };
        let mut next = self.n_parts_done;
        self.n_parts_done = n_parts;
        let changed = || Err(unit.reject("unreadable", "the table changed while it was read"));
        let Some(mut rows) = TimedRows::of(table, mapping) else { return emit(changed()) };
        let mut open: VecDeque<Gathered<'_>> = VecDeque::new();
        loop {
            let Some(row) = rows.next() else { return emit(changed()) };
            let time_s = row.map(|time_s| time_s - start_s);
            let has_begun = |part: &Part| !is_sorted || time_s.is_none_or(|time_s| part.rows_s.start <= time_s);
            while next < n_parts && has_begun(&parts[next]) {
                open.push_back(rows.gather(&parts[next]));
                next += 1;
            }
            let is_over = |part: &Part| time_s.is_none_or(|time_s| *is_sorted && part.rows_s.end < time_s);
            while open.front().is_some_and(|gathered| is_over(gathered.part)) {
                open.pop_front().map_or(ControlFlow::Continue(()), |over| emit(over.unit(unit)))?;
            }
            let Some(time_s) = time_s else { return ControlFlow::Continue(()) };
            open.iter_mut().filter(|gathered| gathered.part.rows_s.contains(&time_s)).for_each(|to| rows.put(to));
        }
    }
}
