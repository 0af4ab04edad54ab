//! Recordings to a scene store, resuming after the last whole shard.

use crate::cloud::Recordings;
use crate::engine::{Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::ingest::{Done, IngestBatch, IngestConfig, IngestReport, ingest};
use crate::pipeline::StageId;
use crate::pipeline::layout::SCENES;
use crate::store::SceneWriter;
use serde_json::{Value, json};
use std::path::PathBuf;

/// The stage.
pub struct Ingest<'a> {
    /// Its section.
    pub config: &'a IngestConfig,
    /// The seed of the run.
    pub seed: u64,
}

impl Stage for Ingest<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Ingest.kind()
    }

    fn version(&self) -> u32 {
        15
    }

    fn check(&self) -> Result<()> {
        self.config.validate()?;
        // Missing ones are noticed among the inputs.
        let real: Vec<_> = self.config.inputs.iter().map(|path| fs_err::canonicalize(path).ok()).collect();
        let same = |i: usize| (0..i).find(|j| real[i].is_some() && real[*j] == real[i]).map(|j| (i, j));
        match (1..real.len()).find_map(same) {
            Some((i, j)) => {
                let detail = format!("is {}, the same as inputs.{j}", self.config.inputs[i].display());
                Err(crate::ingest::Error::Config { key: format!("inputs.{i}"), detail }.into())
            }
            None => Ok(()),
        }
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["seed"] = json!(self.seed);
        Ok(config)
    }

    fn inputs(&self) -> Vec<StageInput> {
        let named = |what: &'static str| {
            move |(idx, path): (usize, &PathBuf)| StageInput::external(format!("{what}.{idx}"), path)
        };
        let recordings = self.config.inputs.iter().enumerate().map(named("inputs"));
        recordings.chain(self.config.map_inputs.iter().enumerate().map(named("map_inputs"))).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Ingest<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let dir = context.root.join(SCENES);
        let (mut writer, finished) = SceneWriter::resume(&dir)?;
        let report: Option<IngestReport> =
            finished.map(|shard| serde_json::from_value(shard.report)).transpose().map_err(anyhow::Error::from)?;
        let mut total = report.clone().unwrap_or_default();
        let scenes = writer.identities()?;
        let done = report.map(|report| Done { report, scenes });
        let config = IngestConfig { seed: self.seed, ..on_disk(self.config)? };
        let report = ingest(&config, done, context.progress, &mut |batch: IngestBatch| {
            total.merge(&batch.report);
            let so_far = serde_json::to_value(&total)?;
            Ok(writer.write_batch(&batch.scenes, &batch.maps, batch.units_done, &so_far)?)
        })?;
        let whole = serde_json::to_value(&report).map_err(anyhow::Error::from)?;
        let manifest = writer.finish(&whole)?;
        Ok(json!({
            "n_scenes": manifest.n_scenes,
            "n_agents": manifest.n_agents,
            "n_rejects": report.n_rejects(),
        }))
    }
}

/// The section with the local paths of its inputs: for URLs, the places to which they are downloaded.
pub(crate) fn on_disk(config: &IngestConfig) -> Result<IngestConfig> {
    let place = |path: &PathBuf| Ok(Recordings::at(path)?.map_or(Ok(path.clone()), |recordings| recordings.on_disk())?);
    let places = |paths: &[PathBuf]| paths.iter().map(place).collect::<Result<Vec<_>>>();
    Ok(IngestConfig { inputs: places(&config.inputs)?, map_inputs: places(&config.map_inputs)?, ..config.clone() })
}
