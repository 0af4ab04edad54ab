//! Generated scenarios to figures and verdicts: how good are they, which are accepted, and do they pass?
//!
//! [`Measurer`] measures scenarios shard by shard, each shard by itself. The samples of one scene at one strength are a cell (`cells`),
//! measured as a whole and one by one (`measures`); each scenario is judged by itself (`judge`). [`Evaluation`] puts the shards
//! together in their order: scenarios are decided on (`verdicts`), rows of metrics and verdicts go to files, and what stays in memory
//! are counts and histograms of series. [`EvaluationSummary`] is what people and gates read.

mod cells;
mod config;
mod error;
mod evaluation;
#[cfg(test)]
mod evaluation_tests;
mod gates;
#[cfg(test)]
mod gates_tests;
mod judge;
mod map_fits;
mod measure;
mod measures;
mod metric_rows;
mod mining;
mod predictions;
mod realism;
mod sampling;
#[cfg(test)]
pub(crate) mod testing;
mod validity;
mod verdicts;
#[cfg(test)]
mod verdicts_tests;

pub use config::{EvaluateConfig, Keep};
pub use error::{Error, Result};
pub use evaluation::{Evaluated, Evaluation, EvaluationFiles, EvaluationSummary, KeptScenarios};
pub use gates::{GateResult, GatesConfig};
pub use map_fits::{MapFitRow, for_maps, map_fits};
pub use measure::{MeasuredShard, Measurer, Shard, ShardFigures, metric_docs};
pub use measures::MetricDoc;
pub use mining::{BehaviorCount, BehaviorDoc, MiningSummary, MiningTally};
pub use realism::RealismRow;
pub use sampling::SamplingRow;
pub use validity::ValidityRow;
pub use verdicts::{AcceptanceRow, LeftOutRow, left_out_by_sweep};
