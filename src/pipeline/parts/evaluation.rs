//! Evaluation in parts: workers measure shards of samples; the process that seals merges them and decides.

use super::folder::PartsFolder;
use super::gathering::Gathering;
use super::work::Shards;
use super::{PartedStage, StampedFile};
use crate::evaluate::MapFitRow;
use crate::files::link_or_copy;
use crate::pipeline::stages::{Evaluate, FIGURES_FORMAT, figures_path};
use crate::pipeline::{ComputeChoice, Result};
use crate::progress::Progress;
use crate::store::write_binary_atomically;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Results that workers share instead of computing them one by one.
#[derive(Serialize, Deserialize)]
pub(super) struct EvaluationPlan {
    /// Number of shards of samples.
    n_shards: usize,
    /// The places where the map is good enough to judge departures from the road.
    maps: Vec<MapFitRow>,
}

impl PartedStage for Evaluate<'_> {
    type Plan = EvaluationPlan;
    type Shard = StampedFile;

    fn plan(&self, _compute: ComputeChoice, _progress: &dyn Progress) -> Result<EvaluationPlan> {
        let ready = self.ready(None)?;
        Ok(EvaluationPlan { n_shards: ready.samples.shards.len(), maps: ready.maps })
    }

    fn n_shards(plan: &EvaluationPlan) -> usize {
        plan.n_shards
    }

    fn work(&self, plan: &EvaluationPlan, shards: &Shards<'_, StampedFile>, _compute: ComputeChoice) -> Result<()> {
        let ready = self.ready(Some(plan.maps.clone()))?;
        let mut measurer = self.measurer(&ready)?;
        shards.progress.start("work", ready.samples.n_scenarios, "scenarios");
        let n_scenarios = |idx: usize| ready.samples.shards[idx].n_scenarios;
        shards.go_about(0..plan.n_shards, &n_scenarios, &|_| true, &mut |idx| {
            let figures = measurer.measure(&self.read(&ready, idx)?)?;
            shards.progress.advance(n_scenarios(idx));
            let file = shards.file_name(idx);
            let stamp = write_binary_atomically(&shards.dir().join(&file), FIGURES_FORMAT, &figures)?;
            Ok(StampedFile { file, stamp })
        })?;
        shards.progress.finish();
        Ok(())
    }

    fn gather(&self, plan: &EvaluationPlan, shards: &mut Gathering<'_, StampedFile>) -> Result<()> {
        for idx in 0..plan.n_shards {
            if let Some(shard) = shards.look_up(idx)? {
                shards.take(idx, shard);
            }
        }
        Ok(())
    }

    fn publish(
        &self,
        _plan: &EvaluationPlan,
        shards: &[(usize, StampedFile)],
        parts: &PartsFolder,
        work: &Path,
    ) -> Result<()> {
        for (idx, shard) in shards {
            let path = figures_path(work, *idx);
            if !shard.stamp.is_of(&path)? {
                fs_err::create_dir_all(path.parent().unwrap_or(work))?;
                link_or_copy(&parts.dir().join(&shard.file), &path)?;
            }
        }
        Ok(())
    }
}
