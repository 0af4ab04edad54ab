//! The metrics of single scenarios.

use super::card::CardValue;
use crate::metrics::MetricRow;
use crate::scenario::ScenarioRecord;
use crate::store::Result;
use std::collections::BTreeMap;

/// The metrics of some scenarios, by their ids, in the order of the table.
#[derive(Debug, Default)]
pub(super) struct FiguresOfScenarios(BTreeMap<String, Vec<CardValue>>);

impl FiguresOfScenarios {
    /// The figures of `records` among the rows of a metric table.
    pub(super) fn new<'a>(
        rows: impl Iterator<Item = Result<MetricRow>>,
        records: impl Iterator<Item = &'a ScenarioRecord>,
    ) -> Result<Self> {
        let mut figures = Self(records.map(|record| (record.scenario.id.clone(), Vec::new())).collect());
        rows.into_iter().try_for_each(|row| row.map(|row| figures.add(row)))?;
        Ok(figures)
    }

    fn add(&mut self, row: MetricRow) {
        if let Some(values) = row.scenario_id.as_ref().and_then(|id| self.0.get_mut(id)) {
            values.push(CardValue { name: row.metric, value: row.value });
        }
    }

    /// The figures of one scenario.
    pub(super) fn of(&self, id: &str) -> Vec<CardValue> {
        self.0.get(id).cloned().unwrap_or_default()
    }

    /// Means over scenarios; a metric that is undefined for some of them is averaged over the others.
    pub(super) fn mean_of(&self, ids: &[&str]) -> Vec<CardValue> {
        let mut sums: Vec<(CardValue, f64)> = Vec::new();
        for value in ids.iter().filter_map(|id| self.0.get(*id)).flatten() {
            match sums.iter_mut().find(|(sum, _)| sum.name == value.name) {
                Some((sum, n)) => (sum.value, *n) = (sum.value + value.value, *n + 1.0),
                None => sums.push((value.clone(), 1.0)),
            }
        }
        sums.into_iter().map(|(sum, n)| CardValue { value: sum.value / n, ..sum }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_the_scenarios_for_which_a_metric_is_defined() {
        let row = |id: &str, metric: &str, value: f64| MetricRow {
            sweep: "s".into(),
            place: "X".into(),
            scene_id: Some("a".into()),
            scenario_id: Some(id.into()),
            n: 1,
            ..MetricRow::example(metric, value)
        };
        let mut figures = FiguresOfScenarios(["1", "2"].map(|id| (id.to_owned(), vec![])).into());
        let rows = [row("1", "a", 2.0), row("2", "a", 4.0), row("2", "b", 5.0), row("3", "a", 99.0)];
        rows.into_iter().for_each(|row| figures.add(row));
        let found: Vec<(String, f64)> =
            figures.mean_of(&["1", "2", "4"]).into_iter().map(|v| (v.name, v.value)).collect();
        assert_eq!(found, [("a".to_owned(), 3.0), ("b".to_owned(), 5.0)]);
        assert_eq!(figures.of("1"), [CardValue { name: "a".into(), value: 2.0 }]);
        assert!(figures.of("3").is_empty());
    }
}
