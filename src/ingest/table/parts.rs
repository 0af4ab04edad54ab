//! Cuts long tables into parts of some minutes, so that memory does not grow with the length of a recording.
//!
//! A table larger than `Sizes::whole_bytes` is read several times: first for its times (in Parquet, before that for
//! its footer), then for the rows of its parts, as many parts at a time as memory allows. If rows are by ascending
//! time, as simulators and fleets write them, one more time suffices, as long as no more than `Sizes::n_at_a_time`
//! recordings of a file are in progress at a time; if they are by track, each time yields a few parts. Scenes are those
//! of the table read as a whole, except for a heading that is not recorded, or cannot be, for longer than a minute;
//! class and size of an agent are those of most of its rows in the part.

use super::columns::PARQUET;
use super::part_plan::{Plan, Planner};
use super::rows::wanted;
use super::table_rows::alternatives;
use super::timed_rows::{Gathered, TimedRows};
use super::tracks::is_of_recording;
use crate::containment::contained;
use crate::ingest::Error;
use crate::ingest::archive::Entry;
use crate::ingest::error::Malformed;
use crate::ingest::pairing::PairReader;
use crate::ingest::parquet_columns::{columns_of, n_bytes_of, read_footer};
use crate::ingest::raw::{Part, RawUnit, Reject};
use crate::ingest::source::{EmitUnit, UnitReader};
use parquet::file::metadata::ParquetMetaData;
use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, Read};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

/// The most bytes of a footer, more than in the largest tables.
const MAX_FOOTER_BYTES: usize = 16 << 20;

/// Reads pairs unchanged, and long tables in parts.
pub(super) struct PartReader<'a> {
    pairs: PairReader<'a>,
    planner: Planner<'a>,
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

impl<'a> PartReader<'a> {
    pub(super) const fn new(pairs: PairReader<'a>, planner: Planner<'a>) -> Self {
        Self { pairs, planner, n_passes: 0, n_entries: 0, long: Vec::new() }
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
        let is_long = n_bytes > self.planner.sizes.whole_bytes;
        let footer = match contained(|| read_footer(last.make_contiguous(), n_bytes)) {
            Some(Ok(Some(footer))) => footer,
            // What is wrong with a small table is said when it is read.
            _ if !is_long => return Ok(None),
            Some(Err(error)) => return Err(error),
            _ => return Err("the file is cut short".into()),
        };
        let found = columns_of(&footer)?;
        let names: Vec<&str> = wanted(&self.planner.mapping.columns)
            .into_iter()
            .flat_map(|(name, _)| alternatives(name, &found))
            .collect();
        let n_cells = footer.file_metadata().num_rows().unsigned_abs().saturating_mul(names.len() as u64);
        let n_bytes = n_bytes_of(&footer, &names).max(n_cells.saturating_mul(8));
        Ok((is_long || n_bytes > self.planner.sizes.whole_bytes).then_some(footer))
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
                return Ok(self.long[index].read(reader, self.planner, emit));
            }
            let plan = self.planner.plan(&entry.path, reader, self.long[index].footer.as_ref());
            return self.keep(index, entry, plan, emit);
        }
        let mut head = Vec::new();
        if let Err(error) = (&mut *reader).take(self.planner.sizes.whole_bytes + 1).read_to_end(&mut head) {
            let detail = format!("{}: {error}", entry.path);
            return Ok(emit(Err(Reject { reason: "unreadable", detail })));
        }
        let is_long = head.len() as u64 > self.planner.sizes.whole_bytes;
        if self.pairs.names.is_companion(&entry.path) {
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
        let plan = self.planner.plan(&entry.path, &mut head.as_slice().chain(reader), None);
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
        Planner { mapping, sizes, .. }: Planner<'_>,
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
