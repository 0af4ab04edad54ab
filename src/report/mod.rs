//! What does a reviewer see of a run? One self-contained HTML page with tables, charts and drawings to scale.
//!
//! [`ReportModel`] holds everything that is shown as plain data; [`render`] turns it into the page. Equal models give equal
//! bytes, and the page needs neither network nor script to be read.

mod distribution;
mod html;
mod model;
mod number;
mod quantities;
mod scene_card;
mod summaries;
mod svg;
mod tally;
mod wilson;

pub use distribution::{Distribution, DistributionSeries};
pub use html::render;
pub use model::{
    AcceptanceRow, BehaviorCount, BehaviorDoc, Chart, Curve, Fact, LeftOutRow, MetricDoc, MetricTable, MiningSummary,
    RealismRow, ReportModel, SamplingRow, TrainingSummary, ValidityRow, Warning,
};
pub use quantities::{MotionDistributions, event_distributions};
pub use scene_card::{DrawnAgent, DrawnLane, SceneCard, ScenePanel, ViewRect};
pub use tally::SamplingTally;
pub use wilson::{Interval, wilson_interval};
