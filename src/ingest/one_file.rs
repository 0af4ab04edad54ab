//! Datasets in which each file is a unit.

use super::archive::Entry;
use super::error::Error;
use super::files::{file_stem, read_whole, split_of_entry};
use super::raw::{RawUnit, UnitSplit};
use super::source::{EmitUnit, UnitReader};
use std::io::BufRead;
use std::ops::ControlFlow;

/// Emits every file as a unit whose case is named as the file.
pub(super) struct OneFileOneUnit;

impl UnitReader for OneFileOneUnit {
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        Ok(emit(read_whole(entry, reader).map(|bytes| RawUnit {
            file: entry.path.clone(),
            container: entry.container.clone(),
            split: UnitSplit::All(split_of_entry(entry)),
            case_id: file_stem(&entry.path).to_owned(),
            bytes,
            first_line: 1,
            ..RawUnit::default()
        })))
    }
}
