//! From the figures of cells to rows: one for each scene, each kept scenario, each place, and all places together.

use super::cells::{CellFigures, CellSamples};
use super::measures::MetricDoc;
use crate::metrics::{Aggregate, Group, SeriesKey};
use crate::scene::{Scene, SceneId};
use crate::store::MetricRow;

/// The figures of a series in one scene.
struct SceneFigures {
    place: String,
    scene_id: SceneId,
    n_samples: u64,
    values: Vec<Option<f64>>,
}

/// Collects figures and turns them into rows.
pub(super) struct MetricRows {
    docs: Vec<MetricDoc>,
    series: Vec<(SeriesKey, Vec<SceneFigures>)>,
    of_scenarios: Vec<MetricRow>,
}

impl MetricRows {
    pub(super) fn new(docs: Vec<MetricDoc>) -> Self {
        Self { docs, series: Vec::new(), of_scenarios: Vec::new() }
    }

    /// Adds a cell of `sweep` with its figures.
    pub(super) fn add(&mut self, sweep: &str, cell: &CellSamples<'_>, recorded: &Scene, figures: CellFigures) {
        let own = cell.series(sweep);
        let (place, scene_id) = (&recorded.source.place, &recorded.id);
        for (record, values) in cell.records.iter().zip(&figures.alone) {
            let rows = self.docs.iter().zip(values).filter_map(|(doc, value)| {
                let row = row(&own, place, &doc.metric, (*value)?, 1);
                let scenario_id = Some(record.scenario.id.clone());
                Some(MetricRow { scene_id: Some(scene_id.clone()), scenario_id, ..row })
            });
            self.of_scenarios.extend(rows);
        }
        let n_samples = cell.records.len() as u64;
        let parts = [
            (SeriesKey::reference(Group::Recorded, sweep), 1, figures.recorded),
            (SeriesKey::reference(Group::ConstantVelocity, sweep), 1, figures.constant_velocity),
            (own, n_samples, Some(figures.together)),
        ];
        for (key, n_samples, values) in parts {
            let Some(values) = values else { continue };
            let figures = SceneFigures { place: place.clone(), scene_id: scene_id.clone(), n_samples, values };
            match self.series.iter_mut().find(|(known, _)| *known == key) {
                Some((_, scenes)) => scenes.push(figures),
                None => self.series.push((key, vec![figures])),
            }
        }
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
    pub(super) fn of_scenes(&self) -> Vec<MetricRow> {
        let mut rows = Vec::new();
        for (key, scenes) in &self.series {
            for scene in scenes {
                for (doc, value) in self.docs.iter().zip(&scene.values) {
                    let Some(value) = value else { continue };
                    let row = row(key, &scene.place, &doc.metric, *value, scene.n_samples);
                    rows.push(MetricRow { scene_id: Some(scene.scene_id.clone()), ..row });
                }
            }
        }
        rows
    }

    /// The value of every scenario, in the order of the samples.
    pub(super) fn into_of_scenarios(self) -> Vec<MetricRow> {
        self.of_scenarios
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
