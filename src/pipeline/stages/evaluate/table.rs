//! From the figures of cells to rows: one for each scene, each kept scenario, each place, and all places together.

use super::cells::{Cell, CellFigures};
use crate::metrics::Aggregate;
use crate::report::MetricDoc;
use crate::scene::{Scene, SceneId};
use crate::store::MetricRow;

/// Which samples a row is about.
#[derive(Debug, Clone, PartialEq)]
struct Group {
    /// `recorded`, `constant_velocity`, `unguided`, or the sweep.
    name: String,
    sweep: String,
    strength: f64,
}

/// The figures of a group in one scene.
struct SceneFigures {
    place: String,
    scene_id: SceneId,
    n_samples: u64,
    values: Vec<Option<f64>>,
}

/// Collects figures and turns them into rows.
pub(super) struct MetricTable {
    docs: Vec<MetricDoc>,
    groups: Vec<(Group, Vec<SceneFigures>)>,
    of_scenarios: Vec<MetricRow>,
}

impl MetricTable {
    pub(super) fn new(docs: Vec<MetricDoc>) -> Self {
        Self { docs, groups: Vec::new(), of_scenarios: Vec::new() }
    }

    /// Adds a cell of `sweep` with its figures.
    pub(super) fn add(&mut self, sweep: &str, cell: &Cell<'_>, recorded: &Scene, figures: CellFigures) {
        let provenance = &cell.records[0].scenario.provenance;
        let strength = provenance.guidance.strength;
        // What starts from an edited recording is no forecast, be it guided or not.
        let generated = if strength == 0.0 && provenance.edit_tau.is_none() { "unguided" } else { sweep };
        let place = &recorded.source.place;
        let (place, scene_id) = (place.clone(), recorded.id.clone());
        for (record, values) in cell.records.iter().zip(&figures.alone) {
            let group = Group { name: generated.to_owned(), sweep: sweep.to_owned(), strength };
            let rows = self.docs.iter().zip(values).filter_map(|(doc, value)| {
                let row = group.row(&place, &doc.metric, (*value)?, 1);
                Some(MetricRow {
                    scene_id: Some(scene_id.clone()),
                    scenario_id: Some(record.scenario.id.clone()),
                    ..row
                })
            });
            self.of_scenarios.extend(rows);
        }
        let n_samples = cell.records.len() as u64;
        let parts = [
            ("recorded", 0.0, 1, figures.recorded),
            ("constant_velocity", 0.0, 1, figures.constant_velocity),
            (generated, strength, n_samples, Some(figures.together)),
        ];
        for (name, strength, n_samples, values) in parts {
            let Some(values) = values else { continue };
            let group = Group { name: name.to_owned(), sweep: sweep.to_owned(), strength };
            let figures = SceneFigures { place: place.clone(), scene_id: scene_id.clone(), n_samples, values };
            match self.groups.iter_mut().find(|(known, _)| *known == group) {
                Some((_, scenes)) => scenes.push(figures),
                None => self.groups.push((group, vec![figures])),
            }
        }
    }

    /// Means over scenes: of all places together, then place by place, each in the order of groups and metrics.
    pub(super) fn aggregates(&self) -> Vec<MetricRow> {
        let mut places: Vec<&str> =
            self.groups.iter().flat_map(|(_, scenes)| scenes).map(|scene| scene.place.as_str()).collect();
        places.sort_unstable();
        places.dedup();
        let mut rows = Vec::new();
        for place in std::iter::once("").chain(places) {
            for (group, scenes) in &self.groups {
                let here: Vec<&SceneFigures> =
                    scenes.iter().filter(|scene| place.is_empty() || scene.place == place).collect();
                for (idx, doc) in self.docs.iter().enumerate() {
                    if let Some(aggregate) = Aggregate::of(here.iter().map(|scene| scene.values[idx])) {
                        let row = group.row(place, &doc.metric, aggregate.mean, aggregate.n);
                        rows.push(MetricRow { std_error: aggregate.std_error, ..row });
                    }
                }
            }
        }
        rows
    }

    /// The value of every scene, in the order of groups.
    pub(super) fn of_scenes(&self) -> Vec<MetricRow> {
        let mut rows = Vec::new();
        for (group, scenes) in &self.groups {
            for scene in scenes {
                for (doc, value) in self.docs.iter().zip(&scene.values) {
                    let Some(value) = value else { continue };
                    let row = group.row(&scene.place, &doc.metric, *value, scene.n_samples);
                    rows.push(MetricRow { scene_id: Some(scene.scene_id.clone()), ..row });
                }
            }
        }
        rows
    }

    /// The value of every scenario, in the order of the samples.
    pub(super) fn of_scenarios(&self) -> &[MetricRow] {
        &self.of_scenarios
    }
}

impl Group {
    fn row(&self, place: &str, metric: &str, value: f64, n: u64) -> MetricRow {
        MetricRow {
            group: self.name.clone(),
            sweep: self.sweep.clone(),
            strength: self.strength,
            place: place.to_owned(),
            scene_id: None,
            scenario_id: None,
            metric: metric.to_owned(),
            value,
            n,
            std_error: None,
        }
    }
}
