//! The content of a pipeline file: one TOML table per stage, each with a type that is defined beside the code it
//! configures.
//!
//! A stage is part of the pipeline if its section exists, even an empty one. Unknown keys are errors, defaults are in
//! the types, `--set` overrides single values, and relative paths are relative to the file, those of `--set` to the
//! current directory.

mod kinds;
mod load;
mod overrides;
mod paths;
mod remarks;
mod urls;

pub use load::{ConfigError, ConfigPlace, parse};
pub use overrides::Override;

use crate::cloud::ObjectUrl;
use crate::engine::run_folder::RunAbout;
use crate::engine::{ComputeChoice, DeviceChoice};
use crate::engine::{Failure, Result};
use crate::evaluate::EvaluateConfig;
use crate::files::regular;
use crate::generate::GenerateConfig;
use crate::ingest::IngestConfig;
use crate::nn::Precision;
use crate::pipeline::StageId;
use crate::pipeline::cluster::ClusterConfig;
use crate::pipeline::stages::MineConfig;
use crate::report::ReportConfig;
use crate::scene::Split;
use crate::settings::{self, Issue};
use crate::simulate::{RatesConfig, SituationsConfig};
use crate::train::{
    BaselineTrainingConfig, ClassifierTrainingConfig, DenoiserTrainingConfig, DistillTrainingConfig, OwnScenes,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Component, Path, PathBuf};

/// A whole pipeline.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// Settings of all stages.
    pub run: RunConfig,
    /// Which recordings to read, and how to cut scenes from them.
    pub ingest: Option<IngestConfig>,
    /// Which behaviors to mine.
    pub mine: Option<MineConfig>,
    /// The models.
    pub train: TrainConfig,
    /// How often what recordings hardly show happens, by the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rates: Option<RatesConfig>,
    /// Situations that nobody recorded, for requests to begin from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub situations: Option<SituationsConfig>,
    /// What to generate.
    pub generate: Option<GenerateConfig>,
    /// What to measure, what to keep in the corpus, and the quality gates.
    pub evaluate: Option<EvaluateConfig>,
    /// What to show in the report.
    pub report: Option<ReportConfig>,
    /// How to submit the pipeline to a cluster.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cluster: Option<ClusterConfig>,
}

/// The models, one section each.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Splits of this run's scenes to train on. Empty: `train`, or all unsplit scenes if there is no such split.
    /// Without `val`, a tenth of the recordings is held out, or of the time of a single one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(extend("uniqueItems" = true))]
    pub splits: Vec<Split>,
    /// Places of this run's scenes to train on. Empty: all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(extend("uniqueItems" = true))]
    pub places: Vec<String>,
    /// The diffusion model that generates scenarios.
    pub denoiser: Option<DenoiserTrainingConfig>,
    /// The distilled model, which samples in few evaluations; for sweeps with `model = "distilled"`.
    pub distill: Option<DistillTrainingConfig>,
    /// The classifier that guides it toward a behavior.
    pub classifier: Option<ClassifierTrainingConfig>,
    /// Scene Transformer, the baseline; for sweeps with `model = "baseline"`.
    pub baseline: Option<BaselineTrainingConfig>,
}

impl TrainConfig {
    /// The scenes of this run that models train on.
    pub fn own_scenes(&self) -> OwnScenes<'_> {
        OwnScenes { splits: &self.splits, places: &self.places }
    }
}

/// Settings of all stages.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RunConfig {
    /// Name of the pipeline: the folder of its runs. Empty: the name of the pipeline file.
    pub name: String,
    /// Seed of everything random; samples are drawn with `generate.seed` if that is set.
    pub seed: u64,
    /// Number of worker threads, at most eight a core; 0 uses every core. Results do not depend on it.
    #[schemars(range(max = 1_024))]
    pub threads: usize,
    /// What networks compute on: `cpu`, or `cuda` or `cuda:N` for a GPU.
    pub device: DeviceChoice,
    /// Precision of the matrix products of networks: `f32`, or `tf32` or `bf16` for the tensor cores of a GPU.
    pub precision: Precision,
    /// The folder that holds the folders of all pipelines. With the feature `cloud`, also a URL such as
    /// `s3://bucket/runs`, to which results are copied when the run ends.
    pub output: PathBuf,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            name: String::new(),
            seed: 0,
            threads: 0,
            device: DeviceChoice::default(),
            precision: Precision::default(),
            output: PathBuf::from("output"),
        }
    }
}

impl RunConfig {
    /// The device that networks compute on, and the precision.
    pub const fn compute(&self) -> ComputeChoice {
        ComputeChoice { device: self.device, precision: self.precision }
    }
}

fn in_utf8(path: &Path, bytes: Vec<u8>) -> Result<String> {
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let line = 1 + error.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count();
        Failure::input_message(format_args!("{}:{line}: is not in UTF-8", path.display()))
            .with_hint("save the file in that encoding")
    })
}

impl PipelineConfig {
    /// Reads a pipeline file (none: all defaults) and applies overrides such as `run.seed=7`.
    pub fn load(path: Option<&Path>, overrides: &[String]) -> Result<Self> {
        let text = match path {
            Some(path) => in_utf8(path, regular(path).and_then(|_| fs_err::read(path)).map_err(Failure::input)?)?,
            None => String::new(),
        };
        let mut config = parse(path, &text, overrides).map_err(|error| {
            let hint = error.suggestion.as_ref().map(|name| format!("did you mean `{name}`?"));
            Failure { hint, ..Failure::input(error).context("failed to read the configuration") }
        })?;
        if config.run.name.is_empty() {
            let stem = path.and_then(Path::file_stem).map_or("pipeline".into(), |stem| stem.to_string_lossy());
            config.run.name = stem.into_owned();
        }
        Ok(config)
    }

    /// The folder of run `run` of this pipeline.
    ///
    /// # Errors
    /// If one of the two names is not a single folder, but leads elsewhere.
    pub fn folder_of(&self, run: &str) -> Result<PathBuf> {
        for name in [self.run.name.as_str(), run] {
            settings::printable_name("the name of a run", name).map_err(Failure::input)?;
            let mut parts = Path::new(name).components();
            if !matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None)) {
                return Err(Failure::input_message(format_args!("`{name}` cannot name a folder of a run")));
            }
        }
        Ok(self.run.output.join(&self.run.name).join(run))
    }

    /// Refuses numbers beyond the ranges that the schema states, URLs where they cannot be, and texts that would break
    /// pages and terminals.
    pub fn check(&self) -> settings::Result {
        settings::check_ranges(self)?;
        urls::check_urls(self)?;
        self.run.compute().check().map_err(|issue| issue.within("run"))?;
        settings::printable("run.name", &self.run.name)?;
        if self.run.output.as_os_str().is_empty() {
            return Err(Issue::new("run.output", "is empty, expected a folder such as output"));
        }
        settings::printable("run.output", &self.run.output.to_string_lossy())?;
        self.cluster.as_ref().map_or(Ok(()), ClusterConfig::validate).map_err(|issue| issue.within("cluster"))
    }

    /// The description that a run of the pipeline writes into its folder.
    pub fn about(&self, root: &Path) -> anyhow::Result<RunAbout> {
        Ok(RunAbout {
            pipeline: self.run.name.clone(),
            seed: self.run.seed,
            device: self.run.compute().to_string(),
            config: self.saved_in(root)?,
        })
    }

    /// The configuration with the section of `stage`: with its defaults if it is missing and has defaults.
    #[must_use]
    pub fn with_section(mut self, stage: StageId) -> Self {
        match stage {
            // The input cannot be guessed.
            StageId::Ingest => {}
            StageId::Mine => _ = self.mine.get_or_insert_default(),
            StageId::TrainDenoiser => _ = self.train.denoiser.get_or_insert_default(),
            StageId::TrainDistill => _ = self.train.distill.get_or_insert_default(),
            StageId::TrainClassifier => _ = self.train.classifier.get_or_insert_default(),
            StageId::TrainBaseline => _ = self.train.baseline.get_or_insert_default(),
            StageId::Rates => _ = self.rates.get_or_insert_default(),
            StageId::Situations => _ = self.situations.get_or_insert_default(),
            StageId::Generate => _ = self.generate.get_or_insert_default(),
            StageId::Evaluate => _ = self.evaluate.get_or_insert_default(),
            StageId::Report => _ = self.report.get_or_insert_default(),
        }
        self
    }

    /// The configuration as TOML, every default spelled out.
    pub fn to_toml(&self) -> anyhow::Result<String> {
        Ok(toml::to_string(self)?)
    }

    /// The configuration without settings that do not affect results: the number of threads, the memory, the output
    /// folder and the cluster. It is the same for runs of one pipeline on different machines.
    #[must_use]
    pub fn portable(&self) -> Self {
        let mut config = self.clone();
        let RunConfig { threads, output, .. } = RunConfig::default();
        config.run = RunConfig { threads, output, ..config.run };
        config.cluster = None;
        config
    }

    /// The recordings and maps that a run reads, by name.
    pub fn recordings(&self) -> impl Iterator<Item = (String, &Path)> {
        fn lists(ingest: &IngestConfig) -> [(&'static str, &[PathBuf]); 2] {
            [("inputs", &ingest.inputs), ("map_inputs", &ingest.map_inputs)]
        }
        self.ingest.iter().flat_map(lists).flat_map(|(what, paths)| {
            paths.iter().enumerate().map(move |(idx, path)| (format!("{what}.{idx}"), path.as_path()))
        })
    }

    /// The portable configuration as TOML for the folder `root` of a run: it runs again from there, into the same
    /// folder.
    pub fn saved_in(&self, root: &Path) -> anyhow::Result<String> {
        let mut config = self.portable();
        // The copy in a store is read elsewhere.
        if ObjectUrl::is_meant(&self.run.output) {
            return config.to_toml();
        }
        config.run.output = PathBuf::from("../..");
        Ok(paths::replaced(config.to_toml()?, |path| paths::seen_from(root, path)))
    }

    /// The portable configuration as TOML without paths, which differ from directory to directory.
    pub fn without_paths(&self) -> anyhow::Result<String> {
        Ok(paths::replaced(self.portable().to_toml()?, |_| Some(String::new())))
    }
}
