//! What does a reviewer see of a run? One self-contained HTML page with tables, charts and drawings to scale.
//!
//! [`ReportModel`] holds everything that is shown as plain data; [`render`] turns it into the page and [`figures`] into files
//! for papers. [`Comparison`] sets two runs side by side. Equal models give equal bytes, and the page needs no network, and no
//! script to be read: with one, scenes play and can be filtered.

mod card;
mod comparison;
#[cfg(test)]
mod comparison_tests;
mod distribution;
mod figures;
mod html;
mod model;
mod number;
mod plain;
mod quantities;
mod summaries;
mod svg;
mod tally;
#[cfg(test)]
mod testing;
mod tradeoffs;
#[cfg(test)]
mod tradeoffs_tests;
mod wilson;

pub use card::{
    Acceptance, CardKey, CardValue, DrawnAgent, DrawnLane, DrawnSample, Sample, SceneCard, ScenePanel, Verdict,
    ViewRect,
};
pub use comparison::{ComparedRun, Comparison};
pub use distribution::{Distribution, DistributionSeries};
pub use figures::{FigureFile, figures};
pub use html::{PAGE_MARK, render, render_comparison};
pub use model::{
    AcceptanceRow, BehaviorCount, BehaviorDoc, Chart, Curve, Fact, LeftOutRow, MetricDoc, MetricTable, MiningSummary,
    RealismRow, ReportModel, SamplingRow, TrainingSummary, ValidityRow, Warning,
};
pub use plain::{PlainRow, PlainSection, PlainTable};
pub use quantities::{MotionDistributions, event_distributions};
pub use summaries::MiningTally;
pub use tally::SamplingTally;
pub use tradeoffs::tradeoffs;
pub use wilson::{Interval, wilson_interval};
