//! What was asked of the sampler and what came out, counted by sweep, strength and place.

use super::cells::{Cell, CellFigures};
use crate::report::{MetricDoc, SamplingRow};
use crate::scene::Scene;

/// Counts of what was sampled.
pub(super) struct SamplingTable {
    collision_idx: Option<usize>,
    offroad_idx: Option<usize>,
    n_evaluations_a_sample: u64,
    rows: Vec<SamplingRow>,
    /// Off-road rates of the scenes of each row.
    offroad: Vec<Vec<Option<f64>>>,
}

impl SamplingTable {
    pub(super) fn new(docs: &[MetricDoc], n_evaluations_a_sample: u64) -> Self {
        let position = |metric: &str| docs.iter().position(|doc| doc.metric == metric);
        Self {
            collision_idx: position("collision_rate"),
            offroad_idx: position("offroad_rate"),
            n_evaluations_a_sample,
            rows: Vec::new(),
            offroad: Vec::new(),
        }
    }

    /// Adds a cell of `sweep` with its figures.
    pub(super) fn add(&mut self, sweep: &str, cell: &Cell<'_>, recorded: &Scene, figures: &CellFigures) {
        let first = cell.records[0];
        let strength = first.scenario.provenance.guidance.strength;
        let is_same =
            |row: &SamplingRow| row.sweep == sweep && row.strength == strength && row.place == recorded.source.place;
        let idx = self.rows.iter().position(is_same).unwrap_or_else(|| {
            self.rows.push(SamplingRow {
                sweep: sweep.to_owned(),
                behavior: first.requested_behavior.clone(),
                place: recorded.source.place.clone(),
                strength,
                sampler: first.scenario.provenance.sampler.clone(),
                n_scenes: 0,
                n_scenarios: 0,
                n_verified: 0,
                n_new: 0,
                n_collision: 0,
                offroad_rate: None,
                n_evaluations: Some(0),
            });
            self.offroad.push(Vec::new());
            self.rows.len() - 1
        });
        let n_with_collision = self.collision_idx.map_or(0, |metric| {
            figures.alone.iter().filter(|values| values[metric].is_some_and(|rate| rate > 0.0)).count()
        });
        let row = &mut self.rows[idx];
        row.n_scenes += 1;
        row.n_scenarios += cell.records.len() as u64;
        row.n_verified += cell.records.iter().filter(|record| record.verified).count() as u64;
        row.n_new += cell.records.iter().filter(|record| record.verified && !record.recorded_event).count() as u64;
        row.n_collision += n_with_collision as u64;
        row.n_evaluations = row.n_evaluations.map(|n| n + self.n_evaluations_a_sample * cell.records.len() as u64);
        self.offroad[idx].push(self.offroad_idx.and_then(|metric| figures.together[metric]));
    }

    /// The rows, ordered by sweep as generated, place and strength.
    pub(super) fn finish(self) -> Vec<SamplingRow> {
        let mut rows = self.rows;
        for (row, offroad) in rows.iter_mut().zip(self.offroad) {
            row.offroad_rate = crate::metrics::Aggregate::of(offroad).map(|aggregate| aggregate.mean);
        }
        let mut sweeps: Vec<String> = rows.iter().map(|row| row.sweep.clone()).collect();
        sweeps.dedup();
        let sweep_idx = |row: &SamplingRow| sweeps.iter().position(|sweep| *sweep == row.sweep);
        rows.sort_by(|a, b| {
            let by_place = sweep_idx(a).cmp(&sweep_idx(b)).then_with(|| a.place.cmp(&b.place));
            by_place.then_with(|| a.strength.total_cmp(&b.strength))
        });
        rows
    }
}
