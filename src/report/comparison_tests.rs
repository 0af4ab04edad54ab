//! Do comparisons pair matching rows, and mark what differs by more than chance?

use super::comparison::{ComparedRun, Comparison};
use super::plain::PlainTable;
use crate::evaluate::EvaluationSummary;
use crate::evaluate::SamplingRow;
use crate::metrics::MetricRow;

fn sampling(strength: f64, n_verified: u64) -> SamplingRow {
    SamplingRow { n_new: n_verified, ..SamplingRow::example(strength, n_verified) }
}

fn metric(name: &str, value: f64, std_error: f64) -> MetricRow {
    MetricRow { std_error: Some(std_error), ..MetricRow::example(name, value) }
}

fn cells(table: &PlainTable) -> Vec<Vec<&str>> {
    table.rows.iter().map(|row| row.cells.iter().map(String::as_str).collect()).collect()
}

#[test]
fn rows_are_paired_by_what_they_are_about() {
    let run = |sampling| {
        let evaluation = EvaluationSummary { sampling, ..EvaluationSummary::default() };
        ComparedRun { evaluation, ..ComparedRun::default() }
    };
    let a = run(vec![sampling(0.0, 5), sampling(2.0, 20)]);
    let b = run(vec![sampling(2.0, 60), sampling(0.0, 6), sampling(4.0, 1)]);
    let table = Comparison { a, b }.sampling();
    let differences: Vec<(&str, &str)> = cells(&table).iter().map(|row| (row[2], row[7])).collect();
    // 20 and 60 of 100 are apart by Wilson's intervals, 5 and 6 are not; strength 4 is only in B.
    assert_eq!(differences, [("0", "+1.0 pp"), ("2", "+40.0 pp *"), ("4", "–")]);
    assert_eq!(table.rows[1].cells[14..], ["95.0", "31.7"], "19 evaluations of 100 samples for 20 and for 60");
}

#[test]
fn metrics_differ_where_twice_the_standard_error_is_exceeded() {
    let run = |ade: f64, fde: f64| ComparedRun {
        evaluation: EvaluationSummary {
            aggregates: vec![metric("min_ade_m", ade, 0.03), metric("min_fde_m", fde, 0.4)],
            ..EvaluationSummary::default()
        },
        ..ComparedRun::default()
    };
    let tables = Comparison { a: run(0.5, 1.0), b: run(0.4, 1.5) }.metrics();
    assert_eq!(tables.len(), 1);
    // √2 · 0.03 = 0.0424: 0.1 is more than twice as much; √2 · 0.4 = 0.566.
    assert_eq!(
        cells(&tables[0]),
        [["min_ade_m", "0.500", "0.400", "−0.100 *", "0.0424"], ["min_fde_m", "1.00", "1.50", "+0.500", "0.566"]]
    );
}

#[test]
fn only_settings_that_differ_are_told() {
    let run = |settings: &[(&str, &str)]| ComparedRun {
        settings: settings.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect(),
        ..ComparedRun::default()
    };
    let comparison = Comparison {
        a: run(&[("run.seed", "1"), ("ingest.limit", "5"), ("mine.x", "2")]),
        b: run(&[("run.seed", "2"), ("ingest.limit", "5"), ("report.n", "7")]),
    };
    let expected = [["mine.x", "2", "not there"], ["report.n", "not there", "7"], ["run.seed", "1", "2"]];
    assert_eq!(cells(&comparison.settings()), expected);
}
