//! The facts about each stage in one table: its names, its section, its output for other stages.

use super::config::PipelineConfig;
use super::layout::{
    BASELINE, CLASSIFIER, CORPUS, DENOISER, DISTILLED, EVENTS, FIGURES, Layout, METRICS, METRICS_SUMMARY, MINE_SUMMARY,
    PREDICTIONS, REPORT, SAMPLES, SCENES, VERDICTS,
};
use super::stage::StageId;
use super::stages::is_round_file;
use std::path::Path;

/// The facts about a stage, apart from its work ([`Stage`](super::Stage)).
pub struct StageFacts {
    /// The name in file names and messages.
    pub name: &'static str,
    /// The words of the command that runs it alone.
    pub command: &'static str,
    /// The section of a pipeline file that configures it.
    pub section: &'static str,
    /// Whether it trains a model, which may have cost hours.
    pub trains: bool,
    /// Whether a configuration has its section.
    pub is_configured: fn(&PipelineConfig) -> bool,
    /// The files and folders that it may write, by name within the output folder.
    pub outputs: &'static [&'static str],
    /// The name and place of its output for other stages; `None` if its output is for people.
    pub output: Option<StageOutput>,
    /// The shards that several processes can make at once; `None` if one process does all the work.
    pub shards: Option<ShardFacts>,
}

/// The files of shards that workers make ([`shards`](super::shards)).
#[derive(Debug, Clone, Copy)]
pub struct ShardFacts {
    /// What their names begin with.
    pub shard: &'static str,
    /// What their names end in.
    pub ending: &'static str,
    /// Whether workers write a file of this name beside the shards.
    pub is_other: fn(&str) -> bool,
}

/// What other stages read of a stage.
pub struct StageOutput {
    /// Its name among their inputs.
    pub name: &'static str,
    /// Where it is.
    pub path: fn(&Layout) -> &Path,
}

const fn output(name: &'static str, path: fn(&Layout) -> &Path) -> Option<StageOutput> {
    Some(StageOutput { name, path })
}

impl ShardFacts {
    /// What shard `idx` is called.
    pub(super) fn shard_name(self, idx: usize) -> String {
        format!("{}-{idx:05}", self.shard)
    }
}

impl StageId {
    /// What is known of it.
    pub const fn facts(self) -> StageFacts {
        match self {
            Self::Ingest => StageFacts {
                name: "ingest",
                command: "ingest",
                section: "ingest",
                trains: false,
                is_configured: |config| config.ingest.is_some(),
                outputs: &[SCENES],
                output: output("scenes", |layout| &layout.scenes),
                shards: None,
            },
            Self::Mine => StageFacts {
                name: "mine",
                command: "mine",
                section: "mine",
                trains: false,
                is_configured: |config| config.mine.is_some(),
                outputs: &[EVENTS, MINE_SUMMARY],
                output: output("events", |layout| &layout.events),
                shards: None,
            },
            Self::TrainDenoiser => StageFacts {
                name: "train_denoiser",
                command: "train denoiser",
                section: "train.denoiser",
                trains: true,
                is_configured: |config| config.train.denoiser.is_some(),
                outputs: &[DENOISER],
                output: output("denoiser", |layout| &layout.denoiser),
                shards: None,
            },
            Self::TrainDistill => StageFacts {
                name: "train_distill",
                command: "train distill",
                section: "train.distill",
                trains: true,
                is_configured: |config| config.train.distill.is_some(),
                outputs: &[DISTILLED],
                output: output("distilled", |layout| &layout.distilled),
                shards: None,
            },
            Self::TrainClassifier => StageFacts {
                name: "train_classifier",
                command: "train classifier",
                section: "train.classifier",
                trains: true,
                is_configured: |config| config.train.classifier.is_some(),
                outputs: &[CLASSIFIER],
                output: output("classifier", |layout| &layout.classifier),
                shards: None,
            },
            Self::TrainBaseline => StageFacts {
                name: "train_baseline",
                command: "train baseline",
                section: "train.baseline",
                trains: true,
                is_configured: |config| config.train.baseline.is_some(),
                outputs: &[BASELINE],
                output: output("baseline", |layout| &layout.baseline),
                shards: None,
            },
            Self::Generate => StageFacts {
                name: "generate",
                command: "generate",
                section: "generate",
                trains: false,
                is_configured: |config| config.generate.is_some(),
                outputs: &[SAMPLES],
                output: output("samples", |layout| &layout.samples),
                shards: Some(ShardFacts { shard: "samples", ending: "parquet", is_other: is_round_file }),
            },
            Self::Evaluate => StageFacts {
                name: "evaluate",
                command: "evaluate",
                section: "evaluate",
                trains: false,
                is_configured: |config| config.evaluate.is_some(),
                outputs: &[CORPUS, METRICS, METRICS_SUMMARY, VERDICTS, PREDICTIONS],
                output: output("metrics", |layout| &layout.metrics),
                shards: Some(ShardFacts { shard: "figures", ending: "bin", is_other: |_| false }),
            },
            Self::Report => StageFacts {
                name: "report",
                command: "report",
                section: "report",
                trains: false,
                is_configured: |config| config.report.is_some(),
                outputs: &[REPORT, FIGURES],
                output: None,
                shards: None,
            },
        }
    }

    /// Whether it computes with networks, and so needs the device.
    pub const fn computes(self) -> bool {
        self.facts().trains || matches!(self, Self::Generate)
    }

    /// The name and place of its output for other stages.
    pub fn output(self, layout: &Layout) -> Option<(&'static str, &Path)> {
        self.facts().output.map(|output| (output.name, (output.path)(layout)))
    }
}
