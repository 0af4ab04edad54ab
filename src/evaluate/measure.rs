//! The figures of one shard of scenarios, which depend on no other shard.

use super::cells::{CellFigures, CellSamples, into_cells};
use super::config::EvaluateConfig;
use super::distinguishability::{CellKey, TrackPool};
use super::error::{Error, Result};
use super::judge::Judge;
use super::measures::{Measures, MetricDoc};
use super::sampling::{Conduct, SampledCell};
use crate::behavior::Behavior;
use crate::metrics::{Check, Judged, MetricSettings, OffroadRate};
use crate::scenario::ScenarioRecord;
use crate::scene::{Roles, Scene};
use crate::store::SceneStore;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Scenarios of one sweep that were generated together.
pub struct Shard<'a> {
    /// The sweep.
    pub sweep: &'a str,
    /// Evaluations of the denoiser for one sample.
    pub n_evaluations: u64,
    /// The scenarios, in order.
    pub records: Vec<ScenarioRecord>,
}

/// The results of measuring a shard, to be saved if another process merges the shards: without the samples and
/// recordings themselves.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardFigures {
    /// The cells, in order of first appearance.
    cells: Vec<CellFindings>,
}

#[derive(Clone, PartialEq, Serialize, Deserialize)]
struct CellFindings {
    key: CellKey,
    conduct: Vec<Conduct>,
    figures: CellFigures,
    not_checked: Vec<Check>,
}

impl ShardFigures {
    /// Adds the tracks of the shard to the pool.
    pub fn pool_tracks(&self, pool: &mut TrackPool) {
        self.cells.iter().for_each(|cell| pool.add(&cell.key, &cell.figures.tracks));
    }
}

/// A shard with its figures, for [`Evaluation`](super::Evaluation) to merge with others.
pub struct MeasuredShard {
    pub(super) n_evaluations: u64,
    /// The scenarios, in order.
    pub(super) records: Vec<ScenarioRecord>,
    /// Their cells, in order of first appearance.
    pub(super) cells: Vec<MeasuredCell>,
}

pub(super) struct MeasuredCell {
    pub(super) key: CellKey,
    pub(super) recorded: Scene,
    /// The scenarios, in order.
    pub(super) scenario_ids: Vec<String>,
    /// Their counts.
    pub(super) sampled: SampledCell,
    pub(super) figures: CellFigures,
    /// The checks of validity that were not made.
    pub(super) not_checked: Vec<Check>,
}

impl MeasuredShard {
    /// The shard with its figures. Cells are assembled in parallel.
    ///
    /// # Errors
    /// When the figures are of another shard, or a scene is missing or damaged.
    pub fn new(shard: Shard<'_>, figures: ShardFigures, store: &SceneStore) -> Result<Self> {
        let Shard { n_evaluations, records, .. } = shard;
        let cells = into_cells(&records);
        if cells.len() != figures.cells.len() {
            return Err(Error::OtherShard { expected: cells.len(), found: figures.cells.len() });
        }
        let cells = cells.into_par_iter().zip(figures.cells).map(|(cell, findings)| {
            let CellFindings { key, conduct, figures, not_checked } = findings;
            Ok(MeasuredCell {
                recorded: store.scene(scene_idx(&cell, store)?)?,
                key,
                scenario_ids: cell.records.iter().map(|record| record.scenario.id.clone()).collect(),
                sampled: SampledCell::new(&cell, conduct),
                figures,
                not_checked,
            })
        });
        let cells = cells.collect::<Result<_>>()?;
        Ok(Self { n_evaluations, records, cells })
    }
}

fn scene_idx(cell: &CellSamples<'_>, store: &SceneStore) -> Result<usize> {
    let scene_id = &cell.records[0].scenario.provenance.scene_id;
    store.position(scene_id).ok_or_else(|| Error::UnknownScene(scene_id.clone()))
}

/// The descriptions of the measures of a configuration, for reading the tables.
pub(super) fn metric_docs(config: &EvaluateConfig, behaviors: &[Box<dyn Behavior>]) -> Vec<MetricDoc> {
    Measures::new(&config.metric_settings(), config.modes, behaviors).docs()
}

/// Measures shards, in any order.
pub struct Measurer<'a> {
    settings: &'a MetricSettings,
    store: &'a SceneStore,
    measures: Measures<'a>,
    judge: Judge<'a>,
    offroad: OffroadRate,
}

impl<'a> Measurer<'a> {
    /// Measures scenarios that continue scenes of `store` by these settings, and over a number of modes if there is
    /// one. Novelty is measured against the positive events in the table `events`.
    pub fn new(
        settings: &'a MetricSettings,
        modes: Option<usize>,
        behaviors: &'a [Box<dyn Behavior>],
        store: &'a SceneStore,
        events: Option<&'a Path>,
    ) -> Result<Self> {
        let (measures, judge) = (Measures::new(settings, modes, behaviors), Judge::new(settings, store, events)?);
        let offroad = OffroadRate { places_without_road: settings.map_gaps.places.clone() };
        Ok(Self { settings, store, measures, judge, offroad })
    }

    /// Measures the cells of a shard in parallel. Recorded events that it reads are kept for the next shard.
    ///
    /// # Errors
    /// When a scene is missing or damaged, or the events are.
    pub fn measure(&mut self, shard: &Shard<'_>) -> Result<ShardFigures> {
        let asked = shard.records.iter().filter_map(|record| record.requested_behavior.as_deref());
        self.judge.learn_events(asked)?;
        let cells = into_cells(&shard.records).into_par_iter().map(|cell| self.measure_cell(&cell, shard.sweep));
        Ok(ShardFigures { cells: cells.collect::<Result<_>>()? })
    }

    fn measure_cell(&self, cell: &CellSamples<'_>, sweep: &str) -> Result<CellFindings> {
        let scene_idx = scene_idx(cell, self.store)?;
        let recorded = self.store.scene(scene_idx)?;
        let judged = Judged::future_of(&recorded, Roles::none()).with_gaps(&self.settings.map_gaps);
        Ok(CellFindings {
            not_checked: judged.not_checked(&self.settings.validity),
            key: CellKey { series: cell.series(sweep), place: recorded.source.place.clone(), scene_idx },
            conduct: Conduct::of(cell, &recorded, &self.offroad),
            figures: cell.evaluate(&recorded, &self.measures, &self.judge),
        })
    }
}
