//! `[[generate.requests]]`: which events are requested, with which parameters, how many of each, and on what budget?

use super::limits::Limit;
use crate::generate::PairSelectionConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

/// Events requested by their parameters. Arms of `[[generate.arms]]` are tried until every bucket is full or the budget
/// is spent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RequestConfig {
    /// Name, unique among the requests.
    pub name: String,
    /// The mined behavior to request, such as `cut_in`.
    pub behavior: String,
    /// The quantities that define buckets: parameters of the event, `place`, an attribute of coverage such as
    /// `junction`, or the class of the agent with a role, such as `other_class`. Ascending edges `[0, 5, 10]` make the
    /// intervals 0 to 5 and 5 to 10 (lower edge included, upper not); texts `["left", "right"]` make a part each. The
    /// buckets are all combinations.
    pub buckets: BTreeMap<String, Divisions>,
    /// Scenarios wanted in each bucket. Either this or `n_total`.
    #[serde(default)]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub per_bucket: Option<u64>,
    /// Scenarios wanted in all, distributed over the buckets by `weights`.
    #[serde(default)]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub n_total: Option<u64>,
    /// How `n_total` is distributed: for a parameter of `buckets` a weight for each of its parts; equal where left out.
    /// Weights of several parameters multiply.
    #[serde(default)]
    pub weights: BTreeMap<String, Vec<f64>>,
    /// What every accepted scenario must satisfy: a range `[least, most]` of a parameter, both ends included, or a list
    /// of texts, such as `side = ["left"]`, `place = […]`, `other_class = ["vehicle"]`.
    #[serde(default, rename = "where")]
    pub conditions: BTreeMap<String, Requirement>,
    /// Limits on metrics of the single scenario, such as criticality: `{ collision_rate = 0.0 }` accepts those without
    /// a collision, `{ pair_min_ttc_s = [0.5, 2.0] }` those that come this close to one,
    /// `{ pair_min_distance_m = { at_least = 1.0 } }` those that stay this far apart. Unless it is limited otherwise,
    /// `validity_rate` is 1: a corpus of accepted scenarios holds valid ones only.
    #[serde(default = "only_valid", deserialize_with = "with_validity")]
    pub limits: BTreeMap<String, Limit>,
    /// Names of `[[generate.arms]]` that may be tried. An arm of several strengths is tried at each of them.
    pub arms: Vec<String>,
    /// Number of scenes to take pairs from.
    #[serde(default = "default_n_scenes")]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub n_scenes: usize,
    /// Which pairs of agents to take.
    #[serde(default)]
    pub pairs: PairSelectionConfig,
    /// Accepted scenarios of one bucket that continue the same scene with the same agents, at most.
    #[serde(default = "default_max_per_scene")]
    #[schemars(range(min = 1, max = 1_000_000_000))]
    pub max_per_scene: u64,
    /// How the budget is spent.
    #[serde(default)]
    pub plan: PlanKind,
    /// Number of shards per round.
    #[serde(default = "default_shards_per_round")]
    #[schemars(range(min = 1, max = 10_000))]
    pub shards_per_round: usize,
    /// The budget; when it is spent, unfilled buckets stay short.
    pub budget: BudgetConfig,
}

/// The limits of a request that names none.
fn only_valid() -> BTreeMap<String, Limit> {
    BTreeMap::from([("validity_rate".to_owned(), Limit::Worst(1.0))])
}

fn with_validity<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, Limit>, D::Error> {
    let named = BTreeMap::deserialize(deserializer)?;
    Ok(only_valid().into_iter().chain(named).collect())
}

const fn default_n_scenes() -> usize {
    100
}

const fn default_max_per_scene() -> u64 {
    3
}

const fn default_shards_per_round() -> usize {
    4
}

/// How a parameter is divided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a list of ascending numbers or a list of texts")]
pub enum Divisions {
    /// Ascending edges of intervals.
    Edges(Vec<f64>),
    /// One part for each text.
    Texts(Vec<String>),
}

/// What a parameter must be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a range [least, most] or a list of texts")]
pub enum Requirement {
    /// Between two numbers, both included.
    Range([f64; 2]),
    /// One of these texts.
    Texts(Vec<String>),
}

/// How the budget of a request is spent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanKind {
    /// First every arm on the same scenes; then, round by round, the arms and scenes that fill open
    /// buckets, each in proportion to its probability of being the best (Thompson sampling).
    #[default]
    Adaptive,
    /// Every arm on every scene in turn, repeatedly: a grid.
    Even,
}

/// The maximum to spend; the first limit reached ends the search. At least one of the two is required.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BudgetConfig {
    /// Samples.
    #[schemars(range(min = 1, max = 1_000_000_000_000_u64))]
    pub n_samples: Option<u64>,
    /// Evaluations of the denoiser: arms with more steps cost more.
    #[schemars(range(min = 1, max = 1_000_000_000_000_000_u64))]
    pub n_evaluations: Option<u64>,
}

impl BudgetConfig {
    /// How many more samples of `n_evaluations` evaluations each the budget allows once `spent` (samples, evaluations)
    /// is spent.
    pub(super) fn samples_left(&self, (n_samples, n_spent): (u64, u64), n_evaluations: u64) -> u64 {
        let by_samples = self.n_samples.map(|most| most.saturating_sub(n_samples));
        let by_evaluations = self.n_evaluations.map(|most| most.saturating_sub(n_spent) / n_evaluations.max(1));
        by_samples.into_iter().chain(by_evaluations).min().unwrap_or(0)
    }

    /// The cost of a sample of this many evaluations, in the unit of the budget.
    pub(super) fn cost(&self, n_evaluations: u64) -> f64 {
        if self.n_evaluations.is_some() { n_evaluations.max(1) as f64 } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_budget_that_ends_first_counts() {
        let budget = BudgetConfig { n_samples: Some(100), n_evaluations: Some(1000) };
        assert_eq!(budget.samples_left((40, 400), 10), 60);
        assert_eq!(budget.samples_left((40, 800), 19), 10);
        assert_eq!(budget.samples_left((140, 0), 10), 0);
        assert_eq!(BudgetConfig { n_evaluations: None, ..budget }.samples_left((40, 800), 19), 60);
        assert!((budget.cost(19) - 19.0).abs() < 1e-12);
    }
}
