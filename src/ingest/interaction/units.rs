//! How is a stream of INTERACTION's files cut into units?

use super::cases::split_cases;
use super::columns::Columns;
use super::path::{RecordingPart, TrackFile, stem};
use super::recordings::Recordings;
use super::{CASE_HORIZON, Interaction};
use crate::ingest::archive::Entry;
use crate::ingest::csv_rows::Lines;
use crate::ingest::{EmitUnit, Error, Horizon, RawUnit, UnitReader};
use std::io::{self, BufRead};
use std::ops::ControlFlow;

/// Largest file of a v1.1 recording; those of 5 minutes of dense traffic have 20 MB.
const MAX_RECORDING_BYTES: u64 = 128 * 1024 * 1024;

/// Cuts v1.2 tables into cases and joins the files of v1.1 recordings.
pub(super) struct TableReader<'a> {
    source: &'a Interaction<'a>,
    recordings: Recordings,
}

impl<'a> TableReader<'a> {
    pub(super) fn new(source: &'a Interaction<'a>) -> Self {
        Self { source, recordings: Recordings::default() }
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
        if self.recordings.enter(&entry.container, &entry.path, emit).is_break() {
            return Ok(ControlFlow::Break(()));
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
            Err(error) => return Ok(emit(Err(unit.reject("unreadable", error)))),
        };
        let is_pedestrians = file.recording.as_ref().is_some_and(|part| part.is_pedestrians);
        let columns = match Columns::of(&header, is_pedestrians) {
            Ok(columns) => columns,
            Err(detail) => return Ok(emit(Err(unit.reject("bad_header", detail)))),
        };

        if columns.case_id.is_some() {
            Horizon::within(self.source.config, CASE_HORIZON)?;
            unit.version = "v1.2";
            unit.split = file.unit_split(false);
            unit.header = header.into();
            return Ok(split_cases(&mut lines, &columns, &unit, emit));
        }
        unit.version = "v1.1";
        unit.split = file.unit_split(true);
        unit.bytes = header;
        unit.bytes.push(b'\n');
        if let Err(error) = lines.read_rest(&mut unit.bytes, MAX_RECORDING_BYTES) {
            let is_too_large = error.kind() == io::ErrorKind::FileTooLarge;
            return Ok(emit(Err(unit.reject(if is_too_large { "too_large" } else { "unreadable" }, error))));
        }
        let part =
            file.recording.unwrap_or_else(|| RecordingPart { number: stem(&entry.path).to_owned(), is_pedestrians });
        unit.case_id.clone_from(&part.number);
        Ok(self.recordings.add(unit, &part, emit))
    }

    fn finish(&mut self, emit: &mut EmitUnit<'_>) -> Result<ControlFlow<()>, Error> {
        Ok(self.recordings.flush(emit))
    }
}
