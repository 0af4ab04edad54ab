//! The stages: how are the sections of a pipeline file connected to the code that does the work?

mod blame;
mod evaluate;
mod generate;
mod ingest;
mod mine;
mod sample_folder;
mod selection;
mod train_classifier;
mod train_denoiser;

pub use evaluate::{Evaluate, EvaluateConfig, EvaluationSummary, GateResult, GatesConfig, Keep};
pub use generate::Generate;
pub use ingest::Ingest;
pub use mine::{BehaviorCounts, LabelCounts, Mine, MineConfig, MineSummary};
pub use sample_folder::{SampleFolder, SampleManifest, SampleSidecar};
pub use train_classifier::TrainClassifier;
pub use train_denoiser::TrainDenoiser;

use super::config::PipelineConfig;
use super::failure::{Failure, Result};
use super::layout::Layout;
use super::record::StageRecord;
use super::stage::{Stage, StageId};

/// The stages whose sections the configuration has, in the order in which they run.
pub fn of_pipeline<'a>(config: &'a PipelineConfig, layout: &'a Layout) -> Result<Vec<Box<dyn Stage + 'a>>> {
    let stages: Vec<_> = StageId::ALL.into_iter().filter_map(|id| build(id, config, layout)).collect();
    if stages.is_empty() {
        return Err(Failure::input_message("the pipeline has no stages")
            .with_hint("give it sections such as [ingest] and [mine]; see pipelines/quickstart.toml"));
    }
    Ok(stages)
}

/// One stage, with its defaults if the configuration has no section for it.
pub fn alone<'a>(id: StageId, config: &'a PipelineConfig, layout: &'a Layout) -> Result<Box<dyn Stage + 'a>> {
    build(id, config, layout).ok_or_else(|| {
        Failure::input_message(format_args!("the configuration has no section [{}]", id.section())).with_hint(format!(
            "name a pipeline file with --config, or set values with --set {}.key=value",
            id.section()
        ))
    })
}

/// Fails if a quality gate was not met, whether the metrics were computed now or earlier.
pub fn check_gates(records: &[StageRecord]) -> Result<()> {
    let Some(evaluated) = records.iter().find(|record| record.stage == StageId::Evaluate) else { return Ok(()) };
    let gates: Vec<GateResult> =
        serde_json::from_value(evaluated.summary["gates"].clone()).map_err(anyhow::Error::from)?;
    let missed: Vec<String> =
        gates.iter().filter(|gate| !gate.met).map(|gate| format!("{}: {}", gate.gate, gate.detail)).collect();
    if missed.is_empty() {
        Ok(())
    } else {
        Err(Failure::gate(format_args!("quality gate not met: {}", missed.join("; "))))
    }
}

fn build<'a>(id: StageId, config: &'a PipelineConfig, layout: &'a Layout) -> Option<Box<dyn Stage + 'a>> {
    let PipelineConfig { run, ingest, mine, train, generate, evaluate } = config;
    let definitions = || mine.clone().unwrap_or_default();
    Some(match id {
        StageId::Ingest => Box::new(Ingest { config: ingest.as_ref()? }),
        StageId::Mine => Box::new(Mine { config: mine.as_ref()?, layout }),
        StageId::TrainDenoiser => Box::new(TrainDenoiser { config: train.denoiser.as_ref()?, seed: run.seed, layout }),
        StageId::TrainClassifier => Box::new(TrainClassifier { config: train.classifier.as_ref()?, layout }),
        StageId::Generate => Box::new(Generate { config: generate.as_ref()?, mine: definitions(), layout }),
        StageId::Evaluate => Box::new(Evaluate {
            config: evaluate.as_ref()?,
            mine: definitions(),
            generate: generate.as_ref(),
            pipeline: &run.name,
            layout,
        }),
        _ => return None,
    })
}
