//! Gathers the rows of each case of a table into one unit, even if they are scattered.
//!
//! A first pass finds the cases that are scattered over the table, which may be sorted by track, or shuffled. The
//! second emits the others as they come and gathers as many scattered cases as fit into memory; the rest is gathered in
//! further passes.

use super::cases::{Case, End, MAX_CASE_BYTES, cut_cases, plain_case_id};
use super::columns::TrackColumns;
use crate::ingest::csv_rows::Lines;
use crate::ingest::ids;
use crate::ingest::{EmitUnit, RawUnit, Reject};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::ControlFlow;

/// Maximum number of bytes gathered in one pass, unless a single case has more.
pub(super) const MAX_GATHERED_BYTES: usize = 128 * 1024 * 1024;

/// The result of a first pass over a table.
#[derive(Debug, Default)]
pub(super) struct Survey {
    /// The scattered cases, by their plain ids.
    scattered: BTreeMap<String, Fate>,
    /// Passes in which cases are gathered.
    pub(super) n_gathering_passes: usize,
    /// The cases whose ids may be the same as others, by their plain ids, with the detail for the reject.
    ambiguous: BTreeMap<String, String>,
}

/// The plan for a scattered case.
#[derive(Debug, Clone, Copy)]
enum Fate {
    /// It is gathered in this pass, counted from 0.
    Gathered(usize),
    /// It has rows before and after another header: two cases with one id.
    InTwoTables,
    /// The table cannot be read to its end, so rows may be missing.
    CutShort,
}

/// Facts about a case while the table is surveyed.
struct Found {
    n_parts: usize,
    n_bytes: usize,
    section: usize,
    is_in_two: bool,
    /// Line of its first row.
    first_line: u64,
}

impl Survey {
    /// Reads a table from behind its header to its end; at most `max_bytes` are to be gathered at a time.
    pub(super) fn of(lines: &mut Lines<'_>, columns: &TrackColumns, max_bytes: usize) -> Self {
        let mut found: BTreeMap<String, Found> = BTreeMap::new();
        let end = cut_cases(lines, columns, false, &mut |case| {
            let Case { first_line, n_bytes, section, .. } = case;
            match found.entry(plain_case_id(&case.id)) {
                Entry::Vacant(entry) => {
                    entry.insert(Found { n_parts: 1, n_bytes, section, is_in_two: false, first_line });
                }
                Entry::Occupied(mut entry) => {
                    let before = entry.get_mut();
                    before.n_parts += 1;
                    before.n_bytes += n_bytes;
                    before.is_in_two |= before.section != section;
                }
            }
            ControlFlow::Continue(())
        });
        let mut survey = Self::default();
        for pair in ids::ambiguous(found.keys().map(String::as_bytes)) {
            let detail = ids::in_words("case", pair);
            survey.ambiguous.extend(pair.map(|id| (String::from_utf8_lossy(id).into_owned(), detail.clone())));
        }
        found.retain(|id, _| !survey.ambiguous.contains_key(id));
        let mut scattered: Vec<(String, Found)> = found.into_iter().filter(|(_, found)| found.n_parts > 1).collect();
        scattered.sort_by_key(|(_, found)| found.first_line);
        let mut n_bytes = 0;
        for (id, found) in scattered {
            let fate = match end {
                End::Unreadable(_) => Fate::CutShort,
                _ if found.is_in_two => Fate::InTwoTables,
                _ => {
                    n_bytes += found.n_bytes;
                    if survey.n_gathering_passes == 0 || n_bytes > max_bytes {
                        survey.n_gathering_passes += 1;
                        n_bytes = found.n_bytes;
                    }
                    Fate::Gathered(survey.n_gathering_passes - 1)
                }
            };
            survey.scattered.insert(id, fate);
        }
        survey
    }

    /// Emits the cases of the table in this pass, counted from 0, and in the first pass the errors of the table; each
    /// unit starts as a copy of `table`. Each case is emitted once, complete or as a reject.
    pub(super) fn split_cases(
        &self,
        pass: usize,
        lines: &mut Lines<'_>,
        columns: &TrackColumns,
        table: &RawUnit,
        emit: &mut EmitUnit<'_>,
    ) -> ControlFlow<()> {
        let is_first_pass = pass == 0;
        let mut gathered = Gathered::default();
        let mut rejected = BTreeMap::new();
        let end = cut_cases(lines, columns, true, &mut |case| {
            let id = plain_case_id(&case.id);
            if let Some(detail) = self.ambiguous.get(&id) {
                return match is_first_pass && rejected.insert(id, ()).is_none() {
                    true => emit(Err(table.reject_at(ids::AMBIGUOUS, case.first_line, detail))),
                    false => ControlFlow::Continue(()),
                };
            }
            match self.scattered.get(&id) {
                None if is_first_pass => emit(unit_of(case, Vec::new(), table)),
                Some(Fate::Gathered(of_pass)) if *of_pass == pass => {
                    gathered.add(id, case);
                    ControlFlow::Continue(())
                }
                Some(Fate::InTwoTables) if is_first_pass && rejected.insert(id.clone(), ()).is_none() => {
                    let detail =
                        format!("case {id} appears before and after a second header; split the file at its headers");
                    emit(Err(table.reject_at("case_not_contiguous", case.first_line, detail)))
                }
                Some(Fate::CutShort) if is_first_pass && rejected.insert(id.clone(), ()).is_none() => {
                    let detail = format!("the rows of case {id} are not contiguous, and the file is truncated");
                    emit(Err(table.reject_at("case_not_contiguous", case.first_line, detail)))
                }
                _ => ControlFlow::Continue(()),
            }
        });
        if end == End::Stopped {
            return ControlFlow::Break(());
        }
        for (case, lines) in gathered.cases {
            emit(unit_of(case, lines, table))?;
        }
        match end {
            End::Unreadable(detail) if is_first_pass => emit(Err(table.reject("unreadable", detail))),
            End::OtherHeader(line) if is_first_pass => {
                let detail =
                    "a second header has different columns, so the rest is left out; split the file at its headers";
                emit(Err(table.reject_at("bad_header", line, detail)))
            }
            _ => ControlFlow::Continue(()),
        }
    }
}

/// Scattered cases while their rows are gathered, in the order of their first rows.
#[derive(Default)]
struct Gathered {
    /// Each with the lines of its rows.
    cases: Vec<(Case, Vec<u64>)>,
    by_id: BTreeMap<String, usize>,
}

impl Gathered {
    fn add(&mut self, id: String, part: Case) {
        let n_lines = part.rows.iter().filter(|byte| **byte == b'\n').count() as u64;
        let lines = part.first_line..part.first_line + n_lines;
        match self.by_id.entry(id) {
            Entry::Vacant(entry) => {
                entry.insert(self.cases.len());
                self.cases.push((part, lines.collect()));
            }
            Entry::Occupied(entry) => {
                let (case, all_lines) = &mut self.cases[*entry.get()];
                case.n_bytes += part.n_bytes;
                if case.n_bytes > MAX_CASE_BYTES {
                    (case.rows, *all_lines) = (Vec::new(), Vec::new());
                } else {
                    case.rows.extend(part.rows);
                    all_lines.extend(lines);
                }
            }
        }
    }
}

/// The unit of a complete case, or a reject. `lines` are the lines of its rows if it is scattered.
fn unit_of(case: Case, lines: Vec<u64>, table: &RawUnit) -> Result<RawUnit, Reject> {
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
    Ok(RawUnit { case_id: id, bytes: case.rows, first_line: case.first_line, lines, ..table.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n";

    fn row(case: &str, track: u32) -> String {
        format!("{case},{track},1,100,car,0,0,0,0,0,4,2\n")
    }

    /// The units and rejects of a table if at most `max_bytes` are gathered at a time, and the number of passes.
    fn split_within(text: &str, max_bytes: usize) -> (Vec<Result<RawUnit, Reject>>, usize) {
        let pass_over = |visit: &mut dyn FnMut(&mut Lines<'_>, &TrackColumns)| {
            let mut bytes = text.as_bytes();
            let mut lines = Lines::new(&mut bytes);
            let (_, header) = lines.next().unwrap().unwrap();
            let columns = TrackColumns::of(header, false).unwrap();
            visit(&mut lines, &columns);
        };
        let mut survey = Survey::default();
        pass_over(&mut |lines, columns| survey = Survey::of(lines, columns, max_bytes));
        let n_passes = survey.n_gathering_passes.max(1);
        let mut units = Vec::new();
        for pass in 0..n_passes {
            pass_over(&mut |lines, columns| {
                let flow = survey.split_cases(pass, lines, columns, &RawUnit::default(), &mut |unit| {
                    units.push(unit);
                    ControlFlow::Continue(())
                });
                assert!(flow.is_continue());
            });
        }
        (units, n_passes)
    }

    /// Case id, first line and number of lines of each unit, or the reject.
    fn split(text: &str) -> Vec<Result<(String, u64, usize), String>> {
        let outcome = |unit: Result<RawUnit, Reject>| match unit {
            Ok(unit) => Ok((unit.case_id, unit.first_line, unit.bytes.iter().filter(|byte| **byte == b'\n').count())),
            Err(reject) => Err(format!("{} {}", reject.reason, reject.detail)),
        };
        split_within(text, MAX_GATHERED_BYTES).0.into_iter().map(outcome).collect()
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
    fn a_case_that_goes_on_later_comes_whole() {
        let text =
            [HEADER, &row("1.0", 1), &row("2.0", 1), &row("1.0", 2), "1.0,1\n", &row("3.0", 1), &row("1", 3)].concat();
        assert_eq!(split(&text), [whole("2.0", 3, 1), whole("3.0", 6, 1), whole("1.0", 2, 4)]);
        let (units, _) = split_within(&text, MAX_GATHERED_BYTES);
        assert_eq!(units[2].as_ref().unwrap().lines, [2, 4, 5, 7]);
        assert!(units[1].as_ref().unwrap().lines.is_empty());
    }

    #[test]
    fn tables_in_any_order_are_gathered_within_memory() {
        let rows: Vec<(u32, u32)> = (0..40).flat_map(|track| (0..25).map(move |case| (case, track))).collect();
        let table = |rows: &[(u32, u32)]| -> String {
            let rows = rows.iter().map(|(case, track)| row(&format!("{case}.0"), *track));
            std::iter::once(HEADER.to_owned()).chain(rows).collect()
        };
        let sorted = |text: &str, max_bytes: usize| {
            let (units, n_passes) = split_within(text, max_bytes);
            let lines = |unit: RawUnit| {
                let text = String::from_utf8(unit.bytes).unwrap();
                let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
                lines.sort();
                (unit.case_id, lines)
            };
            let mut units: Vec<_> = units.into_iter().map(|unit| lines(unit.unwrap())).collect();
            units.sort();
            (units, n_passes)
        };
        let mut by_case = rows.clone();
        by_case.sort_unstable();
        let (expected, n_passes) = sorted(&table(&by_case), 1000);
        assert_eq!((expected.len(), n_passes), (25, 1));
        let mut shuffled = rows.clone();
        let mut rng = crate::seed::Seed(3).rng();
        (1..shuffled.len()).for_each(|i| shuffled.swap(i, rng.below(i + 1)));
        for rows in [&rows, &shuffled] {
            assert_eq!(sorted(&table(rows), MAX_GATHERED_BYTES), (expected.clone(), 1));
            // A case has about 1,250 bytes: three at a time.
            assert_eq!(sorted(&table(rows), 4000), (expected.clone(), 9));
        }
    }

    #[test]
    fn what_stands_on_both_sides_of_a_header_is_rejected_whole() {
        let first = [HEADER, &row("1.0", 1), &row("2.0", 1)].concat();
        let units = split(&[&first, HEADER, &row("2.0", 2), &row("3.0", 1)].concat());
        assert_eq!((&units[0], &units[2]), (&whole("1.0", 2, 1), &whole("3.0", 6, 1)));
        let reject = units[1].as_ref().unwrap_err();
        assert!(reject.starts_with("case_not_contiguous") && reject.contains(":3: case 2 appears before"), "{reject}");
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
        assert_eq!(
            (reason(0), &units[1], reason(2)),
            ("case_not_contiguous".into(), &whole("2.0", 3, 1), "unreadable".into())
        );
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
