//! The report of a run: one self-contained HTML page with tables, charts and drawings to scale.
//!
//! [`ReportModel`] is its content as plain data; [`render`] turns it into the page and [`figures`] into files for
//! papers. Equal models give equal bytes. The page needs no network and is readable
//! without scripts; with scripts, scenes play and can be filtered.
//!
//! A page of thousands of scenes has still drawings of the first few, and a few kilobytes of packed states for each,
//! from which `html/player.js` draws the scenes that scroll into view.

mod accepted;
mod beside_recordings;
mod card;
mod cautions;
mod choice;
#[cfg(test)]
mod choice_tests;
mod config;
mod distinguishability;
mod distribution;
mod drives;
mod figures;
mod figures_of_scenarios;
mod gallery;
mod html;
mod model;
mod number;
mod plain;
mod quantities;
mod svg;
mod tradeoffs;
#[cfg(test)]
mod tradeoffs_tests;
mod training;

pub use accepted::{Accepted, HardnessSummary};
pub use card::{
    Acceptance, CardBucket, CardKey, CardValue, DrawnAgent, DrawnLane, DrawnSample, Light, Sample, SceneCard,
    ScenePanel, Verdict, ViewRect,
};
pub use cautions::cautions;
pub use choice::Drawn;
pub use config::ReportConfig;
pub use distribution::{Distribution, DistributionSeries};
pub use drives::{DriveCell, DriveGrid, DrivesPage};
pub use figures::{FigureFile, drawing_of_recording, figures};
pub use gallery::{Drawings, Gallery};
pub use html::{render, render_drives};
pub use model::{Chart, Curve, Fact, ReportModel, TrainingSummary, Warning};
pub use plain::{PlainRow, PlainSection, PlainTable};
pub use quantities::{EventParameters, MotionDistributions, event_distributions};
pub use tradeoffs::tradeoffs;
