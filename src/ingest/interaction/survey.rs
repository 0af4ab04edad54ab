//! Emits the cases of a table as they come, but those whose rows are not together.
//!
//! A first pass finds cases that come again later, or under another spelling of their id: none of their parts is one.

use super::cases::{Case, End, MAX_CASE_BYTES, cut_cases, plain_case_id};
use super::columns::TrackColumns;
use crate::ingest::csv_rows::Lines;
use crate::ingest::ids;
use crate::ingest::{EmitUnit, RawUnit, Reject};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

/// The result of a first pass over a table.
#[derive(Debug, Default)]
pub(super) struct Survey {
    /// The cases to reject, by their plain ids, with reason and detail.
    faulty: BTreeMap<String, (&'static str, String)>,
}

impl Survey {
    /// Reads a table from behind its header to its end.
    pub(super) fn of(lines: &mut Lines<'_>, columns: &TrackColumns) -> Self {
        let mut n_parts: BTreeMap<String, usize> = BTreeMap::new();
        // Where it cannot be read further, the next pass says so.
        cut_cases(lines, columns, false, &mut |case| {
            *n_parts.entry(plain_case_id(&case.id)).or_default() += 1;
            ControlFlow::Continue(())
        });
        let mut faulty: BTreeMap<String, (&'static str, String)> = BTreeMap::new();
        for (id, _) in n_parts.iter().filter(|(_, n_parts)| **n_parts > 1) {
            let detail = format!("the rows of case {id} are not together; sort the file by case_id");
            faulty.insert(id.clone(), ("case_not_contiguous", detail));
        }
        for pair in ids::ambiguous(n_parts.keys().map(String::as_bytes)) {
            let detail = ids::in_words("case", pair);
            let fault = |id: &[u8]| (String::from_utf8_lossy(id).into_owned(), (ids::AMBIGUOUS, detail.clone()));
            faulty.extend(pair.map(fault));
        }
        Self { faulty }
    }

    /// Emits the cases of the table and its errors; each unit starts as a copy of `table`. Each case is emitted once,
    /// complete or as a reject.
    pub(super) fn split_cases(
        &self,
        lines: &mut Lines<'_>,
        columns: &TrackColumns,
        table: &RawUnit,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        let mut rejected = BTreeSet::new();
        let end = cut_cases(lines, columns, true, &mut |case| {
            let id = plain_case_id(&case.id);
            match self.faulty.get(&id) {
                None => emit(unit_of(case, table)),
                Some((reason, detail)) if rejected.insert(id) => {
                    emit(Err(table.reject_at(reason, case.first_line, detail)))
                }
                Some(_) => ControlFlow::Continue(()),
            }
        });
        match end {
            End::Stopped => ControlFlow::Break(()),
            End::Whole => ControlFlow::Continue(()),
            End::Unreadable(detail) => emit(Err(table.reject("unreadable", detail))),
            End::OtherHeader(line) => {
                let detail =
                    "a second header has different columns, so the rest is left out; split the file at its headers";
                emit(Err(table.reject_at("bad_header", line, detail)))
            }
        }
    }
}

fn unit_of(case: Case, table: &RawUnit) -> Result<RawUnit, Reject> {
    let id = String::from_utf8_lossy(&case.id).into_owned();
    if id.is_empty() || !id.chars().all(|c| c.is_ascii_graphic() && c != '/') {
        let id: String = id.chars().take(40).map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
        let detail = format!("case_id is \"{id}\", expected a number");
        return Err(table.reject_at("bad_case_id", case.first_line, detail));
    }
    if case.n_bytes > MAX_CASE_BYTES {
        let detail = format!("case {id} has more than {} MiB", MAX_CASE_BYTES >> 20);
        return Err(table.reject_at("too_large", case.first_line, detail));
    }
    Ok(RawUnit { case_id: id, bytes: case.rows, first_line: case.first_line, ..table.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n";

    fn row(case: &str, track: u32) -> String {
        format!("{case},{track},1,100,car,0,0,0,0,0,4,2\n")
    }

    /// Case id, first line and number of lines of each unit, or the reject.
    fn split(text: &str) -> Vec<Result<(String, u64, usize), String>> {
        let outcome = |unit: Result<RawUnit, Reject>| match unit {
            Ok(unit) => Ok((unit.case_id, unit.first_line, unit.bytes.iter().filter(|byte| **byte == b'\n').count())),
            Err(reject) => Err(format!("{} {}", reject.reason, reject.detail)),
        };
        let pass_over = |visit: &mut dyn FnMut(&mut Lines<'_>, &TrackColumns)| {
            let mut bytes = text.as_bytes();
            let mut lines = Lines::new(&mut bytes);
            let (_, header) = lines.next().unwrap().unwrap();
            let columns = TrackColumns::of(header, false).unwrap();
            visit(&mut lines, &columns);
        };
        let (mut survey, mut units) = (Survey::default(), Vec::new());
        pass_over(&mut |lines, columns| survey = Survey::of(lines, columns));
        pass_over(&mut |lines, columns| {
            let flow = survey.split_cases(lines, columns, &RawUnit::default(), &mut |unit| {
                units.push(outcome(unit));
                ControlFlow::Continue(())
            });
            assert!(flow.is_continue());
        });
        units
    }

    fn whole(id: &str, line: u64, n: usize) -> Result<(String, u64, usize), String> {
        Ok((id.to_owned(), line, n))
    }

    #[test]
    fn consecutive_rows_of_equal_id_are_a_case() {
        let text = [HEADER, &row("1.0", 1), &row("1.0", 2), &row("3.0", 1)].concat();
        assert_eq!(split(text.trim_end()), [whole("1.0", 2, 2), whole("3.0", 4, 1)]);
    }

    #[test]
    fn cases_that_may_be_one_are_rejected() {
        let text = [HEADER, &row("7.0", 1), &row("8.0", 1), &row("07.0", 1), &row("7", 2)].concat();
        let said = "ambiguous_id :{line}: case 07 is also written 7; write each id in one way";
        let at = |line: &str| Err(said.replace("{line}", line));
        assert_eq!(split(&text), [at("2"), whole("8.0", 3, 1), at("4")]);
    }

    #[test]
    fn a_case_that_goes_on_later_is_rejected_whole() {
        let rows = [row("1.0", 1), row("2.0", 1), row("1.0", 2), "1.0,1\n".to_owned(), row("3.0", 1), row("1", 3)];
        let units = split(&[HEADER.to_owned(), rows.concat()].concat());
        let reject = units[0].as_ref().unwrap_err();
        assert!(reject.starts_with("case_not_contiguous") && reject.contains(":2: the rows of case 1"), "{reject}");
        assert_eq!(units[1..], [whole("2.0", 3, 1), whole("3.0", 6, 1)]);
    }

    #[test]
    fn what_stands_on_both_sides_of_a_header_is_rejected_whole() {
        let first = [HEADER, &row("1.0", 1), &row("2.0", 1)].concat();
        let units = split(&[&first, HEADER, &row("2.0", 2), &row("3.0", 1)].concat());
        assert_eq!((&units[0], &units[2]), (&whole("1.0", 2, 1), &whole("3.0", 6, 1)));
        let reject = units[1].as_ref().unwrap_err();
        assert!(reject.starts_with("case_not_contiguous") && reject.contains(":3: the rows of case 2"), "{reject}");
        assert_eq!(units.len(), 3);
        let other = HEADER.replace(",x,y", ",y,x");
        let units = split(&[first.as_str(), &other, &row("2.0", 2)].concat());
        assert_eq!(units[..2], [whole("1.0", 2, 1), whole("2.0", 3, 1)]);
        let reject = units[2].as_ref().unwrap_err();
        assert!(reject.starts_with("bad_header") && reject.contains(":4: a second header"), "{reject}");
    }

    #[test]
    fn scattered_cases_of_a_table_that_breaks_off_are_rejects() {
        let units = split(&[HEADER, &row("1.0", 1), &row("2.0", 1), &row("1.0", 2), &"x".repeat(100_000)].concat());
        let reason = |index: usize| units[index].as_ref().unwrap_err().split(' ').next().unwrap_or_default().to_owned();
        // The case at which it breaks off is incomplete, too, and the file's reject tells why.
        let found = (reason(0), &units[1], reason(2));
        assert_eq!(found, ("case_not_contiguous".into(), &whole("2.0", 3, 1), "unreadable".into()));
        assert_eq!(units.len(), 3);
    }

    #[test]
    fn rows_that_are_not_whole_stay_with_their_case() {
        let broken = ["1\n", "\n", "x,y\n", "2.0\n"].concat();
        let units =
            split(&[HEADER, &row("1.0", 1), &broken, &row("1.0", 2), "2.0,1,1\n", &row("2.0", 1), "1.0,1\n"].concat());
        assert_eq!(units, [Ok(("1.0".to_owned(), 2, 6)), Ok(("2.0".to_owned(), 8, 3))]);
        // Amid a case with another number, which no other case has, or a later one has.
        let amid =
            [HEADER, &row("1.0", 1), "9.0,1,1\n9.0\n8.0,1\n", &row("1.0", 2), &row("9.0", 1), "3.0,1,\n4.0,2,\n"]
                .concat();
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
}
