//! The stages: how are the sections of a pipeline file connected to the code that does the work?

mod closed_loops;
mod error_causes;
mod evaluate;
mod generate;
mod held_out;
mod ingest;
mod mine;
mod models;
mod rates;
mod report;
mod situations;
mod train;
mod train_baseline;
mod train_classifier;
mod train_denoiser;
mod train_distill;
mod train_loops;
mod training_scenes;

pub use closed_loops::ClosedLoops;
pub use evaluate::Evaluate;
pub(in crate::pipeline) use generate::{FoundShard, find_shard, is_round_file, shard_name};
pub use generate::{Generate, SampleManifest, SampleSettings, SampleSidecar, SampledWith, read_requests};
pub use ingest::Ingest;
pub(crate) use ingest::on_disk;
pub use mine::{Mine, MineConfig};
pub(in crate::pipeline) use models::{LoadedModels, needed_models, roll_out};
pub use rates::{ModeledSummary, Rates};
pub use report::{About, Report};
pub use situations::Situations;
pub(in crate::pipeline) use train::checkpoint_file;
pub use train::{Recipe, Train};

use super::StageId;
use super::config::PipelineConfig;
use super::layout::Layout;
use crate::engine::Stage;
use crate::engine::StageRecord;
use crate::engine::{Failure, Result};
use crate::evaluate::{EvaluateConfig, GateResult, Keep};
use crate::ingest::usual_horizon;
use crate::metrics::DUPLICATE_DISTANCE_M;
use crate::nn::Precision;
use serde_json::{Value, json};

/// The stages whose sections the configuration has, in the order in which they run.
pub fn of_pipeline<'a>(config: &'a PipelineConfig, layout: &'a Layout) -> Result<Vec<Box<dyn Stage + 'a>>> {
    check_learned_behavior(config)?;
    let stages: Vec<_> = StageId::ALL.into_iter().filter_map(|id| build(id, config, layout)).collect();
    if stages.is_empty() {
        return Err(Failure::input_message("the pipeline has no stages")
            .with_hint("give it sections such as [ingest] and [mine]; see pipelines/quickstart.toml"));
    }
    Ok(stages)
}

/// Refuses a behavior to learn that the pipeline does not mine.
fn check_learned_behavior(config: &PipelineConfig) -> Result<()> {
    let Some(mine) = &config.mine else { return Ok(()) };
    let mined: Vec<&str> = mine.build()?.iter().map(|behavior| behavior.id()).collect();
    let classifier = config.train.classifier.as_ref().filter(|classifier| classifier.checkpoint.is_none());
    let is_unmined = |id: &&String| !mined.contains(&id.as_str());
    match classifier.map(|classifier| &classifier.behavior).filter(is_unmined) {
        Some(id) => Err(Failure::input_message(format_args!(
            "train.classifier.behavior is \"{id}\", expected one of mine.behaviors, which are {}",
            mined.join(", ")
        ))),
        None => Ok(()),
    }
}

/// One stage, with its defaults if the configuration has no section for it.
pub fn alone<'a>(id: StageId, config: &'a PipelineConfig, layout: &'a Layout) -> Result<Box<dyn Stage + 'a>> {
    build(id, config, layout).ok_or_else(|| {
        Failure::input_message(format_args!("the configuration has no section [{}]", id.kind().section)).with_hint(
            format!("pass a pipeline file with --config, or set values with --set {}.key=value", id.kind().section),
        )
    })
}

/// Fails if a quality gate was not met, whether the metrics were computed now or earlier.
pub fn check_gates(records: &[StageRecord]) -> Result<()> {
    let Some(evaluated) = records.iter().find(|record| record.stage == StageId::Evaluate.name()) else { return Ok(()) };
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
    let PipelineConfig { run, ingest, mine, train, report, .. } = config;
    let precision = run.precision;
    let own = train.own_scenes();
    Some(match id {
        StageId::Ingest => Box::new(Ingest { config: ingest.as_ref()?, seed: run.seed }),
        StageId::Mine => Box::new(Mine { config: mine.as_ref()?, layout }),
        StageId::TrainDenoiser => {
            Box::new(Train { recipe: train.denoiser.as_ref()?, own, seed: run.seed, precision, layout })
        }
        StageId::TrainDistill => {
            Box::new(Train { recipe: train.distill.as_ref()?, own, seed: run.seed, precision, layout })
        }
        StageId::TrainClassifier => {
            Box::new(Train { recipe: train.classifier.as_ref()?, own, seed: run.seed, precision, layout })
        }
        StageId::TrainBaseline => {
            Box::new(Train { recipe: train.baseline.as_ref()?, own, seed: run.seed, precision, layout })
        }
        StageId::Rates => Box::new(Rates {
            config: config.rates.as_ref()?,
            mine: mine.clone().unwrap_or_default(),
            loops: ClosedLoops::new(config, layout),
        }),
        StageId::Situations => Box::new(Situations {
            config: config.situations.as_ref()?,
            validity: config.evaluate.as_ref().map(|evaluate| evaluate.validity.clone()).unwrap_or_default(),
            loops: ClosedLoops::new(config, layout),
        }),
        StageId::Generate => Box::new(generation(config, layout)?),
        StageId::Evaluate => Box::new(evaluation(config, layout)?),
        StageId::Report => Box::new(Report {
            config: report.as_ref()?,
            parts: reported_stages(config, layout),
            about: About {
                pipeline: run.name.clone(),
                seed: run.seed,
                device: run.compute().to_string(),
                // A configuration that cannot be written has failed before: it is saved in the run folder.
                config: config.portable().to_toml().unwrap_or_default(),
                settings: config.without_paths().unwrap_or_default(),
            },
            layout,
        }),
    })
}

/// The stage of generation, if the configuration has its section.
pub fn generation<'a>(config: &'a PipelineConfig, layout: &'a Layout) -> Option<Generate<'a>> {
    let PipelineConfig { run, ingest, mine, train, generate, evaluate, .. } = config;
    Some(Generate {
        config: generate.as_ref()?,
        precision: run.precision,
        mine: mine.clone().unwrap_or_default(),
        metric_settings: evaluate.as_ref().map(EvaluateConfig::metric_settings).unwrap_or_default(),
        duplicate_distance_m: evaluate.as_ref().map_or(DUPLICATE_DISTANCE_M, |evaluate| evaluate.duplicate_distance_m),
        keeps_duplicates: evaluate.as_ref().is_some_and(|evaluate| evaluate.keep != Keep::Accepted),
        classified_behavior: train.classifier.as_ref().map(|classifier| classifier.behavior.as_str()),
        // A folder of models that the command line names may hold one that was distilled with other settings.
        learns_from: train::scenes_learned_from(train),
        has_situations: config.situations.is_some(),
        distill: train.distill.as_ref().filter(|_| layout.distilled.parent() == layout.scenes.parent()),
        horizon: ingest.as_ref().and_then(|ingest| usual_horizon(ingest).ok()),
        layout,
    })
}

/// The stage of evaluation, if the configuration has its section.
pub fn evaluation<'a>(config: &'a PipelineConfig, layout: &'a Layout) -> Option<Evaluate<'a>> {
    let PipelineConfig { run, mine, generate, evaluate, .. } = config;
    Some(Evaluate {
        config: evaluate.as_ref()?,
        mine: mine.clone().unwrap_or_default(),
        pipeline: &run.name,
        has_events: has_events(config, layout),
        has_modeled: config.rates.is_some() || layout.modeled.exists(),
        // Samples that the command line names may come from another configuration.
        generated: generate.as_ref().filter(|_| layout.samples.parent() == layout.scenes.parent()),
        layout,
    })
}

/// The configuration that decides the outputs of a stage: its section and, if it computes with networks, the precision
/// of products. The default precision is left out, as in records of earlier versions.
fn with_precision(mut config: Value, precision: Option<Precision>) -> Value {
    if let Some(precision) = precision.filter(|precision| *precision != Precision::default()) {
        config["precision"] = json!(precision);
    }
    config
}

/// Whether there are recorded events to compare scenarios with, or will be once the pipeline has mined them.
fn has_events(config: &PipelineConfig, layout: &Layout) -> bool {
    layout.events.exists()
        || (layout.events.parent() == layout.scenes.parent() && config.ingest.is_some() && config.mine.is_some())
}

/// The stages to report on: those of the pipeline or, if the configuration has no other section, those with outputs.
fn reported_stages(config: &PipelineConfig, layout: &Layout) -> Vec<StageId> {
    let is_configured = |id: &StageId| *id != StageId::Report && id.is_configured(config);
    let is_there = |id: &StageId| id.output(layout).is_some_and(|(_, path)| path.exists());
    let in_pipeline: Vec<StageId> = StageId::ALL.into_iter().filter(is_configured).collect();
    if in_pipeline.is_empty() { StageId::ALL.into_iter().filter(is_there).collect() } else { in_pipeline }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::config::parse;
    use crate::pipeline::status::steps_in_all;

    #[test]
    fn what_other_sections_decide_counts_for_the_stages_that_it_changes() {
        let text = "[mine]\n[train.denoiser]\n[train.distill]\n[train.classifier]\n[train.baseline]\n[evaluate]\n\
                    [generate]\n";
        let request = "[[generate.arms]]\nname = 'a'\n[[generate.requests]]\nname = 'r'\nbehavior = 'cut_in'\n\
                       per_bucket = 1\narms = ['a']\nbuckets = { gap_m = [0, 5] }\nbudget = { n_samples = 9 }\n";
        let layout = Layout::below(std::path::Path::new("out"));
        let records = |request: &str, setting: &str| -> Vec<(&str, Value)> {
            let settings = ["run.device=cuda", setting].map(str::to_owned);
            let config = parse(None, &format!("{text}{request}"), &settings).unwrap();
            let stages = of_pipeline(&config, &layout).unwrap();
            stages.iter().map(|stage| (stage.kind().name, stage.config().unwrap())).collect()
        };
        let trained = ["train_denoiser", "train_distill", "train_classifier", "train_baseline"];
        for (request, setting, expected) in [
            ("", "run.precision=bf16", [&trained[..], &["generate"]].concat()),
            ("", "train.splits=[\"val\"]", [&trained[..], &["generate"]].concat()),
            ("", "evaluate.duplicate_distance_m=0.7", vec!["evaluate"]),
            (request, "evaluate.duplicate_distance_m=0.7", vec!["generate", "evaluate"]),
        ] {
            let (plain, changed) = (records(request, "run.precision=f32"), records(request, setting));
            let differ = plain.iter().zip(&changed).filter(|(plain, changed)| plain != changed);
            assert_eq!(differ.map(|((name, _), _)| *name).collect::<Vec<_>>(), expected, "{setting}");
        }
        for (name, record) in records("", "run.precision=f32") {
            assert!(record.get("precision").is_none(), "{name}: records of earlier versions hold");
            // The values of a preset may change with the program.
            assert_eq!(steps_in_all(&record).is_some(), trained.contains(&name), "{name}");
        }
    }
}
