//! What is said of a shard of scenarios by itself: it depends on no other shard.

use super::cells::{CellFigures, CellSamples, into_cells};
use super::config::EvaluateConfig;
use super::error::{Error, Result};
use super::judge::Judge;
use super::measures::{Measures, MetricDoc};
use super::sampling::SampledCell;
use crate::behavior::Behavior;
use crate::metrics::{Check, Judged, OffroadRate, SeriesKey};
use crate::scene::{Roles, Scene};
use crate::store::{ScenarioRecord, SceneStore};
use rayon::prelude::*;
use std::path::Path;

/// Scenarios of one sweep that were generated together.
pub struct Shard<'a> {
    /// The sweep.
    pub sweep: &'a str,
    /// Calls of the denoiser for one sample.
    pub n_evaluations: u64,
    /// The scenarios, in order.
    pub records: Vec<ScenarioRecord>,
}

/// A shard with its figures, which [`Evaluation`](super::Evaluation) puts beside those of others.
pub struct MeasuredShard {
    pub(super) n_evaluations: u64,
    /// The scenarios, in order.
    pub(super) records: Vec<ScenarioRecord>,
    /// Their cells, in order of first appearance.
    pub(super) cells: Vec<MeasuredCell>,
}

/// A cell with its figures.
pub(super) struct MeasuredCell {
    /// The series of its samples.
    pub(super) series: SeriesKey,
    /// The scene that it continues.
    pub(super) recorded: Scene,
    /// Where the store has that scene.
    pub(super) scene_idx: usize,
    /// The scenarios, in order.
    pub(super) scenario_ids: Vec<String>,
    /// What is counted of them.
    pub(super) sampled: SampledCell,
    /// The figures.
    pub(super) figures: CellFigures,
    /// The checks of validity that were not made of it.
    pub(super) not_checked: Vec<Check>,
}

/// Measures shards, in any order.
pub struct Measurer<'a> {
    config: &'a EvaluateConfig,
    store: &'a SceneStore,
    measures: Measures<'a>,
    judge: Judge<'a>,
    offroad: OffroadRate,
}

impl<'a> Measurer<'a> {
    /// Measures scenarios that continue scenes of `store`. Novelty is measured against the positive events in the table `events`.
    ///
    /// # Errors
    /// When scenes cannot be read.
    pub fn new(
        config: &'a EvaluateConfig,
        behaviors: &'a [Box<dyn Behavior>],
        store: &'a SceneStore,
        events: Option<&'a Path>,
    ) -> Result<Self> {
        let (measures, judge) = (Measures::new(config, behaviors), Judge::new(config, store, events)?);
        let offroad = OffroadRate { places_without_road: config.validity.places_without_road.clone() };
        Ok(Self { config, store, measures, judge, offroad })
    }

    /// What is measured, for reading the tables.
    pub fn docs(&self) -> Vec<MetricDoc> {
        self.measures.docs()
    }

    /// Measures the cells of a shard in parallel. What is read for it of recorded events stays for the next one.
    ///
    /// # Errors
    /// When a scene is missing or damaged, or the events are.
    pub fn measure(&mut self, Shard { sweep, n_evaluations, records }: Shard<'_>) -> Result<MeasuredShard> {
        self.judge.learn_events(records.iter().filter_map(|record| record.requested_behavior.as_deref()))?;
        let cells = into_cells(&records).into_par_iter().map(|cell| self.measure_cell(sweep, &cell));
        let cells = cells.collect::<Result<_>>()?;
        Ok(MeasuredShard { n_evaluations, records, cells })
    }

    fn measure_cell(&self, sweep: &str, cell: &CellSamples<'_>) -> Result<MeasuredCell> {
        let scene_id = &cell.records[0].scenario.provenance.scene_id;
        let scene_idx = self.store.position(scene_id).ok_or_else(|| Error::UnknownScene(scene_id.clone()))?;
        let recorded = self.store.scene(scene_idx)?;
        let not_checked = Judged::future_of(&recorded, Roles::none()).not_checked(&self.config.validity);
        Ok(MeasuredCell {
            series: cell.series(sweep),
            scene_idx,
            scenario_ids: cell.records.iter().map(|record| record.scenario.id.clone()).collect(),
            sampled: SampledCell::of(cell, &recorded, &self.offroad),
            figures: cell.evaluate(&recorded, &self.measures, &self.judge, self.config),
            not_checked,
            recorded,
        })
    }
}
