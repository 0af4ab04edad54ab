//! Held-out scenes and a model to situations that nobody recorded.

use super::closed_loops::ClosedLoops;
use crate::engine::{Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::evaluate::MapFits;
use crate::generate::Futures;
use crate::ingest::IngestConfig;
use crate::metrics::ValidityConfig;
use crate::pipeline::StageId;
use crate::pipeline::layout::SITUATIONS;
use crate::simulate::{NewScenes, SituationsConfig};
use crate::store::{SceneStore, SceneWriter};
use serde_json::{Value, json};

/// The stage.
pub struct Situations<'a> {
    /// Its section.
    pub config: &'a SituationsConfig,
    /// What is valid in a loop, as in the evaluation.
    pub validity: ValidityConfig,
    /// Where its loops begin, and what drives them.
    pub loops: ClosedLoops<'a>,
}

impl Stage for Situations<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Situations.kind()
    }

    fn version(&self) -> u32 {
        9
    }

    fn check(&self) -> Result<()> {
        let config = self.config;
        self.loops.check("situations", config.validate(), |dt_s, future_s| config.check(dt_s, future_s))
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = self.loops.config(self.config)?;
        config["validity"] = serde_json::to_value(&self.validity)?;
        if let Some(IngestConfig { max_agents, map_radius_m, .. }) = self.loops.ingest {
            config["scenes"] = json!([max_agents, map_radius_m]);
        }
        Ok(config)
    }

    fn inputs(&self) -> Vec<StageInput> {
        self.loops.inputs()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Situations<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let store = SceneStore::open(&self.loops.layout.scenes)?;
        let positions = self.loops.starts(&store)?;
        let model = self.loops.model(context)?;
        let futures = Futures::new(&model, self.loops.seed, &context.compute.device)?;
        let judged_by = MapFits::of(&store, &self.validity)?.settings(&self.validity);
        let dataset = store.index().get(positions[0]).dataset;
        let as_usual = IngestConfig { seed: self.loops.seed, ..IngestConfig::new(dataset, Vec::new()) };
        let ingest =
            self.loops.ingest.map_or(as_usual, |ingest| IngestConfig { seed: self.loops.seed, ..ingest.clone() });
        let (mut writer, finished) = SceneWriter::resume(&context.root.join(SITUATIONS))?;
        let (mut n_batches, report) = finished.map_or((0, json!(null)), |shard| (shard.units_done, shard.report));
        let counts = serde_json::from_value(report).unwrap_or_default();
        let (config, judged_by, ingest) = (self.config, &judged_by, &ingest);
        let new = NewScenes { config, futures: &futures, store: &store, judged_by, ingest };
        let counts = new.make(&positions, counts, context.progress, &mut |scenes, maps, counts| {
            n_batches += 1;
            Ok(writer.write_batch(scenes, maps, Some(n_batches), &json!(counts))?)
        })?;
        let counts = serde_json::to_value(counts).map_err(anyhow::Error::from)?;
        writer.finish(&counts)?;
        Ok(counts)
    }
}
