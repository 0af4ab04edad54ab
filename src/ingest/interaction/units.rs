//! Cuts INTERACTION's files into units.

use super::columns::TrackColumns;
use super::path::{RecordingPart, TrackFile, stem};
use super::recordings::{RecordingKey, Recordings};
use super::survey::Survey;
use super::{CASE_HORIZON, Interaction};
use crate::ingest::archive::Entry;
use crate::ingest::csv_rows::Lines;
use crate::ingest::quotes::without_quotes;
use crate::ingest::{EmitUnit, Error, Horizon, RawUnit, Reject, UnitReader};
use std::borrow::Cow;
use std::io::{self, BufRead, Read};
use std::ops::ControlFlow;

/// Maximum size of a file of a v1.1 recording; 5 minutes of dense traffic have 20 MB.
const MAX_RECORDING_BYTES: u64 = 128 * 1024 * 1024;

/// Cuts v1.2 tables into cases and joins the files of v1.1 recordings.
pub(super) struct TableReader<'a> {
    source: &'a Interaction<'a>,
    recordings: Recordings,
    /// The survey of each entry by the first pass, in their order; empty for entries that are not tables of cases.
    surveys: Vec<Survey>,
    /// The current pass, which emits units; `None` in the first, which surveys.
    pass: Option<usize>,
    n_entries_of_pass: usize,
}

impl<'a> TableReader<'a> {
    pub(super) fn new(source: &'a Interaction<'a>) -> Self {
        Self { source, recordings: Recordings::default(), surveys: Vec::new(), pass: None, n_entries_of_pass: 0 }
    }

    /// Surveys a table of cases. Files of recordings are only registered.
    fn survey(&mut self, entry: &Entry, part: &RecordingPart, reader: &mut dyn BufRead) -> Survey {
        let mut lines = Lines::new(reader);
        let columns = match lines.next() {
            Ok(Some((_, header))) => TrackColumns::of(header, false).ok(),
            // The next pass reports this.
            Ok(None) | Err(_) => None,
        };
        if let Some(columns) = columns.filter(|columns| columns.case_id.is_some()) {
            return Survey::of(&mut lines, &columns);
        }
        let n_bytes = entry.size.unwrap_or_else(|| {
            let rest = &mut Read::take(&mut *reader, MAX_RECORDING_BYTES);
            // The next pass reports read errors, too.
            io::copy(rest, &mut io::sink()).unwrap_or(MAX_RECORDING_BYTES)
        });
        self.recordings.note(RecordingKey::of(entry, part), part.is_pedestrians, n_bytes);
        Survey::default()
    }
}

impl TableReader<'_> {
    /// Reads a table of v1.1 after its header: one recording, with its counterpart if it has one.
    fn read_recording(
        &mut self,
        mut unit: RawUnit,
        key: RecordingKey,
        lines: &mut Lines<'_>,
        is_pedestrians: bool,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        if let Err(error) = lines.read_rest(&mut unit.bytes, MAX_RECORDING_BYTES) {
            let is_too_large = error.kind() == io::ErrorKind::FileTooLarge;
            let reject = unit.reject(if is_too_large { "too_large" } else { "unreadable" }, error);
            return self.leave_out(reject, &key, emit);
        }
        if let Cow::Owned(plain) = without_quotes(&unit.bytes) {
            unit.bytes = plain;
        }
        self.recordings.add(key, unit, is_pedestrians, emit)
    }

    /// Emits the reject of a file, and its counterpart, if any, as a recording of its own.
    fn leave_out(&mut self, reject: Reject, key: &RecordingKey, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
        emit(Err(reject))?;
        self.recordings.give_up(key, emit)
    }
}

impl UnitReader for TableReader<'_> {
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let Some(file) = TrackFile::of(&entry.container, &entry.path).filter(|file| self.source.wants(file)) else {
            return Ok(ControlFlow::Continue(()));
        };
        let part = file
            .recording
            .clone()
            .unwrap_or_else(|| RecordingPart { number: stem(&entry.path).to_owned(), is_pedestrians: false });
        let Some(pass) = self.pass else {
            let survey = self.survey(entry, &part, reader);
            self.surveys.push(survey);
            return Ok(ControlFlow::Continue(()));
        };
        let key = RecordingKey::of(entry, &part);
        let entry_idx = self.n_entries_of_pass;
        self.n_entries_of_pass += 1;
        if pass != self.recordings.pass_of(&key) {
            return Ok(ControlFlow::Continue(()));
        }
        let mut unit = RawUnit {
            file: entry.path.clone(),
            container: entry.container.clone(),
            place: file.place.clone(),
            first_line: 1,
            ..RawUnit::default()
        };
        let mut lines = Lines::new(reader);
        let header = match lines.next() {
            Ok(line) => line.map(|(_, line)| line.to_vec()).unwrap_or_default(),
            Err(error) => return Ok(self.leave_out(unit.reject("unreadable", error), &key, emit)),
        };
        let columns = match TrackColumns::of(&header, part.is_pedestrians) {
            Ok(columns) => columns,
            Err(detail) => return Ok(self.leave_out(unit.reject("bad_header", detail), &key, emit)),
        };

        if columns.case_id.is_some() {
            Horizon::within(self.source.config, CASE_HORIZON)?;
            unit.version = "v1.2";
            unit.split = file.unit_split(false);
            unit.header = header.into();
            let unsurveyed = Survey::default();
            let survey = self.surveys.get(entry_idx).unwrap_or(&unsurveyed);
            let mut n_emitted = 0;
            let flow = survey.split_cases(&mut lines, &columns, &unit, &mut |case| {
                n_emitted += 1;
                emit(case)
            });
            let is_empty = n_emitted == 0;
            return Ok(if is_empty { emit(Err(unit.reject("no_rows", "has a header and no rows"))) } else { flow });
        }
        unit.version = "v1.1";
        unit.split = file.unit_split(true);
        unit.bytes = header;
        unit.bytes.push(b'\n');
        unit.case_id = part.number;
        Ok(self.read_recording(unit, key, &mut lines, part.is_pedestrians, emit))
    }

    fn next_pass(&mut self) -> bool {
        let pass = self.pass.map_or(0, |pass| pass + 1);
        (self.pass, self.n_entries_of_pass) = (Some(pass), 0);
        pass < self.recordings.n_passes().max(1)
    }

    fn finish(&mut self, emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        Ok(self.recordings.flush(emit))
    }
}
