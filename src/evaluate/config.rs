//! The `[evaluate]` section: what to measure, what to keep, and which gates to check.

use super::error::{Error, Result};
use super::gate_config::GatesConfig;
use crate::metrics::{ALL, DUPLICATE_DISTANCE_M, Likelihoods, MetricSettings, ModesConfig, ValidityConfig};
use crate::scene::Dataset;
use crate::settings;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What to measure, what to keep in the corpus, and the quality gates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluateConfig {
    /// The metrics, by name; empty: all.
    #[schemars(extend("uniqueItems" = true))]
    pub metrics: Vec<String>,
    /// Reduces many samples to a few modes, as in benchmarks, and reports their metrics beside those of all samples,
    /// under names that begin with `modes6_` (or another number). Left out: no reduction.
    pub modes: Option<ModesConfig>,
    /// The datasets for which predictions are written into `predictions/`, in the format of their benchmark:
    /// INTERACTION's CSVs, Argoverse's Parquet. The first unguided samples of each scene count, reduced to modes if
    /// there are more (as in `modes`, or to six means).
    #[schemars(extend("uniqueItems" = true))]
    pub predictions: Vec<Dataset>,
    /// Which scenarios become the corpus.
    pub keep: Keep,
    /// The limits for valid scenarios.
    pub validity: ValidityConfig,
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
            metrics: Vec::new(),
            modes: None,
            predictions: Vec::new(),
            keep: Keep::default(),
            validity: ValidityConfig::default(),
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
    /// The settings that metrics judge by.
    pub fn metric_settings(&self) -> MetricSettings {
        MetricSettings { validity: self.validity.clone() }
    }

    /// Rejects settings that cannot work.
    ///
    /// # Errors
    /// [`Error::Config`] with the key, its value and what was expected.
    pub fn validate(&self) -> Result<()> {
        settings::check_ranges(self).map_err(|issue| Error::Config {
            message: issue.within("evaluate").to_string(),
            advice: "leave it out for its default".to_owned(),
        })?;
        if self.modes.as_ref().is_some_and(|modes| modes.by.is_empty()) {
            let message = "evaluate.modes.by is empty, expected mean, medoid or both".to_owned();
            return Err(Error::Config { message, advice: "leave it out for its default".to_owned() });
        }
        self.gates.validate(&self.metrics)?;
        let known: Vec<&str> = ALL.iter().map(|metric| metric.spec().id).chain([Likelihoods::META_METRIC]).collect();
        let Some(unknown) = self.metrics.iter().find(|name| !known.contains(&name.as_str())) else { return Ok(()) };
        let nearest = known.iter().min_by_key(|name| strsim::damerau_levenshtein(unknown, name));
        Err(Error::Config {
            message: format!("evaluate.metrics: unknown metric {unknown}; known: {}", known.join(", ")),
            advice: nearest.map(|nearest| format!("did you mean `{nearest}`?")).unwrap_or_default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_must_be_possible() {
        let check = |text: &str| toml::from_str::<EvaluateConfig>(text).expect("readable").validate();
        assert!(check("").is_ok() && check("[modes]").is_ok());
        for wrong in ["n_modes = 0", "by = []"] {
            assert!(check(&format!("[modes]\n{wrong}")).is_err(), "{wrong}");
        }
    }

    #[test]
    fn limits_must_be_numbers() {
        let check = |text: &str| toml::from_str::<EvaluateConfig>(text).expect("readable").validate();
        for wrong in [
            "duplicate_distance_m = -1.0",
            "duplicate_distance_m = inf",
            "[validity]\nmax_recorded_offroad = 1.5",
            "[validity]\nmax_slip_rad = -0.1",
            "[validity]\nmax_jerk_mps3 = inf",
            "[validity]\nmax_jerk_mps3 = nan",
        ] {
            assert!(check(wrong).is_err(), "{wrong}");
        }
        assert!(check("[validity]\nskip = [\"jerk\"]").is_ok());
        assert!(toml::from_str::<EvaluateConfig>("[validity]\nskip = [\"jerks\"]").is_err());
    }
}
