//! How is a v1.2 table, which holds thousands of cases, cut into one unit a case without loading it?

use super::columns::Columns;
use crate::ingest::csv_rows::Lines;
use crate::ingest::decimal;
use crate::ingest::{EmitUnit, RawUnit, Reject};
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// Largest case that is kept together; usual ones have 20 to 200 kB.
const MAX_CASE_BYTES: usize = 64 * 1024 * 1024;

/// Most cases of nothing but rows that are not whole that may turn out to be parts of another one.
const MAX_HELD: usize = 16;

/// Most bytes that are set aside for a case before it is read.
const MAX_GUESSED_BYTES: usize = 1024 * 1024;

/// The rows of consecutive lines with equal `case_id`.
struct Case {
    /// As written, such as `1.0`.
    id: Vec<u8>,
    first_line: u64,
    rows: Vec<u8>,
    /// Why the case is left out, if it is.
    flaw: Option<&'static str>,
}

impl Case {
    /// Whether a line is of this case at the first glance, as nearly all are: whole or not, it begins with the id.
    fn goes_on_with(&self, line: &[u8], columns: &Columns) -> bool {
        columns.case_id == Some(0) && line.strip_prefix(self.id.as_slice()).is_some_and(|rest| rest.starts_with(b","))
    }

    fn push(&mut self, line: &[u8]) {
        if self.rows.len() + line.len() > MAX_CASE_BYTES {
            self.flaw = self.flaw.or(Some("too_large"));
        }
        if self.flaw.is_none() {
            self.rows.extend_from_slice(line);
            self.rows.push(b'\n');
        }
    }
}

/// Emits the cases of a table that has been read up to its header; `table` is a unit to start each from.
///
/// Rows of a case stand together. A case whose id came before is a reject, since its first part has been emitted then.
pub(super) fn split_cases(
    lines: &mut Lines<'_>,
    columns: &Columns,
    table: &RawUnit,
    emit: &mut EmitUnit<'_>,
) -> ControlFlow<()> {
    let mut cases = Cases { columns, seen: BTreeSet::new(), current: None, held: Vec::new() };
    let mut done = |case: Case| emit_case(case, table, emit);
    loop {
        match lines.next() {
            Ok(Some((number, line))) => cases.add(number, line, &mut done)?,
            Ok(None) => return cases.held.into_iter().chain(cases.current).try_for_each(done),
            // The case that is being read is not whole.
            Err(error) => {
                let rest = match (cases.held.is_empty(), cases.current) {
                    (true, None) => "the file",
                    (true, Some(_)) => "the current case and the rest of the file",
                    (false, _) => "the last cases and the rest of the file",
                };
                let detail =
                    format!("{error}; {rest} is left out, and where the file is damaged, so may what came before be");
                return emit(Err(table.reject("unreadable", detail)));
            }
        }
    }
}

/// The cases of a table while it is read.
struct Cases<'a> {
    columns: &'a Columns,
    /// The ids that have begun.
    seen: BTreeSet<String>,
    current: Option<Case>,
    /// While the current case has nothing but rows that are not whole: the case before all of these, which may go on, and those of them
    /// that say they are of further cases.
    held: Vec<Case>,
}

impl Cases<'_> {
    /// Takes a line in. Cases that it ends are `done`.
    fn add(&mut self, number: u64, line: &[u8], done: &mut dyn FnMut(Case) -> ControlFlow<()>) -> ControlFlow<()> {
        let goes_on = |case: Option<&Case>| case.is_some_and(|case| case.goes_on_with(line, self.columns));
        if !self.held.is_empty() || !goes_on(self.current.as_ref()) {
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
            case.push(line);
        }
        ControlFlow::Continue(())
    }

    /// The rows that were not whole stood amid the case before, which goes on.
    fn join_held(&mut self) {
        let mut held = self.held.drain(..).chain(self.current.take());
        self.current = held.next();
        for broken in held {
            self.seen.remove(&plain_case_id(&broken.id));
            if let Some(case) = &mut self.current {
                case.rows.extend(broken.rows);
            }
        }
    }

    /// Begins another case if the line is not of the current one.
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
        let flaw = (!self.seen.insert(plain_case_id(id.text()))).then_some("case_not_contiguous");
        // Cases of a table are of similar size.
        let n_guessed = self.current.as_ref().map_or(0, |case| case.rows.len().min(MAX_GUESSED_BYTES));
        let case = Case { id: id.text().to_vec(), first_line: number, rows: Vec::with_capacity(n_guessed), flaw };
        let before = self.current.replace(case);
        if id.whole().is_some() {
            return before.map_or(ControlFlow::Continue(()), done);
        }
        self.held.extend(before);
        // Not a table any more: nothing is waited for.
        let n_given_up = if self.held.len() > MAX_HELD { self.held.len() } else { 0 };
        self.held.drain(..n_given_up).try_for_each(done)
    }
}

/// The case that a row says it is of.
enum CaseId<'a> {
    Whole(&'a [u8]),
    /// The row has too few or too many columns, so this is the case only if it looks like one: a number with more behind
    /// it. Else the row stays with the case around it, which is found to be malformed.
    Broken(Option<&'a [u8]>),
}

impl<'a> CaseId<'a> {
    fn of(line: &'a [u8], columns: &Columns) -> Self {
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

    /// Empty where the row does not tell.
    fn text(&self) -> &'a [u8] {
        match self {
            Self::Whole(id) | Self::Broken(Some(id)) => id,
            Self::Broken(None) => b"",
        }
    }
}

/// A case id as scenes are named by it: case ids are whole numbers printed as floats, `1.0` is `1`.
pub(super) fn plain_case_id(id: &[u8]) -> String {
    let text = String::from_utf8_lossy(id).into_owned();
    match text.strip_suffix(".0") {
        Some(number) if !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()) => number.to_owned(),
        _ => text,
    }
}

fn emit_case(case: Case, table: &RawUnit, emit: &mut EmitUnit<'_>) -> ControlFlow<()> {
    let id = String::from_utf8_lossy(&case.id).into_owned();
    let reject =
        |reason, detail: String| -> Result<RawUnit, Reject> { Err(table.reject_at(reason, case.first_line, detail)) };
    if id.is_empty() || !id.chars().all(|c| c.is_ascii_graphic() && c != '/') {
        let id: String = id.chars().take(40).map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
        return emit(reject("bad_case_id", format!("case_id is \"{id}\", expected a number")));
    }
    emit(match case.flaw {
        Some("case_not_contiguous") => {
            let detail = format!(
                "case {id} appears again, and its first rows were taken for all of it; sort the table by case_id"
            );
            reject("case_not_contiguous", detail)
        }
        Some(flaw) => reject(flaw, format!("case {id} has more than {} MiB", MAX_CASE_BYTES >> 20)),
        None => Ok(RawUnit { case_id: id, bytes: case.rows, first_line: case.first_line, ..table.clone() }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n";

    fn row(case: &str, track: u32) -> String {
        format!("{case},{track},1,100,car,0,0,0,0,0,4,2\n")
    }

    /// Case id, first line and number of lines of each unit, or the reason of the reject.
    fn split(text: &str) -> Vec<Result<(String, u64, usize), String>> {
        let mut bytes = text.as_bytes();
        let mut lines = Lines::new(&mut bytes);
        let (_, header) = lines.next().unwrap().unwrap();
        let columns = Columns::of(header, false).unwrap();
        let mut units = Vec::new();
        let flow = split_cases(&mut lines, &columns, &RawUnit::default(), &mut |unit| {
            units.push(match unit {
                Ok(unit) => {
                    let n_lines = unit.bytes.iter().filter(|byte| **byte == b'\n').count();
                    Ok((unit.case_id, unit.first_line, n_lines))
                }
                Err(reject) => Err(format!("{} {}", reject.reason, reject.detail)),
            });
            ControlFlow::Continue(())
        });
        assert!(flow.is_continue());
        units
    }

    #[test]
    fn consecutive_rows_of_equal_id_are_a_case() {
        let text = [HEADER, &row("1.0", 1), &row("1.0", 2), &row("3.0", 1)].concat();
        let units = split(text.trim_end());
        assert_eq!(units, [Ok(("1.0".to_owned(), 2, 2)), Ok(("3.0".to_owned(), 4, 1))]);
    }

    #[test]
    fn a_case_that_appears_again_is_rejected() {
        let units = split(&[HEADER, &row("1.0", 1), &row("2.0", 1), &row("1.0", 2), &row("3.0", 1)].concat());
        assert_eq!(units.len(), 4);
        let reject = units[2].as_ref().unwrap_err();
        assert!(reject.starts_with("case_not_contiguous") && reject.contains(":4: case 1.0"), "{reject}");
        assert!(units[3].is_ok());
    }

    #[test]
    fn rows_that_are_not_whole_stay_with_their_case() {
        let broken = ["1\n", "\n", "x,y\n", "2.0\n"].concat();
        let units =
            split(&[HEADER, &row("1.0", 1), &broken, &row("1.0", 2), "2.0,1,1\n", &row("2.0", 1), "1.0,1\n"].concat());
        assert_eq!(units, [Ok(("1.0".to_owned(), 2, 6)), Ok(("2.0".to_owned(), 8, 3))]);
        // Amid a case with another number, which no case has, or has later.
        let amid =
            [HEADER, &row("1.0", 1), "9.0,1,1\n9.0\n8.0,1\n", &row("1.0", 2), &row("9.0", 1), "3.0,1,\n4.0,2,\n"]
                .concat();
        let whole = |id: &str, line, n| Ok((id.to_owned(), line, n));
        assert_eq!(split(&amid), [whole("1.0", 2, 5), whole("9.0", 7, 1), whole("3.0", 8, 1), whole("4.0", 9, 1)]);
    }

    #[test]
    fn strange_ids_and_endless_lines_are_rejects() {
        let units = split(&[HEADER, &row("", 1), &row("a/b", 1), &row("2.0", 1)].concat());
        assert!(units[0].as_ref().unwrap_err().starts_with("bad_case_id"));
        assert!(units[1].as_ref().unwrap_err().starts_with("bad_case_id"));
        assert!(units[2].is_ok());
        let units = split(&[HEADER, &row("1.0", 1), &row("2.0", 1), &"x".repeat(100_000)].concat());
        assert!(units[0].is_ok());
        let reject = units[1].as_ref().unwrap_err();
        assert!(reject.starts_with("unreadable") && reject.contains("line 4"), "{reject}");
        assert_eq!(units.len(), 2);
    }

    #[test]
    fn ids_lose_the_point_they_were_printed_with() {
        for (written, plain) in [("1.0", "1"), ("17", "17"), ("1.5", "1.5"), (".0", ".0"), ("a.0", "a.0")] {
            assert_eq!(plain_case_id(written.as_bytes()), plain);
        }
    }
}
