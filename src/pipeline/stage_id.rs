//! The stages: their names, sections and outputs.

use super::config::PipelineConfig;
use super::layout::{
    BASELINE, CLASSIFIER, CORPUS, COVERAGE, DENOISER, DISTILLED, EVENTS, EXPOSURE, FIGURES, Layout, METRICS,
    METRICS_SUMMARY, MINE_SUMMARY, MODELED, MODELED_RATES, MODELED_SUMMARY, OCCURRENCES, RATES, REPORT, SAMPLES,
    SCENES, SITUATIONS, TAGS, VERDICTS,
};
use super::stages::is_round_file;
use crate::engine::{ShardNames, StageKind};
use crate::settings::Unreadable;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// The stages, in the order in which they run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageId {
    /// Recordings to scenes.
    Ingest,
    /// Scenes to events.
    Mine,
    /// Scenes to a denoiser.
    TrainDenoiser,
    /// A denoiser to one that needs few evaluations.
    TrainDistill,
    /// Scenes and events to a classifier of noised scenes.
    TrainClassifier,
    /// Scenes to a Scene Transformer, to compare the denoiser with.
    TrainBaseline,
    /// Scenes and a model to rates of what was hardly recorded.
    Rates,
    /// Scenes and a model to situations that nobody recorded.
    Situations,
    /// Scenes and models to generated scenarios.
    Generate,
    /// Generated scenarios to metrics and the corpus.
    Evaluate,
    /// Metrics and corpus to a page for people.
    Report,
}

impl StageId {
    /// Every stage, in the order in which they run.
    pub const ALL: [Self; 11] = [
        Self::Ingest,
        Self::Mine,
        Self::TrainDenoiser,
        Self::TrainDistill,
        Self::TrainClassifier,
        Self::TrainBaseline,
        Self::Rates,
        Self::Situations,
        Self::Generate,
        Self::Evaluate,
        Self::Report,
    ];

    /// The kind of stage, for the engine.
    pub fn kind(self) -> &'static StageKind {
        &KINDS[self as usize]
    }

    /// The name in file names and messages.
    pub fn name(self) -> &'static str {
        self.kind().name
    }

    /// The stage of this kind.
    pub fn of(kind: &StageKind) -> Option<Self> {
        Self::ALL.into_iter().find(|stage| stage.kind() == kind)
    }

    /// Whether a configuration has its section.
    pub fn is_configured(self, config: &PipelineConfig) -> bool {
        let PipelineConfig { ingest, mine, train, rates, situations, generate, evaluate, report, .. } = config;
        match self {
            Self::Ingest => ingest.is_some(),
            Self::Mine => mine.is_some(),
            Self::TrainDenoiser => train.denoiser.is_some(),
            Self::TrainDistill => train.distill.is_some(),
            Self::TrainClassifier => train.classifier.is_some(),
            Self::TrainBaseline => train.baseline.is_some(),
            Self::Rates => rates.is_some(),
            Self::Situations => situations.is_some(),
            Self::Generate => generate.is_some(),
            Self::Evaluate => evaluate.is_some(),
            Self::Report => report.is_some(),
        }
    }

    /// The name and place of its output for other stages; `None` if its output is for people.
    pub fn output(self, layout: &Layout) -> Option<(&'static str, &Path)> {
        let (name, path) = match self {
            Self::Ingest => ("scenes", &layout.scenes),
            Self::Mine => ("events", &layout.events),
            Self::TrainDenoiser => ("denoiser", &layout.denoiser),
            Self::TrainDistill => ("distilled", &layout.distilled),
            Self::TrainClassifier => ("classifier", &layout.classifier),
            Self::TrainBaseline => ("baseline", &layout.baseline),
            Self::Rates => ("modeled", &layout.modeled),
            Self::Situations => ("situations", &layout.situations),
            Self::Generate => ("samples", &layout.samples),
            Self::Evaluate => ("metrics", &layout.metrics),
            Self::Report => return None,
        };
        Some((name, path))
    }
}

/// The kinds of some stages.
pub fn kinds(stages: &[StageId]) -> Vec<&'static StageKind> {
    stages.iter().map(|stage| stage.kind()).collect()
}

impl From<StageId> for &'static StageKind {
    fn from(stage: StageId) -> Self {
        stage.kind()
    }
}

impl FromStr for StageId {
    type Err = Unreadable;

    fn from_str(name: &str) -> Result<Self, Unreadable> {
        Self::ALL.into_iter().find(|stage| stage.name() == name).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|stage| stage.name()).collect();
            Unreadable(format!("unknown stage; known stages: {}", known.join(", ")))
        })
    }
}

impl fmt::Display for StageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A stage that one process runs without networks, and whose outputs are checked as wholes.
const fn plain(name: &'static str, command: &'static str, outputs: &'static [&'static str]) -> StageKind {
    StageKind {
        name,
        command,
        section: command,
        places: &[],
        trains: false,
        computes: false,
        outputs,
        is_checked_by_readers: false,
        shards: None,
    }
}

/// A stage that trains a model.
const fn training(
    name: &'static str,
    command: &'static str,
    section: &'static str,
    outputs: &'static [&'static str],
) -> StageKind {
    let places = &["checkpoint", "start_from", "data.scenes"];
    StageKind { section, places, trains: true, computes: true, ..plain(name, command, outputs) }
}

/// The kinds of all stages, in the order of [`StageId::ALL`].
pub static KINDS: [StageKind; 11] = [
    StageKind {
        places: &["inputs", "map_inputs"],
        is_checked_by_readers: true,
        ..plain("ingest", "ingest", &[SCENES])
    },
    plain("mine", "mine", &[EVENTS, OCCURRENCES, EXPOSURE, RATES, TAGS, MINE_SUMMARY]),
    training("train_denoiser", "train denoiser", "train.denoiser", &[DENOISER]),
    training("train_distill", "train distill", "train.distill", &[DISTILLED]),
    training("train_classifier", "train classifier", "train.classifier", &[CLASSIFIER]),
    training("train_baseline", "train baseline", "train.baseline", &[BASELINE]),
    StageKind { computes: true, ..plain("rates", "rates", &[MODELED, MODELED_RATES, MODELED_SUMMARY]) },
    StageKind { computes: true, is_checked_by_readers: true, ..plain("situations", "situations", &[SITUATIONS]) },
    StageKind {
        computes: true,
        is_checked_by_readers: true,
        shards: Some(ShardNames { shard: "samples", ending: "parquet", is_other: is_round_file }),
        ..plain("generate", "generate", &[SAMPLES])
    },
    StageKind {
        shards: Some(ShardNames { shard: "figures", ending: "bin", is_other: |_| false }),
        ..plain("evaluate", "evaluate", &[CORPUS, METRICS, METRICS_SUMMARY, VERDICTS, COVERAGE])
    },
    plain("report", "report", &[REPORT, FIGURES]),
];
