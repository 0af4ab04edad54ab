//! Where does each stage find the outputs of others?

use crate::store::SceneManifest;
use std::path::{Path, PathBuf};

/// The places of everything that stages pass on. In a run folder they are all below it; a stage that runs alone may
/// read from elsewhere, but always writes below its output folder under these names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// The scene store.
    pub scenes: PathBuf,
    /// The mined events.
    pub events: PathBuf,
    /// The folder of the trained denoiser.
    pub denoiser: PathBuf,
    /// The folder of the distilled denoiser.
    pub distilled: PathBuf,
    /// The folder of the trained classifier.
    pub classifier: PathBuf,
    /// The folder of the trained baseline.
    pub baseline: PathBuf,
    /// Exposure and events in closed loops of the model.
    pub modeled: PathBuf,
    /// The scene store of situations that nobody recorded.
    pub situations: PathBuf,
    /// The folder of sample shards.
    pub samples: PathBuf,
    /// The folder of the corpus.
    pub corpus: PathBuf,
    /// The metric rows.
    pub metrics: PathBuf,
}

impl Layout {
    /// All places under their own names below `root`.
    pub fn below(root: &Path) -> Self {
        Self {
            scenes: root.join(SCENES),
            events: root.join(EVENTS),
            denoiser: root.join(DENOISER),
            distilled: root.join(DISTILLED),
            classifier: root.join(CLASSIFIER),
            baseline: root.join(BASELINE),
            modeled: root.join(MODELED),
            situations: root.join(SITUATIONS),
            samples: root.join(SAMPLES),
            corpus: root.join(CORPUS),
            metrics: root.join(METRICS),
        }
    }

    /// The folders of recorded scenes and of other situations, if there are any.
    pub fn scene_folders(&self) -> Vec<&Path> {
        let has_situations = SceneManifest::is_in(&self.situations);
        [Some(&self.scenes), Some(&self.situations).filter(|_| has_situations)]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect()
    }
}

/// The scene store.
pub const SCENES: &str = "scenes";
/// The mined events.
pub const EVENTS: &str = "events.parquet";
/// The mined events that count, each once however many scenes show it.
pub const OCCURRENCES: &str = "occurrences.parquet";
/// The exposure in recordings, every moment once.
pub const EXPOSURE: &str = "exposure.parquet";
/// How often behaviors were recorded.
pub const RATES: &str = "rates.parquet";
/// The surroundings of the center of each recorded scene, as tags.
pub const TAGS: &str = "tags.parquet";
/// Counts of the mined events.
pub const MINE_SUMMARY: &str = "mine.json";
/// The trained denoiser.
pub const DENOISER: &str = "denoiser";
/// The distilled denoiser.
pub const DISTILLED: &str = "distilled";
/// The trained classifier.
pub const CLASSIFIER: &str = "classifier";
/// The trained baseline.
pub const BASELINE: &str = "baseline";
/// Exposure and weighted events in closed loops of the unguided model.
pub const MODELED: &str = "modeled.bin";
/// How often behaviors happen in them, where that agrees with recordings.
pub const MODELED_RATES: &str = "modeled_rates.parquet";
/// Figures of the loops, and modeled against recorded rates.
pub const MODELED_SUMMARY: &str = "modeled.json";
/// The scene store of situations that nobody recorded.
pub const SITUATIONS: &str = "situations";
/// The generated scenarios, sharded.
pub const SAMPLES: &str = "samples";
/// The corpus.
pub const CORPUS: &str = "corpus";
/// The metric rows.
pub const METRICS: &str = "metrics.parquet";
/// The main figures of the evaluation, and the gates.
pub const METRICS_SUMMARY: &str = "metrics.json";
/// The outcome of each scenario, beside the metric rows.
pub const VERDICTS: &str = "verdicts.parquet";
/// Counts of recorded and generated events of each behavior, by tags.
pub const COVERAGE: &str = "coverage.parquet";
/// The report.
pub const REPORT: &str = "report.html";
/// The figures of the report as files.
pub const FIGURES: &str = "figures";
