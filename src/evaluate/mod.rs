//! Turns generated scenarios into figures and verdicts: how good are they, which are accepted, and do the gates pass?
//!
//! [`Measurer`] measures each shard of scenarios by itself. The samples of one scene at one strength are a cell
//! (`cells`); some measures take a cell as a whole, others each sample (`measures`). Each scenario is judged by itself
//! (`judge`). [`Evaluation`] merges the shards in their order: it decides on scenarios (`verdicts`), writes rows of
//! metrics and verdicts to files, and keeps only counts and histograms of series in memory. [`EvaluationSummary`] is
//! for people and gates.
//!
//! Verdicts come in the order of the samples, because the first of several near-duplicates is accepted. Rows of metrics
//! are spooled to files, because aggregates come first in the table but are known last.

mod bucket_rates;
mod cells;
mod config;
mod distinguishability;
mod error;
mod evaluation;
#[cfg(test)]
mod evaluation_tests;
mod gate_config;
mod gates;
#[cfg(test)]
mod gates_tests;
mod judge;
mod map_fits;
mod measure;
mod measures;
mod metric_rows;
mod mining;
mod sampling;
mod summary;
#[cfg(test)]
pub(crate) mod testing;
mod validity;
mod verdicts;
#[cfg(test)]
mod verdicts_tests;

pub use config::{EvaluateConfig, Keep};
pub use distinguishability::{DistinguishabilityRow, Distinguished, TellingFeatureRow, TrackPool};
pub use error::{Error, Result};
pub use evaluation::{Evaluated, Evaluation, EvaluationFiles, KeptScenarios};
pub use gate_config::GatesConfig;
pub use gates::of_requests;
pub use map_fits::{MapFitRow, MapFits};
pub use measure::{MeasuredShard, Measurer, Shard, ShardFigures};
pub use measures::MetricDoc;
pub use mining::{BehaviorCount, BehaviorDoc, MiningSummary, MiningTally};
pub use sampling::SamplingRow;
pub use summary::{EvaluationSummary, GateResult};
pub use validity::ValidityRow;
pub use verdicts::{AcceptanceRow, LeftOutRow, left_out_by_sweep};
