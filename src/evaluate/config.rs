//! The `[evaluate]` section: what to measure, what to keep, and which gates to check.

use super::error::{Error, Result};
use super::gate_config::GatesConfig;
use crate::metrics::{DUPLICATE_DISTANCE_M, MetricSettings, ValidityConfig};
use crate::scene::Dataset;
use crate::settings;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What to measure, what to keep in the corpus, and the quality gates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluateConfig {
    /// The number of modes to which many samples are reduced, as in benchmarks, which take 6. A mode is the mean of
    /// similar samples, as in the paper. Metrics over modes stand beside those of all samples, under names that begin
    /// with `modes6_`. Left out: no reduction.
    #[schemars(range(min = 1, max = 1_000))]
    pub modes: Option<usize>,
    /// Which scenarios become the corpus.
    pub keep: Keep,
    /// The limits for valid scenarios.
    pub validity: ValidityConfig,
    /// Whether a hard brake needs a cause in its scene, and a near miss an ordinary mistake, to be accepted (column
    /// `cause`). Default true. Requests always ask for it.
    pub require_cause: bool,
    /// A scenario is a near-duplicate of an earlier accepted one if the paths of the requested agents differ by less
    /// than this, meters: the mean over the future, of a position each half second, in the frame of the first of them.
    /// 0 for none. Requests accept no near-duplicates. Default 0.25.
    #[schemars(range(min = 0.0))]
    pub duplicate_distance_m: f64,
    /// The terms under which the recordings are, by dataset, where they are not those of the dataset: in the card of
    /// the corpus, its exports and the report.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub terms: BTreeMap<Dataset, String>,
    /// Quality gates; if one fails, the exit code is 3.
    pub gates: GatesConfig,
}

impl Default for EvaluateConfig {
    fn default() -> Self {
        Self {
            modes: None,
            keep: Keep::default(),
            validity: ValidityConfig::default(),
            require_cause: true,
            duplicate_distance_m: DUPLICATE_DISTANCE_M,
            terms: BTreeMap::new(),
            gates: GatesConfig::default(),
        }
    }
}

/// Which scenarios become the corpus. All others are counted by reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// Verified scenarios (of requests, those that fill a bucket) that pass every validity check and are not
    /// near-duplicates of earlier ones. The default: an impossible or repeated scenario tests nothing.
    #[default]
    Accepted,
    /// Verified scenarios (of requests, those that fill a bucket), valid or not.
    Verified,
    /// All.
    All,
}

impl EvaluateConfig {
    /// The settings that metrics judge by, where maps have no gaps.
    pub fn metric_settings(&self) -> MetricSettings {
        MetricSettings { validity: self.validity.clone(), ..MetricSettings::default() }
    }

    /// Rejects settings that cannot work.
    ///
    /// # Errors
    /// [`Error::Config`] with the key, its value and what was expected.
    pub fn validate(&self) -> Result<()> {
        settings::check_ranges(self).map_err(|issue| Error::Config {
            message: issue.within("evaluate").to_string(),
            advice: "leave it out for its default".to_owned(),
        })
    }
}
