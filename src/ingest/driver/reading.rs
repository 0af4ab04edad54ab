//! The reading thread of an ingest: cuts recordings into units, and passes over files that others repeat.

use crate::ingest::archive::{Entry, visit_entries};
use crate::ingest::batches::BatchSender;
use crate::ingest::config::IngestConfig;
use crate::ingest::copies::copies_among;
use crate::ingest::error::Error;
use crate::ingest::files::{is_archive, is_copy, passed_over};
use crate::ingest::places::Places;
use crate::ingest::raw::{RawUnit, Reject};
use crate::ingest::source::RecordingSource;
use crate::ingest::table::TableMapping;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// The files that the reader has seen.
#[derive(Default)]
pub(super) struct SeenFiles {
    n_recordings: u64,
    n_others: u64,
    example_of_others: Option<String>,
}

impl SeenFiles {
    pub(super) fn summary(&self, config: &IngestConfig, pattern: &str) -> String {
        let inputs: Vec<String> = config.inputs.iter().map(|input| input.display().to_string()).collect();
        let example = self.example_of_others.as_ref().map_or(String::new(), |path| format!(", such as {path}"));
        let named = match &config.table {
            Some(TableMapping { files, .. }) => format!("`{files}` (ingest.table.files)"),
            None => format!("`{pattern}`"),
        };
        let is_table =
            |path: &String| [".csv", ".parquet"].iter().any(|end| path.trim_end_matches(".gz").ends_with(end));
        let to_convert = match config.table {
            Some(_) if self.n_recordings > 0 => "",
            Some(_) if self.example_of_others.as_ref().is_some_and(is_table) => {
                "; name the tables in ingest.table.files"
            }
            Some(_) => "; configs/README.md says what to convert first, such as SUMO's XML by its xml2csv.py",
            None => "",
        };
        format!(
            "{} has {} files named like {} recordings of the chosen splits, {named}, and {} other files{example}\
             {to_convert}",
            inputs.join(", "),
            self.n_recordings,
            config.dataset.name(),
            self.n_others
        )
    }
}

/// The reading thread: cuts all recordings into units until the receiver is gone.
pub(super) fn read_batches(
    config: &IngestConfig,
    source: &dyn RecordingSource,
    places: &Places<'_>,
    mut sender: BatchSender,
) -> SeenFiles {
    let seen = std::cell::RefCell::new(SeenFiles::default());
    let is_wanted = |path: &str| {
        places.note(source.place_at(path).as_deref());
        let is_recording = source.is_recording(path);
        let seen = &mut *seen.borrow_mut();
        if is_recording {
            seen.n_recordings += u64::from(!source.is_companion(path));
        } else {
            seen.n_others += 1;
            seen.example_of_others.get_or_insert_with(|| path.to_owned());
        }
        is_recording || is_archive(path)
    };
    let copies = copies_among(&config.inputs, &|path| source.is_recording(path) && !source.is_companion(path));
    let mut units = source.unit_reader();
    let mut emit = |unit: Result<RawUnit, Reject>| {
        let n_bytes = unit.as_ref().map_or(0, |unit| source.n_bytes_parsed(unit));
        sender.push(unit, n_bytes)
    };
    let mut read_all = || -> Result<(), Error> {
        for pass in 0.. {
            seen.take();
            let mut told = BTreeSet::new();
            let mut is_stopped = false;
            visit_entries(&config.inputs, &is_wanted, &mut |entry, reader| {
                let original = copied(entry, &copies);
                if original.is_some_and(|(file, _)| file == &entry.container && !told.insert(file.clone())) {
                    return Ok(ControlFlow::Continue(()));
                }
                let reject = match (&entry.path, original) {
                    (path, _) if is_archive(path) => Some(passed_over(path, reader)),
                    (_, Some((file, original))) => Some(same_content(entry, file, original)),
                    (path, None) => is_copy(path).then(|| copy(path)),
                };
                let flow = match reject {
                    Some(reject) if pass == 0 => emit(Err(reject)),
                    Some(_) => ControlFlow::Continue(()),
                    None => units.read(entry, reader, &mut emit)?,
                };
                is_stopped = flow.is_break();
                Ok(flow)
            })?;
            if is_stopped || !units.next_pass() {
                break;
            }
        }
        units.finish(&mut emit).map(drop)
    };
    let result = read_all();
    sender.finish(result);
    seen.into_inner()
}

/// The file that holds an entry, if it is among `copies`, and its original. An archive holds all of its entries.
fn copied<'c>(entry: &Entry, copies: &'c BTreeMap<PathBuf, PathBuf>) -> Option<(&'c PathBuf, &'c PathBuf)> {
    let itself = entry.container.join(&entry.path);
    let packed = entry.container.join(format!("{}.gz", entry.path));
    [&entry.container, &itself, &packed].into_iter().find_map(|path| copies.get_key_value(path))
}

/// The reject for a file with the content of another one: its scenes would count twice.
fn same_content(entry: &Entry, file: &Path, original: &Path) -> Reject {
    // Names without the folder of the input, as in other rejects.
    let folder: &Path = if file == entry.container { file.parent().unwrap_or(file) } else { &entry.container };
    let name = |path: &Path| path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
    let detail = format!("{}: has the same content as {}", name(file), name(original));
    Reject { reason: "recording_repeated", detail }
}

/// The reject for a file that is named as a copy of another: its scenes would count twice.
fn copy(path: &str) -> Reject {
    let detail = format!("{path}: it is named as a copy; give each recording once, or rename it if it is another one");
    Reject { reason: "recording_repeated", detail }
}
