//! From the figures of cells to rows: one for each scene, each kept scenario, each place, and all places together.

use super::cells::{CellFigures, CellSamples};
use super::measures::MetricDoc;
use crate::metrics::{Aggregate, Group, SeriesKey};
use crate::scene::{Scene, SceneId};
use crate::store::MetricRow;

/// The figures of a series in one scene.
#[derive(Debug, PartialEq)]
struct SceneFigures {
    place: String,
    scene_id: SceneId,
    n_samples: u64,
    values: Vec<Option<f64>>,
}

/// The figures of a scenario. Whose they are, its series says in the scene that its cell is of.
#[derive(Debug, PartialEq)]
struct ScenarioFigures {
    series_idx: usize,
    scene_idx: usize,
    scenario_id: String,
    values: Vec<Option<f64>>,
}

/// Collects figures and turns them into rows. Rows are many times as large, so they are made one by one on demand.
#[derive(Debug, PartialEq)]
pub struct MetricRows {
    docs: Vec<MetricDoc>,
    series: Vec<(SeriesKey, Vec<SceneFigures>)>,
    of_scenarios: Vec<ScenarioFigures>,
}

impl MetricRows {
    pub(super) fn new(docs: Vec<MetricDoc>) -> Self {
        Self { docs, series: Vec::new(), of_scenarios: Vec::new() }
    }

    /// Adds a cell of `sweep` with its figures.
    pub(super) fn add(&mut self, sweep: &str, cell: &CellSamples<'_>, recorded: &Scene, figures: CellFigures) {
        let own = cell.series(sweep);
        let (place, scene_id) = (&recorded.source.place, &recorded.id);
        let n_samples = cell.records.len() as u64;
        let parts = [
            (SeriesKey::reference(Group::Recorded, sweep), 1, figures.recorded),
            (SeriesKey::reference(Group::ConstantVelocity, sweep), 1, figures.constant_velocity),
            (own.clone(), n_samples, Some(figures.together)),
        ];
        for (key, n_samples, values) in parts {
            let Some(values) = values else { continue };
            let figures = SceneFigures { place: place.clone(), scene_id: scene_id.clone(), n_samples, values };
            match self.series.iter_mut().find(|(known, _)| *known == key) {
                Some((_, scenes)) => scenes.push(figures),
                None => self.series.push((key, vec![figures])),
            }
        }
        let Some(series_idx) = self.series.iter().position(|(known, _)| *known == own) else { return };
        let scene_idx = self.series[series_idx].1.len() - 1;
        let ids = cell.records.iter().map(|record| record.scenario.id.clone());
        self.of_scenarios.extend(ids.zip(figures.alone).map(|(scenario_id, values)| ScenarioFigures {
            series_idx,
            scene_idx,
            scenario_id,
            values,
        }));
    }

    /// Means over scenes: of all places together, then place by place, each in the order of series and metrics.
    pub(super) fn aggregates(&self) -> Vec<MetricRow> {
        let mut places: Vec<&str> =
            self.series.iter().flat_map(|(_, scenes)| scenes).map(|scene| scene.place.as_str()).collect();
        places.sort_unstable();
        places.dedup();
        let mut rows = Vec::new();
        for place in std::iter::once("").chain(places) {
            for (key, scenes) in &self.series {
                let here: Vec<&SceneFigures> =
                    scenes.iter().filter(|scene| place.is_empty() || scene.place == place).collect();
                for (idx, doc) in self.docs.iter().enumerate() {
                    if let Some(aggregate) = Aggregate::of(here.iter().map(|scene| scene.values[idx])) {
                        let row = row(key, place, &doc.metric, aggregate.mean, aggregate.n);
                        rows.push(MetricRow { std_error: aggregate.std_error, ..row });
                    }
                }
            }
        }
        rows
    }

    /// The value of every scene, in the order of series.
    pub fn of_scenes(&self) -> impl Iterator<Item = MetricRow> + '_ {
        let scenes = self.series.iter().flat_map(|(key, scenes)| scenes.iter().map(move |scene| (key, scene)));
        scenes.flat_map(|(key, scene)| self.rows(key, scene, scene.n_samples, &scene.values))
    }

    /// The value of every scenario that is wanted by its id, in the order of the samples.
    pub fn of_scenarios<'a>(&'a self, is_wanted: impl Fn(&str) -> bool + 'a) -> impl Iterator<Item = MetricRow> + 'a {
        let wanted = self.of_scenarios.iter().filter(move |figures| is_wanted(&figures.scenario_id));
        wanted.flat_map(|ScenarioFigures { series_idx, scene_idx, scenario_id, values }| {
            let (key, scenes) = &self.series[*series_idx];
            let rows = self.rows(key, &scenes[*scene_idx], 1, values);
            rows.map(move |row| MetricRow { scenario_id: Some(scenario_id.clone()), ..row })
        })
    }

    /// The values that are defined, as rows of a scene.
    fn rows<'a>(
        &'a self,
        key: &'a SeriesKey,
        SceneFigures { place, scene_id, .. }: &'a SceneFigures,
        n: u64,
        values: &'a [Option<f64>],
    ) -> impl Iterator<Item = MetricRow> + 'a {
        self.docs.iter().zip(values).filter_map(move |(doc, value)| {
            let row = row(key, place, &doc.metric, (*value)?, n);
            Some(MetricRow { scene_id: Some(scene_id.clone()), ..row })
        })
    }
}

fn row(key: &SeriesKey, place: &str, metric: &str, value: f64, n: u64) -> MetricRow {
    MetricRow {
        group: key.group.clone(),
        sweep: key.sweep.clone(),
        level: key.level,
        place: place.to_owned(),
        scene_id: None,
        scenario_id: None,
        metric: metric.to_owned(),
        value,
        n,
        std_error: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{evaluated_cell, record, recorded};

    #[test]
    fn scenes_and_scenarios_have_a_row_for_each_value_that_is_defined() {
        let mut second = record(2.0, false, false, recorded());
        second.scenario.id = "s-5".to_owned();
        let first = record(2.0, false, false, recorded());
        let (_, mut figures, docs) = evaluated_cell(&first, &recorded());
        let n_values = figures.alone[0].iter().flatten().count();
        assert!(0 < n_values && n_values < docs.len());
        figures.alone.push(figures.alone[0].clone());
        let cell = CellSamples { records: vec![&first, &second], with_references: true };
        let mut rows = MetricRows::new(docs);
        rows.add("guided", &cell, &recorded(), figures);

        let of_scenes: Vec<MetricRow> = rows.of_scenes().collect();
        let n_of = |group: &Group, n: u64| of_scenes.iter().filter(|row| row.group == *group && row.n == n).count();
        let own = Group::Sweep("guided".to_owned());
        assert_eq!((n_of(&Group::Recorded, 1), n_of(&own, 2), n_of(&own, 1)), (n_values, n_values, 0));
        let ids = |wanted: &'static str| rows.of_scenarios(move |id| id == wanted).map(|row| row.scenario_id);
        assert_eq!(ids("s-5").collect::<Vec<_>>(), vec![Some("s-5".to_owned()); n_values]);
        let all: Vec<MetricRow> = rows.of_scenarios(|_| true).collect();
        assert_eq!((all.len(), all[0].scenario_id.as_deref()), (2 * n_values, Some("s-4")));
        assert!(
            all.iter().all(|row| row.group == own && row.place == "Test" && row.n == 1 && row.level.strength == 2.0)
        );
        assert!(all.iter().all(|row| row.scene_id == Some(recorded().id) && row.std_error.is_none()));
    }
}
