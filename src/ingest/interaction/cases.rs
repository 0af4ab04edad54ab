//! Cuts a v1.2 table into its thousands of cases without loading it.

use super::columns::TrackColumns;
use crate::ingest::csv_rows::Lines;
use crate::ingest::decimal;
use memchr::memmem;
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// Maximum size of a case; usual ones have 20 to 200 kB.
pub(super) const MAX_CASE_BYTES: usize = 64 * 1024 * 1024;

/// The most consecutive cases with only incomplete rows that may turn out to be parts of another one.
const MAX_HELD: usize = 16;

/// The most bytes that are reserved for a case before it is read.
const MAX_GUESSED_BYTES: usize = 1024 * 1024;

/// The rows of consecutive lines with equal `case_id`: a case, or a part of one.
#[derive(Debug)]
pub(super) struct Case {
    /// The id as written, such as `1.0`.
    pub(super) id: Vec<u8>,
    pub(super) first_line: u64,
    /// Empty if rows are only counted, or if there are too many.
    pub(super) rows: Vec<u8>,
    pub(super) n_bytes: usize,
}

impl Case {
    /// Whether a line is recognizably of this case, as nearly all are: whether it begins with the id, complete or not.
    fn goes_on_with(&self, line: &[u8], columns: &TrackColumns) -> bool {
        columns.case_id == Some(0) && line.strip_prefix(self.id.as_slice()).is_some_and(|rest| rest.starts_with(b","))
    }

    fn push(&mut self, line: &[u8], keeps_rows: bool) {
        self.n_bytes += line.len() + 1;
        if self.n_bytes > MAX_CASE_BYTES {
            self.rows = Vec::new();
        } else if keeps_rows {
            self.rows.extend_from_slice(line);
            self.rows.push(b'\n');
        }
    }
}

/// Why the cutting of a table ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum End {
    /// All of it was read.
    Whole,
    /// The receiver needs no more cases.
    Stopped,
    /// It cannot be read further; the text says why, and what is left out.
    Unreadable(String),
    /// This line is a header with different columns.
    OtherHeader(u64),
}

/// Cuts a table, read up to its header, where the case id changes.
pub(super) fn cut_cases(
    lines: &mut Lines<'_>,
    columns: &TrackColumns,
    keeps_rows: bool,
    done: &mut dyn FnMut(Case) -> ControlFlow<()>,
) -> End {
    let mut cases = Cases { columns, keeps_rows, seen: BTreeSet::new(), current: None, held: Vec::new(), end: None };
    loop {
        let flow = match lines.next() {
            Ok(Some((number, line))) => cases.add(number, line, done),
            Ok(None) => {
                cases.end = Some(End::Whole);
                cases.end_all(done)
            }
            // The current case is incomplete.
            Err(error) => {
                let rest = match (cases.held.is_empty(), &cases.current) {
                    (true, None) => "the file",
                    (true, Some(_)) => "the current case and the rest of the file",
                    (false, _) => "the last cases and the rest of the file",
                };
                let detail =
                    format!("{error}; {rest} is left out, and earlier rows of a damaged file may be wrong too");
                // A pass that only counts rows still needs the rest of them.
                let is_stopped = !keeps_rows && cases.end_all(done).is_break();
                return if is_stopped { End::Stopped } else { End::Unreadable(detail) };
            }
        };
        if flow.is_break() {
            return End::Stopped;
        }
        if let Some(end) = cases.end {
            return end;
        }
    }
}

/// The cases of a table while it is read.
struct Cases<'a> {
    columns: &'a TrackColumns,
    keeps_rows: bool,
    /// The ids that have begun.
    seen: BTreeSet<String>,
    current: Option<Case>,
    /// While the current case has only incomplete rows: the case before them, which may continue, and those of them
    /// whose ids are of further cases.
    held: Vec<Case>,
    end: Option<End>,
}

impl Cases<'_> {
    /// Adds a line. Cases that it ends are passed to `done`.
    fn add(&mut self, number: u64, line: &[u8], done: &mut dyn FnMut(Case) -> ControlFlow<()>) -> ControlFlow<()> {
        let goes_on = |case: Option<&Case>| case.is_some_and(|case| case.goes_on_with(line, self.columns));
        if !self.held.is_empty() || !goes_on(self.current.as_ref()) {
            if memmem::find(line, b"case_id").is_some()
                && let Ok(header) = TrackColumns::of(line, false)
            {
                self.end = (header != *self.columns).then_some(End::OtherHeader(number));
                return self.end_all(done);
            }
            let id = CaseId::of(line, self.columns);
            let before = self.held.first();
            if goes_on(before) || before.is_some_and(|before| id.whole() == Some(&before.id)) {
                self.join_held();
            } else if id.whole().is_some() {
                self.held.drain(..).try_for_each(&mut *done)?;
            }
            self.begin_with(number, line, &id, done)?;
        }
        if let Some(case) = &mut self.current {
            case.push(line, self.keeps_rows);
        }
        ControlFlow::Continue(())
    }

    fn end_all(&mut self, done: &mut dyn FnMut(Case) -> ControlFlow<()>) -> ControlFlow<()> {
        self.held.drain(..).chain(self.current.take()).try_for_each(done)
    }

    /// Adds the incomplete rows to the case before them, which continues.
    fn join_held(&mut self) {
        let mut held = self.held.drain(..).chain(self.current.take());
        self.current = held.next();
        for broken in held {
            self.seen.remove(&plain_case_id(&broken.id));
            if let Some(case) = &mut self.current {
                case.n_bytes += broken.n_bytes;
                case.rows.extend(broken.rows);
            }
        }
    }

    /// Begins another case if the line does not belong to the current one.
    fn begin_with(
        &mut self,
        number: u64,
        line: &[u8],
        id: &CaseId<'_>,
        done: &mut dyn FnMut(Case) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let begins = match (&self.current, id) {
            (None, _) => !line.is_empty(),
            (Some(case), CaseId::Whole(id)) => *id != case.id,
            (Some(case), CaseId::Broken(Some(id))) => *id != case.id && !self.seen.contains(&plain_case_id(id)),
            (Some(_), CaseId::Broken(None)) => false,
        };
        if !begins {
            return ControlFlow::Continue(());
        }
        self.seen.insert(plain_case_id(id.text()));
        // Cases of a table are of similar size.
        let n_guessed = self.current.as_ref().map_or(0, |case| case.rows.len().min(MAX_GUESSED_BYTES));
        let rows = Vec::with_capacity(n_guessed);
        let case = Case { id: id.text().to_vec(), first_line: number, rows, n_bytes: 0 };
        let before = self.current.replace(case);
        if id.whole().is_some() {
            return before.map_or(ControlFlow::Continue(()), done);
        }
        self.held.extend(before);
        // Not a table any more.
        let n_given_up = if self.held.len() > MAX_HELD { self.held.len() } else { 0 };
        self.held.drain(..n_given_up).try_for_each(done)
    }
}

enum CaseId<'a> {
    Whole(&'a [u8]),
    /// The row has too few or too many columns, so this is its case only if it looks like one: a number followed by
    /// more. Otherwise the row stays with the case around it, which is found to be malformed.
    Broken(Option<&'a [u8]>),
}

impl<'a> CaseId<'a> {
    fn of(line: &'a [u8], columns: &TrackColumns) -> Self {
        let mut cells = line.split(|byte| *byte == b',').map(<[u8]>::trim_ascii);
        let id = columns.case_id.and_then(|index| cells.nth(index));
        let n_commas = line.iter().filter(|byte| **byte == b',').count();
        if let Some(id) = id
            && n_commas + 1 == columns.n_columns
        {
            return Self::Whole(id);
        }
        Self::Broken(id.filter(|id| cells.next().is_some() && decimal::number(id).is_some()))
    }

    const fn whole(&self) -> Option<&'a [u8]> {
        match self {
            Self::Whole(id) => Some(id),
            Self::Broken(_) => None,
        }
    }

    /// The id; empty if the row has none.
    fn text(&self) -> &'a [u8] {
        match self {
            Self::Whole(id) | Self::Broken(Some(id)) => id,
            Self::Broken(None) => b"",
        }
    }
}

/// A case id as in the names of scenes: case ids are whole numbers printed as floats, `1.0` is `1`.
pub(super) fn plain_case_id(id: &[u8]) -> String {
    String::from_utf8_lossy(without_point(id)).into_owned()
}

/// An id without the decimal point that it has if whole numbers are printed as floats.
pub(super) fn without_point(id: &[u8]) -> &[u8] {
    id.strip_suffix(b".0").filter(|number| !number.is_empty() && number.iter().all(u8::is_ascii_digit)).unwrap_or(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_lose_the_point_they_were_printed_with() {
        for (written, plain) in [("1.0", "1"), ("17", "17"), ("1.5", "1.5"), (".0", ".0"), ("a.0", "a.0")] {
            assert_eq!(plain_case_id(written.as_bytes()), plain);
        }
    }
}
