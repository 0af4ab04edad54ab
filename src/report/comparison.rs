//! The comparison of two runs: settings, results and figures side by side, with differences.

use super::distinguishability;
use super::model::{Chart, Fact};
use super::number::{ABSENT, count, level, optional, percent, share, value};
use super::plain::{PlainRow, PlainTable};
use super::tradeoffs::tradeoffs;
use crate::evaluate::{AcceptanceRow, BehaviorCount, EvaluationSummary, MiningSummary, RealismRow, SamplingRow};
use crate::metrics::{MetricRow, SeriesKey};
use crate::statistics::wilson_interval;
use std::collections::BTreeMap;

/// Two runs.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Comparison {
    /// The run that the other one is compared with.
    pub a: ComparedRun,
    /// The other one.
    pub b: ComparedRun,
}

/// The compared parts of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ComparedRun {
    /// Its folder.
    pub name: String,
    /// Facts about it as a whole: pipeline, seed, program version.
    pub facts: Vec<Fact>,
    /// Every setting by its path, such as `generate.sweeps.cut_ins.n_samples`.
    pub settings: BTreeMap<String, String>,
    /// The events in the recordings.
    pub mining: Option<MiningSummary>,
    /// The tables of its evaluation. Metrics over all places are compared.
    pub evaluation: EvaluationSummary,
}

/// Differences of more than this many standard errors are marked.
const MARKED_ERRORS: f64 = 2.0;

impl Comparison {
    /// Facts about the two runs as wholes.
    pub(super) fn facts(&self) -> PlainTable {
        let mut names: Vec<&str> = Vec::new();
        for fact in self.a.facts.iter().chain(&self.b.facts) {
            if !names.contains(&fact.name.as_str()) {
                names.push(&fact.name);
            }
        }
        let of = |run: &ComparedRun, name: &str| {
            run.facts.iter().find(|fact| fact.name == name).map_or_else(|| ABSENT.to_owned(), |fact| fact.value.clone())
        };
        let mut table = PlainTable::new("The two runs", &["", "A", "B"]);
        table.push(vec!["Folder".to_owned(), self.a.name.clone(), self.b.name.clone()]);
        for name in names {
            table.push(vec![name.to_owned(), of(&self.a, name), of(&self.b, name)]);
        }
        table
    }

    /// Settings that are not the same in both.
    pub(super) fn settings(&self) -> PlainTable {
        let mut table = PlainTable::new("Settings that differ", &["Setting", "A", "B"]);
        let keys: std::collections::BTreeSet<&String> = self.a.settings.keys().chain(self.b.settings.keys()).collect();
        for key in keys {
            let of = |run: &ComparedRun| run.settings.get(key).cloned();
            let (a, b) = (of(&self.a), of(&self.b));
            if a != b {
                let text = |setting: Option<String>| setting.unwrap_or_else(|| "not there".to_owned());
                table.push(vec![key.clone(), text(a), text(b)]);
            }
        }
        table
    }

    /// Events that were mined, by behavior, split and place.
    pub(super) fn mining(&self) -> PlainTable {
        let mut table = PlainTable::new(
            "Events found in the recordings",
            &["Behavior", "Split", "Place", "Scenes with it, A", "Scenes with it, B", "Difference"],
        );
        let of = |run: &ComparedRun| run.mining.as_ref().map_or_else(Vec::new, |mining| mining.counts.clone());
        let rows = paired(of(&self.a), of(&self.b), |row| (row.behavior.clone(), row.split.clone(), row.place.clone()));
        for ((behavior, split, place), a, b) in rows {
            let rate = |row: &BehaviorCount| (row.n_scenes > 0).then(|| row.n_scenes_with as f64 / row.n_scenes as f64);
            let (a, b) = (a.as_ref().and_then(rate), b.as_ref().and_then(rate));
            let text = |rate: Option<f64>| rate.map_or_else(|| ABSENT.to_owned(), percent);
            table.push(vec![behavior, split, place, text(a), text(b), points(a, b)]);
        }
        table
    }

    /// Yield, collisions and cost by sweep, place and strength.
    pub(super) fn sampling(&self) -> PlainTable {
        let columns = [
            "Sweep",
            "Place",
            "Strength α",
            "Scenarios, A",
            "B",
            "Verified, A",
            "B",
            "Difference",
            "New, A",
            "B",
            "With collision, A",
            "B",
            "Off-road, A",
            "B",
            "Evaluations per verified, A",
            "B",
        ];
        let mut table = PlainTable::new("Sampling by sweep, place and guidance strength", &columns);
        let key = |row: &SamplingRow| (row.sweep.clone(), row.place.clone(), row.level);
        for ((sweep, place, own), a, b) in
            paired(self.a.evaluation.sampling.clone(), self.b.evaluation.sampling.clone(), key)
        {
            let both = |of: &dyn Fn(&SamplingRow) -> String| {
                [&a, &b].map(|row| row.as_ref().map_or_else(|| ABSENT.to_owned(), of))
            };
            let asked = |row: &SamplingRow, text: String| if row.behavior.is_some() { text } else { ABSENT.to_owned() };
            let rate = |row: &Option<SamplingRow>| {
                let row = row.as_ref().filter(|row| row.behavior.is_some() && row.n_scenarios > 0)?;
                Some(row.n_verified as f64 / row.n_scenarios as f64)
            };
            let interval = |row: &Option<SamplingRow>| {
                row.as_ref().and_then(|row| wilson_interval(row.n_verified, row.n_scenarios))
            };
            let is_apart = interval(&a).zip(interval(&b)).is_some_and(|(a, b)| a.high < b.low || b.high < a.low);
            let difference = format!("{}{}", points(rate(&a), rate(&b)), if is_apart { " *" } else { "" });
            let mut cells = vec![sweep, place, level(own)];
            cells.extend(both(&|row| count(row.n_scenarios)));
            cells.extend(both(&|row| asked(row, share(row.n_verified, row.n_scenarios))));
            cells.push(difference);
            cells.extend(both(&|row| asked(row, share(row.n_new, row.n_scenarios))));
            cells.extend(both(&|row| share(row.n_collision, row.n_scenarios)));
            cells.extend(both(&|row| row.offroad_rate.map_or_else(|| ABSENT.to_owned(), percent)));
            cells.extend(both(&|row| {
                let cost = (row.n_evaluations * row.n_scenarios) as f64 / row.n_verified as f64;
                asked(row, value(cost))
            }));
            table.push(cells);
        }
        table
    }

    /// Counts of scenarios up to the accepted ones, by sweep and strength.
    pub(super) fn acceptance(&self) -> PlainTable {
        let columns =
            ["Sweep", "Strength α", "Valid, A", "B", "Accepted, A", "B", "Share accepted, A", "B", "Difference"];
        let mut table = PlainTable::new("Accepted by sweep and guidance strength", &columns);
        let key = |row: &AcceptanceRow| (row.sweep.clone(), row.level);
        let rows = paired(self.a.evaluation.acceptance.clone(), self.b.evaluation.acceptance.clone(), key);
        for ((sweep, own), a, b) in rows {
            let both = |of: &dyn Fn(&AcceptanceRow) -> String| {
                [&a, &b].map(|row| row.as_ref().map_or_else(|| ABSENT.to_owned(), of))
            };
            let rate = |row: &Option<AcceptanceRow>| {
                let row = row.as_ref().filter(|row| row.n_scenarios > 0)?;
                Some(row.n_accepted as f64 / row.n_scenarios as f64)
            };
            let mut cells = vec![sweep, level(own)];
            cells.extend(both(&|row| share(row.n_valid, row.n_scenarios)));
            cells.extend(both(&|row| count(row.n_accepted)));
            cells.extend(both(&|row| share(row.n_accepted, row.n_scenarios)));
            cells.push(points(rate(&a), rate(&b)));
            table.push(cells);
        }
        table
    }

    /// A table for each group of each sweep: every metric over all places.
    pub(super) fn metrics(&self) -> Vec<PlainTable> {
        let overall = |run: &ComparedRun| -> Vec<MetricRow> {
            let rows = run.evaluation.aggregates.iter();
            rows.filter(|row| row.place.is_empty() && row.scene_id.is_none() && row.scenario_id.is_none())
                .cloned()
                .collect()
        };
        let key = |row: &MetricRow| (row.series(), row.metric.clone());
        let mut tables: Vec<(SeriesKey, PlainTable)> = Vec::new();
        for ((series, metric), a, b) in paired(overall(&self.a), overall(&self.b), key) {
            let at = tables.iter().position(|(known, _)| *known == series).unwrap_or_else(|| {
                let SeriesKey { group, sweep, level } = &series;
                let caption = match group.is_generated() {
                    false => format!("{sweep}: {group}"),
                    true => format!("{sweep}: {}, {level}", group.name()),
                };
                tables.push((
                    series.clone(),
                    PlainTable::new(caption, &["Metric", "A", "B", "Difference", "Its standard error"]),
                ));
                tables.len() - 1
            });
            let values = [&a, &b].map(|row| row.as_ref().map(|row| row.value));
            let error = a.as_ref().and_then(|row| row.std_error).zip(b.as_ref().and_then(|row| row.std_error));
            let error = error.map(|(a, b)| a.hypot(b)).filter(|error| *error > 0.0);
            let difference = values[0].zip(values[1]).map(|(a, b)| b - a);
            let is_marked = difference.zip(error).is_some_and(|(d, error)| d.abs() > MARKED_ERRORS * error);
            let mark = if is_marked { " *" } else { "" };
            let cells = vec![
                metric,
                optional(values[0]),
                optional(values[1]),
                format!("{}{mark}", signed(difference)),
                optional(error),
            ];
            let is_reference = !series.group.is_generated();
            tables[at].1.rows.push(PlainRow { cells, is_reference });
        }
        tables.into_iter().map(|(_, table)| table).collect()
    }

    /// Distances of motion from the recording.
    pub(super) fn realism(&self) -> PlainTable {
        let columns = [
            "Group",
            "Sweep",
            "Strength α",
            "Quantity",
            "Wasserstein-1, A",
            "B",
            "Difference",
            "Jensen-Shannon, A",
            "B",
        ];
        let mut table = PlainTable::new("Distance of motion from the recording", &columns);
        let key = |row: &RealismRow| (row.series(), format!("{} ({})", row.quantity, row.unit));
        for ((SeriesKey { group, sweep, level: own }, quantity), a, b) in
            paired(self.a.evaluation.realism.clone(), self.b.evaluation.realism.clone(), key)
        {
            let both = |of: fn(&RealismRow) -> Option<f64>| [&a, &b].map(|row| row.as_ref().and_then(of));
            let ([w_a, w_b], [js_a, js_b]) = (both(|row| row.wasserstein), both(|row| row.jensen_shannon));
            let difference = signed(w_a.zip(w_b).map(|(a, b)| b - a));
            let is_reference = !group.is_generated();
            let cells = vec![
                group.to_string(),
                sweep,
                level(own),
                quantity,
                optional(w_a),
                optional(w_b),
                difference,
                optional(js_a),
                optional(js_b),
            ];
            table.rows.push(PlainRow { cells, is_reference });
        }
        table
    }

    /// The table of how well tracks can be told from recorded ones.
    pub(super) fn distinguishability(&self) -> PlainTable {
        distinguishability::comparison(&self.a.evaluation, &self.b.evaluation)
    }

    /// Curves over guidance strength of both runs, overlaid.
    pub(super) fn charts(&self) -> Vec<Chart> {
        let mut both = EvaluationSummary::default();
        for (letter, ComparedRun { evaluation, .. }) in [("A", &self.a), ("B", &self.b)] {
            let name = |sweep: &str| format!("{letter}: {sweep}");
            let sampling = evaluation.sampling.iter();
            both.sampling.extend(sampling.map(|row| SamplingRow { sweep: name(&row.sweep), ..row.clone() }));
            let realism = evaluation.realism.iter();
            both.realism.extend(realism.map(|row| RealismRow { sweep: name(&row.sweep), ..row.clone() }));
            let aggregates = evaluation.aggregates.iter();
            both.aggregates.extend(aggregates.map(|row| MetricRow { sweep: name(&row.sweep), ..row.clone() }));
        }
        tradeoffs(&both)
    }
}

/// The rows of both runs by their key, in the order of A, then those of B alone.
pub(super) fn paired<R, K: PartialEq>(a: Vec<R>, b: Vec<R>, key: impl Fn(&R) -> K) -> Vec<(K, Option<R>, Option<R>)> {
    let mut pairs: Vec<(K, Option<R>, Option<R>)> = a.into_iter().map(|row| (key(&row), Some(row), None)).collect();
    for row in b {
        let of_row = key(&row);
        match pairs.iter_mut().find(|(known, ..)| *known == of_row) {
            Some((_, _, b)) => *b = Some(row),
            None => pairs.push((of_row, None, Some(row))),
        }
    }
    pairs
}

/// A difference with its sign.
fn signed(difference: Option<f64>) -> String {
    match difference {
        Some(d) if d > 0.0 => format!("+{}", value(d)),
        other => optional(other),
    }
}

/// A difference of shares in percentage points.
fn points(a: Option<f64>, b: Option<f64>) -> String {
    match a.zip(b) {
        Some((a, b)) => format!("{:+.1} pp", 100.0 * (b - a)).replace('-', "−"),
        None => ABSENT.to_owned(),
    }
}
