//! Generated scenarios to figures and verdicts: how good are they, which are accepted, and do they pass?
//!
//! [`Evaluation`] takes the scenarios shard by shard. The samples of one scene at one strength are a cell (`cells`), measured as a
//! whole and one by one (`measures`); each scenario is judged by itself (`judge`) and then decided on, in order (`verdicts`). What
//! is kept of them are rows: of metrics, of realism, of validity, and counts. [`EvaluationSummary`] is what people and gates read.

mod cells;
mod config;
mod error;
mod evaluation;
mod gates;
#[cfg(test)]
mod gates_tests;
mod judge;
mod map_fits;
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
pub use evaluation::{Evaluated, Evaluation, EvaluationSummary, KeptScenarios, Shard};
pub use gates::{GateResult, GatesConfig};
pub use map_fits::{MapFitRow, for_maps, map_fits};
pub use measures::MetricDoc;
pub use metric_rows::MetricRows;
pub use mining::{BehaviorCount, BehaviorDoc, MiningSummary, MiningTally};
pub use realism::RealismRow;
pub use sampling::SamplingRow;
pub use validity::ValidityRow;
pub use verdicts::{AcceptanceRow, LeftOutRow, left_out_by_sweep};
