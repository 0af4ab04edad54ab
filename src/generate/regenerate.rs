//! Generates one scenario again, by denoising its original batch and nothing else.

use super::{Error, Generator, ShardPlan};
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, Provenance};

/// One sample of a shard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleKey {
    /// The cell of the shard that it continues.
    pub cell: usize,
    /// The level of its guidance.
    pub level: GuidanceLevel,
    /// Its number.
    pub sample_idx: usize,
}

impl SampleKey {
    /// The sample of `shard` that has this provenance. `None` when the shard has no such cell.
    pub fn of(shard: &ShardPlan, provenance: &Provenance) -> Option<Self> {
        let is_own =
            |cell: &super::Cell| cell.scene_id == provenance.scene_id && cell.roles == provenance.guidance.roles;
        Some(Self {
            cell: shard.cells.iter().position(is_own)?,
            level: provenance.guidance.level,
            sample_idx: provenance.sample_idx,
        })
    }
}

impl Generator<'_> {
    /// Generates one sample of a shard exactly as with the whole shard, to the last digit. Matrix products of few rows
    /// round differently from those of many, so the other samples of its batch are denoised again, too.
    ///
    /// `None` if the shard has no such sample, or the sample did not become a scenario.
    pub fn regenerate(&self, shard: &ShardPlan, wanted: SampleKey) -> Result<Option<ScenarioRecord>, Error> {
        let Some(cell) = shard.cells.get(wanted.cell) else { return Ok(None) };
        let output = self.generate_part(
            shard,
            &|level, members, samples| {
                level == wanted.level && members.contains(&wanted.cell) && samples.contains(&wanted.sample_idx)
            },
            &Silent,
        )?;
        Ok(output.records.into_iter().find(|record| {
            let provenance = &record.scenario.provenance;
            provenance.scene_id == cell.scene_id
                && provenance.guidance.roles == cell.roles
                && provenance.guidance.level == wanted.level
                && provenance.sample_idx == wanted.sample_idx
        }))
    }
}
