//! Exports a corpus: chooses, counts and writes scenarios, and the files of all exports.

use super::index::Index;
use super::report::meaning;
use super::{EgoMotion, Error, ExportFormat, ExportOutcome, ExportReport, Item, Result, Selection, notice, text};
use crate::files::NewFolder;
use crate::progress::Progress;
use crate::scenario::EgoChoice;
use crate::scene::Dataset;
use crate::store::{CorpusReader, write_atomically, write_json_atomically};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// The file of each scenario.
pub const INDEX_FILE: &str = "index.tsv";
/// The name of each track.
pub const TRACKS_FILE: &str = "tracks.tsv";
/// Sources and their terms.
pub const NOTICE_FILE: &str = "NOTICE.txt";
/// The report; written last.
pub const EXPORT_FILE: &str = "export.json";

/// Exports the scenarios of the corpus in `corpus` that pass `selection`, in the corpus's order, into the folder `out`,
/// which must be new or empty and appears when it is complete. `ego` chooses the ego's track, `motion` who moves it;
/// `None` is the format's default. Scenarios are read and written one by one. The same corpus gives the same bytes.
///
/// # Errors
/// [`Error::Files`] when `out` is not empty or overlaps the corpus; [`Error::Store`] when the corpus cannot be read or
/// lacks a scenario that is selected by its id; [`Error::NothingSelected`] and [`Error::NothingWritten`] when the
/// export would be empty; [`Error::EgoIsReplayed`]; errors of the file system.
pub fn export_corpus(
    corpus: &Path,
    format: ExportFormat,
    out: &Path,
    selection: &Selection,
    ego: &EgoChoice,
    motion: Option<EgoMotion>,
    progress: &dyn Progress,
) -> Result<ExportReport> {
    let motion = motion.unwrap_or(format.usual_ego());
    if motion == EgoMotion::Free && !format.can_free_ego() {
        return Err(Error::EgoIsReplayed { format: format.name() });
    }
    let reader = CorpusReader::open(corpus)?;
    let positions = selection.positions(&reader)?;
    let folder = NewFolder::begin(out, [("corpus", corpus)])?;
    let limit = selection.limit.unwrap_or(usize::MAX);
    let mut report = ExportReport::new(format, selection, ego, motion);
    let mut writer: Option<Writer> = None;
    let mut n_chosen = 0;
    progress.start("export", positions.len().min(limit) as u64, "scenarios");
    for position in positions {
        if n_chosen == limit {
            break;
        }
        let record = reader.scenario(position)?;
        if !selection.wants(&record) {
            continue;
        }
        n_chosen += 1;
        let stem = stem(&record.scenario.id, n_chosen);
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(Writer::begin(format, folder.path(), motion)?),
        };
        match ego.of(&record) {
            Some((ego_idx, is_for_want)) => {
                let terms = terms(&reader.manifest().sources, record.scenario.scene.source.dataset);
                let item = Item { record: &record, number: n_chosen, stem, ego_idx, terms };
                writer.add(&item, is_for_want, &mut report)?;
            }
            None => report.count_left_out(&record.scenario.id, "no_such_track"),
        }
        progress.advance(1);
    }
    progress.finish();
    let Some(writer) = writer else {
        let (corpus, n_scenarios) = (corpus.to_owned(), reader.len());
        return Err(Error::NothingSelected { corpus, n_scenarios, wanted: selection.words() });
    };
    writer.finish(folder.path(), &report)?;
    folder.commit()?;
    Ok(report)
}

/// The terms of a source: of the corpus if it states some, otherwise of its dataset.
fn terms(of_corpus: &BTreeMap<String, String>, dataset: Dataset) -> &str {
    of_corpus.get(dataset.name()).map_or(dataset.facts().terms, String::as_str)
}

/// The id if it can name a file; else a similar name with a unique number.
fn stem(scenario_id: &str, number: usize) -> String {
    let plain = text::plain(scenario_id);
    if plain == scenario_id && !plain.starts_with('.') { plain } else { format!("{plain}-{number}") }
}

/// The state of an export.
struct Writer {
    exporter: Box<dyn super::Exporter>,
    index: Index,
}

impl Writer {
    fn begin(format: ExportFormat, out: &Path, motion: EgoMotion) -> Result<Self> {
        let index = Index::begin(&out.join(INDEX_FILE), &out.join(TRACKS_FILE))?;
        Ok(Self { exporter: format.begin(out, motion), index })
    }

    /// Adds a scenario; `is_for_want` is whether its ego is the center because there is no subject.
    fn add(&mut self, item: &Item<'_>, is_for_want: bool, report: &mut ExportReport) -> Result<()> {
        let scenario_id = item.record.scenario.id.as_str();
        match self.exporter.add(item)? {
            ExportOutcome::Written(written) => {
                self.index.add(item, &written)?;
                report.count_written(scenario_id, &written);
                report.count_assumed("no_subject", u64::from(is_for_want));
                report.sources.insert(item.scene().source.dataset.name().to_owned(), item.terms.to_owned());
            }
            ExportOutcome::LeftOut(reason) => report.count_left_out(scenario_id, reason),
        }
        Ok(())
    }

    fn finish(self, out: &Path, report: &ExportReport) -> Result<()> {
        if report.n_scenarios == 0 {
            let reasons = report.scenarios_left_out.iter();
            let reasons: Vec<String> =
                reasons.map(|(reason, left_out)| format!("{}: {}", left_out.count, meaning(reason))).collect();
            let (format, n_scenarios) = (report.format.name(), report.n_left_out());
            // An unfinished export is removed when this is dropped.
            return Err(Error::NothingWritten { format, n_scenarios, reasons: reasons.join(", ") });
        }
        self.exporter.finish()?;
        self.index.finish()?;
        let notice = notice::text(report);
        write_atomically::<Error>(&out.join(NOTICE_FILE), |file| Ok(file.write_all(notice.as_bytes())?))?;
        write_json_atomically(&out.join(EXPORT_FILE), report)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_terms_of_a_corpus_come_before_those_of_its_dataset() {
        let of_corpus = BTreeMap::from([("womd".to_owned(), "by letter".to_owned())]);
        assert_eq!(terms(&of_corpus, Dataset::Womd), "by letter");
        assert!(terms(&of_corpus, Dataset::Interaction).starts_with("INTERACTION dataset"));
    }
}
